"""Volumetric refocusing: image regions each at their own slope, from all views or few.

T. Samarakoon, K. Abeywardena, C. U. S. Edussooriya, "Arbitrary Volumetric Refocusing of Dense and
Sparse Light Fields", arXiv 2502.19238. The slope of a region is the one at which it is sharpest
(`lf_flame.refocus.find_sharpest_slope`). From a cross of 17 views the image has ghosts, which the
U-Net of `lf_flame.systems.sparse_unet` removes; only this needs Keras.
"""

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from lf_flame.errors import InputError
from lf_flame.refocus import (
    SlopeSearch,
    farthest_slope,
    find_sharpest_slope,
    refocus_surface,
    region_slopes,
)
from lf_flame.refocus._arguments import Views, as_views
from lf_flame.systems.formulas import cross_of_views, only_views

if TYPE_CHECKING:
    from lf_flame.systems.sparse_unet import SparseUNet

CERTAIN = 0.3
"""Smallest confidence of a region's slope."""

BLUR = 8.0
"""Displacement, in pixels, of the outermost views by default where the image is to be blurred."""


def refocus_regions(
    light_field: Views,
    regions: Iterable[Sequence[int]],
    *,
    slopes: ArrayLike | None = None,
    background: float | None = None,
    cross: bool = False,
    unet: "SparseUNet | None" = None,
    interpolation: str = "linear",
    weights: ArrayLike | None = None,
) -> tuple[np.ndarray, np.ndarray, list[SlopeSearch]]:
    """Bring several regions into focus at once, at any depths; the rest is blurred.

    Parameters
    ----------
    light_field : LightField or array_like, shape (v, u, t, s) or (v, u, t, s, channels)
        Views; for a network, with values from 0 to 1.
    regions : iterable of (int, int, int, int)
        First row, last row + 1, first column, last column + 1 of each region.
    slopes : sequence of float, optional
        Slopes to search, as for `lf_flame.refocus.find_sharpest_slope`.
    background : float, optional
        Slope outside the regions. Default: below the lowest slope of a region, so far that the
        outermost views are 8 pixels apart from the central one.
    cross : bool, optional
        Whether only a cross of 17 views is used.
    unet : SparseUNet, optional
        Trained network that removes the ghosts of the cross; it implies `cross`.
    interpolation, weights : optional
        Interpolation, and weights of the views in the image, as for
        `lf_flame.refocus.refocus_surface`; without a cross. The search uses all views.

    Returns
    -------
    ndarray of float32, shape (t, s) or (t, s, channels)
        Image; with a network, from 0 to 1.
    ndarray of float64, shape (t, s)
        Slope of every pixel.
    list of SlopeSearch
        Slope of every region, its confidence and sharpness curve.

    Raises
    ------
    InputError
        If a region is not inside the image, or its slope is not certain (confidence below 0.3),
        with the reason; with a network also if the image is too small for it.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.systems import refocus_regions
    >>> texture = np.random.default_rng(1).uniform(size=(48, 64))
    >>> views = [[np.roll(texture, (2 - v, 2 - u), (0, 1)) for u in range(5)] for v in range(5)]
    >>> image, surface, found = refocus_regions(np.array(views), [(4, 40, 4, 50)])
    >>> image.shape, round(found[0].slope, 2)
    ((48, 64), -1.0)
    """
    views = as_views(light_field)
    cross = cross or unet is not None
    if unet is not None:
        unet.check(light_field)
    shape = views.shape[:2]
    searched = only_views(shape, cross_of_views(*shape)) if cross else None
    found = [_find(light_field, region, slopes, searched) for region in regions]
    if not found:
        raise InputError("regions must contain at least one region, got none.")
    if background is None:
        lowest = min(one.slope for one in found) - 2 * BLUR / max(max(shape) - 1, 1)
        background = max(lowest, -farthest_slope(light_field))
    in_focus = [(one.region, one.slope) for one in found]
    # The paper's standard deviation, in pixels.
    surface = region_slopes(views.shape[2:4], in_focus, background=background, soften=5.0)
    weights = searched if cross else weights
    image = refocus_surface(light_field, surface, interpolation=interpolation, weights=weights)
    return image if unet is None else _without_ghosts(image, unet), surface, found


def _find(light_field: Views, region, slopes, weights) -> SlopeSearch:
    """Find a region's slope, or say why it is not certain."""
    try:
        found = find_sharpest_slope(light_field, slopes, region=region, weights=weights)
    except InputError as error:
        raise InputError(f"Region {' '.join(map(str, np.ravel(region)))}: {error}") from None
    if found.confidence < CERTAIN:
        raise InputError(
            f"Region {' '.join(map(str, found.region))} has no certain slope (best "
            f"{found.slope:+.3f}, confidence {found.confidence:.2f} of the {CERTAIN} needed): "
            f"{found.doubt}."
        )
    return found


def _without_ghosts(image: np.ndarray, unet: "SparseUNet") -> np.ndarray:
    """Correct an image (t, s) or (t, s, channels) with the network, one channel at a time."""
    channels = np.moveaxis(np.atleast_3d(image), 2, 0)[..., None]
    corrected = np.moveaxis(unet.predict(channels)[..., 0], 0, 2)
    return np.clip(corrected, 0, 1).reshape(image.shape)
