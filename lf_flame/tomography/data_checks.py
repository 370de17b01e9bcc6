"""Warnings where a light field disagrees with the assumptions of the inversion."""

import numpy as np

from lf_flame.errors import InputError
from lf_flame.tomography.background import measure_edge
from lf_flame.tomography.frustum_grid import FrustumGrid
from lf_flame.tomography.misfit import explain_misfit
from lf_flame.tomography.resolution import depth_blur, finest_period

SATURATED = 4
"""Smallest number of pixels at exactly the brightest value that suggests saturation."""

LARGEST = 1e15
"""Largest value of a light field: the fit sums squares of squares of pixels in float64."""

BRIGHT = 5.0
"""Number of standard errors by which the brightest pixel, averaged over views, exceeds darkness."""

ALIKE = 0.3
"""Smallest cosine between the light of two depth planes with flames behind each other: flames side
by side reach 0.15, flames behind each other 0.6 and more."""

SUBTRACT = "subtract the dark frame, or a picture without the flame"
FIT_EVEN = "subtract the dark frame, or fit the background (--background fit)"
UNEVEN = (
    "an even background was fitted and this is what is left, so it is uneven; subtract a picture "
    "without the flame"
)
"""Advice against a background: without a fit of it, before and after one."""


def check_range(views: np.ndarray, noise: float | None) -> None:
    """Refuse values with squares that overflow, and a noise above all values.

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
    views: np.ndarray,
    chi_squared: np.ndarray,
    noise: float,
    measured: float,
    stated: bool,
    *,
    residual: np.ndarray | None = None,
    correlation: float = 1.0,
    advice: str = SUBTRACT,
) -> tuple[str, ...]:
    """Compare residuals and edges with the noise.

    Parameters
    ----------
    views : ndarray, shape (v, u, t, s)
    chi_squared : ndarray, shape (v, u)
        Mean squared residual of each view, in units of the noise's variance.
    noise, measured : float
        Standard deviation of a pixel's noise as used, and of the part that no emission on the grid
        explains.
    stated : bool
        Whether the user gave the noise.
    residual : ndarray, shape of `views`, optional
        Part that the emission does not explain. Default: unknown, and not checked.
    correlation : float, optional
        Factor by which correlation raises the noise of sums of pixels (`correlation_factor`).
    advice : str, optional
        Advice against a background, `SUBTRACT`, `FIT_EVEN` or `UNEVEN`.

    Returns
    -------
    tuple of str
        One sentence for each disagreement.
    """
    if not _has_light(views, noise):
        if _has_light(-views, noise):
            return (
                f"The light field is negative (its darkest pixel, averaged over the views, is "
                f"{float(views.mean(axis=(0, 1)).min()):.3g}), and no light explains that: its "
                f"sign is turned, or too much was subtracted.",
            )
        return (
            f"The light field holds no light above its noise (its brightest pixel, averaged over "
            f"the views, is {float(views.mean(axis=(0, 1)).max()):.3g}): there is nothing to find; "
            f"check the exposure, and what was subtracted.",
        )
    found = []
    if stated and measured > 1.1 * noise:
        found.append(
            f"The light field holds {measured / max(noise, 1e-30):.3g} times the stated noise of "
            f"what no emission at these depths explains: depths, alignment, gains or a background "
            f"may be wrong."
        )
    found += explain_misfit(views, chi_squared, noise, residual, correlation)
    found += _check_edges(views, noise, len(chi_squared), advice)
    peak = views.max()
    ceiling = int(np.count_nonzero(views == peak))
    if peak > 0 and ceiling >= SATURATED:
        found.append(
            f"{ceiling} pixels stand at exactly the brightest value, {peak:g}: the sensor may be "
            f"saturated, and emission is then too low."
        )
    return tuple(found)


def check_unknown(valid: np.ndarray | None) -> tuple[str, ...]:
    """Say how many rays are unknown, and what follows.

    Raises
    ------
    InputError
        If none is known.
    """
    if valid is None:
        return ()
    lost = int(np.count_nonzero(~valid))
    if lost == valid.size:
        raise InputError("A fit needs known pixels, and all of this light field are unknown.")
    if not lost:
        return ()
    return (
        f"{lost} of the {valid.size} rays are unknown, as saturated ones, and have weight 0: "
        f"emission that hardly another ray sees is a guess from its neighbours, and its error bars "
        f"are too narrow.",
    )


def check_spacing(grid: FrustumGrid) -> tuple[str, ...]:
    """Warn if depth planes are closer to each other than the resolution in depth."""
    steps = np.abs(np.diff(grid.depths_mm))
    period = finest_period(grid.camera, grid.block)
    blur, smooth = depth_blur(grid.camera, period), depth_blur(grid.camera, 10 * period)
    if not steps.size or steps.min() >= blur:
        return ()
    return (
        f"Planes are {steps.min():.3g} mm apart, and the finest detail that pixels hold, of "
        f"{period:.2g} mm, is blurred over {blur:.2g} mm in depth, detail of {10 * period:.2g} mm "
        f"over {smooth:.2g} mm (lf-flame resolution): neighbouring planes are not separated, and "
        f"the penalty shares their light.",
    )


def check_overlap(grid: FrustumGrid, emission: np.ndarray) -> tuple[str, ...]:
    """Warn of light behind other light within the depth blur: error bars are too narrow there.

    Parameters
    ----------
    grid : FrustumGrid
    emission : ndarray, shape (planes, rows, columns)
        Emission of the cells.
    """
    flat = emission.reshape(len(emission), -1).astype(np.float64)
    products = flat @ flat.T
    power = np.diagonal(products)
    # Mean squared frequency of the light's own detail.
    steps = sum(float(np.sum(np.square(np.diff(emission, axis=axis)))) for axis in (1, 2))
    if not steps > 0:
        return ()
    cell = grid.block * grid.camera.lenslet_in_focus_mm
    period = 2 * np.pi * cell * float(np.sqrt(power.sum() / steps))
    blur = depth_blur(grid.camera, period)
    apart = np.abs(np.subtract.outer(grid.depths_mm, grid.depths_mm))
    alike = products / np.sqrt(np.maximum(np.outer(power, power), 1e-30))
    alike[(apart == 0) | (apart >= blur)] = 0
    if alike.max() < ALIKE:
        return ()
    one, other = (int(k) for k in np.unravel_index(np.argmax(alike), alike.shape))
    return (
        f"Flames stand behind each other, as at {grid.depths_mm[one]:g} and "
        f"{grid.depths_mm[other]:g} mm, nearer than the {blur:.2g} mm over which their detail, of "
        f"{period:.2g} mm, is blurred in depth: error bars hold noise and penalty, not all of how "
        f"planes may share light, and at little noise bars of 95 % hold the truth more rarely.",
    )


def _has_light(views: np.ndarray, noise: float) -> bool:
    error = noise / np.sqrt(np.prod(views.shape[:2]))
    return float(views.mean(axis=(0, 1), dtype=np.float64).max()) > BRIGHT * error


def _share(adds: float) -> str:
    """Put into words what a background adds, relative to the rest of the light."""
    return f"about {abs(adds):.0%} of" if abs(adds) < 1 else "more than the rest of its"


def _check_edges(views: np.ndarray, noise: float, count: int, advice: str = SUBTRACT) -> list[str]:
    """Warn of light at the edges of the field: a background, or emission that is cut off.

    count: number of views along an axis; advice: what to do against a background.
    """
    edge = measure_edge(views)
    if edge.is_background and edge.clipped:
        return [
            f"Blacks are cut off at 0: many pixels of the field's edge are exactly 0 and none is "
            f"below, which leaves a background of {edge.level:.3g} and adds {_share(edge.adds)} "
            f"light. Record with a black level above the noise, and subtract it in numbers that "
            f"may be negative."
        ]
    if edge.is_background:
        verb = "adds" if edge.level > 0 else "takes away"
        return [
            f"The field's edge is at {edge.level:.3g} +- {edge.error:.1g}, which {verb} "
            f"{_share(edge.adds)} light if nothing glows there: {advice}, or it becomes emission. "
            f"A flame at the edge is cut there."
        ]
    error = max(noise / np.sqrt(np.prod(views.shape[:2])), 1e-6 * float(views.max()))
    if edge.brightest > 8 * error and edge.brightest > 0.01 * views.max():
        return [
            f"Light reaches the field's edge ({edge.brightest:.3g}): emission there is cut, and "
            f"wrong within {count // 2} views' parallax of it."
        ]
    return []
