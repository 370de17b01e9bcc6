"""Refocused images (planes) for a page that cannot, or should not, sum views itself."""

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
"""Names in a query, each once; v and u are the centre of the aperture."""

NUMBER = re.compile(r"-?\d{1,9}(\.\d{1,30})?(e-\d{1,2})?", re.ASCII)
"""Pattern of numbers as browsers write them."""

BLOCKS = (4, 3, 2)
"""Sides of the blocks that are averaged while the user drags, best first."""

SMALLEST = 32
"""Smallest side of an image that is useful while the user drags."""

WIDEST = {"square": 1.0, "round": np.sqrt(2)}
"""Largest width of the aperture by shape, in widths of the full one; it contains all views."""


@dataclass(frozen=True)
class PlaneQuery:
    """Request for one refocused image.

    Attributes
    ----------
    slope : float
        Slope in lenslets per view step.
    shape : str
        Shape of the aperture, "square" or "round".
    width, ring : float
        Widths of the aperture and of its covered centre, in widths of the full aperture.
    v, u : float
        Centre of the aperture, in views from the central view.
    block : int
        Side of the blocks of pixels that are averaged into one.
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
    """Read the query of an address, after the question mark.

    Raises
    ------
    InputError
        If a name is missing, unknown or repeated, or a value is not a plain number.
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
        As for `parse_plane`.
    """
    values = _values(query, ("row", "column"))
    return _whole(values, "row"), _whole(values, "column")


def _values(query: str, names: tuple[str, ...]) -> dict[str, str]:
    parts = [part.partition("=") for part in query.split("&")]
    if sorted(name for name, _, _ in parts) != sorted(names):
        raise InputError(f"The query must contain each of {', '.join(names)} exactly once.")
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
    """Makes refocused images (planes) of a light field, one at a time.

    Attributes
    ----------
    light_field : LightField
        Light field to refocus.
    slopes : (float, float)
        Range of slopes; others are refused.
    interpolation : {"linear", "nearest", "cubic", "sinc"}, optional
        Interpolation between lenslets.
    network : lf_flame.systems.base.RefocusingSystem, optional
        System that refocuses instead of `lf_flame.refocus.refocus`, with its own aperture.
    """

    light_field: LightField
    slopes: tuple[float, float]
    interpolation: str = "linear"
    network: Any = None
    _lock: Any = field(default_factory=Lock, init=False, repr=False)

    @property
    def channels(self) -> int:
        """Number of colour channels of an image."""
        return self.light_field.views.shape[4] if self.light_field.views.ndim == 5 else 1

    @cached_property
    def coarse(self) -> int:
        """The one block beside 1 that may be requested; 1 if a coarser image is useless."""
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

        Incomplete blocks at the ends are left out.

        Raises
        ------
        InputError
            If a number is out of range, or a network would need another aperture than the full one.
        """
        self._check(query)
        with self._lock:  # one image already uses all cores, and the memory planned for one
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
        """Radiance that becomes 1 for a network."""
        return np.float32(white_level(self.light_field.views))

    @cached_property
    def _views(self) -> np.ndarray:
        """Views for refocusing: unchanged, or scaled to 0 to 1 for a network."""
        views = self.light_field.filled
        return views if self.network is None or self._white == 1 else views / self._white

    @cached_property
    def _binned(self) -> np.ndarray:
        return _bin_views(self._views, self.coarse)

    def middle(self) -> np.ndarray:
        """Central view: radiance, float32, shape (t, s, channels)."""
        v, u, t, s = self.light_field.views.shape[:4]
        view = self.light_field.filled[(v - 1) // 2, (u - 1) // 2]
        return view.reshape(t, s, self.channels)

    def slices(self, row: int, column: int) -> tuple[np.ndarray, np.ndarray]:
        """Slices of a row over the views of the central row, and of a column over the central one.

        Returns
        -------
        ndarray of float32, shape (u, s, channels)
        ndarray of float32, shape (v, t, channels)

        Raises
        ------
        InputError
            If the position is outside the image.
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
    for to, row in zip(out, views, strict=True):  # one row at a time saves memory
        cut = row[:, : height * block, : width * block]
        cut = cut.reshape(u, height, block, width, block, *views.shape[4:])
        cut.mean(axis=(2, 4), out=to)
    return out
