"""Check that the lenslets of a calibration are those that a picture shows."""

import math
from itertools import product

import numpy as np
from scipy.spatial import cKDTree

from lf_flame.errors import InputError
from lf_flame.formats.focused.lenslets import FocusedLenslets
from lf_flame.formats.raw.lenslet_search import estimate_grid, flattened

PARTS = 4
"""Number of parts along each axis of a picture in which the lenslets are compared."""

COHERENT = 0.8
"""Smallest share of the contrast with the lenslets' period that has one phase along a side."""

LARGEST_SHIFT = 0.08
"""Largest displacement of the lenslets in a picture from those of the calibration, in pitches."""


def check_fit(image: np.ndarray, lenslets: FocusedLenslets, calibration: object) -> None:
    """Refuse a calibration whose lenslets are not where a picture shows them.

    Micro-images are dark between each other, so that a picture has contrast with the lenslets'
    period and with its brightest places at their centres, everywhere. Texture has it too, but of
    another phase in each part of the picture. Where a picture shows no lenslets, nothing is
    checked.

    Parameters
    ----------
    image : ndarray, shape (rows, columns) or (rows, columns, channels)
    lenslets : FocusedLenslets
    calibration : object
        Name of the calibration, for the message.

    Raises
    ------
    InputError
        If the lenslets are elsewhere, or of another pitch.
    """
    grey = np.atleast_3d(image).mean(axis=2, dtype=np.float64)
    pitch = lenslets.grid.pitch
    amplitudes = _amplitudes(flattened(grey, 2 * pitch), lenslets)
    strength = np.sqrt(np.mean(np.abs(amplitudes) ** 2, axis=(1, 2)))
    sides = [amplitudes[:, 0], amplitudes[:, -1], amplitudes[:, :, 0], amplitudes[:, :, -1]]
    means = np.array([side.mean(axis=1) for side in sides])
    if strength.min() > 0 and np.all(np.abs(means) > COHERENT * strength):
        away = pitch * np.abs(np.angle(means)).max() / (2 * math.pi)
    else:
        away = _distance(grey, lenslets)
    if away > LARGEST_SHIFT * pitch:
        raise InputError(
            f"The lenslets of {calibration} do not fit the picture, in which the micro-images lie "
            f"{away:.2g} pixels beside theirs or more: both must be of the same camera, and the "
            f"picture whole, neither scaled nor cropped."
        )


def _distance(grey: np.ndarray, lenslets: FocusedLenslets) -> float:
    """Largest distance of micro-images that a picture shows from the calibration's; 0 if none."""
    try:
        found = estimate_grid(grey, lenslets.grid.pitch, lenslets.grid.layout)
    except InputError:
        return 0.0
    centres = found.centres(grey.shape).reshape(-1, 2)
    stated = lenslets.array(grey.shape).centres.reshape(-1, 2)
    return float(cKDTree(stated).query(centres)[0].max())


def _amplitudes(contrast: np.ndarray, lenslets: FocusedLenslets) -> np.ndarray:
    """Fourier amplitudes of the lenslets' shortest periods, shape (periods, PARTS, PARTS).

    The phase is 0 where the micro-images' centres are brightest.
    """
    grid = lenslets.grid
    y, x = (np.arange(n) for n in contrast.shape)
    offset = 0.5 if grid.layout == "hexagonal" else 0.0
    # Periods of the lattice spanned by (pitch, 0) and (offset pitch, row pitch).
    across = 1 / grid.row_pitch
    waves = [(-offset * across, 1 / grid.pitch), (across, 0.0)]
    if offset:
        waves.append((offset * across, 1 / grid.pitch))
    out = []
    for down, along in waves:
        # A wave turns as its lattice does.
        wave_y, wave_x = grid.turned(down, along)
        line_y = np.exp(-2j * math.pi * wave_y * (y - grid.y0))
        line_x = np.exp(-2j * math.pi * wave_x * (x - grid.x0))
        parts = [np.array_split(np.arange(n), PARTS) for n in contrast.shape]
        out.append(
            [
                line_y[rows]
                @ contrast[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
                @ line_x[columns]
                / (rows.size * columns.size)
                for rows, columns in product(*parts)
            ]
        )
    return np.array(out).reshape(len(out), PARTS, PARTS)
