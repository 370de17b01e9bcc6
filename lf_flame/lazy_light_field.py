"""Light fields larger than memory, of which bands of rows are read when they are needed.

Shift-and-sum, a slope map and the image all in focus are local in the rows of pixels: a row of
the result depends on the rows within the largest shift of a view. A band with so many rows more on
both sides therefore gives the same as the whole light field.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext
from functools import cached_property
from math import ceil, prod
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from lf_flame._common import progress
from lf_flame._common.images import check_levels, to_unit
from lf_flame._common.memory import check_memory, memory_limit
from lf_flame.errors import InputError
from lf_flame.lightfield import LightField, as_view_weights

BAND_SHARE = 1 / 8
"""Fraction of the memory limit that one band may take as float32; it is copied a few times."""

FLOAT = np.dtype(np.float32).itemsize


class Band(NamedTuple):
    """Some rows of an image, and the rows of the views that they are made from.

    Attributes
    ----------
    rows, read : slice
        Rows of the image, and the rows of the views that were read.
    """

    rows: slice
    read: slice

    @property
    def inner(self) -> slice:
        """The rows of the image, counted from the first one that was read."""
        return slice(self.rows.start - self.read.start, self.rows.stop - self.read.start)


class LazyLightField:
    """A light field in a file, of which rows of pixels are read when they are needed.

    Parameters
    ----------
    array : array-like with ``shape``, ``dtype`` and slices
        Stored views: an array of Zarr, h5py, Dask or NumPy's ``memmap``. As in
        `lf_flame.formats.read_array`, unsigned levels of 8 and 16 bits become 0 to 1.
    axes : str, optional
        Meaning of its axes, one letter each: v and u, row and column of the view, or n, its running
        number; t and s, row and column of the pixel; c, the channel. Default: ``vuts``, ``vutsc``.
    numbers : array_like of int, shape (v, u), optional
        Place of view v, u among the stored views. Default: row by row.
    weights : array_like, shape (v, u), optional
        Weight of each view, as in `LightField`.
    source : str, optional
        Name of the light field, for messages.
    guard : callable, optional
        Function that gives a context in which the array is read, which turns the errors of its
        reader into `InputError`.

    Attributes
    ----------
    shape : tuple of int
        Shape of the views: (v, u, t, s) or (v, u, t, s, channels).

    Raises
    ------
    InputError
        If the array is not one of views. NaN and infinite pixels are refused when they are read.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame import LazyLightField, refocus
    >>> views = np.random.default_rng(1).uniform(size=(5, 5, 24, 30)).astype(np.float32)
    >>> np.save("views.npy", views)
    >>> stored = LazyLightField(np.load("views.npy", mmap_mode="r"))
    >>> stored
    LazyLightField(5 x 5 views of 24 x 30 pixels)
    >>> image = refocus.refocus(stored, 0.7)
    >>> bool(np.abs(image - refocus.refocus(views, 0.7)).max() < 1e-6)
    True
    """

    positions = valid = None

    def __init__(
        self,
        array: Any,
        *,
        axes: str | None = None,
        numbers: ArrayLike | None = None,
        weights: ArrayLike | None = None,
        source: str = "The light field",
        guard: Callable[[], AbstractContextManager] = nullcontext,
    ):
        stored = tuple(getattr(array, "shape", ()))
        axes = axes or {4: "vuts", 5: "vutsc"}.get(len(stored), "")
        wanted = ("n" if "n" in axes else "vu") + "ts" + ("c" if "c" in axes else "")
        if len(axes) != len(stored) or sorted(axes) != sorted(wanted) or 0 in stored:
            raise InputError(
                f"A light field needs views[v, u, t, s], or axes that name others, got an array "
                f"of shape {stored} with axes {axes!r}."
            )
        check_levels(np.empty(0, array.dtype), source)
        self._array, self._axes, self._source, self._guard = array, axes, source, guard
        self._order = [axes.index(letter) for letter in wanted]
        size = dict(zip(axes, stored, strict=True))
        views = (size["n"],) if "n" in axes else (size["v"], size["u"])
        plain = np.arange(prod(views)).reshape(views if len(views) == 2 else (-1, 1))
        self._numbers = plain if numbers is None else np.asarray(numbers)
        self.shape = (*self._numbers.shape, *(size[x] for x in wanted[len(views) :]))
        self.weights = (
            None if weights is None else as_view_weights(weights, self.shape[:2]).astype(np.float32)
        )

    def __repr__(self) -> str:
        v, u, t, s = self.shape[:4]
        kind = f", {self.shape[4]} channels" if len(self.shape) == 5 else ""
        return f"LazyLightField({v} x {u} views of {t} x {s} pixels{kind})"

    def rearranged(
        self, numbers: ArrayLike | None = None, *, weights: ArrayLike | None = None
    ) -> LazyLightField:
        """Give the same light field with other weights, and its views in another order.

        Parameters
        ----------
        numbers : array_like of int, shape (v, u), optional
            Number of each view, counted row by row in this light field. Default: as here.
        weights : array_like, shape (v, u), optional
            Weights of the views in the new order. Default: all equal.
        """
        order = self._numbers if numbers is None else self._numbers.ravel()[np.asarray(numbers)]
        return LazyLightField(
            self._array, axes=self._axes, numbers=order, weights=weights, source=self._source,
            guard=self._guard,
        )  # fmt: skip

    def view(self, v: int, u: int) -> np.ndarray:
        """Read one view: float32, shape (t, s) or (t, s, channels)."""
        number = int(self._numbers[v, u])
        at = (number,) if "n" in self._axes else np.unravel_index(number, self._views_stored)
        place = dict(zip("n" if "n" in self._axes else "vu", map(int, at), strict=True))
        pixels = self._read(*(place.get(letter, slice(None)) for letter in self._axes))
        kept = [letter for letter in self._axes if letter not in place]
        return pixels.transpose([kept.index(letter) for letter in "tsc" if letter in kept])

    def _read(self, *key: Any) -> np.ndarray:
        with self._guard():
            pixels = np.asarray(self._array[key])
        return to_unit(pixels, self._source)

    def rows(self, start: int, stop: int) -> LightField:
        """Read the rows of pixels from `start` to `stop` - 1 of all views."""
        shape = list(self._array.shape)
        shape[self._axes.index("t")] = stop - start
        stored = np.empty(shape, np.float32)
        key = [slice(start, stop) if letter == "t" else slice(None) for letter in self._axes]
        # One part at a time: a reader of chunks may hold several of them beside what it returns.
        whole = self._axes[0] in "ts"
        for first in [None] if whole else range(shape[0]):
            stored[... if whole else first] = self._read(key[0] if whole else first, *key[1:])
        views = stored.transpose(self._order)
        if "n" not in self._axes:
            views = views.reshape(-1, *views.shape[2:])
        if not np.array_equal(self._numbers.ravel(), np.arange(len(views))):
            views = views[self._numbers.ravel()]
        return LightField(views.reshape(*self.shape[:2], *views.shape[1:]), weights=self.weights)

    def bands(self, reach: int = 0, what: str = "refocusing") -> Iterator[tuple[Band, LightField]]:
        """Read bands of rows one after the other, with a progress bar.

        Parameters
        ----------
        reach : int, optional
            Number of rows that are read beyond both ends of a band, as far as there are any.
        what : str, optional
            Name of the work, for the progress bar.

        Yields
        ------
        Band, LightField
            The rows, and the light field of the rows that were read.

        Raises
        ------
        InputError
            If one band exceeds the memory limit.
        """
        bands = self.plan(reach)
        for band in progress.steps(bands, what, len(bands), "band"):
            yield band, self.rows(band.read.start, band.read.stop)

    def plan(self, reach: int = 0) -> list[Band]:
        """Plan bands of about equal height, as `bands` reads them."""
        height, room = self.shape[2], self.rows_at_once
        tallest = max(room - 2 * reach, reach // 2, 1)
        check_memory(self._row_bytes * min(tallest + 2 * reach, height), self._source)
        count = ceil(height / tallest)
        ends = [height * k // count for k in range(count + 1)]
        return [
            Band(slice(a, b), slice(max(a - reach, 0), min(b + reach, height)))
            for a, b in zip(ends[:-1], ends[1:], strict=True)
        ]

    @property
    def rows_at_once(self) -> int:
        """Number of rows of pixels that a band may have."""
        return max(int(BAND_SHARE * memory_limit() / self._row_bytes), 1)

    @property
    def _row_bytes(self) -> int:
        return FLOAT * prod(self.shape) // self.shape[2]

    @property
    def _views_stored(self) -> tuple[int, int]:
        return tuple(self._array.shape[self._axes.index(letter)] for letter in "vu")  # type: ignore

    @property
    def brightest_rows(self) -> LightField:
        """Light field of one row of pixels, that with the brightest pixel."""
        return self.rows(self._brightest_row, self._brightest_row + 1)

    @cached_property
    def _brightest_row(self) -> int:
        """Number of the row that holds the brightest pixel; all rows are read for it."""
        found = (0, -np.inf)
        for band, some in self.bands(what="reading"):
            tops = np.moveaxis(some.views, 2, 0).reshape(some.shape[2], -1).max(axis=1)
            if tops.max() > found[1]:
                found = (band.rows.start + int(tops.argmax()), float(tops.max()))
        return found[0]
