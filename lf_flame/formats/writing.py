"""One function for writing light fields of all kinds."""

from contextlib import AbstractContextManager
from pathlib import Path

import numpy as np

from lf_flame._common.atomic_files import atomic_folder, atomic_write
from lf_flame.errors import InputError
from lf_flame.formats.images import to_levels, write_image
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
        _write_views(light_field, path, bits, linear=linear)
    elif suffix in (".png", ".tif", ".tiff"):
        raw = light_field.to_raw()
        write_image(path, raw if bits == 32 else to_levels(raw, bits), linear=linear)
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


def _new_folder(path: Path) -> AbstractContextManager[Path]:
    """Make a folder beside its place; refuse a place that holds anything."""
    path = path.resolve()
    if path.exists() and (not path.is_dir() or any(path.iterdir())):
        raise InputError(f"Views need a new or empty folder, got {path}, which is neither.")
    return atomic_folder(path)


def _write_views(light_field: LightField, path: Path, bits: int, *, linear: bool) -> None:
    """Write each view as ``view_RR_CC.png`` (floats: ``.tif``) of a folder."""
    views = light_field.filled
    levels = views if bits == 32 else to_levels(views, bits)
    suffix = ".tif" if bits == 32 else ".png"
    width = max(2, len(str(max(levels.shape[:2]) - 1)))
    with _new_folder(path) as aside:
        for v, u in np.ndindex(levels.shape[:2]):
            name = f"view_{v:0{width}}_{u:0{width}}{suffix}"
            write_image(aside / name, levels[v, u], linear=linear)


def _write_zarr(light_field: LightField, path: Path) -> None:
    """Write views, weights and known pixels as a Zarr group, with named axes."""
    zarr = import_zarr()
    shape = light_field.shape
    with _new_folder(path) as aside:
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
