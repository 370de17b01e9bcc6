"""Refocused images that a page asks its program for: where it cannot, or should not, sum itself."""

import re
from dataclasses import dataclass, field
from functools import cached_property
from threading import Lock
from typing import Any

import numpy as np

from lf_flame.errors import InputError
from lf_flame.formats.images import white_level
from lf_flame.lightfield import LightField
from lf_flame.refocus import aperture_weights, refocus
from lf_flame.refocus._arguments import as_weights

NAMES = ("slope", "shape", "width", "ring", "v", "u", "block")
"""Of what a plane is asked for by, each once; v and u are where the aperture's centre is."""

NUMBER = re.compile(r"-?\d{1,9}(\.\d{1,30})?(e-\d{1,2})?", re.ASCII)
"""As browsers write the numbers that may be asked for."""

BLOCKS = (4, 3, 2)
"""Sides of the blocks that are averaged while one drags, the best one first."""

SMALLEST = 32
"""Side of an image that is still worth looking at while one drags."""

WIDEST = {"square": 1.0, "round": np.sqrt(2)}
"""Aperture that holds all views, in widths of the full one; more would be the same."""


@dataclass(frozen=True)
class PlaneQuery:
    """What plane is asked for.

    Attributes
    ----------
    slope : float
        In lenslets per view step.
    shape : str
        Of the aperture, "square" or "round".
    width, ring : float
        Of the aperture and of its covered middle, in widths of the full aperture.
    v, u : float
        Where its centre is, in views from the middle one.
    block : int
        Pixels along the sides of the blocks that are averaged into one.
    """

    slope: float
    shape: str
    width: float
    ring: float
    v: float
    u: float
    block: int

    @property
    def whole(self) -> bool:
        """Whether the aperture is the full one."""
        return (self.shape, self.width, self.ring, self.v, self.u) == ("square", 1, 0, 0, 0)


def parse_plane(query: str) -> PlaneQuery:
    """Read what stands behind the question mark of an address.

    Raises
    ------
    InputError
        If a name is missing, unknown or there twice, or a value no plain number.
    """
    values = _values(query, NAMES)
    if values["shape"] not in WIDEST:
        raise InputError(f"shape must be one of {', '.join(WIDEST)}.")
    slope, width, ring, v, u = (
        _number(name, values[name]) for name in ("slope", "width", "ring", "v", "u")
    )
    return PlaneQuery(slope, values["shape"], width, ring, v, u, _whole(values, "block"))


def parse_place(query: str) -> tuple[int, int]:
    """Read a row and a column.

    Raises
    ------
    InputError
        As `parse_plane`.
    """
    values = _values(query, ("row", "column"))
    return _whole(values, "row"), _whole(values, "column")


def _values(query: str, names: tuple[str, ...]) -> dict[str, str]:
    parts = [part.partition("=") for part in query.split("&")]
    if sorted(name for name, _, _ in parts) != sorted(names):
        raise InputError(f"What is asked for is told by {', '.join(names)}, each once.")
    return {name: value for name, _, value in parts}


def _number(name: str, text: str) -> float:
    if not NUMBER.fullmatch(text):
        raise InputError(f"{name} must be a plain number.")
    return float(text)


def _whole(values: dict[str, str], name: str) -> int:
    number = _number(name, values[name])
    if number != int(number):
        raise InputError(f"{name} must be a whole number.")
    return int(number)


@dataclass(frozen=True, eq=False)
class PlaneMaker:
    """Makes the planes of a light field, one at a time.

    Attributes
    ----------
    light_field : LightField
    slopes : (float, float)
        Beyond which no plane is made.
    interpolation : {"linear", "nearest", "cubic", "sinc"}, optional
    network : lf_flame.systems.base.RefocusingSystem, optional
        Refocuses instead of `lf_flame.refocus.refocus`, by its own aperture.
    """

    light_field: LightField
    slopes: tuple[float, float]
    interpolation: str = "linear"
    network: Any = None
    _lock: Any = field(default_factory=Lock, init=False, repr=False)

    @property
    def channels(self) -> int:
        """Colours of a plane."""
        return self.light_field.views.shape[4] if self.light_field.views.ndim == 5 else 1

    @cached_property
    def coarse(self) -> int:
        """The one block beside 1 that may be asked for; 1 where a coarser image is of no use."""
        return next((block for block in BLOCKS if self._takes(block)), 1)

    def _takes(self, block: int) -> bool:
        shape = self.light_field.views.shape
        small = shape[:2] + tuple(n // block for n in shape[2:4]) + shape[4:]
        if min(small[2:4]) < SMALLEST:
            return False
        try:
            if self.network is not None:
                views = np.broadcast_to(np.float32(0), small)
                self.network.check(views, [slope / block for slope in self.slopes])
        except InputError:
            return False
        return True

    def make(self, query: PlaneQuery) -> np.ndarray:
        """Refocus: radiance, float32, shape (t / block, s / block, channels).

        What is left over at the ends, where the block does not divide the sides, is left out.

        Raises
        ------
        InputError
            If a number is out of range, or there is a network and another aperture than the full.
        """
        self._check(query)
        with self._lock:  # all cores work at one plane already, and memory is for one
            views = self._views if query.block == 1 else self._binned
            slope = query.slope / query.block
            if self.network is not None:
                image = self._white * self.network.refocus(views, [slope])[0]
            else:
                image = refocus(
                    views, [slope], interpolation=self.interpolation, weights=self._weights(query)
                )[0]
        return np.asarray(image, np.float32).reshape(*views.shape[2:4], self.channels)

    def _check(self, query: PlaneQuery) -> None:
        low, high = self.slopes
        if not low <= query.slope <= high:
            raise InputError(f"slope must be from {low:g} to {high:g}, got {query.slope:g}.")
        if not 0 < query.width <= WIDEST[query.shape]:
            raise InputError(
                f"width must be above 0 and {WIDEST[query.shape]:.4g} at most, got {query.width:g}."
            )
        for name, n in zip("vu", self.light_field.views.shape[:2], strict=True):
            if not abs(getattr(query, name)) <= (n - 1) / 2:
                raise InputError(f"{name} must be from {-(n - 1) / 2:g} to {(n - 1) / 2:g}.")
        if query.block not in (1, self.coarse):
            raise InputError(f"block must be 1 or {self.coarse}, got {query.block}.")
        if self.network is not None and not query.whole:
            raise InputError("A network has its own aperture.")
        self._weights(query)

    def _weights(self, query: PlaneQuery) -> np.ndarray:
        shape = self.light_field.views.shape[:2]
        centre = query.v, query.u
        aperture = aperture_weights(shape, query.width, query.ring, query.shape, centre)
        return as_weights(aperture, self.light_field)

    @cached_property
    def _white(self) -> np.float32:
        """What a network takes for 1."""
        return np.float32(white_level(self.light_field.views))

    @cached_property
    def _views(self) -> np.ndarray:
        """Views as they are refocused: as they are, or from 0 to 1 for a network."""
        views = self.light_field.views
        return views if self.network is None or self._white == 1 else views / self._white

    @cached_property
    def _binned(self) -> np.ndarray:
        return _bin_views(self._views, self.coarse)

    def middle(self) -> np.ndarray:
        """Give the view next to the middle: radiance, float32, shape (t, s, channels)."""
        v, u, t, s = self.light_field.views.shape[:4]
        view = self.light_field.views[(v - 1) // 2, (u - 1) // 2]
        return view.reshape(t, s, self.channels)

    def slices(self, row: int, column: int) -> tuple[np.ndarray, np.ndarray]:
        """Give a row in the views beside each other, and a column in those above each other.

        Returns
        -------
        ndarray of float32, shape (u, s, channels)
        ndarray of float32, shape (v, t, channels)

        Raises
        ------
        InputError
            If the place is outside of the image.
        """
        v, u, t, s = self.light_field.views.shape[:4]
        if not (0 <= row < t and 0 <= column < s):
            raise InputError(f"row must be below {t} and column below {s}, and none below 0.")
        views = self.light_field.views.reshape(v, u, t, s, self.channels)
        return views[(v - 1) // 2, :, row], views[:, (u - 1) // 2, :, column]


def _bin_views(views: np.ndarray, block: int) -> np.ndarray:
    """Average blocks of pixels; float32, shape (v, u, t / block, s / block, ...)."""
    v, u, t, s = views.shape[:4]
    height, width = t // block, s // block
    out = np.empty((v, u, height, width, *views.shape[4:]), np.float32)
    for to, row in zip(out, views, strict=True):  # a row at a time: less memory than all
        cut = row[:, : height * block, : width * block]
        cut = cut.reshape(u, height, block, width, block, *views.shape[4:])
        cut.mean(axis=(2, 4), out=to)
    return out
