"""The light field and its two layouts.

``views[v, u, t, s]``, float32: v, u are the angular row and column (sub-aperture view), t, s the
spatial row and column (lenslet); an optional fifth axis is for colour channels. The raw
lenslet image is ``raw[t * N + v, s * N + u]``: micro-image pixels in sensor order, not flipped.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lf_flame.errors import InputError

LARGEST = 1e37
"""Largest value of a light field; sums of several larger ones are beyond float32."""


def as_view_weights(weights: ArrayLike, shape: tuple[int, ...]) -> np.ndarray:
    """Check weights of views, shape (v, u), and give them as float64.

    Raises
    ------
    InputError
        If the weights have another shape, are not finite, are below 0, or are all 0.
    """
    try:
        weights = np.asarray(weights, float)
    except (TypeError, ValueError):
        raise InputError(f"weights must be numbers, one for each view, got {weights!r}.") from None
    if weights.shape != tuple(shape):
        raise InputError(
            f"weights must have the shape of the views, {shape[0]} x {shape[1]}, got an array of "
            f"shape {weights.shape}."
        )
    total = weights.sum()
    if not np.all(weights >= 0) or not 0 < total < np.inf:
        raise InputError("weights must be finite and 0 or above, with at least one above 0.")
    return weights


def as_valid(valid: ArrayLike, shape: tuple[int, ...]) -> np.ndarray | None:
    """Check which pixels are known, shape (v, u, t, s): contiguous bool, or None if all are.

    Raises
    ------
    InputError
        If the array has another shape, or other values than 0 and 1.
    """
    given = np.asarray(valid)
    if given.shape != tuple(shape):
        raise InputError(
            f"valid must have the shape of the views without channels, {tuple(shape)}, got an "
            f"array of shape {given.shape}."
        )
    known = np.ascontiguousarray(given, bool) if given.dtype.kind in "biuf" else np.array(False)
    if not np.array_equal(known, given):
        raise InputError("valid must be True (1) where a pixel is known, False (0) elsewhere.")
    return None if known.all() else known


AXES = ("v", "u", "t", "s", "channel")
"""Axis names of an `xarray.DataArray`, in the order of `LightField.views`."""


def in_order(views: Any) -> Any:
    """Bring the axes of an `xarray.DataArray` into the order of `AXES`; leave anything else.

    Raises
    ------
    InputError
        If the axes have other names.
    """
    names, transpose = getattr(views, "dims", None), getattr(views, "transpose", None)
    if not isinstance(names, tuple) or transpose is None:
        return views
    if set(names) not in (set(AXES), set(AXES[:4])):
        raise InputError(
            f"The axes of a light field must be named {', '.join(AXES[:4])} and, for colour, "
            f"{AXES[4]}, got {', '.join(map(str, names))}."
        )
    return transpose(*(name for name in AXES if name in names))


@dataclass(frozen=True, eq=False, repr=False)
class LightField:
    """A light field as sub-aperture views.

    Parameters
    ----------
    views : array_like, shape (v, u, t, s) or (v, u, t, s, channels)
        Finite radiance values. Stored as contiguous float32; copied only if they are not.
    plan : lf_flame.simulation.planning.plan.EffectPlan, optional
        Effect plan of a rendered light field: the effects that were simulated, and why.
    weights : array_like, shape (v, u), optional
        Weights of views in every search, refocusing and fit: 0 or above, at least one above 0;
        weights passed to such a function multiply these. A decoded raw image has weight 0 for views
        with light of neighbouring lenslets, and for mostly dark ones. Stored as float32. Default:
        all views have weight 1.
    valid : array_like of bool, shape (v, u, t, s), optional
        Whether the value of each pixel is known: it is not where the sensor was saturated, a pixel
        is bad, or its lenslet is too dark. The stored value of an unknown pixel is a lower bound of
        its light. Refocusing and fits leave unknown pixels out; everything else takes them from
        `filled`. Default: all are known.

    Raises
    ------
    InputError
        If the array has another number of axes, is empty, or contains NaN, infinite values or
        values beyond 1e37; if the weights cannot be used, or `valid` has another shape or other
        values.

    Notes
    -----
    An `xarray.DataArray` may have its axes in any order if they are named ``v, u, t, s`` and,
    for colour, ``channel``; `to_xarray` returns one.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame import LightField
    >>> light_field = LightField(np.ones((9, 9, 60, 90)))
    >>> light_field
    LightField(9 x 9 views of 60 x 90 pixels, grey)
    >>> light_field.photograph.shape
    (60, 90)
    """

    views: np.ndarray
    plan: Any = None
    weights: np.ndarray | None = None
    valid: np.ndarray | None = None

    def __post_init__(self):
        views = in_order(self.views)
        try:
            views = np.asarray(views)
        except ValueError:
            raise InputError("All views must be numbers, and of one shape.") from None
        if views.ndim not in (4, 5) or views.size == 0 or views.dtype.kind not in "biuf":
            raise InputError(
                f"A light field needs views[v, u, t, s] with at least one element, real-valued, "
                f"got an array of shape {views.shape} and type {views.dtype}."
            )
        views = np.ascontiguousarray(views, np.float32)
        if not np.all(np.isfinite(views)):
            bad = np.count_nonzero(~np.isfinite(views))
            raise InputError(f"A light field must be finite, got {bad} NaN or infinite pixels.")
        largest = max(float(views.max()), -float(views.min()))
        if largest > LARGEST:
            raise InputError(
                f"The values of a light field must be at most {LARGEST:g}, for float32 to hold "
                f"their sums, got {largest:g}: scale them."
            )
        object.__setattr__(self, "views", views)
        if self.weights is not None:
            with np.errstate(over="ignore"):  # refused below
                weights = as_view_weights(self.weights, views.shape[:2]).astype(np.float32)
            as_view_weights(weights, views.shape[:2])
            object.__setattr__(self, "weights", weights)
        if self.valid is not None:
            object.__setattr__(self, "valid", as_valid(self.valid, views.shape[:4]))

    @classmethod
    def trusted(
        cls,
        views: np.ndarray,
        plan: Any = None,
        weights: np.ndarray | None = None,
        valid: np.ndarray | None = None,
    ) -> LightField:
        """Wrap contiguous float32 views that are known to be finite, without checking them."""
        light_field = object.__new__(cls)
        given = {"views": views, "plan": plan, "weights": weights, "valid": valid}
        for name, value in given.items():
            object.__setattr__(light_field, name, value)
        return light_field

    @classmethod
    def from_raw(cls, raw: ArrayLike, *, views: int) -> LightField:
        """Cut a raw lenslet image into its views.

        Parameters
        ----------
        raw : array_like, shape (t * views, s * views) or with a last axis of channels
        views : int
            Number of pixels under a lenslet along each axis.

        Raises
        ------
        InputError
            If a side is not a multiple of `views`, or a pixel is not finite.
        """
        raw = np.asarray(raw)
        whole = views >= 1 and views % 1 == 0 and not any(n % views for n in raw.shape[:2])
        if raw.ndim not in (2, 3) or not whole:
            raise InputError(
                f"A raw lenslet image needs sides that are multiples of the {views} pixels under "
                f"a lenslet, got an array of shape {raw.shape}."
            )
        lenslets = [n // int(views) for n in raw.shape[:2]]
        cells = raw.reshape(lenslets[0], -1, lenslets[1], int(views), *raw.shape[2:])
        return cls(np.moveaxis(cells, (1, 3), (0, 1)))

    def to_raw(self) -> np.ndarray:
        """Return the raw lenslet image: float32, shape (t * v, s * u) or with a channel axis."""
        v, u, t, s = self.views.shape[:4]
        cells = np.moveaxis(self.views, (0, 1), (1, 3))
        return cells.reshape(t * v, s * u, *self.views.shape[4:])

    def to_xarray(self) -> Any:
        """Return an `xarray.DataArray` with axes ``v, u, t, s`` and, for colour, ``channel``.

        The axes v and u have coordinates, in view steps from the central view. It needs the extra
        ``[xarray]``.
        """
        import xarray

        steps = {
            name: np.arange(n) - (n - 1) / 2
            for name, n in zip("vu", self.views.shape, strict=False)
        }
        return xarray.DataArray(self.views, steps, AXES[: self.views.ndim], name="radiance")

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the views: (v, u, t, s) or (v, u, t, s, channels)."""
        return self.views.shape

    @property
    def channels(self) -> int:
        """Number of colour channels; 1 for grey light fields."""
        return self.views.shape[4] if self.views.ndim == 5 else 1

    def grey(self) -> LightField:
        """Average over the channels; returns the light field itself if it is grey.

        Examples
        --------
        >>> import numpy as np
        >>> LightField(np.ones((3, 3, 8, 8, 3))).grey().shape
        (3, 3, 8, 8)
        """
        if self.views.ndim == 4:
            return self
        mean = self.views.mean(axis=4, dtype=np.float64).astype(np.float32)
        return LightField.trusted(mean, self.plan, self.weights, self.valid)

    @cached_property
    def filled(self) -> np.ndarray:
        """Views with unknown pixels filled, float32, shape of the views.

        A filled pixel has the mean of the known ones around it in its view, or its stored value, if
        that is larger. If all are known, these are the views themselves.

        Examples
        --------
        >>> import numpy as np
        >>> light_field = LightField([[[[1.0, 9.0, 3.0]]]], valid=[[[[True, False, True]]]])
        >>> light_field.filled.tolist()
        [[[[1.0, 9.0, 3.0]]]]
        >>> LightField([[[[1.0, 0.0, 3.0]]]], valid=light_field.valid).filled.tolist()
        [[[[1.0, 2.0, 3.0]]]]
        """
        if self.valid is None:
            return self.views
        shape = (*self.views.shape[:4], self.channels)
        return fill_unknown(self.views.reshape(shape), self.valid).reshape(self.views.shape)

    def __repr__(self) -> str:
        v, u, t, s = self.views.shape[:4]
        kind = {1: "grey", 3: "colour"}.get(self.channels, f"{self.channels} channels")
        return f"LightField({v} x {u} views of {t} x {s} pixels, {kind})"

    def __array__(self, dtype: Any = None, copy: Any = None) -> np.ndarray:
        """Return the views, for ``numpy.asarray(light_field)``; see `numpy.array`."""
        return np.array(self.views, dtype, copy=copy)

    @property
    def photograph(self) -> np.ndarray:
        """Weighted mean of the views, as of an ordinary camera: float32, (t, s[, channels])."""
        if self.weights is None:
            return self.filled.mean(axis=(0, 1), dtype=np.float64).astype(np.float32)
        weights = self.weights.astype(np.float64) / self.weights.sum(dtype=np.float64)
        return np.einsum("vu,vu...->...", weights, self.filled).astype(np.float32)

    @property
    def used_values(self) -> np.ndarray:
        """Values of known pixels in views with weight; all values where there are none."""
        some = slice(None) if self.weights is None else self.weights > 0
        found = self.views[some] if self.valid is None else self.views[some][self.valid[some]]
        return found if found.size else self.views

    @property
    def excluded(self) -> str:
        """Sentence on the number of views with weight 0; empty if there are none."""
        if self.weights is None or self.weights.all():
            return ""
        return (
            f"{np.count_nonzero(self.weights == 0)} of the {self.weights.size} views are excluded: "
            f"outermost ones, mostly dark or lit through neighbouring lenslets, or missing ones"
        )

    @property
    def unknown(self) -> str:
        """Sentence on the number of unknown pixels; empty if there are none."""
        if self.valid is None:
            return ""
        lost = int(np.count_nonzero(~self.valid))
        return (
            f"{lost} of the {self.valid.size} pixels of the views ({lost / self.valid.size:.2g}) "
            f"are unknown: saturated, bad, or of dark lenslets (left out, or filled from around)"
        )


AROUND = [(i, j, 0.5 if i and j else 1.0) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j]
"""Rows and columns from a pixel to its eight neighbours, and their weights."""


def fill_unknown(images: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Fill unknown pixels of images with means of known neighbours, from the rim of a hole inwards.

    A pixel with more than that mean keeps its value, which is a lower bound of the light, for
    example where a sensor is saturated.

    Parameters
    ----------
    images : ndarray of float32, shape (..., rows, columns, channels)
    known : ndarray of bool, shape (..., rows, columns)

    Returns
    -------
    ndarray of float32, shape of `images`
        Images; one without a known pixel is unchanged.
    """
    out = images.reshape(-1, *images.shape[-3:]).copy()
    given, done = images.reshape(out.shape), known.reshape(out.shape[:3]).copy()
    rows, columns = out.shape[1:3]
    places = np.nonzero(~done)
    unknown = places
    while places[0].size:
        n, y, x = places
        total, weight = np.zeros((n.size, out.shape[3])), np.zeros(n.size)
        for down, right, share in AROUND:
            beside = n, np.clip(y + down, 0, rows - 1), np.clip(x + right, 0, columns - 1)
            inside = (beside[1] == y + down) & (beside[2] == x + right)
            counts = share * (done[beside] & inside)
            total += counts[:, None] * out[beside]
            weight += counts
        ready = weight > 0
        if not ready.any():
            break
        filled = tuple(place[ready] for place in places)
        out[filled] = total[ready] / weight[ready, None]
        done[filled] = True
        places = tuple(place[~ready] for place in places)
    out[unknown] = np.maximum(out[unknown], given[unknown])
    return out.reshape(images.shape)
