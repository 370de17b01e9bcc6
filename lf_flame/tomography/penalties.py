"""Kinds of regularisation: of the roughness of emission, or of its total variation."""

from dataclasses import dataclass
from typing import ClassVar

from lf_flame.errors import InputError

ROUGHNESS, VARIATION = "roughness", "variation"
PENALTIES = ROUGHNESS, VARIATION
"""Names of the kinds with their default options."""


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
