"""Slopes between those searched, by least squares over the views that see a place.

The right slope follows from the derivatives of the views by the slope (Adelson, Wang, IEEE Trans.
Pattern Anal. Mach. Intell. 14, 99, 1992), for the half or quarter of the views that matches best.
The costs of the search do not tell it: their limit makes them flat a step away.

A fit of one pixel is uncertain. Therefore the equations of the pixels around it are added, of
similar brightness and of about the same slope, each at its own: a tilted surface stays tilted.
"""

import numpy as np

from lf_flame._common.arrays import centred
from lf_flame.refocus import _matching_kernels, _refinement_kernels
from lf_flame.refocus.matching import ComparedViews, sides
from lf_flame.refocus.semi_global import ALIKE, SAME, in_deviations

WINDOW, REACH = 2.0, 3
"""Standard deviation, in lenslets, of the Gaussian under which equations are added, and largest
distance in these."""

OUTLYING = 1.5
"""Difference from which a view hardly counts, relative to the largest that counts in the search,
which leaves larger differences than chance."""

SCATTER = 3.0
"""Largest difference that counts in the search, relative to the usual one at the right slope."""

MOST_CHANGE = 0.6
"""Largest change of a slope, in steps of the search; a larger one is an outlier, and is left out.
"""

MOST_SHIFT = 1.0
"""Largest shift of the outermost view by a change of the slope, in lenslets; derivatives do not
reach further. It matters where the search is coarse."""

ROWS_TOGETHER = 32
"""Number of rows whose equations are set up together, which bounds the memory."""


def refine_slopes(
    compared: ComparedViews, slope: np.ndarray, guide: np.ndarray, limit: float
) -> np.ndarray:
    """Change each pixel's slope by the little at which the views around it agree best.

    Pixels of other brightness of the guide count less; limit: see `ComparedViews.limit`.
    """
    step = compared.slopes[1] - compared.slopes[0]
    equations = set_up_equations(compared, slope, OUTLYING * limit)
    change = fit_changes(slope, equations, guide, step, limit / SCATTER)
    farthest = max(centred(n)[-1] for n in compared.views.shape[:2])
    return slope + np.where(farthest * np.abs(change) <= MOST_SHIFT, change, 0.0)


def set_up_equations(
    compared: ComparedViews, slope: np.ndarray, limit: float
) -> tuple[np.ndarray, np.ndarray]:
    """Set up, at each pixel, the least-squares fit of a change of its slope.

    The change is the ratio of the two, of one pixel or of the sums over several. A view hardly
    counts beyond a difference of `limit`.
    """
    numerator, denominator = np.empty(slope.shape), np.empty(slope.shape)
    height = slope.shape[0]
    for start in range(0, height, ROWS_TOGETHER):
        rows = slice(start, min(start + ROWS_TOGETHER, height))
        # Differences are smoothed over three rows.
        read = np.arange(max(start - 1, 0), min(rows.stop + 1, height))
        some = _equations_of(compared, slope[read], read, limit)
        inner = slice(start - read[0], rows.stop - read[0])
        numerator[rows], denominator[rows] = (sums[inner] for sums in some)
    return numerator, denominator


def _equations_of(
    compared: ComparedViews, slope: np.ndarray, rows: np.ndarray, limit: float
) -> tuple[np.ndarray, np.ndarray]:
    """Numerator and denominator in some rows, of the side of the aperture that matches best."""
    parts = np.empty((3, rows.size, 9, slope.shape[1]), np.float32)
    _refinement_kernels.differentiate_views(
        compared.weighted(), rows, slope.astype(np.float32), np.float32(compared.unit),
        np.float32(limit), *parts,
    )  # fmt: skip
    differences, products, squares = parts
    numerator, denominator = np.zeros(slope.shape), np.zeros(slope.shape)
    least, cost = np.full(slope.shape, np.inf, np.float32), np.empty(slope.shape, np.float32)
    for share, margin in zip(*sides(compared.counts), strict=True):
        scaled = share[None] / np.float32(limit)
        _matching_kernels.choose_sides(differences, scaled, margin[None], cost)
        better = cost < least
        least[better] = cost[better]
        for sums, out in ((-products, numerator), (squares, denominator)):
            of_side = sums[:, share > 0].sum(axis=1, dtype=np.float64)
            out[better] = of_side[better]
    return numerator, denominator


def fit_changes(
    slope: np.ndarray,
    equations: tuple[np.ndarray, np.ndarray],
    guide: np.ndarray,
    step: float,
    scatter: float,
) -> np.ndarray:
    """Fit the change of each pixel's slope to the equations around it.

    Where the usual difference of views at the right slope, `scatter`, exceeds what a change of half
    a step of the search makes, the change is nearly 0.
    """
    distances = np.arange(int(np.ceil(REACH * WINDOW)) + 1)
    near = np.exp(-((distances / WINDOW) ** 2) / 2)
    change, least = np.empty(slope.shape), (2 * scatter / step) ** 2
    _refinement_kernels.fit(
        slope, *equations, in_deviations(guide), near, ALIKE, SAME * step, least, change
    )
    return np.where(np.abs(change) <= MOST_CHANGE * step, change, 0.0)
