"""Emission by depth from one light field: fit, strength of the penalty, error bars, warnings."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage

from lf_flame.errors import InputError
from lf_flame.lightfield import LightField
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.tomography.absorption import Absorption, spread_thickness
from lf_flame.tomography.data_checks import check_data
from lf_flame.tomography.frequency_gram import ROUGHNESS_ORDER, FrequencyGram
from lf_flame.tomography.frustum_grid import FrustumGrid
from lf_flame.tomography.penalised_fit import RIDGE, RangeFit
from lf_flame.tomography.projection_operator import ProjectionOperator
from lf_flame.tomography.strength_search import StrengthSearch, TriedStrength

ITERATIONS = 160
"""Of the splitting, for the solution. For each strength that is tried an eighth of them, from the
last one's."""

UNSETTLED = (
    "The correction for absorption has not settled: emission and optical thickness do not go "
    "together, or the thickness is too large."
)

NOISE_BLOCK = 5
"""Pixels along each axis over which the noise of a place is averaged."""


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """Emission by depth, and how far to trust it.

    Attributes
    ----------
    grid : FrustumGrid
    emission : ndarray of float32, shape (planes, rows, columns)
        Radiance that each plane adds along the line of sight, in the unit of the light field;
        rows and columns are the pixels of the central view. `per_mm` is emission by volume. With
        an optical thickness, the radiance that each would add if nothing were absorbed.
    draws : ndarray of float32, shape (redraws, planes, rows, columns)
        Emission of light fields that were drawn anew from what was found, with noise.
    sigma_linear : ndarray of float64, shape (planes,)
        That of each plane's cells by the covariance, were light allowed to be negative: how much
        the bound at zero adds to what the light field itself tells.
    noise : float
        Standard deviation of the noise of a pixel, stated or measured, in the same unit.
    strength : float
        Of the penalty that was taken.
    tried : tuple of TriedStrength
        The L-curve: what was tried to find it, weakest first.
    chi_squared : ndarray of float64, shape (v, u)
        Mean squared residual of each view, in units of the noise's variance.
    warnings : tuple of str
        Where data and model disagree.
    """

    grid: FrustumGrid
    emission: np.ndarray
    draws: np.ndarray
    sigma_linear: np.ndarray
    noise: float
    strength: float
    tried: tuple[TriedStrength, ...]
    chi_squared: np.ndarray
    warnings: tuple[str, ...]

    @cached_property
    def sigma(self) -> np.ndarray | None:
        """Standard deviation of each cell by the light field's noise, None where nothing was drawn.

        float32, shape of `emission`; the penalty's pull is not in it.
        """
        return np.std(self.draws, axis=0, ddof=1) if len(self.draws) else None

    @property
    def light_sigma(self) -> np.ndarray | None:
        """Give the same of the sum over each plane's cells, float64, shape (planes,)."""
        if not len(self.draws):
            return None
        return np.std(self.draws.sum(axis=(2, 3), dtype=np.float64), axis=0, ddof=1)

    @property
    def spacing_mm(self) -> float | None:
        """Distance between neighbouring planes, where all are as far apart."""
        steps = np.abs(np.diff(self.grid.depths_mm))
        return float(steps[0]) if steps.size and np.ptp(steps) <= 1e-6 * steps[0] else None

    @property
    def per_mm(self) -> np.ndarray:
        """Emission by length of the line of sight: each plane's over the planes' distance.

        Radiance per mm, shape of `emission`; times 4 pi, power per volume where the light field
        is in radiance.

        Raises
        ------
        InputError
            If the planes are not evenly spaced.
        """
        if self.spacing_mm is None:
            raise InputError(
                f"Emission by volume needs two or more evenly spaced planes, got the depths "
                f"{list(self.grid.depths_mm)}."
            )
        return self.emission / np.float32(self.spacing_mm)


def reconstruct(
    light_field: LightField,
    grid: FrustumGrid,
    noise: float | None = None,
    strength: float | None = None,
    order: int = ROUGHNESS_ORDER,
    nonnegative: bool = True,
    iterations: int = ITERATIONS,
    whole_curve: bool = False,
    redraws: int = 0,
    rng: np.random.Generator | None = None,
    optical_thickness: ArrayLike | None = None,
) -> Reconstruction:
    """Find the emission of the planes of a grid that explains a light field.

    Least squares with a penalty on roughness and no negative light. The strength of the penalty
    follows the discrepancy principle (Morozov 1966): the residual is to be what noise leaves, less
    the degrees of freedom that the fit itself takes up (Wahba, SIAM J. Numer. Anal. 14, 651, 1977),
    here the trace of the linear fit times the share of cells above zero. Where the model's own
    error keeps the residual above that, the strength is taken at which it is least above it.

    Parameters
    ----------
    light_field : LightField
        Grey, of the grid's camera; black level subtracted, divided by a white image.
    grid : FrustumGrid
    noise : float, optional
        Standard deviation of a pixel's noise, after averaging over blocks, in the unit of the
        light field. Default: measured, as what no emission on the grid explains.
    strength : float, optional
        Of the penalty, instead of the principle's.
    order : int, optional
        Of the differences that are penalised: 1 to 4.
    nonnegative : bool, optional
    iterations : int, optional
        Of the splitting that keeps light from being negative.
    whole_curve : bool, optional
        Whether all strengths are tried, for the L-curve, instead of the few that are needed.
    redraws : int, optional
        Light fields of the found emission that are drawn with new noise, as uneven as that found,
        and fitted again, for `Reconstruction.sigma`: 0, or 2 and more.
    rng : numpy.random.Generator, optional
        Needed for redraws.
    optical_thickness : float, or array_like of shape (planes,) or (planes, rows, columns), optional
        Absorption along the line of sight, 0 or above, known from elsewhere: the total, spread
        evenly over the planes, or each plane's, even across it or by the pixels of the central
        view. A plane lets ``(1 - exp(-tau)) / tau`` of its own light out and ``exp(-tau)`` of what
        is behind it through, at greater depth, as a `Layer` does. The penalty then is on the
        emission as it leaves towards the camera. Default: light only adds.

    Returns
    -------
    Reconstruction

    Raises
    ------
    InputError
        If light field and grid do not fit, or a value cannot be used.
    """
    _check_options(noise, strength, order, iterations)
    _check_redraws(redraws, rng)
    thickness = None if optical_thickness is None else spread_thickness(grid, optical_thickness)
    views = average_blocks(light_field, grid.camera, grid.block)
    operator, gram = ProjectionOperator(grid), FrequencyGram(grid)
    how = _How(noise, strength, order, nonnegative, iterations, whole_curve)
    if thickness is None or not thickness.any():
        found, settled = _explain(operator, gram, how, views), True
        fitted = seen = operator.matvec(found.cells.ravel()).reshape(views.shape)
        leaves = np.ones((grid.shape[0], 1, 1), np.float32)
    else:
        absorption = Absorption(operator, grid, thickness)
        found, settled = absorption.settle(views, partial(_explain, operator, gram, how))
        fitted = operator.matvec(found.cells.ravel()).reshape(views.shape)
        seen, leaves = absorption.seen(found.cells), grid.crop(absorption.transmission)
    sd, uneven, chosen, cells = found.noise, found.uneven, found.strength, found.cells
    residual = np.square(views - seen, dtype=np.float64)
    chi_squared = residual.mean(axis=(2, 3)) / noise_variance(sd)
    emission = np.ascontiguousarray(grid.crop(cells) / leaves)
    again = []
    if rng is not None and redraws:
        # As it leaves: noise is no other for what single views see absorbed.
        draws = _redraw(operator, fitted, sd * np.sqrt(uneven), redraws, rng)
        options = (chosen, order, nonnegative, max(1, iterations // 2), cells)
        again = [grid.crop(RangeFit(gram, *draw).solve(*options).cells) / leaves for draw in draws]
    return Reconstruction(
        grid=grid,
        emission=emission,
        draws=np.array(again, np.float32).reshape(-1, *emission.shape),
        sigma_linear=standard_errors(gram, sd, chosen, order) * _raised(leaves),
        noise=sd,
        strength=chosen,
        tried=found.tried,
        chi_squared=chi_squared,
        warnings=(
            *check_data(views, chi_squared, sd, found.measured, noise is not None),
            *(() if settled else (UNSETTLED,)),
        ),
    )


class _How(NamedTuple):
    """Options of `reconstruct` that each of its fits takes."""

    noise: float | None
    strength: float | None
    order: int
    nonnegative: bool
    iterations: int
    whole_curve: bool


class _Explained(NamedTuple):
    """What one fit found, its noise and its strength."""

    cells: np.ndarray
    noise: float
    measured: float
    uneven: np.ndarray
    strength: float
    tried: tuple[TriedStrength, ...]


def _explain(
    operator: ProjectionOperator,
    gram: FrequencyGram,
    how: _How,
    views: np.ndarray,
    known: _Explained | None = None,
) -> _Explained:
    """Fit a light field in which light only adds; with the strength of a known fit, from there."""
    problem = RangeFit(gram, *_seen(operator, views))
    measured = problem.measure_noise()
    sd = measured if how.noise is None else float(how.noise)
    uneven = noise_by_pixel(operator, views, problem.unpenalised())
    options = (how.order, how.nonnegative, how.iterations)
    if known is not None:
        cells = problem.solve(known.strength, *options, known.cells).cells
        return _Explained(cells, sd, measured, uneven, known.strength, known.tried)
    around = np.pad(uneven, gram.grid.reach, mode="edge")
    share = around / around.sum()
    few = min(how.iterations, max(20, how.iterations // 8))
    search = StrengthSearch(problem, noise_variance(sd), share, how.order, how.nonnegative, few)
    if how.whole_curve:
        search.try_all()
    chosen = search.find() if how.strength is None else float(how.strength)
    cells = problem.solve(chosen, *options, search.nearest(chosen)).cells
    tried = tuple(search.tried[key] for key in sorted(search.tried))
    return _Explained(cells, sd, measured, uneven, chosen, tried)


def _raised(leaves: np.ndarray) -> np.ndarray:
    """By how much a plane's errors grow, root-mean-square, if this share of its light leaves it."""
    return np.sqrt(np.mean(np.square(1 / leaves, dtype=np.float64), axis=(1, 2)))


Seen = tuple[np.ndarray, float, int]
"""Filtered focal stack of a light field, sum of its squares, number of its pixels."""


def _seen(operator: ProjectionOperator, views: np.ndarray) -> Seen:
    stack = operator.rmatvec(views.ravel()).reshape(operator.dims)
    return stack, float(np.sum(np.square(views, dtype=np.float64))), views.size


def _redraw(
    operator: ProjectionOperator, fitted: np.ndarray, sd: np.ndarray, count: int, rng
) -> Iterator[Seen]:
    """Draw light fields of the fitted emission with noise anew; sd[t, s] of each pixel."""
    for _ in range(count):
        noise = rng.standard_normal(fitted.shape, dtype=np.float32)
        yield _seen(operator, fitted + sd.astype(np.float32) * noise)


def noise_by_pixel(
    operator: ProjectionOperator, views: np.ndarray, cells: np.ndarray
) -> np.ndarray:
    """Measure the noise by place: bright pixels have more of it, as light comes in portions.

    Parameters
    ----------
    operator : ProjectionOperator
    views : ndarray, shape (v, u, t, s)
    cells : ndarray, shape (planes, rows, columns)
        That explain all of the light field which any can.

    Returns
    -------
    ndarray of float64, shape (t, s)
        Variance relative to its mean over the pixels.
    """
    rest = views - operator.matvec(cells.ravel()).reshape(views.shape)
    power = np.mean(np.square(rest, dtype=np.float64), axis=(0, 1))
    # A running sum may end just below 0 where there is no noise.
    smooth = np.clip(ndimage.uniform_filter(power, NOISE_BLOCK, mode="nearest"), 0, None)
    return smooth / smooth.mean() if smooth.any() else np.ones_like(smooth)


def standard_errors(gram: FrequencyGram, noise: float, strength: float, order: int) -> np.ndarray:
    """Estimate the standard deviation of each plane's cells in the linear fit, by its covariance.

    With H the inverse of the penalised matrix, the covariance is ``noise^2 H G H`` at each
    frequency; a cell's variance is its mean over the frequencies.

    Returns
    -------
    ndarray of float64, shape (planes,)
    """
    values, _ = gram.decomposition
    shrunk = gram.gains / (values + gram.penalty(strength, order) + RIDGE * gram.scale) ** 2
    diagonal = np.diagonal(gram.compose(shrunk), axis1=-2, axis2=-1)
    mean = np.sum(gram.multiplicity[..., None] * diagonal, axis=(0, 1)) / np.prod(gram.size)
    return noise * np.sqrt(np.clip(mean, 0, None))


def noise_variance(sd: float) -> float:
    """Variance of the noise, above 0 so that it may divide."""
    return max(sd**2, float(np.finfo(np.float32).tiny))


def average_blocks(light_field: LightField, camera: PlenopticCamera, block: int) -> np.ndarray:
    """Average blocks of a camera's lenslets, float32 with float64 sums.

    Returns
    -------
    ndarray of float32, shape (v, u, t, s)

    Raises
    ------
    InputError
        If the light field is not grey, or not of that camera.
    """
    views = light_field.views
    wanted = (camera.views, camera.views, *camera.lenslets)
    if views.shape != wanted:
        raise InputError(
            f"The light field must be grey, of the camera's {wanted[0]} x {wanted[1]} views of "
            f"{wanted[2]} x {wanted[3]} lenslets, got an array of shape {views.shape}."
        )
    if block == 1:
        return views
    t, s = (count // block for count in camera.lenslets)
    cells = views.reshape(*views.shape[:2], t, block, s, block)
    return cells.mean(axis=(3, 5), dtype=np.float64).astype(np.float32)


def _check_options(
    noise: float | None, strength: float | None, order: int, iterations: int
) -> None:
    for name, value in (("noise", noise), ("strength", strength)):
        if value is not None and not (np.isfinite(value) and value >= 0):
            raise InputError(f"{name} must be a finite number, 0 or above, got {value}.")
    if order not in (1, 2, 3, 4):
        raise InputError(f"order must be 1, 2, 3 or 4, got {order}.")
    if iterations < 1:
        raise InputError(f"iterations must be 1 or more, got {iterations}.")


def _check_redraws(redraws: int, rng: np.random.Generator | None) -> None:
    if redraws < 0 or redraws == 1 or (redraws and rng is None):
        raise InputError(
            f"redraws must be 0, or 2 and more with a generator rng, got {redraws} and "
            f"{'no generator' if rng is None else 'one'}."
        )


def planes_between(from_mm: float, to_mm: float, step_mm: float) -> Sequence[float]:
    """Depths of evenly spaced planes, both ends included.

    Raises
    ------
    InputError
        If the step does not lead from one end to the other.
    """
    if not (np.isfinite([from_mm, to_mm, step_mm]).all() and step_mm > 0):
        raise InputError(
            f"Depths need finite ends and a step above 0 mm, got {from_mm}, {to_mm}, {step_mm}."
        )
    count = round(abs(to_mm - from_mm) / step_mm)
    if abs(count * step_mm - abs(to_mm - from_mm)) > 1e-6 * step_mm:
        raise InputError(
            f"The step of {step_mm} mm must divide the way from {from_mm} to {to_mm} mm."
        )
    return [float(depth) for depth in np.linspace(from_mm, to_mm, count + 1)]
