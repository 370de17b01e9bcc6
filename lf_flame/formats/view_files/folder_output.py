"""Views of a light field, written as one image file each."""

from pathlib import Path

import numpy as np

from lf_flame._common.atomic_files import atomic_folder
from lf_flame.errors import InputError
from lf_flame.formats.images import to_levels, write_image
from lf_flame.lightfield import LightField


def write_view_folder(
    light_field: LightField, folder: str | Path, bits: int = 16, *, linear: bool = True
) -> None:
    """Write each view as ``view_RR_CC.png`` (floats: ``.tif``), rows and columns from 0.

    Parameters
    ----------
    light_field : LightField
        Values from 0 to 1, unless written as floats; grey, or with 1 or 3 channels.
    folder : str or Path
        A new or an empty folder. It appears when all views are written.
    bits, linear : optional
        As in `write_light_field`.

    Raises
    ------
    InputError
        If the folder contains files, or values or channels do not fit.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame import LightField, formats
    >>> light_field = LightField(np.random.default_rng(1).uniform(size=(3, 3, 20, 30)))

    >>> formats.write_view_folder(light_field, "views")
    >>> formats.read_view_folder("views")
    LightField(3 x 3 views of 20 x 30 pixels, grey)
    """
    folder = Path(folder).resolve()
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError(f"The views need a new or empty folder, got {folder}, which is neither.")
    levels = light_field.views if bits == 32 else to_levels(light_field.views, bits)
    suffix = ".tif" if bits == 32 else ".png"
    width = max(2, len(str(max(levels.shape[:2]) - 1)))
    with atomic_folder(folder) as aside:
        for v, u in np.ndindex(levels.shape[:2]):
            path = aside / f"view_{v:0{width}}_{u:0{width}}{suffix}"
            write_image(path, levels[v, u], linear=linear)
