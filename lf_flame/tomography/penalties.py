"""Kinds of regularisation: of the roughness of emission, or of its total variation."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from lf_flame.errors import InputError
from lf_flame.tomography.frustum_grid import FEW_PLANES, FrustumGrid
from lf_flame.tomography.resolution import depth_blur, finest_period

ROUGHNESS, VARIATION = "roughness", "variation"
PENALTIES = ROUGHNESS, VARIATION
"""Names of the kinds with their default options."""

ROUGHNESS_ORDER = 3
"""Order of the differences that are penalised: third, quadratic in the third derivatives of the
emission. It hardly changes flames of millimetres; first or second differences shift light from
plane to plane at strengths too low to help against noise."""

DEPTH_WEIGHT, DEPTH_LENGTH = 1e-4, 0.5
"""Weight of a penalty on third differences along depth, relative to the square of the number of
views, for planes at a distance of this fraction of the finest depth blur. The light field hardly
distinguishes the light of many planes; without this penalty one plane has too much and the next too
little."""


@dataclass(frozen=True)
class Roughness:
    """Penalty on squared differences between neighbouring cells, for smooth emission.

    Parameters
    ----------
    nonnegative : bool, optional
        Whether emission is kept at 0 or above; if not, the fit is linear.
    dark_cells : bool, optional
        Whether light that is hardly brighter than noise alone would make it is set to 0, unless the
        light field contradicts this: see `lf_flame.tomography.foreground`.
    corrected : bool, optional
        Whether the effect of penalty and constant cells on a flame is computed and corrected: see
        `lf_flame.tomography.plane_fit.PlaneFit.correct`. A linear fit is never corrected.
    whole_curve : bool, optional
        Whether all strengths are tried, for the L-curve, instead of the few that are needed.

    Examples
    --------
    A plain linear fit:

    >>> from lf_flame.tomography import Roughness
    >>> penalty = Roughness(nonnegative=False)
    >>> penalty.corrects
    False
    """

    nonnegative: bool = True
    dark_cells: bool = True
    corrected: bool = True
    whole_curve: bool = False

    @property
    def corrects(self) -> bool:
        """Whether fits are corrected."""
        return self.corrected and self.nonnegative


@dataclass(frozen=True)
class TotalVariation:
    """Penalty on the length of lateral gradients, for emission with sharp edges, 0 or above.

    Its strength is in standard deviations of a cell's filtered noise. It has no options.
    """

    corrects: ClassVar[bool] = False


Penalty = Roughness | TotalVariation


def as_penalty(penalty: str | Penalty) -> Penalty:
    """Turn the name of a penalty into the penalty with its default options.

    Raises
    ------
    InputError
        If it is neither a known name nor a penalty.
    """
    if isinstance(penalty, Roughness | TotalVariation):
        return penalty
    if penalty == ROUGHNESS:
        return Roughness()
    if penalty == VARIATION:
        return TotalVariation()
    raise InputError(
        f"penalty must be one of {', '.join(PENALTIES)}, or a Roughness with its options, got "
        f"{penalty!r}."
    )


def depth_roughness(grid: FrustumGrid) -> np.ndarray:
    """Penalty along depth for many evenly spaced planes; zeros otherwise.

    It is the integral of the squared third derivative of the emission per mm, so that it does not
    depend on the spacing of planes in a volume: for planes with light x at a distance d, it is
    ``sum (D3 x)^2 / d^7``.

    Returns
    -------
    ndarray of float64, shape (planes, planes)
        Penalty relative to `FrequencyGram.scale`.
    """
    count, steps = len(grid.depths_mm), np.diff(grid.depths_mm)
    if count <= FEW_PLANES or np.ptp(steps) > 1e-6 * abs(steps[0]):
        return np.zeros((count, count))
    length = DEPTH_LENGTH * depth_blur(grid.camera, finest_period(grid.camera, grid.block))
    differences = np.diff(np.eye(count), 3, axis=0)
    return DEPTH_WEIGHT * (length / abs(steps[0])) ** 7 * (differences.T @ differences)
