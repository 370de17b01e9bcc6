"""Where a light field disagrees with what the inversion takes for granted, in words."""

import numpy as np

from lf_flame.errors import InputError

VIEW_EXCESS = 1.3
"""Chi-squared of a view, relative to the median view, that is no accident."""

MODEL_ERROR = 2e-3
"""Residual relative to the peak that comes of taking the glow of a cell as even."""

SATURATED = 4
"""Pixels at exactly the brightest value from which it is a ceiling."""

LARGEST = 1e15
"""Largest value of a light field: the fit sums squares of squares of pixels in float64."""


def check_range(views: np.ndarray, noise: float | None) -> None:
    """Refuse values whose squares overflow, and a noise above all that was seen.

    Parameters
    ----------
    views : ndarray, shape (v, u, t, s)
    noise : float or None
        Standard deviation of a pixel's noise, as stated.

    Raises
    ------
    InputError
        If the light field exceeds `LARGEST`, or the noise its largest absolute value.
    """
    largest = max(float(views.max()), -float(views.min()))
    if largest > LARGEST:
        raise InputError(
            f"The light field's values must be at most {LARGEST:g}, got {largest:g}: scale it."
        )
    if noise is not None and 0 < largest < noise:
        raise InputError(
            f"noise, the standard deviation of a pixel, must be at most the light field's largest "
            f"value, {largest:.4g}, got {noise:g}."
        )


def check_data(
    views: np.ndarray, chi_squared: np.ndarray, noise: float, measured: float, stated: bool
) -> tuple[str, ...]:
    """Compare residuals and edges with the noise.

    Parameters
    ----------
    views : ndarray, shape (v, u, t, s)
    chi_squared : ndarray, shape (v, u)
    noise, measured : float
        That was used, and that no emission on the grid explains.
    stated : bool
        Whether the user gave the noise.

    Returns
    -------
    tuple of str
        One sentence for each disagreement.
    """
    found = []
    if stated and measured > 1.1 * noise:
        found.append(
            f"The light field holds {measured / max(noise, 1e-30):.3g} times the stated noise of "
            f"what no emission at these depths explains: depths, alignment, gains or a background "
            f"may be wrong."
        )
    worst = np.unravel_index(np.argmax(chi_squared), chi_squared.shape)
    middle = float(np.median(chi_squared))
    residual = float(np.sqrt(chi_squared[worst])) * noise
    if residual > MODEL_ERROR * views.max() and chi_squared[worst] > VIEW_EXCESS * middle:
        found.append(
            f"View {worst[0]}, {worst[1]} is explained {chi_squared[worst] / middle:.3g} times "
            f"worse than the median view: its gain, or the alignment, may be off."
        )
    found += _check_edges(views, noise)
    peak = views.max()
    ceiling = int(np.count_nonzero(views == peak))
    if peak > 0 and ceiling >= SATURATED:
        found.append(
            f"{ceiling} pixels stand at exactly the brightest value, {peak:g}: the sensor may be "
            f"saturated, and emission is then too low."
        )
    return tuple(found)


def _check_edges(views: np.ndarray, noise: float) -> list[str]:
    """Light on the field's edges: a background, or emission that is cut."""
    frame = np.ones(views.shape[2:], bool)
    frame[1:-1, 1:-1] = False
    # The mean over views keeps what noise does not.
    edge = views.mean(axis=(0, 1), dtype=np.float64)[frame]
    error = max(noise / np.sqrt(np.prod(views.shape[:2])), 1e-6 * float(views.max()))
    background = float(np.median(edge))
    if abs(background) > 5 * error:
        return [
            f"The field's edge is at {background:.3g} where nothing glows: subtract the dark "
            f"frame, or the background becomes emission."
        ]
    if edge.max() > 8 * error and edge.max() > 0.01 * views.max():
        return [
            f"Light reaches the field's edge ({edge.max():.3g}): emission there is cut, and wrong "
            f"within {views.shape[0] // 2} views' parallax of it."
        ]
    return []
