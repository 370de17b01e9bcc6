"""Light fields in NumPy's files, never unpickled."""

from pathlib import Path

from lf_flame._common.array_files import ArrayFile, open_arrays
from lf_flame.errors import InputError
from lf_flame.formats.images import to_unit
from lf_flame.formats.lenslet_image import cut_views
from lf_flame.lightfield import LightField

WEIGHTS = "weights"
"""Array of an archive with the weight of each view."""

MOST_ARRAYS = 1000
"""Arrays of an archive among which that of the views is looked for."""

MOST_NAMED = 5
"""Arrays that an error names."""


def read_array(path: str | Path, views: int | None = None) -> LightField:
    """Read a light field from a ``.npy`` or ``.npz`` file.

    Parameters
    ----------
    path : str or Path
        An array ``[v, u, t, s]`` or ``[v, u, t, s, channels]``, or a raw lenslet array of 2 or 3
        axes. In a ``.npz`` file it is the one named ``views``, or the only one, or the only one of
        4 or 5 axes; one named ``weights``, [v, u], tells how much each view counts.
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
    with open_arrays(path) as file:
        name = _choose(file)
        (array,) = file.read([name], copies=2)  # as stored, and as views
        beside = [WEIGHTS] if name != WEIGHTS and WEIGHTS in file.names else []
        weights = file.read(beside)[0] if beside else None
    if array.ndim not in (2, 3, 4, 5) or array.size == 0:
        raise InputError(
            f"{path} must hold views[v, u, t, s] (with a last axis of channels or without), or a "
            f"raw lenslet array, got shape {array.shape}."
        )
    array = to_unit(array, path)
    return LightField(cut_views(array, views, path) if array.ndim < 4 else array, weights=weights)


def _choose(file: ArrayFile) -> str:
    """Name the file's array of views."""
    if "views" in file.names or len(file.names) == 1:
        return "views" if "views" in file.names else file.names[0]
    headers = {name: file.header(name) for name in file.names[:MOST_ARRAYS]}
    fitting = [name for name, header in headers.items() if len(header.shape) in (4, 5)]
    if len(fitting) != 1 or len(file.names) > MOST_ARRAYS:
        held = [f"{name} {header.shape}" for name, header in headers.items()][:MOST_NAMED]
        more = f" and {len(file.names) - MOST_NAMED} more" if len(file.names) > MOST_NAMED else ""
        raise InputError(
            f"{file.path} must hold one array named views, or one only of 4 or 5 axes, got "
            f"{', '.join(held) or 'none'}{more}."
        )
    return fitting[0]
