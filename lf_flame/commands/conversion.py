"""A light field in another form: as levels, as floats, or scaled, with the scale in a record."""

from pathlib import Path

import numpy as np

from lf_flame._common import provenance
from lf_flame._common.atomic_files import write_json
from lf_flame._common.input_files import read_record
from lf_flame.errors import InputError
from lf_flame.formats import write_light_field
from lf_flame.formats.images import TIFF_SUFFIXES
from lf_flame.lightfield import LightField

ARRAYS = (".npy", ".npz", ".zarr")
"""Endings of the formats that keep values unchanged."""

LEVEL_0, LEVEL_1 = "radiance_of_black", "radiance_of_white"
"""Keys of the record: radiance of the lowest level, and radiance of the highest level."""


def convert_light_field(
    light_field: LightField,
    target: Path,
    bits: int | None = None,
    linear: bool = True,
) -> str:
    """Write a light field; values outside the levels become floats, or are scaled.

    Parameters
    ----------
    light_field : LightField
    target : Path
        As in `write_light_field`.
    bits : int, optional
        8, 16 or 32 (floats). Default: 16, or 32 where a value is below 0 or above 1 and the format
        of the target has floats.
    linear : bool, optional
        Whether values are linear in light; PNG files of 8 bits record it.

    Returns
    -------
    str
        Note on the values for the user; empty if they are unchanged, in levels of 16 bits.
    """
    views = light_field.views
    low, high = min(float(views.min()), 0.0), max(float(views.max()), 1.0)
    fits, suffix = (low, high) == (0.0, 1.0), target.suffix.lower()
    if bits is None:
        bits = 16 if fits or suffix not in ("", *TIFF_SUFFIXES) else 32
    record = Path(f"{target}.json")
    held = f"values from {views.min():.4g} to {views.max():.4g}"
    if fits or bits == 32 or suffix in ARRAYS:
        write_light_field(light_field, target, bits, linear=linear)
        if record.exists() and _is_record(record):
            record.unlink()  # of an earlier file of this name
        return f" with {held}, as floats" if bits == 32 and suffix not in ARRAYS else ""
    if record.exists() and not _is_record(record):
        raise InputError(
            f"{record} is there, and would be replaced by the record of the scale; move it, or "
            f"choose another target."
        )
    scaled = LightField((views.astype(np.float64) - low) / (high - low))
    write_light_field(scaled, target, bits, linear=linear and low == 0)
    write_json(record, {LEVEL_0: low, LEVEL_1: high, "bits": bits, **provenance.environment()})
    return (
        f"; {held} were scaled to fit: level 0 is {low:.6g} and level {2**bits - 1} is {high:.6g}, "
        f"as {record} says (.npy, or .tif without --bits, keeps values as they are)"
    )


def _is_record(path: Path) -> bool:
    """Whether a file is the record of such a scale."""
    try:
        return LEVEL_0 in read_record(path)
    except InputError:
        return False
