"""Views of a focused plenoptic camera, assembled from patches of its micro-images."""

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
from lf_flame.formats.focused.lenslets import FocusedLenslets, find_virtual_depth, read_raytrix
from lf_flame.formats.images import read_image
from lf_flame.formats.raw import sensor_images as sensor
from lf_flame.formats.raw.decode_plan import count_views
from lf_flame.formats.raw.lenslet_search import estimate_grid
from lf_flame.lightfield import LightField

REFERENCE = 3.0
"""Absolute virtual depth at which views coincide by default; Raytrix cameras use depths above 2.
It is the same for all pictures, so that their slopes are comparable."""


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
    if stated := Path(focused).suffix.lower() == ".xml":
        lenslets = read_raytrix(focused, image.shape)
    else:
        shown = read_image(focused)
        light = sensor.subtract_dark(shown, black, "white", image.shape)
        lenslets = FocusedLenslets(estimate_grid(light), image.shape)
        flat = shown if flat is None else flat
    plan = FocusedPlan(lenslets, white=flat, dark=black, bayer=bayer, **options)
    light = sensor.subtract_dark(image, black, "raw", image.shape)
    sensor.warn_of_saturated(sensor.find_saturated(image), "views are too dark there")
    if stated:
        shown = light if flat is None else sensor.subtract_dark(flat, black, "white", image.shape)
        _check_fit(shown, lenslets, focused)
    if bayer is None:
        sensor.check_colours(light, lenslets.grid, "raw")
    return plan, image


def _check_fit(image: np.ndarray, lenslets: FocusedLenslets, calibration: object) -> None:
    """Refuse a calibration whose lenslets are not where an image shows them, if it does.

    Micro-images are dark between each other.
    """
    try:
        seen = estimate_grid(image)
    except InputError:
        return
    rows, columns = seen.indices(image.shape)
    shown = np.stack(seen.position(rows[:, None], columns), axis=-1).reshape(-1, 2)
    away = float(cKDTree(shown).query(lenslets.array[0])[0].max())
    if away > 0.08 * lenslets.grid.pitch:
        raise InputError(
            f"The lenslets of {calibration} do not fit the picture, whose micro-images are "
            f"displaced from them by {away:.2g} pixels or more: both must be of the same camera, "
            f"and the picture neither scaled nor cropped."
        )


class FocusedPlan:
    """Plan for the views of one camera with focused lenslets.

    Each point of a view is assembled from the lenslets around it: from the part of each
    micro-image around an offset p that belongs to the view, magnified by the lenslet's virtual
    depth v: a patch of pitch / v pixels for each lenslet. Lenslets of a kind that is out of focus
    at its depth are used only where no other sees the point. From view to view the offset p moves
    through the micro-image, and a point at the depth v moves by ``(3 - v) p`` pixels of the raw
    picture. The offsets lie in a square within the round micro-image, so that all views are used.
    Unlike a view of an unfocused camera, a patch contains directions from p - pitch / (2 v) to
    p + pitch / (2 v).

    `reference` is the virtual depth at which views coincide, `step` the distance between pixels of
    a view, `spacing` that between the offsets of neighbouring views, `first` the position (y, x) of
    the central view's first pixel, all in pixels of the raw picture: the slope at the virtual depth
    v is ``(reference - v) spacing / step``. `found` says in words which depths `decode` has found.
    """

    def __init__(
        self,
        lenslets: FocusedLenslets,
        *,
        virtual_depth: float | None = None,
        views: int | None = None,
        white: ArrayLike | None = None,
        dark: ArrayLike | None = None,
        bayer: str | None = None,
    ):
        self.lenslets, self.shape, self.found = lenslets, lenslets.shape, ""
        self.bayer = sensor.check_bayer(bayer, self.shape)
        self.views = count_views(lenslets.grid, 5 if views is None else views)
        pitch, self._plane = lenslets.grid.pitch, virtual_depth
        # Nearer, patches do not fit into their micro-images.
        if virtual_depth is not None and not 1.5 <= abs(virtual_depth) <= pitch / 2:
            raise InputError(
                f"A virtual depth must be from 1.5 to {pitch / 2:.4g}, half the pixels under a "
                f"lenslet, or the same below 0, got {virtual_depth}."
            )
        self.reference = REFERENCE if virtual_depth is None else float(virtual_depth)
        self.step = abs(self.reference)
        patch = 0.6 * pitch / self.step  # half its width: as far as a lenslet's cell goes
        farthest = max(lenslets.radius - patch, 0.0) / math.sqrt(2)
        self.spacing = 2 * farthest / (self.views - 1) if self.views > 1 else 0.0
        centres = lenslets.array[0]
        self._black, self._fall = dark, None
        if white is not None:
            light = sensor.subtract_dark(white, dark, "white", self.shape)
            self._fall = fall_off(self._coloured(light), centres)
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
        # Lenslets within reach of each square of half a pitch: in dense arrays, up to nine. Some of
        # each kind are as near, anywhere.
        self._reach, self._cell = 1.1 * pitch, pitch / 2
        squares = [math.ceil(n / self._cell) for n in self.shape[:2]]
        places = self._cell * (np.moveaxis(np.indices(squares), 0, -1) + 0.5)
        farthest = self._reach + math.sqrt(0.5) * self._cell
        _, self._near = cKDTree(centres).query(places, 12, distance_upper_bound=farthest)

    def decode(self, raw: ArrayLike) -> LightField:
        """Assemble the views of a raw picture of the planned shape."""
        image = sensor.subtract_dark(raw, self._black, "raw", self.shape)
        image = self._coloured(image.astype(np.float32, copy=False))
        (centres, _), radius = self.lenslets.array, self.lenslets.radius
        fall = mean_fall_off(image, centres, radius) if self._fall is None else self._fall
        image = np.ascontiguousarray(image / fall, np.float32)
        inverse = self._inverse(image)
        # A lenslet of a kind that is out of focus is used only where no other sees the point.
        weights = np.where(self.lenslets.in_focus(1 / inverse), 1.0, 1e-3)
        places = centred(self.views) * self.spacing
        offsets = np.stack(np.meshgrid(places, places, indexing="ij"), axis=-1).reshape(-1, 2)
        out = np.empty((len(offsets), *self._size, image.shape[2]), np.float32)
        view = (*self.first.tolist(), self.step, self.reference)
        render(
            image, centres, inverse, weights, self._near, self._cell, offsets, view, self._reach,
            radius, out,
        )  # fmt: skip
        out = out.reshape(self.views, self.views, *out.shape[1:])
        return LightField(out if image.shape[2] > 1 else out[..., 0])

    def _inverse(self, image: np.ndarray) -> np.ndarray:
        """Inverse virtual depth of each lenslet, that of the nearest known one where unknown."""
        centres = self.lenslets.array[0]
        if self._plane is not None:
            return np.full(len(centres), 1 / self._plane)
        depth = find_virtual_depth(image, self.lenslets)
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
            f"virtual depth from {low:.3g} to {high:.3g}, known for {known.mean():.0%} of the "
            f"lenslets; slopes of the views are "
            f"{self.spacing / self.step:.4g} ({self.reference:g} - virtual depth)"
        )
        return 1 / depth[known][cKDTree(centres[known]).query(centres)[1]]

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
        return np.where(pixels > 0, light, sums / counts)


def fall_off(white: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """Brightness of a white image relative to the centre of its micro-images, and at least 0.2."""
    y, x = np.rint(centres).astype(int).T
    middle = np.median(white[y, x], axis=0)
    if not np.all(middle > 0):
        raise InputError(
            f"The white image must be bright in the centre of its micro-images, "
            f"got a median there of {middle.min():g}."
        )
    return np.maximum(white / middle, 0.2)


def mean_fall_off(image: np.ndarray, centres: np.ndarray, radius: float) -> np.ndarray:
    """Find the mean of `fall_off` in a picture's micro-images, which is taken to be round."""
    apart, rings = np.ones(image.shape[:2], bool), np.arange(int(radius) + 1)
    apart[tuple(np.rint(centres).astype(int).T)] = False
    away = ndimage.distance_transform_edt(apart)  # from the nearest micro-image's centre
    ring, fall = np.rint(away).astype(int), np.empty_like(image)
    for channel in range(image.shape[2]):
        light = ndimage.mean(image[..., channel], ring, rings)
        # A picture without light has no fall-off.
        light = light / light[0] if light[0] > 0 else np.ones(rings.size)
        fall[..., channel] = np.interp(away, rings, light)
    return np.maximum(fall, 0.2)
