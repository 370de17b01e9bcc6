"""Volumetric refocusing: image regions each at their own slope, from all views or few.

T. Samarakoon, K. Abeywardena, C. U. S. Edussooriya, "Arbitrary Volumetric Refocusing of Dense and
Sparse Light Fields", arXiv 2502.19238. With all views a region's slope comes from a slope map. With
a cross of 17 views it is the slope at which the region is most similar to the central view, and the
U-Net of `lf_flame.systems.sparse_unet` removes the ghosts. Only the cross needs Keras.
"""

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from lf_flame.errors import InputError
from lf_flame.refocus import (
    FocusMap,
    all_in_focus,
    refocus_surface,
    region_slopes,
    shift_and_sum,
    sparse_aperture,
)
from lf_flame.refocus._arguments import Region, Views, as_region, as_views, refuse_uncounted
from lf_flame.refocus.focus_map import TRUSTED
from lf_flame.systems.formulas import cross_of_views

if TYPE_CHECKING:
    from lf_flame.systems.sparse_unet import SparseUNet

STEP = 0.1
"""Distance between slopes that are distinguished, in pixels per view step."""

SOFTEN = 5.0
"""Standard deviation in pixels of the Gaussian that joins the regions."""


def search_region_slope(
    light_field: Views, region: Region, slopes: tuple[float, float]
) -> tuple[float, float]:
    """Find the slope at which a region, refocused from the cross of views, is most like the centre.

    The similarity is MS-SSIM, which has a single peak there. The range is divided into ten; the
    best slope and its neighbours bracket the peak and are divided again, until steps are at most
    0.1.

    Parameters
    ----------
    light_field : LightField or array_like, shape (v, u, t, s) or (v, u, t, s, channels)
        Views with values from 0 to 1.
    region : (int, int, int, int)
        First row, last row + 1, first column, last column + 1; 11 pixels or more each way.
    slopes : (float, float)
        Range of slopes, in pixels per view step.

    Returns
    -------
    float
        Slope.
    float
        MS-SSIM at this slope.

    Raises
    ------
    InputError
        If the region is not inside the image or is too small, or the range is empty.
    """
    views = as_views(light_field)
    from keras import ops

    from lf_flame.systems.similarity import ms_ssim, scales

    _check(views, region, slopes)
    centre = cross_of_views(*views.shape[:2])[4]
    refuse_uncounted(light_field, [centre], "The search of a region's slope")
    t0, t1, s0, s1 = region
    scales((t1 - t0, s1 - s0))
    middle = views[centre]
    weights = sparse_aperture(views.shape[:2], cross_of_views(*views.shape[:2]))

    def likeness(some: np.ndarray) -> np.ndarray:
        stack = shift_and_sum(light_field, some, weights=weights)[:, t0:t1, s0:s1]
        same = np.broadcast_to(middle[t0:t1, s0:s1], stack.shape)
        shape = (*stack.shape[:3], -1)
        return ops.convert_to_numpy(
            ms_ssim(np.reshape(same, shape).astype(np.float32), np.reshape(stack, shape))
        )

    low, high = slopes
    while True:
        steps = np.linspace(low, high, 11)
        found = likeness(steps)
        best = int(np.argmax(found))
        if steps[1] - steps[0] <= STEP:
            return float(steps[best]), float(found[best])
        low, high = steps[max(best - 1, 0)], steps[min(best + 1, 10)]


def most_common_slope(focus_map: FocusMap, region: Region) -> tuple[float, float]:
    """Find the slope that most of a region's certain pixels share, within a step of 0.1.

    Returns the slope (if no pixel is certain, that of most pixels), and the fraction of the pixels
    that are certain.
    """
    t0, t1, s0, s1 = region
    inside, confidence = (
        values[t0:t1, s0:s1].ravel() for values in (focus_map.slope, focus_map.confidence)
    )
    certain = confidence >= TRUSTED
    counted = inside[certain] if certain.any() else inside
    steps = np.round(counted / STEP)
    values, counts = np.unique(steps, return_counts=True)
    return float(counted[steps == values[counts.argmax()]].mean()), float(certain.mean())


def _check(views: np.ndarray, region: Sequence[int], slopes: tuple[float, float]) -> None:
    as_region(region, views.shape[2:4])
    if not -np.inf < slopes[0] < slopes[1] < np.inf:
        raise InputError(
            f"slopes to search must be two rising numbers, got {slopes[0]} and {slopes[1]}."
        )


def refocus_regions(
    light_field: Views,
    regions: Iterable[Sequence[int]],
    slopes: tuple[float, float],
    *,
    background: float | None = None,
    cross: bool = False,
    unet: "SparseUNet | None" = None,
) -> tuple[np.ndarray, np.ndarray, list[tuple[float, float]]]:
    """Bring several regions into focus at once, at any depths; the rest is blurred.

    Parameters
    ----------
    light_field : LightField or array_like, shape (v, u, t, s) or (v, u, t, s, channels)
        Views with values from 0 to 1.
    regions : iterable of (int, int, int, int)
        First row, last row + 1, first column, last column + 1 of each region.
    slopes : (float, float)
        Range of the search, in lenslets per view step.
    background : float, optional
        Slope outside the regions. Default: the lower end of `slopes`.
    cross : bool, optional
        Whether only a cross of 17 views is used, with `search_region_slope`; this is less exact.
        Otherwise a region's slope is the most frequent one of its pixels in a slope map of all
        views (`lf_flame.refocus.all_in_focus`).
    unet : SparseUNet, optional
        Trained network that removes the ghosts of the cross; it implies `cross`.

    Returns
    -------
    ndarray of float32, shape (t, s) or (t, s, channels)
        Image; with a network, from 0 to 1.
    ndarray of float64, shape (t, s)
        Slope of every pixel.
    list of (float, float)
        Slope of every region, and its confidence: with all views the fraction of the region's
        pixels with a certain slope, else the MS-SSIM with the central view.

    Raises
    ------
    InputError
        If a region is not inside the image, the range is empty, or views are missing; with the
        cross also if a region is too small, with a network if the image is too small for it.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.systems import refocus_regions
    >>> views = np.random.default_rng(1).uniform(size=(9, 9, 48, 64))
    >>> image, slopes, found = refocus_regions(views, [(4, 24, 4, 30)], (-1.0, 1.0))
    >>> image.shape, slopes.shape, len(found)
    ((48, 64), (48, 64), 1)
    """
    views, regions = as_views(light_field), list(regions)
    cross = cross or unet is not None
    if unet is not None:
        unet.check(views)
    for region in regions:
        _check(views, region, slopes)
    found = _region_slopes(light_field, regions, slopes, cross)
    rest = slopes[0] if background is None else background
    in_focus = [(region, slope) for region, (slope, _) in zip(regions, found, strict=True)]
    surface = region_slopes(views.shape[2:4], in_focus, background=rest, soften=SOFTEN)
    shape = views.shape[:2]
    weights = sparse_aperture(shape, cross_of_views(*shape)) if cross else None
    image = refocus_surface(light_field, surface, weights=weights)
    return image if unet is None else _without_ghosts(image, unet), surface, found


def _region_slopes(views: Views, regions: list, slopes: tuple[float, float], cross: bool):
    """Find the slope of every region, and its confidence."""
    if cross:
        return [search_region_slope(views, region, slopes) for region in regions]
    steps = np.linspace(*slopes, max(round((slopes[1] - slopes[0]) / STEP), 2) + 1)
    focus_map = all_in_focus(views, steps)
    return [most_common_slope(focus_map, region) for region in regions]


def _without_ghosts(image: np.ndarray, unet: "SparseUNet") -> np.ndarray:
    """Correct an image (t, s) or (t, s, channels) with the network, one channel at a time."""
    channels = np.moveaxis(np.atleast_3d(image), 2, 0)[..., None]
    corrected = np.moveaxis(unet.predict(channels)[..., 0], 0, 2)
    return np.clip(corrected, 0, 1).reshape(image.shape)
