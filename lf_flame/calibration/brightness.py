"""Brightness of views relative to the central one: measured on a target, and evened out."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lf_flame.lightfield import LightField
from lf_flame.refocus import align_views

FallOff = tuple[tuple[float, ...], ...]
"""Brightness of each view, row by row; 0 of views that do not count."""

FEWEST = 3
"""Smallest number of targets of which the brightness is known."""

EVEN, ERRORS = 0.01, 4.0
"""Smallest difference of the views' brightness that is written, and that in standard errors: where
nothing surely differs, all views count alike."""

MOSTLY_DARK = 0.5
"""Brightness below which a view does not count."""


def brightness(views, chosen: np.ndarray, slope: float, box: np.ndarray) -> np.ndarray:
    """Mean of the target in the chosen views, shape (n,), over the same part of it in all.

    box: corners of that part in the central view, as far as all views see it.
    """
    reach = abs(slope) * (np.array(views.shape[:2]) - 1) / 2
    low = np.ceil(np.maximum(box[0], reach)).astype(int)
    high = np.floor(np.minimum(box[1], np.array(views.shape[2:]) - 1 - reach)).astype(int)
    if np.any(high - low < 2):  # moved by nearly the whole image
        return np.full(len(chosen), np.nan)
    aligned = align_views(views, slope, [(int(v), int(u)) for v, u in chosen])
    part = aligned[:, low[0] : high[0] + 1, low[1] : high[1] + 1]
    return part.mean(axis=(1, 2), dtype=np.float64)


def common_fall_off(levels: Sequence[np.ndarray]) -> FallOff | None:
    """Brightness of each view over all targets; None unless it surely differs.

    levels: brightness relative to the central view in each target, shape (v, u); NaN if unknown.
    """
    seen = np.array(levels)
    seen = seen[np.isfinite(seen).any(axis=(1, 2))]
    if len(seen) < FEWEST:
        return None
    middle = np.median(seen, axis=0)
    errors = np.std(seen, axis=0, ddof=1) / np.sqrt(len(seen))
    off = np.abs(middle - 1) > np.maximum(EVEN, ERRORS * errors)
    if not off.any():
        return None
    return tuple(map(tuple, np.round(np.nan_to_num(middle), 4).tolist()))


def even_out(light_field: LightField, fall_off: FallOff) -> LightField:
    """Divide views by their fall-off; those that are mostly dark get weight 0."""
    levels = np.array(fall_off, np.float32)
    lit = levels >= MOSTLY_DARK
    own = np.ones(levels.shape) if light_field.weights is None else light_field.weights
    weights = light_field.weights if lit.all() else own * lit
    shape = levels.shape + (1,) * (light_field.views.ndim - 2)
    views = light_field.views / np.where(lit, levels, 1).reshape(shape)
    return replace(light_field, views=views, weights=weights)
