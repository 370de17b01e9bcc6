"""Emission from one light field, on depth planes or of an axisymmetric flame, with error bars."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from lf_flame.errors import InputError
from lf_flame.lightfield import LightField
from lf_flame.optics.lens import Lens
from lf_flame.refocus import align_views
from lf_flame.refocus._arguments import refuse_excluded
from lf_flame.tomography.absorption import MOST_FITS, Absorption, spread_thickness
from lf_flame.tomography.axisymmetric_grid import AxisymmetricGrid
from lf_flame.tomography.data_checks import axis_checks, data_checks, depth_checks, left_out
from lf_flame.tomography.emission import Emission
from lf_flame.tomography.fit import Explanation, Fit, FitOptions, check_bootstrap
from lf_flame.tomography.frustum_grid import FrustumGrid
from lf_flame.tomography.geometries import PlaneGeometry, geometry_of
from lf_flame.tomography.noise import Level, fit_background, noise_variance

Grid = FrustumGrid | AxisymmetricGrid

LARGEST = 1e15
"""Largest value of a light field: the fit sums squares of squares of pixels in float64."""


def reconstruct(
    light_field: LightField,
    grid: FrustumGrid,
    *,
    noise: float | None = None,
    strength: float | None = None,
    bootstrap: int = 0,
    rng: int | np.random.Generator | None = 0,
    optical_thickness: ArrayLike | None = None,
    background: str = "fit",
) -> Emission:
    """Find the emission on a grid's depth planes that explains a light field.

    It is a least-squares fit with regularisation (a penalty on roughness) and no negative light.
    The strength follows the discrepancy principle (Morozov 1966): the residual must equal the
    noise, reduced by the degrees of freedom of the fit (Wahba, SIAM J. Numer. Anal. 14, 651, 1977).

    Parameters
    ----------
    light_field : LightField
        Grey light field of the grid's camera, black level subtracted, divided by a white image
        (flat field). Unknown pixels (`LightField.valid`) have weight 0.
    grid : FrustumGrid
        Depth planes and cells.
    noise : float, optional
        Standard deviation of a pixel's noise in the unit of the light field (of the mean of a block
        of pixels, if the grid's cells are blocks), above 0. Default: measured from the residual
        that no emission on the grid can make.
    strength : float, optional
        Strength of the regularisation, above 0. Default: by the discrepancy principle.
    bootstrap : int, optional
        Number of bootstrap light fields, each made of the found emission and new noise, with the
        measured dependence of noise on brightness, and fitted again for `Emission.sigma`: 0, or 2
        and more.
    rng : int, numpy.random.Generator or None, optional
        Seed or generator of the bootstrap; with None every call draws differently.
    optical_thickness : float, or array_like of shape (planes,) or (planes, rows, columns), optional
        Known absorption along the line of sight, 0 or above: the total, spread evenly over the
        planes, or a value for each plane, or for each plane and pixel of the central view. Like a
        `Layer`, a plane transmits ``(1 - exp(-tau)) / tau`` of its own light and ``exp(-tau)`` of
        the light from behind it, at greater depth. The penalty then acts on what is left of the
        emission after its own absorption. Default: no absorption.
    background : {"fit", "none"}, optional
        "fit" subtracts a uniform background, the mean of the pixels that no emission reaches, if
        there are such pixels; its error is in the error bars. "none" assumes that black is 0.

    Returns
    -------
    Emission
        Emission of shape (planes, rows, columns) in the unit of the light field, with warnings,
        and with error bars if `bootstrap` is not 0.

    Raises
    ------
    InputError
        If light field and grid do not match, or a value cannot be used.

    Examples
    --------
    >>> from dataclasses import replace
    >>> import numpy as np
    >>> from lf_flame import PAPER_CAMERA, render
    >>> from lf_flame.tomography import FrustumGrid
    >>> camera = replace(PAPER_CAMERA, views=5, lenslets=(32, 40))
    >>> grid = FrustumGrid(camera, [6.0, -6.0])

    >>> y, x = np.mgrid[-1:1:32j, -1:1:40j]
    >>> glow = np.exp(-8 * (x**2 + y**2))
    >>> cells = np.zeros(grid.shape)
    >>> grid.crop(cells)[...] = glow, 0.5 * glow  # crop: the cells within the central view
    >>> light_field = render(grid.scene(cells), camera)
    >>> from lf_flame.tomography import reconstruct
    >>> found = reconstruct(light_field, grid, noise=0.001)
    >>> bool(np.abs(found.emission - grid.crop(cells)).max() < 0.1)
    True
    """
    plan = ReconstructionPlan(
        grid,
        noise=noise,
        strength=strength,
        optical_thickness=optical_thickness,
        background=background,
    )
    return plan.reconstruct(light_field, bootstrap=bootstrap, rng=rng)


def reconstruct_axisymmetric(
    light_field: LightField,
    grid: AxisymmetricGrid,
    *,
    noise: float | None = None,
    strength: float | None = None,
    bootstrap: int = 0,
    rng: int | np.random.Generator | None = 0,
    background: str = "fit",
) -> Emission:
    """Find the emission of an axisymmetric flame that explains a light field: Abel inversion.

    For one view with parallel rays this is Abel's integral equation (Hansen and Law, J. Opt. Soc.
    Am. A 2, 510, 1985, for its numerical side). Here rays are those of the camera, all views are
    used, and the fit is regularised and without negative light. The strength of the penalty is that
    of the least expected error of the light field (Mallows, Technometrics 15, 661, 1973).

    Parameters
    ----------
    light_field : LightField
        Grey light field of the grid's camera, black level subtracted, divided by a white image
        (flat field). If the grid uses only the central view, that view alone is enough.
    grid : AxisymmetricGrid
        Grid with the axis, as `lf_flame.tomography.find_axis` finds it or as it is known.
    noise, strength, bootstrap, rng, background
        As for `reconstruct`; a background is measured in the columns beyond the grid's radius.

    Returns
    -------
    Emission
        Emission of shape (heights, radii), per mm, with warnings and error bars.

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
    plan = ReconstructionPlan(grid, noise=noise, strength=strength, background=background)
    return plan.reconstruct(light_field, bootstrap=bootstrap, rng=rng)


class ReconstructionPlan:
    """Everything of `reconstruct` that does not depend on the light field, for videos.

    Parameters
    ----------
    grid : FrustumGrid or AxisymmetricGrid
        Depth planes and cells, or nodes of a half section.
    noise, strength, optical_thickness, background
        As for `reconstruct`; the thickness of a half section is absorption per mm at its nodes.

    Raises
    ------
    InputError
        If a value cannot be used.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from lf_flame import PAPER_CAMERA, render
    >>> from lf_flame.scenes.flames import flame_texture
    >>> from lf_flame.tomography import FrustumGrid, ReconstructionPlan
    >>> camera = replace(PAPER_CAMERA, views=5, lenslets=(32, 40))
    >>> plan = ReconstructionPlan(FrustumGrid(camera, [6.0, -6.0]))

    >>> from lf_flame import Layer, Scene
    >>> last = None
    >>> for height in (2.0, 2.2):
    ...     flame = Layer(flame_texture(height, 0.3, cell_mm=0.05), 6.0, (height, 1.92))
    ...     last = plan.reconstruct(render(Scene([flame]), camera), start=last)
    >>> last.emission.shape
    (2, 32, 40)
    """

    def __init__(
        self,
        grid: Grid,
        *,
        noise: float | None = None,
        strength: float | None = None,
        optical_thickness: ArrayLike | None = None,
        background: str = "fit",
    ):
        if background not in ("fit", "none"):
            raise InputError(f"background must be 'fit' or 'none', got {background!r}.")
        self.grid, self._background = grid, background
        self._options = FitOptions(noise, strength)
        self._thickness = None
        if optical_thickness is not None:
            self._thickness = spread_thickness(grid, optical_thickness)
        self._geometry = geometry_of(grid)
        self._absorption: Absorption | None = None

    def absorbing(
        self, optical_thickness: ArrayLike | None, *, strength: float | None = None
    ) -> ReconstructionPlan:
        """Plan with the same operators and options, another thickness, and a strength if given."""
        plan = copy.copy(self)
        if strength is not None:
            plan._options = replace(self._options, strength=strength)
        plan._thickness = plan._absorption = None
        if optical_thickness is not None:
            plan._thickness = spread_thickness(self.grid, optical_thickness)
        return plan

    def reconstruct(
        self,
        light_field: LightField,
        *,
        start: Emission | None = None,
        bootstrap: int = 0,
        rng: int | np.random.Generator | None = 0,
        prior_rng: np.random.Generator | None = None,
        fits: int = MOST_FITS,
    ) -> Emission:
        """Find the emission that explains a light field.

        Parameters
        ----------
        light_field : LightField
            As for `reconstruct`.
        start : Emission, optional
            Result of the frame before. The fit starts from it, and takes from it the strength, and
            how noise depends on pixel and brightness, and is correlated. Default: the light field
            alone decides.
        bootstrap, rng
            As for `reconstruct`.
        prior_rng : numpy.random.Generator, optional
            Generator of the bootstrap's prior and multiples of the correction. Colours of one flame
            share it, each with a new one of the same seed: penalty and cells affect all
            colours equally, and their ratios not at all. Default: `rng`.
        fits : int, optional
            Largest number of fits until the correction for absorption converges.

        Returns
        -------
        Emission

        Raises
        ------
        InputError
            If the light field does not match the grid, or `start` is of another grid.
        """
        check_bootstrap(bootstrap)
        rng = np.random.default_rng(rng)
        grid, views, valid = _fitted_views(self.grid.camera.corrected(light_field), self.grid)
        checks = left_out(grid, valid)
        geometry = self._prepare(grid)
        before = None if start is None else _checked_start(start, grid)
        fit = Fit(geometry, self._options, valid, before)
        measured = fit_background(views, geometry, valid) if self._background == "fit" else None
        level = measured or Level()
        if level.mean:
            views = views - np.float32(level.mean)
        found, excess = self._explain(fit, views, before, fits)
        level = level._replace(error=level.error * found.shared)  # pixels are correlated
        # Fit, correction and draws are light that leaves towards the camera, whose noise absorption
        # does not change.
        thin = views if excess is None else views - excess
        correction = fit.correct(found)
        drawn = fit.redraw(found, thin, correction, level.error, bootstrap, rng, prior_rng or rng)
        draws = [self._leaving(one) for one in drawn]
        emission = self._leaving(found.cells + correction)
        seen = geometry.smooth_views(found.cells + correction)
        known = thin if valid is None else np.where(valid, thin, seen)
        residual = (known - seen).astype(np.float32, copy=False)
        chi_squared = grid.place(_chi_squared(residual, valid, found.noise), np.nan)
        if isinstance(geometry, PlaneGeometry):
            checks = depth_checks(geometry.grid, emission) + checks
        else:
            checks += axis_checks(light_field, geometry, known)
        fitted = bool(measured) if self._background == "fit" else None
        whole = known if excess is None else known + excess
        checks += data_checks(
            whole, grid.place(residual), chi_squared, found,
            stated=self._options.noise is not None, fitted_background=fitted,
        )  # fmt: skip
        return Emission(
            grid=grid,
            emission=emission,
            correction=self._leaving(correction),
            draws=np.array(draws, np.float32).reshape(-1, *emission.shape),
            noise=found.noise,
            strength=found.strength,
            chi_squared=chi_squared,
            checks=tuple(checks),
            fit=found,
            background=level.mean,
            background_sigma=level.error,
        )

    def _explain(
        self, fit: Fit, views: np.ndarray, before: Explanation | None, fits: int
    ) -> tuple[Explanation, np.ndarray | None]:
        """Fit a light field; the excess is what absorption adds to or takes from single views."""
        if self._absorption is None:
            return fit.explain(views), None
        found, settled = self._absorption.settle(views, fit.explain, before, fits)
        return replace(found, settled=settled), self._absorption.excess(found.cells)

    def _leaving(self, cells: np.ndarray) -> np.ndarray:
        """Emission at the result's pixels or nodes, for the light that leaves each cell."""
        if self._absorption is not None:
            cells = cells / self._absorption.transmission
        cells = self.grid.crop(cells) if isinstance(self.grid, FrustumGrid) else cells
        return np.ascontiguousarray(cells, np.float32)

    def _prepare(self, grid: Grid):
        """Keep the operators of the views with weight, made anew where others have weight."""
        if not _matches(grid, self._geometry.grid):
            self._geometry, self._absorption = geometry_of(grid), None
        if self._absorption is None and self._thickness is not None:
            self._absorption = Absorption(self._geometry.operator, grid, self._thickness)
        return self._geometry


def _fitted_views(
    light_field: LightField, grid: Grid
) -> tuple[Grid, np.ndarray, np.ndarray | None]:
    """Pick the views that a grid fits, in its pixels: grid, views, and which rays are known.

    A ray is known if all pixels of its block are; None if all are.
    """
    camera = grid.camera
    if isinstance(grid, AxisymmetricGrid) and grid.which == "central":
        v, u = light_field.views.shape[:2]
        if (v, u) == (1, 1):
            camera = camera.with_views(1)
        refuse_excluded(light_field, [(v // 2, u // 2)], "A fit of the central view")
    elif light_field.weights is not None and light_field.weights.shape == (camera.views,) * 2:
        weights = light_field.weights
        some = weights[weights > 0]
        if np.ptp(some) > 0:
            raise InputError(
                f"A fit needs views of equal weight, or of weight 0, got weights from "
                f"{some.min():g} to {some.max():g}."
            )
        used_views = weights > 0 if grid.used_views is None else (weights > 0) & grid.used_views
        grid = replace(grid, used_views=used_views)
    views = grid.pick(_average_blocks(light_field, camera, grid.block))
    largest = max(float(views.max()), -float(views.min()))
    if not largest <= LARGEST:
        raise InputError(
            f"The light field's values must be finite, at most {LARGEST:g}, got {largest:g}."
        )
    if light_field.valid is None:
        return grid, views, None
    one = LightField.trusted(light_field.valid.astype(np.float32))
    known = _average_blocks(one, camera, grid.block) > 1 - 1 / (2 * grid.block**2)
    return grid, views, grid.pick(known)


def _average_blocks(light_field: LightField, camera: Lens, block: int) -> np.ndarray:
    """Average blocks of a camera's lenslets, float32, shape (v, u, t, s)."""
    views = light_field.filled
    wanted = (camera.views, camera.views, *camera.lenslets)
    if views.shape != wanted:
        hint = "; in colour, take its mean (`grey`) or --colours" if views.ndim == 5 else ""
        raise InputError(
            f"The light field must be grey, of the camera's {wanted[0]} x {wanted[1]} views of "
            f"{wanted[2]} x {wanted[3]} lenslets, got an array of shape {views.shape}{hint}."
        )
    if block == 1:
        return views
    # Alignment at slope 0 is the identity; it averages blocks at the speed of reading.
    indices = [(v, u) for v in range(camera.views) for u in range(camera.views)]
    aligned = align_views(views, 0.0, indices, block=(block, block))
    return aligned.reshape(*views.shape[:2], *aligned.shape[1:])


def _matches(grid: Grid, other: Grid) -> bool:
    """Whether two grids have the same cells or nodes, and fit the same views."""
    return grid == other and np.array_equal(
        np.asarray(grid.used_views), np.asarray(other.used_views)
    )


def _checked_start(start: Emission, grid: Grid) -> Explanation:
    """Fit from which to start; refused if it is of another grid."""
    if not _matches(grid, start.grid):
        raise InputError(
            f"start must be a reconstruction on the plan's grid with the same views, got one of "
            f"{start.grid.view_count} views on {start.grid}."
        )
    return start.fit


def _chi_squared(residual: np.ndarray, valid: np.ndarray | None, noise: float) -> np.ndarray:
    """Mean squared residual of each view in units of the noise's variance; NaN if none is known."""
    power = np.einsum("vuts,vuts->vut", residual, residual).sum(axis=2, dtype=np.float64)
    rays = np.prod(residual.shape[2:]) if valid is None else valid.sum(axis=(2, 3))
    with np.errstate(invalid="ignore"):
        return power / rays / noise_variance(noise)
