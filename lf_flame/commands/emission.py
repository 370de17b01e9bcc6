"""Table of `lf-flame resolution`, and the optical thickness given to `lf-flame reconstruct`."""

from pathlib import Path

import numpy as np
from tabulate import tabulate

from lf_flame._common.images import TIFF_SUFFIXES, read_tiff
from lf_flame.errors import InputError
from lf_flame.optics.lens import Lens
from lf_flame.tomography.resolution import angular_width, depth_blur, depth_modes


def resolution_report(camera: Lens, thickness_mm: float, periods_mm) -> str:
    """Describe the depth resolution of a camera, as a table for the terminal."""
    rows = [
        (
            f"{period:g}",
            f"{depth_blur(camera, period):.3g}",
            f"{depth_modes(camera, period, thickness_mm):.1f}",
        )
        for period in periods_mm
    ]
    columns = [
        "lateral period (mm)", "blur in depth (mm)", f"values told apart in {thickness_mm:g} mm",
    ]  # fmt: skip
    table = tabulate(rows, headers=columns, tablefmt="simple", disable_numparse=True)
    width = angular_width(camera)
    return (
        f"The views span {width:.4f} rad ({np.degrees(width):.1f} degrees), seen from the focal "
        f"plane.\nDetail is blurred in depth over its lateral period divided by that.\n\n"
        f"{table}\n\nWhere the last column is near 1, a light field shows where light is across, "
        f"but not in depth;\nits distribution in depth in a reconstruction comes from the penalty."
    )


def read_thickness(given: str) -> float | np.ndarray:
    """Read an optical thickness: a number, or a TIFF file of one depth plane or more.

    Returns
    -------
    float, or ndarray of float, shape (planes, rows, columns)

    Raises
    ------
    InputError
        If it is neither, or the file cannot be read or has no floating-point numbers.
    """
    try:
        return float(given)
    except ValueError:
        path = Path(given)
    if path.suffix.lower() not in TIFF_SUFFIXES:
        raise InputError(f"--optical-thickness must be a number or a TIFF file, got {given}.")
    stack = read_tiff(path)
    if stack.dtype.kind != "f" or stack.ndim < 2:
        raise InputError(
            f"{path} must hold planes of optical thickness as floating-point numbers, got "
            f"{stack.dtype} of shape {stack.shape}."
        )
    return stack.reshape(-1, *stack.shape[-2:])


def thickness_facts(given: str | None, thickness: float | np.ndarray | None) -> dict:
    """Entries of the record on the optical thickness: as given, and its largest total."""
    if thickness is None:
        return {"optical_thickness": None}
    greatest = float(np.max(np.sum(thickness, axis=0))) if np.ndim(thickness) else thickness
    return {"optical_thickness": given, "greatest_optical_thickness": greatest}
