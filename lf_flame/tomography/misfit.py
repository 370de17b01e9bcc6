"""The part of a light field that no emission explains, and its possible causes."""

import numpy as np

from lf_flame.tomography.background import measure_edge

VIEW_EXCESS = 1.3
"""Smallest significant chi-squared of a view, relative to the median view; also that of the median
view, which sound fits keep near 1, and a little above where neighbours share noise."""

ALONE = 2.0
"""Distance of the worst view from the median view, relative to that of the third worst, above which
the view is wrong and not the model."""

MODEL_ERROR = 2e-3
"""Residual relative to the peak that is due to constant emission over each cell."""

APART = 3
"""Distance in pixels over which the residual is compared with itself: noise that decoding spreads
over neighbours is hardly alike there, and what no emission explains is as broad as the flame's
detail."""

STRUCTURE = 0.015
"""Correlation of residuals `APART` pixels apart above which they are not white noise. At 5 % of
noise sound fits stay below, and a focus distance that is wrong by 5 % and gamma exceed it."""

SHARED = 0.005
"""Increase of this limit with the variance of sums of noise that neighbours share, relative to that
of white noise: the penalty is stronger then, and leaves more of the light."""

ERRORS = 5.0
"""Number of its standard errors that this correlation must exceed, too, which matters in small
fields only: one false alarm in some million."""

NEGATIVE = 6.0
"""Number of standard deviations of noise below 0 beyond which light is negative."""

DARK_CORNERS = 0.9
"""Light of the corner views, relative to the median view, below which a stop darkens them."""

UNEVEN = 0.02
"""Standard deviation of the views' light, relative to their median, above which views lose light on
its way: with wrong depths or a wrong camera it is 0.005, behind a post 0.1."""

LIT_EDGE = 0.03
"""Light at the field's edge, relative to the peak, above which the edge is the likely cause."""


def explain_misfit(
    views: np.ndarray,
    chi_squared: np.ndarray,
    noise: float,
    residual: np.ndarray | None,
    correlation: float = 1.0,
) -> list[str]:
    """Say what no emission explains: of a single view, or of all, with the likely causes.

    Parameters
    ----------
    views : ndarray, shape (v, u, t, s)
    chi_squared : ndarray, shape (v, u)
        Mean squared residual of each view, in units of the noise's variance.
    noise : float
        Standard deviation of a pixel's noise.
    residual : ndarray, shape of `views`, or None
        Part that the emission does not explain; None if it is unknown.
    correlation : float, optional
        Factor by which correlation raises the noise of sums of pixels (`correlation_factor`).
    """
    alone = _odd_view(views, chi_squared, noise)
    if residual is None:
        return alone
    by_view = residual.reshape(-1, *residual.shape[2:])
    if not alone:
        return _unexplained(views, chi_squared, noise, by_view, correlation)
    # Least squares leaves more of a fault in its view than in all other views together.
    order = np.argsort(chi_squared[np.isfinite(chi_squared)])
    rest = by_view[order[:-2]]
    shared = _likeness(rest) * float(np.sum(np.square(rest, dtype=np.float64)))
    if shared < float(np.sum(np.square(by_view[order[-2:]], dtype=np.float64))):
        return alone
    return _unexplained(views, chi_squared, noise, rest, correlation) or alone


def _odd_view(views: np.ndarray, chi_squared: np.ndarray, noise: float) -> list[str]:
    """Name the worst view if it, or it and one other, is wrong, and the rest is not."""
    worst = np.unravel_index(np.nanargmax(chi_squared), chi_squared.shape)
    middle, highest = float(np.nanmedian(chi_squared)), float(chi_squared[worst])
    third = float(np.sort(chi_squared[np.isfinite(chi_squared)])[-3:][0])
    residual = np.sqrt(highest) * noise
    if (
        residual > MODEL_ERROR * views.max()
        and highest > VIEW_EXCESS * middle
        and highest - middle > ALONE * (third - middle)
    ):
        return [
            f"View {worst[0]}, {worst[1]} is explained {highest / middle:.3g} times "
            f"worse than the median view: its gain, or the alignment, may be off."
        ]
    return []


def _unexplained(
    views: np.ndarray,
    chi_squared: np.ndarray,
    noise: float,
    residual: np.ndarray,
    correlation: float,
) -> list[str]:
    """Warn if the emission does not explain the views, with the possible causes."""
    peak, size = float(views.max()), float(np.sqrt(np.mean(np.square(residual, dtype=np.float64))))
    likeness, middle = _likeness(residual), float(np.nanmedian(chi_squared))
    # The standard error of a correlation of white noise, of pairs along rows and columns.
    error = 1 / np.sqrt(2 * residual.size)
    limit = max(STRUCTURE + SHARED * (correlation**2 - 1), ERRORS * error)
    structured = likeness > limit and np.sqrt(likeness) * size > MODEL_ERROR * peak
    far_above = middle > VIEW_EXCESS and size > MODEL_ERROR * peak
    if not structured and not far_above:
        return []
    return [
        f"No emission at these depths explains the views: the residual is {size / peak:.1%} of the "
        f"peak, chi-squared of the median view is {middle:.3g}, and {max(likeness, 0):.0%} of the "
        f"residual is structure over {APART} pixels and more, which noise does not have. The "
        f"emission is wrong by more than its error bars say. Most likely first: "
        f"{'; '.join(_causes(views, noise))}."
    ]


def _likeness(residual: np.ndarray) -> float:
    """Correlation of residuals of pixels `APART` from each other, over rows and columns."""
    power = float(np.mean(np.square(residual, dtype=np.float64)))
    products = (
        residual[..., APART:, :] * residual[..., :-APART, :],
        residual[..., APART:] * residual[..., :-APART],
    )
    found = [np.mean(one, dtype=np.float64) for one in products if one.size]
    return float(np.mean(found)) / power if found and power else 0.0


def _causes(views: np.ndarray, noise: float) -> list[str]:
    """List the causes of views that no emission explains, most likely first.

    Causes that show in the views themselves come before those that do not.
    """
    edge, light = measure_edge(views), views.mean(axis=(2, 3), dtype=np.float64)
    middle = float(np.median(light))
    corners = light[np.ix_([0, -1], [0, -1])]
    lit = edge.brightest > max(LIT_EDGE * float(views.max()), NEGATIVE * edge.error)
    dark = light.shape[1] > 1 and corners.max() < DARK_CORNERS * middle
    # The noise of a view's mean is far smaller than that of a pixel.
    lost = float(light.std()) > max(UNEVEN * middle, 3 * noise / np.sqrt(views[0, 0].size))
    seen = {
        "a background that was not subtracted, or too much of it": edge.is_background,
        "negative light, where too much was subtracted": views.min() < -NEGATIVE * noise,
        "light at the field's edge, of a flame that is cut, another object or an uneven "
        "background": lit,
        "a round stop, which darkens the corner views (keep the inner views)": dark,
        "light that is hidden or absorbed on its way, or views of different gains": lost,
    }
    return [
        *(cause for cause, shows in seen.items() if shows),
        "depths that are wrong or do not hold all of the scene",
        "another camera than the one stated, or views that are not aligned",
        "values that are not linear in light (gamma, sRGB)",
        *(cause for cause, shows in reversed(seen.items()) if not shows),
    ]
