"""Emission of an axisymmetric flame with an upright axis from one light field: Abel inversion.

For one view with parallel rays this is Abel's integral equation (Hansen and Law, J. Opt. Soc. Am. A
2, 510, 1985, for its numerical side). Here rays are those of the camera, all views are used, and
the fit is regularised and without negative light.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from lf_flame.lightfield import LightField
from lf_flame.tomography.axisymmetric.axis import FlameAxis, find_axis
from lf_flame.tomography.axisymmetric.grid import AxisymmetricGrid
from lf_flame.tomography.axisymmetric.roundness import (
    check_misfit,
    check_roundness,
    check_stated,
    name_unseen,
)
from lf_flame.tomography.axisymmetric.section_fit import SectionFit
from lf_flame.tomography.data_checks import check_data, check_range
from lf_flame.tomography.error_bars import bar_times, check_bootstrap, noise_variance
from lf_flame.tomography.fitted_views import average_blocks, fitted_views
from lf_flame.tomography.strength_search import check_noise_and_strength


@dataclass(frozen=True, eq=False)
class AxisymmetricFlame:
    """Emission of an axisymmetric flame by height and radius, with errors and warnings.

    Attributes
    ----------
    grid : AxisymmetricGrid
        Nodes of the half section.
    emission : ndarray of float32, shape (heights, radii)
        Emission along the line of sight, in the light field's unit per mm. If that unit is a
        radiance, 4 pi times the emission is power per volume.
    draws : ndarray of float32, shape (draws, heights, radii)
        Random draws of emission (bootstrap) that light field and penalty allow.
    noise : float
        Standard deviation of a pixel's noise, stated or measured.
    strength : float
        Strength of the regularisation that was used.
    chi_squared : ndarray of float64, shape (v, u)
        Mean squared residual of each view, in units of the noise's variance; NaN of views that
        are not fitted.
    warnings : tuple of str
        Sentences on disagreements of data and model.
    unseen : tuple of str
        Departures from an upright, axisymmetric flame that this light field would not show.
    """

    grid: AxisymmetricGrid
    emission: np.ndarray
    draws: np.ndarray
    noise: float
    strength: float
    chi_squared: np.ndarray
    warnings: tuple[str, ...]
    unseen: tuple[str, ...] = ()

    @property
    def sigma(self) -> np.ndarray | None:
        """Standard deviation of each node due to noise and penalty, None without draws."""
        return self.draws.std(axis=0, ddof=1) if len(self.draws) else None

    @property
    def bar(self) -> np.ndarray | None:
        """Half-width of each node's 95 % error bar, None without draws."""
        if self.sigma is None:
            return None
        # With few draws the standard deviation is uncertain: Student's t.
        return (bar_times(len(self.draws) - 1) * self.sigma).astype(np.float32)


def reconstruct_axisymmetric(
    light_field: LightField,
    grid: AxisymmetricGrid,
    *,
    noise: float | None = None,
    strength: float | None = None,
    bootstrap: int = 0,
    rng: int | np.random.Generator | None = 0,
) -> AxisymmetricFlame:
    """Find the emission of an axisymmetric flame that explains a light field.

    Parameters
    ----------
    light_field : LightField
        Grey light field of the grid's camera, black level subtracted, divided by a white image
        (flat field). If the grid uses only the central view, that view alone is enough.
    grid : AxisymmetricGrid
        Grid with the axis, as `lf_flame.tomography.find_axis` finds it or as it is known.
    noise : float, optional
        Standard deviation of a pixel's noise, averaged over the grid's blocks. Default: measured
        from the part that no axisymmetric flame on the grid explains.
    strength : float, optional
        Strength of the regularisation, a penalty on third differences. Default: the strength with
        the least expected error of the light field, see `StrengthSearch.find_by_risk`.
    bootstrap : int, optional
        Number of draws for the error bars, 0, or 2 and more: noise with the measured dependence on
        brightness is added to the light field and to the prior, and the fit is repeated
        (`AxisymmetricFit.draw`).
    rng : int, numpy.random.Generator or None, optional
        Seed or generator of the bootstrap, and of vectors that estimate degrees of freedom; with
        None every call draws differently.

    Returns
    -------
    AxisymmetricFlame
        Emission with error bars and warnings.

    Raises
    ------
    InputError
        If light field and grid do not match, or a value cannot be used.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from lf_flame import PAPER_CAMERA
    >>> from lf_flame.tomography import AxisymmetricGrid
    >>> camera = replace(PAPER_CAMERA, views=3, lenslets=(24, 40))
    >>> grid = AxisymmetricGrid(camera, axis_mm=0.0, depth_mm=0.0, radius_mm=1.5)

    >>> import numpy as np
    >>> from lf_flame import LightField
    >>> from lf_flame.tomography import AxisymmetricOperator, reconstruct_axisymmetric
    >>> glow = np.outer(np.ones(grid.shape[0]), np.exp(-4 * grid.radii_mm**2))
    >>> operator = AxisymmetricOperator(grid)
    >>> views = np.reshape(operator @ glow.ravel(), operator.dimsd)
    >>> found = reconstruct_axisymmetric(LightField(views), grid)
    >>> bool(np.abs(found.emission - glow)[2:-2].max() < 0.02)  # but at the field's edges
    True
    """
    check_fit_options(noise, strength, bootstrap)
    looked = look_at(light_field, grid)
    check_range(looked.views, noise)
    rng = np.random.default_rng(rng)
    fit = SectionFit(looked.grid, looked.views, noise, rng)
    stated = noise is not None
    return explain_views(looked, fit, strength, stated=stated, bootstrap=bootstrap, rng=rng)


class Looked(NamedTuple):
    """Views of a light field that a fit uses, and what is seen of the axis in them.

    Attributes
    ----------
    views : ndarray of float32, shape (v, u, t, s)
        Fitted views in the grid's pixels, as `AxisymmetricGrid.pick` gives them.
    grid : AxisymmetricGrid
        Grid of the views that count.
    axis : FlameAxis
    said : tuple of str
        Sentences on views and pixels that are left out.
    """

    views: np.ndarray
    grid: AxisymmetricGrid
    axis: FlameAxis
    said: tuple[str, ...]


def look_at(light_field: LightField, grid: AxisymmetricGrid) -> Looked:
    """Select the views that a fit uses, averaged over the grid's blocks, and find the axis."""
    said: tuple[str, ...] = ()
    even = grid.camera.corrected(light_field)
    if grid.which == "all":
        grid, said = fitted_views(even, grid)
    views = _pixels(even, grid)
    if light_field.unknown:
        said = (*said, f"{light_field.unknown}.")
    depth = grid.depth_mm if light_field.views.shape[1] < 3 else None
    return Looked(views, grid, find_axis(light_field, grid.camera, depth), said)


def explain_views(
    looked: Looked,
    fit: SectionFit,
    strength: float | None,
    *,
    stated: bool,
    bootstrap: int,
    rng: np.random.Generator,
    of_prior: np.random.Generator | None = None,
) -> AxisymmetricFlame:
    """Solve a fit, draw its errors, and compare data and model.

    Parameters
    ----------
    looked : Looked
    fit : SectionFit
        Fit to the looked-at views, or to these with a correction.
    strength : float or None
        Strength of the regularisation; None for that of least expected error.
    stated : bool
        Whether the noise was stated.
    bootstrap : int
    rng : numpy.random.Generator
    of_prior : numpy.random.Generator, optional
        See `SectionFit.draw`.
    """
    grid, section, views = looked.grid, fit.solve(strength), fit.views
    residual = section.residual
    power = np.square(residual, dtype=np.float64).mean(axis=(2, 3))
    chi_squared = grid.place(power / noise_variance(fit.noise), np.nan)
    draws = fit.draw(section, bootstrap, rng, of_prior)
    depth_ratio = fit.depth_ratio(section)
    # An axis that is not straight may also seem to lean.
    departures = check_stated(looked.axis, grid, views) + check_roundness(looked.axis)
    # A wrong axis or radius would look like another depth ratio.
    departures = departures or depth_ratio.check()
    misfit = check_misfit(grid, residual, float(views.max()))
    # What the misfit already says is not said again.
    checked = None if misfit else residual
    said = check_data(
        views, chi_squared, fit.noise, fit.measured, stated, residual=checked,
        correlation=fit.correlation,
    )  # fmt: skip
    return AxisymmetricFlame(
        grid=grid,
        emission=values_at_nodes(section.cells[0]).astype(np.float32),
        draws=values_at_nodes(draws).astype(np.float32),
        noise=fit.noise,
        strength=section.options.strength,
        chi_squared=chi_squared,
        warnings=(*looked.said, *departures, *misfit, *said),
        unseen=name_unseen(looked.axis, depth_ratio),
    )


def values_at_nodes(heights: ArrayLike) -> np.ndarray:
    """Emission at the nodes of a smooth flame that is fitted by straight lines between nodes.

    The straight lines with the least squared distance from a smooth function f miss it at the nodes
    by ``-step^2 f'' / 12`` along each axis. Along height nothing is added to the two rows beside
    the field's edges and the burner: nodes there, of which little is seen, would spoil f''.

    Parameters
    ----------
    heights : array_like, shape (..., heights, radii)
        Fitted emission at the nodes, linear between them, 0 or above.

    Returns
    -------
    ndarray, shape (..., heights, radii)
        Emission, 0 or above.
    """
    fitted = np.asarray(heights)
    curved = np.zeros_like(fitted)
    curved[..., 2:-2, :] = np.diff(fitted[..., 1:-1, :], 2, axis=-2)
    beyond = np.zeros_like(fitted[..., :1])  # no emission
    mirrored = np.concatenate([fitted[..., 1:2], fitted, beyond], axis=-1)
    return fitted + (curved + np.diff(mirrored, 2, axis=-1)) / 12


def _pixels(light_field: LightField, grid: AxisymmetricGrid) -> np.ndarray:
    """Average the used views over blocks."""
    if grid.which == "central" and light_field.views.shape[:2] == (1, 1):
        alone = grid.camera.with_views(1)
        return average_blocks(light_field, alone, grid.block)
    return grid.pick(average_blocks(light_field, grid.camera, grid.block))


def check_fit_options(noise: float | None, strength: float | None, bootstrap: int) -> None:
    """Refuse unusable options of a fit before any computation.

    Raises
    ------
    InputError
        If noise or strength is negative, not finite or too large, or the number of draws is 1 or
        negative.
    """
    check_noise_and_strength(noise, strength)
    check_bootstrap(bootstrap)
