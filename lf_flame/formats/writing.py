"""One function for writing light fields of all kinds."""

import json
from pathlib import Path

import numpy as np

from lf_flame._common import provenance
from lf_flame._common.atomic_files import atomic_folder, atomic_write
from lf_flame.errors import InputError
from lf_flame.formats.arrays import RECORD, VIEWS
from lf_flame.formats.images import to_levels, write_image
from lf_flame.lightfield import LightField


def write_light_field(
    light_field: LightField, path: str | Path, bits: int = 16, *, linear: bool = True
) -> None:
    """Write a light field in the format that the path's ending selects.

    Parameters
    ----------
    light_field : LightField
        Light field; for images of 8 or 16 bits, values from 0 to 1.
    path : str or Path
        Without an ending, a new folder with one image for each view; .png or .tif, a lenslet image;
        .npy, the array ``views``; .npz, ``views``, the record of the command, its date and
        versions, and ``weights`` and ``valid`` if there are any, which no other format stores.
    bits : int, optional
        Number of bits of images, 8 or 16; 32 for floats, in TIFF files.
    linear : bool, optional
        Whether values are linear in radiance. An 8-bit PNG states it if they are, a record if not.

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
    check_ending(path := Path(path))
    suffix, place = path.suffix.lower(), path.resolve()
    if not suffix:
        if place.exists() and (not place.is_dir() or any(place.iterdir())):
            raise InputError(f"Views need a new or empty folder, got {place}, which is neither.")
        with atomic_folder(place) as aside:
            _write_views(light_field.filled, aside, bits, linear=linear)
    elif suffix in (".png", ".tif", ".tiff"):
        v, u = light_field.shape[:2]
        if v != u:
            raise InputError(f"A lenslet image has N x N views, got {v} x {u}: write .npz.")
        raw = LightField.trusted(light_field.filled).to_raw()
        write_image(path, raw if bits == 32 else to_levels(raw, bits), linear=linear)
    elif suffix == ".npy":
        with atomic_write(path) as aside, aside.open("wb") as file:
            np.save(file, light_field.filled, allow_pickle=False)
    else:
        record = json.dumps({"linear": linear, **provenance.environment()}).encode()
        beside = {"weights": light_field.weights, "valid": light_field.valid}
        given = {name: array for name, array in beside.items() if array is not None}
        given |= {VIEWS: light_field.views, RECORD: np.frombuffer(record, np.uint8)}
        with atomic_write(path) as aside, aside.open("wb") as file:
            np.savez(file, allow_pickle=False, **given)


def check_ending(path: Path) -> None:
    """Refuse a file that selects no format."""
    if path.suffix.lower() not in ("", ".png", ".tif", ".tiff", ".npy", ".npz"):
        raise InputError(
            f"A light field is written to a folder (a name without a point), .png, .tif, .npy "
            f"or .npz, got {path}."
        )


def _write_views(views: np.ndarray, folder: Path, bits: int, *, linear: bool) -> None:
    """Write each view as ``view_RR_CC.png`` (floats: ``.tif``) of a folder."""
    levels = views if bits == 32 else to_levels(views, bits)
    suffix = ".tif" if bits == 32 else ".png"
    width = max(2, len(str(max(levels.shape[:2]) - 1)))
    for v, u in np.ndindex(levels.shape[:2]):
        name = f"view_{v:0{width}}_{u:0{width}}{suffix}"
        write_image(folder / name, levels[v, u], linear=linear)
