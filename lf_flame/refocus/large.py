"""Refocusing of light fields that are larger than memory, one row of views at a time."""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lf_flame._common import progress
from lf_flame._common.arrays import centred
from lf_flame.errors import InputError
from lf_flame.lightfield import LightField
from lf_flame.refocus._arguments import as_slopes, as_weights, for_slopes
from lf_flame.refocus.interpolation import INTERPOLATIONS, check_interpolation
from lf_flame.refocus.shift import shift_views


def refocus_large(
    views: Any,
    slopes: ArrayLike,
    *,
    interpolation: str = "linear",
    weights: ArrayLike | None = None,
) -> np.ndarray:
    """Refocus views that are read one row of views at a time, as `shift_and_sum` does.

    Memory holds one row of views and the images. The images differ from those of `shift_and_sum`
    by the rounding of float32.

    Parameters
    ----------
    views : array-like with ``shape`` and slices, (v, u, t, s) or (v, u, t, s, channels)
        Stored views: an array of Zarr, h5py, Dask or NumPy's ``memmap``. Each row of views,
        ``views[v]``, is read once.
    slopes : float or sequence of float
        Slope of each refocused image, in lenslets per view step.
    interpolation : {"linear", "nearest", "cubic"}, optional
    weights : array_like, shape (v, u), optional
        Weight of each view, 0 or above, divided by their sum. Rows of weight 0 are not read.

    Returns
    -------
    ndarray of float32, shape (n, t, s) or (n, t, s, channels)
        One image for each slope; for a single number the image itself, without the first axis.

    Raises
    ------
    InputError
        If an argument cannot be used, a pixel that counts is NaN or infinite, or the views are a
        light field, which is in memory already.

    Examples
    --------
    >>> import numpy as np
    >>> import zarr
    >>> from lf_flame.refocus import refocus, refocus_large
    >>> views = np.random.default_rng(1).uniform(size=(5, 5, 24, 30)).astype(np.float32)
    >>> stored = zarr.create_array("views.zarr", data=views, chunks=(1, 5, 24, 30))
    >>> bool(np.abs(refocus_large(stored, 0.7) - refocus(views, 0.7)).max() < 1e-6)
    True
    """
    check_interpolation(interpolation, INTERPOLATIONS)
    if isinstance(views, LightField):
        raise InputError("A light field is in memory already: refocus it by `refocus`.")
    shape = tuple(getattr(views, "shape", ()))
    if len(shape) not in (4, 5) or 0 in shape:
        raise InputError(f"A light field needs views[v, u, t, s], got an array of shape {shape}.")
    steps = as_slopes(slopes)
    counted = as_weights(weights, np.broadcast_to(np.float32(0), shape))
    total = np.zeros((len(steps), *shape[2:]))
    across = np.broadcast_to(centred(shape[1]), (1, shape[1]))
    rows = [v for v in range(shape[0]) if counted[v].any()]
    for v in progress.steps(rows, "refocusing", len(rows), "row of views"):
        place = centred(shape[0])[v : v + 1], across
        row = np.asarray(views[v])[None]
        image = shift_views(row, steps, interpolation, counted[v : v + 1], place)
        total += counted[v].sum() * image
    return for_slopes((total / counted.sum()).astype(np.float32), slopes)
