"""Light fields in NumPy's files, never unpickled."""

from pathlib import Path

import numpy as np

from lf_flame._common.pixels import readable
from lf_flame.errors import InputError
from lf_flame.formats.images import to_unit
from lf_flame.formats.lenslet_image import cut_views
from lf_flame.lightfield import LightField


def read_array(path: str | Path, views: int | None = None) -> LightField:
    """Read a light field from a ``.npy`` or ``.npz`` file.

    Parameters
    ----------
    path : str or Path
        An array ``[v, u, t, s]`` or ``[v, u, t, s, channels]``, or a raw lenslet array of 2 or 3
        axes. In a ``.npz`` file it is the one named ``views``, or the only one, or the only one of
        4 or 5 axes.
    views : int, optional
        Pixels under a lenslet along each axis of a raw lenslet array.

    Returns
    -------
    LightField
        Unsigned levels of 8 or 16 bits as 0 to 1, floats as they are.

    Raises
    ------
    InputError
        If the file cannot be read, holds other arrays, or `views` does not divide a raw array.
    """
    # Of a damaged archive, NumPy would leave a file of its own open.
    with readable(path), Path(path).open("rb") as file:
        loaded = np.load(file, allow_pickle=False)
        array = loaded if isinstance(loaded, np.ndarray) else _choose(loaded, path)
    if array.ndim not in (2, 3, 4, 5) or array.size == 0:
        raise InputError(
            f"{path} must hold views[v, u, t, s] (with a last axis of channels or without), or a "
            f"raw lenslet array, got shape {array.shape}."
        )
    array = to_unit(array, path)
    return LightField(cut_views(array, views, path) if array.ndim < 4 else array)


def _choose(archive: np.lib.npyio.NpzFile, path: str | Path) -> np.ndarray:
    """Take the archive's array of views."""
    with archive:
        if "views" in archive:
            return archive["views"]
        arrays = {name: archive[name] for name in archive.files}
    fitting = {name: one for name, one in arrays.items() if len(arrays) == 1 or one.ndim in (4, 5)}
    if len(fitting) != 1:
        held = ", ".join(f"{name} {one.shape}" for name, one in arrays.items()) or "none"
        raise InputError(
            f"{path} must hold one array named views, or one only of 4 or 5 axes, got {held}."
        )
    return next(iter(fitting.values()))
