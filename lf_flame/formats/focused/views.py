"""Views of a focused plenoptic camera, put together from patches of its micro-images."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage
from scipy.spatial import cKDTree

from lf_flame._common.arrays import centred
from lf_flame._common.input_files import check_memory
from lf_flame.errors import InputError
from lf_flame.formats.focused._kernels import render
from lf_flame.formats.focused.lenslets import Array, FocusedLenslets, is_raytrix, read_raytrix
from lf_flame.formats.focused.virtual_depth import find_virtual_depth
from lf_flame.formats.images import read_image
from lf_flame.formats.raw.lenslet_search import estimate_grid
from lf_flame.formats.raw.sensor_images import (
    as_image,
    check_bayer,
    check_colours,
    fitting,
    less_dark,
)
from lf_flame.lightfield import LightField

REFERENCE = 3.0
"""Absolute virtual depth at which views coincide by default; Raytrix cameras use depths from 2 on.
It is the same for all pictures, so that their slopes are comparable."""

NEAREST = 1.5
"""Smallest virtual depth at which patches fit into their micro-images."""


def plan_focused(
    path: str | Path,
    focused: str | Path,
    *,
    white: str | Path | None = None,
    dark: str | Path | None = None,
    bayer: str | None = None,
    **options,
) -> tuple[FocusedPlan, np.ndarray]:
    """Read a raw picture, and plan its views and those of others by the same camera.

    Arguments are those of `lf_flame.read_light_field`. Without a white image the mean fall-off
    within the micro-images is taken from each picture.
    """
    image = read_image(path)
    black, flat = (None if one is None else read_image(one) for one in (dark, white))
    if stated := is_raytrix(focused):
        lenslets = read_raytrix(focused, image.shape)
    else:
        shown = read_image(focused)
        lenslets = FocusedLenslets(estimate_grid(less_dark(shown, black, "white")))
        flat = shown if flat is None else flat
    options |= {"white": flat, "dark": black, "bayer": bayer}
    plan = FocusedPlan(lenslets, shape=image.shape, **options)
    if stated:
        _check_fit(less_dark(image if flat is None else flat, black, "raw"), plan, focused)
    if bayer is None:
        check_colours(less_dark(image, black, "raw"), lenslets.grid, "raw")
    return plan, image


def _check_fit(image: np.ndarray, plan: FocusedPlan, calibration: object) -> None:
    """Refuse a calibration whose lenslets are not where a picture, (rows, columns), shows them.

    Micro-images are dark between each other. Where a picture shows no lenslets, nothing is checked.
    """
    grey = np.atleast_3d(image).mean(axis=2, dtype=np.float64)
    try:
        found = estimate_grid(grey, layout=plan.lenslets.grid.layout).centres(grey.shape)
    except InputError:
        return
    stated = cKDTree(plan.array.centres.reshape(-1, 2))
    away = float(stated.query(found.reshape(-1, 2))[0].max())
    if away > 0.08 * plan.lenslets.grid.pitch:
        raise InputError(
            f"The lenslets of {calibration} do not fit the picture, in which the micro-images lie "
            f"{away:.2g} pixels beside theirs or more: both must be of the same camera, and the "
            f"picture whole, neither scaled nor cropped."
        )


class FocusedPlan:
    """Plan for the views of one camera with focused lenslets.

    Each place of a view is put together from the lenslets around it: from the part of each
    micro-image around an offset p that belongs to the view, magnified by the lenslet's virtual
    depth v: a patch of pitch / v pixels for each lenslet. Lenslets of a kind that is out of focus
    at its depth count only where no other sees the place. From view to view the offset p moves
    through the micro-image, and a place at the depth v moves by ``(3 - v) p`` pixels of the raw
    picture. The offsets lie in a square within the round micro-image, so that all views count.
    Unlike a view of an unfocused camera, a patch holds directions from p - pitch / (2 v) to
    p + pitch / (2 v).

    `reference` is the virtual depth at which views coincide, `step` the distance between pixels of
    a view, `spacing` that between the offsets of neighbouring views, `first` the place (y, x) of
    the central view's first pixel, all in pixels of the raw picture: the slope at the virtual depth
    v is ``(reference - v) spacing / step``. `found` says in words which depths `decode` has found.
    """

    def __init__(
        self,
        lenslets: FocusedLenslets,
        *,
        shape: tuple[int, ...],
        virtual_depth: float | None = None,
        views: int | None = None,
        white: ArrayLike | None = None,
        dark: ArrayLike | None = None,
        bayer: str | None = None,
    ):
        self.lenslets, self.shape, self.found = lenslets, tuple(shape), ""
        self.bayer = None if bayer is None else check_bayer(bayer, self.shape)
        self.views = 5 if views is None else views
        if not 1 <= self.views <= 64 or self.views != int(self.views):
            raise InputError(
                f"views must be a whole number from 1 to 64 for focused lenslets, got {views}."
            )
        pitch, self._plane = lenslets.grid.pitch, virtual_depth
        if virtual_depth is not None and not NEAREST <= abs(virtual_depth) <= pitch / 2:
            raise InputError(
                f"A virtual depth must be from {NEAREST:g} to {pitch / 2:.4g}, half the pixels "
                f"under a lenslet, or the same below 0, got {virtual_depth}."
            )
        self.reference = REFERENCE if virtual_depth is None else float(virtual_depth)
        self.step = abs(self.reference)
        patch = 0.6 * pitch / self.step  # half its width: as far as a lenslet's cell goes
        farthest = max(lenslets.radius - patch, 0.0) / math.sqrt(2)
        self.spacing = 2 * farthest / (self.views - 1) if self.views > 1 else 0.0
        self.array = lenslets.array(self.shape)
        self._black = None if dark is None else as_image(dark, "dark")
        self._fall = None
        if white is not None:
            light = fitting(less_dark(white, self._black, "white"), "white", self.shape)
            self._fall = fall_off(self._coloured(light), self.array)
        inner = np.array(self.shape[:2]) - 1
        room = inner - 2 * (lenslets.radius + 1 + self.step * farthest + pitch / 2)
        size = np.floor(np.maximum(room, 0) / self.step).astype(int) + 1
        if min(size) < 8:
            raise InputError(
                f"Pictures of {self.shape[0]} x {self.shape[1]} pixels are too small for views "
                f"from lenslets of {pitch:.4g} pixels at the virtual depth {self.reference:g}."
            )
        check_memory(self.views**2 * int(size.prod()) * 3 * 4 * 2, "The light field of views")
        self.first, self._size = (inner - (size - 1) * self.step) / 2, size.tolist()

    def decode(self, raw: ArrayLike) -> LightField:
        """Put the views of a raw picture of the planned shape together."""
        image = as_image(raw, "raw")
        if image.shape != (*self.shape, 1)[:3]:
            raise InputError(
                f"A raw image must have the plan's shape {self.shape}, got {np.shape(raw)}."
            )
        image = self._coloured(less_dark(image, self._black, "raw").astype(np.float32, copy=False))
        fall = self._fall
        if fall is None:
            white = mean_white(image, self.array, self.lenslets.radius)
            fall = fall_off(white, self.array)
        image = np.ascontiguousarray(image / fall, np.float32)
        inverse = self._inverse(image)
        focused = self.lenslets.in_focus(self.array, 1 / inverse)
        # A lenslet of a kind that is out of focus counts only where no other sees the place.
        weights = np.where(focused, 1.0, 1e-3) * self.array.whole
        places = centred(self.views) * self.spacing
        offsets = np.stack(np.meshgrid(places, places, indexing="ij"), axis=-1).reshape(-1, 2)
        out = np.empty((len(offsets), *self._size, image.shape[2]), np.float32)
        view = (*self.first.tolist(), self.step, self.reference)
        first = int(self.array.rows[0]), int(self.array.columns[0])
        grid, odd = self.lenslets.grid, 0.5 if self.lenslets.grid.layout == "hexagonal" else 0.0
        turn = math.cos(grid.rotation), math.sin(grid.rotation)
        lattice = grid.y0, grid.x0, grid.pitch, grid.row_pitch, odd, *turn
        reach = 1.1 * grid.pitch  # some lenslets of each kind are as near, anywhere
        render(
            image, lattice, first, inverse, weights, offsets, view, reach, self.lenslets.radius, out
        )
        out = out.reshape(self.views, self.views, *out.shape[1:])
        return LightField(out if image.shape[2] > 1 else out[..., 0])

    def _inverse(self, image: np.ndarray) -> np.ndarray:
        """Inverse virtual depth of each lenslet, that of the nearest known one where unknown."""
        if self._plane is not None:
            return np.full(self.array.whole.shape, 1 / self._plane)
        depth = find_virtual_depth(image, self.lenslets, self.array)
        known = np.isfinite(depth)
        if not known.any():
            raise InputError(
                "No virtual depth was found: neighbouring micro-images do not show the same "
                "detail, displaced. The picture lacks texture, or the calibration does not fit it; "
                "state the virtual depth (--virtual-depth) to render it as a plane."
            )
        self.reference = float(np.copysign(REFERENCE, np.median(depth[known])))
        low, high = np.percentile(depth[known], [2, 98])
        self.found = (
            f"virtual depth from {low:.3g} to {high:.3g}, known for "
            f"{known.sum() / self.array.whole.sum():.0%} of the lenslets; slopes of the views are "
            f"{self.spacing / self.step:.4g} ({self.reference:g} - virtual depth)"
        )
        nearest = ndimage.distance_transform_edt(
            ~known, return_distances=False, return_indices=True
        )
        return 1 / depth[tuple(nearest)]

    def _coloured(self, image: np.ndarray) -> np.ndarray:
        """Colours of a mosaic, (rows, columns, 1), at all pixels by linear interpolation."""
        if self.bayer is None:
            return image
        kernel = np.outer([1, 2, 1], [1, 2, 1]) / 4
        light, pixels = (np.zeros((*image.shape[:2], 3), np.float32) for _ in range(2))
        for place, colour in enumerate(self.bayer):
            at = np.s_[place // 2 :: 2, place % 2 :: 2, "rgb".index(colour)]
            light[at], pixels[at] = image[at[0], at[1], 0], 1
        sums, counts = (
            ndimage.convolve(one, kernel[..., None], mode="constant") for one in (light, pixels)
        )
        return sums / counts


def fall_off(white: np.ndarray, array: Array) -> np.ndarray:
    """Brightness of a white image relative to the middle of its micro-images, and at least 0.2."""
    y, x = np.rint(array.centres[array.whole]).astype(int).T
    middle = np.median(white[y, x], axis=0)
    if not np.all(middle > 0):
        raise InputError(
            f"The white image must be bright in the middle of its micro-images, "
            f"got a median there of {middle.min():g}."
        )
    return np.maximum(white / middle, 0.2)


def mean_white(image: np.ndarray, array: Array, radius: float) -> np.ndarray:
    """White image by the mean fall-off of a picture's micro-images, which is taken to be round."""
    apart, half = np.ones(image.shape[:2], bool), int(radius)
    centres = np.rint(array.centres).astype(int)
    inside = np.all((centres >= 0) & (centres < apart.shape), axis=2)
    apart[tuple(centres[inside].T)] = False
    away = ndimage.distance_transform_edt(apart)  # from the nearest micro-image's centre
    rings, white = np.rint(away).astype(np.intp).ravel(), np.empty_like(image)
    for channel in range(image.shape[2]):
        sums, counts = np.bincount(rings, image[..., channel].ravel()), np.bincount(rings)
        # A picture without light, or below black, has no fall-off.
        light = (sums / counts)[: half + 1] if sums[0] > 0 else np.ones(half + 1)
        white[..., channel] = np.interp(away, np.arange(half + 1), light)
    return white
