"""Volumetric refocusing: regions of an image each at a slope of their own, from all views or few.

T. Samarakoon, K. Abeywardena, C. U. S. Edussooriya, "Arbitrary Volumetric Refocusing of Dense and
Sparse Light Fields", arXiv 2502.19238. From all views a region's slope is read off a slope map;
from a cross of 17 it is the one at which the region looks most like the middle view, and the U-Net
of `lf_flame.systems.sparse_unet` removes the ghosts. Only the cross needs Keras.
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
from lf_flame.refocus._arguments import Region, Views, as_region, as_views
from lf_flame.refocus.focus_map import TRUSTED
from lf_flame.systems.view_selection import ARM, cross_of_views

if TYPE_CHECKING:
    from lf_flame.systems.sparse_unet import SparseUNet

STEP = 0.1
"""Between the slopes that are told apart, in pixels per view step."""

SOFTEN = 5.0
"""Standard deviation in pixels of the Gaussian that joins the regions."""


def search_region_slope(
    light_field: Views, region: Region, slopes: tuple[float, float]
) -> tuple[float, float]:
    """Find the slope at which a region, refocused with the cross alone, looks most like the middle.

    By MS-SSIM, which has a single peak there: the range is divided into ten, the best slope and its
    neighbours bracket the peak, and are divided again, until steps are at most 0.1.

    Parameters
    ----------
    light_field : LightField or array_like, shape (v, u, t, s) or (v, u, t, s, channels)
        From 0 to 1.
    region : (int, int, int, int)
        First and last but one row, first and last but one column; 11 pixels or more each way.
    slopes : (float, float)
        Range, in pixels per view step.

    Returns
    -------
    float
        The slope.
    float
        MS-SSIM there.

    Raises
    ------
    InputError
        If the region does not lie in the image or is too small, or the range is empty.
    """
    views = as_views(light_field)
    from keras import ops

    from lf_flame.systems.similarity import ms_ssim, scales

    _check(views, region, slopes)
    t0, t1, s0, s1 = region
    scales((t1 - t0, s1 - s0))
    middle = views[cross_of_views(*views.shape[:2])[ARM]]
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
    """Find the slope that most of a region's certain pixels share, to within a step of 0.1.

    Parameters
    ----------
    focus_map : FocusMap
    region : (int, int, int, int)
        First and last but one row, first and last but one column.

    Returns
    -------
    float
        The slope; where no pixel is certain, that of most.
    float
        Part of the pixels that are certain, from 0 to 1.
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
    dense: bool = False,
    unet: "SparseUNet | None" = None,
) -> tuple[np.ndarray, np.ndarray, list[tuple[float, float]]]:
    """Bring several regions into focus at once, whatever their depths; the rest is blurred.

    Parameters
    ----------
    light_field : LightField or array_like, shape (v, u, t, s) or (v, u, t, s, channels)
        From 0 to 1.
    regions : iterable of (int, int, int, int)
        See `search_region_slope`.
    slopes : (float, float)
        Range of the search.
    background : float, optional
        Slope of all that is no region. Default: the lowest, as Samarakoon et al. choose a smaller
        one.
    dense : bool, optional
        Use all views: a region's slope is then the one that most of its pixels have in a slope map
        (`lf_flame.refocus.all_in_focus`, where the authors have a map of their own). Otherwise the
        cross of 17 views alone is used, and `search_region_slope`.
    unet : SparseUNet, optional
        Trained, removes the ghosts that the cross leaves.

    Returns
    -------
    ndarray of float32, shape (t, s) or (t, s, channels)
        The image; with a network, from 0 to 1.
    ndarray of float64, shape (t, s)
        Slope of every pixel.
    list of (float, float)
        Slope of every region, and how far to trust it: of dense views the part of the region's
        pixels whose slope is certain, else its MS-SSIM to the middle view.

    Raises
    ------
    InputError
        If a region does not lie in the image, or is too small, the range is empty, or views are
        missing; with a network also if the image is smaller than it can take.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.systems import refocus_regions
    >>> views = np.random.default_rng(1).uniform(size=(9, 9, 48, 64))
    >>> image, slopes, found = refocus_regions(views, [(4, 24, 4, 30)], (-1.0, 1.0), dense=True)
    >>> image.shape, slopes.shape, len(found)
    ((48, 64), (48, 64), 1)
    """
    views, regions = as_views(light_field), list(regions)
    if unet is not None:
        unet.check(views)
    for region in regions:
        _check(views, region, slopes)
    found = _region_slopes(light_field, regions, slopes, dense)
    rest = slopes[0] if background is None else background
    in_focus = [(region, slope) for region, (slope, _) in zip(regions, found, strict=True)]
    surface = region_slopes(views.shape[2:4], in_focus, background=rest, soften=SOFTEN)
    shape = views.shape[:2]
    weights = None if dense else sparse_aperture(shape, cross_of_views(*shape))
    image = refocus_surface(light_field, surface, weights=weights)
    return image if unet is None else _without_ghosts(image, unet), surface, found


def _region_slopes(views: Views, regions: list, slopes: tuple[float, float], dense: bool):
    """Find the slope of every region, and how far to trust it."""
    if not dense:
        return [search_region_slope(views, region, slopes) for region in regions]
    steps = np.linspace(*slopes, max(round((slopes[1] - slopes[0]) / STEP), 2) + 1)
    focus_map = all_in_focus(views, steps)
    return [most_common_slope(focus_map, region) for region in regions]


def _without_ghosts(image: np.ndarray, unet: "SparseUNet") -> np.ndarray:
    """Correct an image (t, s) or (t, s, channels) by the network, a channel at a time."""
    channels = np.moveaxis(np.atleast_3d(image), 2, 0)[..., None]
    corrected = np.moveaxis(unet.predict(channels)[..., 0], 0, 2)
    return np.clip(corrected, 0, 1).reshape(image.shape)
