"""Views of a focused plenoptic camera, put together from patches of its micro-images."""

from __future__ import annotations

import logging
import math

import numpy as np
from numpy.typing import ArrayLike

from lf_flame._common.arrays import centred
from lf_flame._common.memory import check_memory
from lf_flame.errors import InputError
from lf_flame.formats.focused._kernels import render
from lf_flame.formats.focused.lenslets import FocusedLenslets
from lf_flame.formats.focused.levelling import in_colour, levelled, white_gain
from lf_flame.formats.focused.virtual_depth import VirtualDepth, match_depth
from lf_flame.formats.raw.lenslet_grid import LensletGrid
from lf_flame.formats.raw.sensor_images import as_image, check_bayer, less_dark
from lf_flame.lightfield import LightField

LOGGER = logging.getLogger(__name__)

REFERENCE = 3.0
"""Absolute virtual depth at which views coincide by default; Raytrix cameras use depths from 2 on.
It is the same for all pictures, so that their slopes are comparable."""

NEAREST = 1.5
"""Smallest virtual depth at which patches fit into their micro-images."""

VIEWS, MOST_VIEWS = 5, 64
"""Number of views along each axis by default, and the largest."""

REACH = 1.1
"""Radius in pitches of the lenslets that contribute to a place: some of each kind, anywhere."""

OUT_OF_FOCUS = 1e-3
"""Weight of lenslets of a kind that is out of focus."""

HALF_PATCH = 0.6
"""Half the width of a patch, in pitches over the virtual depth: as far as a lenslet's cell goes."""

SMALLEST_VIEW = 8
"""Smallest number of rows and columns of a view."""


class FocusedPlan:
    """Plan for the views of one camera with focused lenslets.

    Each place of a view is put together from the lenslets around it: from the part of each
    micro-image around an offset p that belongs to the view, magnified by the lenslet's virtual
    depth v: a patch of pitch / v pixels for each lenslet. Lenslets of a kind that is out of focus
    at its depth count only where no other sees the place. From view to view the offset p moves
    through the micro-image, and a place at the depth v moves by ``(reference - v) p`` pixels of the
    raw picture: by the slope ``(reference - v) spacing / step`` in pixels of a view.

    The offsets lie in a square within the round micro-image, so that all views count. Unlike a view
    of an unfocused camera, a patch holds directions from p - pitch / (2 v) to p + pitch / (2 v).

    Parameters
    ----------
    lenslets : FocusedLenslets
        As from `read_raytrix`, or with the grid of a white image (`estimate_grid`).
    shape : (int, int) or (int, int, int)
        Shape of the raw pictures: rows, columns and, for colour, channels.
    virtual_depth : float, optional
        Virtual depth of all lenslets, and at which views coincide: a plane. Default: found for each
        lenslet, as by `find_virtual_depth`; views coincide at 3, or at -3 if most are negative.
    views : int, optional
        Number of views along each axis, 1 to 64; 1 gives a picture with everything in focus.
        Default: 5.
    white, dark : array_like, shape as raw, or without channels; optional
        White image (flat field) and dark image. Without a white image the mean fall-off within the
        micro-images is taken from each picture.
    bayer : {"rggb", "bggr", "grbg", "gbrg"}, optional
        Colours of the upper left 2 x 2 pixels of a mosaic. Default: no mosaic.

    Attributes
    ----------
    reference : float
        Virtual depth at which views coincide. Unless one is stated or the lenslets have ranges, its
        sign is that of the first picture.
    spacing, step : float
        Distance between the offsets of neighbouring views, and between pixels of a view, in pixels
        of the raw picture.

    Raises
    ------
    InputError
        If an argument cannot be used, or the pictures are too small.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.formats import FocusedLenslets, FocusedPlan, LensletGrid
    >>> raw = np.random.default_rng(1).uniform(size=(240, 320))
    >>> lenslets = FocusedLenslets(LensletGrid(9.5, 9.5, 20))
    >>> plan = FocusedPlan(lenslets, shape=raw.shape, virtual_depth=4.0)
    >>> plan.decode(raw)
    LightField(5 x 5 views of 42 x 62 pixels, grey)
    >>> plan.depth_at(plan.slope_at(5.0))
    5.0
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
        self.lenslets, self.shape = lenslets, tuple(shape)
        self.bayer = None if bayer is None else check_bayer(bayer, self.shape)
        self.views = VIEWS if views is None else views
        if not 1 <= self.views <= MOST_VIEWS or self.views != int(self.views):
            raise InputError(
                f"views must be a whole number from 1 to {MOST_VIEWS} for focused lenslets, "
                f"got {views}."
            )
        farthest = lenslets.grid.pitch / 2
        if virtual_depth is not None and not NEAREST <= abs(virtual_depth) <= farthest:
            raise InputError(
                f"A virtual depth must be from {NEAREST:g} to {farthest:.4g}, half the pixels "
                f"under a lenslet, or the same below 0, got {virtual_depth}."
            )
        self._plane = virtual_depth
        self.reference = REFERENCE if virtual_depth is None else float(virtual_depth)
        self._array = lenslets.array(self.shape)
        self._black = None if dark is None else as_image(dark, "dark")
        self._gain = None
        if white is not None:
            light = less_dark(white, self._black, "white")
            if light.shape[:2] != self.shape[:2]:
                raise InputError(
                    f"The white image must have the raw image's shape {self.shape}, "
                    f"got {light.shape}."
                )
            self._gain = white_gain(self._coloured(light), lenslets)
        self._first, self._size = self._window()
        self._is_new = True

    @property
    def grid(self) -> LensletGrid:
        """Positions of the micro-images."""
        return self.lenslets.grid

    @property
    def step(self) -> float:
        """Distance between pixels of a view, in pixels of the raw picture."""
        return abs(self.reference)

    @property
    def spacing(self) -> float:
        """Distance between the offsets of neighbouring views, in pixels of the raw picture."""
        return 2 * self._farthest / (self.views - 1) if self.views > 1 else 0.0

    @property
    def _farthest(self) -> float:
        """Largest offset along an axis."""
        patch = HALF_PATCH * self.grid.pitch / abs(self.reference)
        return max(self.lenslets.radius - patch, 0.0) / math.sqrt(2)

    def slope_at(self, virtual_depth: float) -> float:
        """Slope of a place at a virtual depth, in pixels of a view per view."""
        return (self.reference - virtual_depth) * self.spacing / self.step

    def depth_at(self, slope: float) -> float:
        """Virtual depth of a place with a slope in the views."""
        if self.views == 1:
            raise InputError("A single view has no slopes; state more views.")
        return self.reference - slope * self.step / self.spacing

    def decode(self, raw: ArrayLike) -> LightField:
        """Put the views of a raw picture together.

        Parameters
        ----------
        raw : array_like, shape as planned
            Picture, linear in radiance, of any real type.

        Returns
        -------
        LightField
            Views of the part of the picture that all of them see. The pixel (t, s) of the central
            view is the place ``first + step (t, s)`` of the raw picture.

        Raises
        ------
        InputError
            If the picture has another shape, or shows no virtual depth and none is stated.
        """
        image = as_image(raw, "raw")
        if image.shape != (*self.shape, 1)[:3]:
            raise InputError(
                f"A raw image must have the plan's shape {self.shape}, got {np.shape(raw)}."
            )
        image = self._coloured(less_dark(image, self._black, "raw").astype(np.float32, copy=False))
        if self._gain is None:
            image = levelled(image, self.lenslets)
        else:
            image = np.ascontiguousarray(image * self._gain)
        inverse = self._inverse(image)
        weights = (
            np.where(self.lenslets.in_focus(self._array, 1 / inverse), 1.0, OUT_OF_FOCUS)
            * self._array.whole
        )
        places = centred(self.views) * self.spacing
        offsets = np.stack(np.meshgrid(places, places, indexing="ij"), axis=-1).reshape(-1, 2)
        out = np.empty((len(offsets), *self._size, image.shape[2]), np.float32)
        view = (*self._first, self.step, self.reference)
        first = int(self._array.rows[0]), int(self._array.columns[0])
        render(
            image, self.lenslets.lattice, first, inverse, weights, offsets, view,
            REACH * self.grid.pitch, self.lenslets.radius, out,
        )  # fmt: skip
        coloured = image.shape[2] > 1
        out = out.reshape(self.views, self.views, *out.shape[1:])
        return LightField(out if coloured else out[..., 0])

    @property
    def first(self) -> tuple[float, float]:
        """Place (y, x) in the raw picture of the first pixel of the central view."""
        return self._first

    def _coloured(self, image: np.ndarray) -> np.ndarray:
        return image if self.bayer is None else in_colour(image, self.bayer)

    def _window(self) -> tuple[tuple[float, float], tuple[int, int]]:
        """Place of the first pixel of the central view, and number of rows and columns."""
        margin = self.lenslets.radius + 1 + abs(self.reference) * self._farthest
        inner = np.array(self.shape[:2]) - 1 - 2 * (margin + self.grid.pitch / 2)
        size = np.floor(np.maximum(inner, 0) / self.step).astype(int) + 1
        if min(size) < SMALLEST_VIEW:
            raise InputError(
                f"Pictures of {self.shape[0]} x {self.shape[1]} pixels are too small for views "
                f"from lenslets of {self.grid.pitch:.4g} pixels at the virtual depth "
                f"{self.reference:g}."
            )
        first = (np.array(self.shape[:2]) - 1 - (size - 1) * self.step) / 2
        check_memory(self.views**2 * int(size.prod()) * 3 * 4 * 2, "The light field of views")
        return (float(first[0]), float(first[1])), (int(size[0]), int(size[1]))

    def _inverse(self, image: np.ndarray) -> np.ndarray:
        """Inverse virtual depth of each lenslet."""
        if self._plane is not None:
            return np.full(self._array.whole.shape, 1 / self._plane)
        found = match_depth(image, self.lenslets)
        known = _known(found)
        if self._is_new and not self.lenslets.ranges:
            self.reference = float(np.copysign(REFERENCE, np.median(known)))
        if self._is_new:
            low, high = np.percentile(known, [2, 98])
            law = f"; in the views, slope = {self.slope_at(self.reference - 1):.4g}"
            law += f" ({self.reference:g} - virtual depth)"
            LOGGER.info(
                f"virtual depth from {low:.3g} to {high:.3g}, known for {found.share:.0%} of the "
                f"lenslets{law if self.views > 1 else ''}"
            )
        self._is_new = False
        return found.inverse()


def _known(found: VirtualDepth) -> np.ndarray:
    """Known virtual depths."""
    known = found.depth[np.isfinite(found.depth)]
    if not known.size:
        raise InputError(
            "No virtual depth was found: neighbouring micro-images do not show the same detail, "
            "displaced. The picture lacks texture, or the calibration does not fit it; state the "
            "virtual depth (--virtual-depth) to render it as a plane."
        )
    return known
