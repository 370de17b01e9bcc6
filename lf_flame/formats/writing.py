"""One function for writing light fields of all kinds."""

from pathlib import Path

import numpy as np

from lf_flame._common.atomic_files import atomic_folder, atomic_write
from lf_flame.errors import InputError
from lf_flame.formats.lenslet_image import write_lenslet_image
from lf_flame.formats.view_files.folder import write_view_folder
from lf_flame.formats.zarr_arrays import EVERY_CHUNK, import_zarr
from lf_flame.lightfield import AXES, LightField


def write_light_field(
    light_field: LightField,
    path: str | Path,
    bits: int = 16,
    *,
    linear: bool = True,
) -> None:
    """Write a light field in the format that the path's ending selects.

    Parameters
    ----------
    light_field : LightField
        Light field; for images of 8 or 16 bits, values from 0 to 1.
    path : str or Path
        Without an ending, a new folder with one image for each view; .png or .tif, a lenslet image;
        .npy, the array ``views``; .npz, or .zarr, a new folder: ``views`` and, if there are any,
        ``weights`` and ``valid``, which no other format stores.
    bits : int, optional
        Number of bits of images, 8 or 16; 32 for floats, in TIFF files.
    linear : bool, optional
        Whether values are linear in radiance; an 8-bit PNG then states it.

    Raises
    ------
    InputError
        If the ending is unknown, or values or channels do not fit.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame import LightField, formats
    >>> light_field = LightField(np.random.default_rng(1).uniform(size=(3, 3, 20, 30)))

    >>> formats.write_light_field(light_field, "light_field.npz")
    >>> formats.read_light_field("light_field.npz")
    LightField(3 x 3 views of 20 x 30 pixels, grey)
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix == ".zarr":
        _write_zarr(light_field, path)
    elif not suffix:
        write_view_folder(light_field, path, bits, linear=linear)
    elif suffix in (".png", ".tif", ".tiff"):
        write_lenslet_image(light_field, path, bits, linear=linear)
    elif suffix == ".npy":
        with atomic_write(path) as aside:
            np.save(aside, light_field.views, allow_pickle=False)
    elif suffix == ".npz":
        arrays = {"views": light_field.views}
        beside = {"weights": light_field.weights, "valid": light_field.valid}
        arrays |= {name: array for name, array in beside.items() if array is not None}
        with atomic_write(path) as aside, aside.open("wb") as file:
            np.savez(file, allow_pickle=False, **arrays)
    else:
        raise InputError(
            f"A light field is written to a folder, .png, .tif, .npy, .npz or .zarr, got {path}."
        )


def _write_zarr(light_field: LightField, path: Path) -> None:
    """Write views, weights and known pixels as a Zarr group, with named axes."""
    zarr = import_zarr()
    if path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise InputError(f"A Zarr folder is written new, got {path}, which is there.")
    shape = light_field.shape
    with atomic_folder(path) as aside:
        group = zarr.create_group(str(aside))
        views = group.create_array(
            "views", shape=shape, dtype=np.float32, dimension_names=AXES[: len(shape)],
            chunks=(1, 1, *shape[2:]), config=EVERY_CHUNK,
        )  # fmt: skip
        views[...] = light_field.views
        for name, axes in (("weights", 2), ("valid", 4)):
            array = getattr(light_field, name)
            if array is not None:
                group.create_array(
                    name, data=array, dimension_names=AXES[:axes], config=EVERY_CHUNK
                )
