"""Views averaged over their channels, of which rows of pixels are taken as they are needed."""

from itertools import pairwise
from typing import Any

import numpy as np

from lf_flame._common.arrays import centred
from lf_flame.lazy_light_field import LazyLightField
from lf_flame.refocus._arguments import Views, as_readable, as_views, refuse_not_finite, shape_of

TAPS = 4
"""Number of rows beyond a shift that a method may read: taps, and a smoothing by one row."""


def reach_of(slopes: np.ndarray, views: int) -> int:
    """Count the rows beyond its own from which a row of an image at some slopes is made."""
    return int(np.ceil(np.abs(slopes).max() * np.abs(centred(views)).max())) + TAPS


class GreyViews:
    """Grey views of a light field, in memory or in a file.

    Parameters
    ----------
    light_field : LightField or LazyLightField or array_like

    Attributes
    ----------
    shape : (int, int, int, int)
        Numbers of views, rows and columns, (v, u, t, s).
    rows_at_once : int
        Number of rows that may be taken at once: all, of a light field in memory.
    """

    def __init__(self, light_field: Views):
        self._lazy = light_field if isinstance(light_field, LazyLightField) else None
        if self._lazy is None:
            views = as_views(light_field)
            refuse_not_finite(views)
            self._views = as_readable(_grey(views, 4))
        self.shape = shape_of(light_field)[:4]
        self.rows_at_once = self._lazy.rows_at_once if self._lazy else self.shape[2]

    def __getitem__(self, at: tuple[Any, Any]) -> np.ndarray:
        """Take one whole view, [t, s]."""
        return _grey(self._lazy.view(*at), 2) if self._lazy else self._views[at]

    def rows(self, start: int, stop: int) -> np.ndarray:
        """Take rows of all views: [v, u, t, s]."""
        if self._lazy is None:
            return self._views[:, :, start:stop]
        return np.ascontiguousarray(_grey(self._lazy.rows(start, stop).views, 4))

    def bands(self, reach: int) -> list[slice]:
        """Rows of an image in bands, for each of which `reach` rows more on both sides are read."""
        if self._lazy is None:
            return [slice(0, self.shape[2])]
        return [band.rows for band in self._lazy.plan(reach)]

    def near(self, rows: np.ndarray, reach: int) -> tuple[np.ndarray, int]:
        """Take the rows within `reach` of some; also returns the number of the first."""
        if self._lazy is None:
            return self._views, 0
        start = max(int(rows[0]) - reach, 0)
        return self.rows(start, min(int(rows[-1]) + reach + 1, self.shape[2])), start

    def groups(self, rows: np.ndarray, reach: int) -> list[np.ndarray]:
        """Part rising rows into groups that are taken at once with those near them."""
        starts = [0]
        for k in range(1, len(rows)) if self._lazy else ():
            tall = rows[k] - rows[starts[-1]] + 2 * reach >= self.rows_at_once
            if tall or rows[k] - rows[k - 1] > 2 * reach:  # what lies between is not needed
                starts.append(k)
        return [rows[a:b] for a, b in pairwise([*starts, len(rows)])]

    @property
    def brightest(self) -> float:
        """Largest absolute value."""
        parts = (self.rows(band.start, band.stop) for band in self.bands(0))
        return max(float(np.abs(row).max()) for part in parts for row in part)


def _grey(views: np.ndarray, axes: int) -> np.ndarray:
    return views if views.ndim == axes else views.mean(axis=axes, dtype=np.float32)
