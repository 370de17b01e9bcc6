"""Check that the lenslets of a calibration are those that a picture shows."""

import math
from itertools import product

import numpy as np

from lf_flame.errors import InputError
from lf_flame.formats.focused.lenslets import FocusedLenslets
from lf_flame.formats.raw.grid_fit import flattened
from lf_flame.formats.raw.white_image import estimate_grid

PARTS = 4
"""Number of parts along each axis of a picture in which the lenslets are compared."""

COHERENT = 0.8
"""Smallest share of the parts' contrast, of the lenslets' period, that is of one phase."""

LARGEST_SHIFT = 0.12
"""Largest displacement of the lenslets in a picture from those of the calibration, in pitches."""

LARGEST_ERROR = 2e-3
"""Largest relative error of the pitch: over a hundred lenslets, a fifth of one."""


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
    total = amplitudes.mean(axis=1)
    strength = np.sqrt(np.mean(np.abs(amplitudes) ** 2, axis=1))
    if strength.min() > 0 and np.all(np.abs(total) > COHERENT * strength):
        shift = np.abs(np.angle(total)) / (2 * math.pi)
        if np.all(shift < LARGEST_SHIFT):
            return
        raise InputError(
            f"The lenslets of {calibration} do not fit the picture, in which the micro-images lie "
            f"up to {shift.max() * pitch:.2g} pixels beside theirs: the picture must be whole, as "
            f"the camera gave it."
        )
    turned = abs(lenslets.grid.rotation) > math.pi / 12  # straight columns
    try:
        found = estimate_grid(np.rot90(grey) if turned else grey, pitch, lenslets.grid.layout)
    except InputError:
        return
    if abs(found.pitch / pitch - 1) > LARGEST_ERROR:
        raise InputError(
            f"The lenslets of {calibration} do not fit the picture, which shows a pitch of "
            f"{found.pitch:.5g} pixels, not {pitch:.5g}: it must be of this camera, and neither "
            f"scaled nor cropped."
        )


def _amplitudes(contrast: np.ndarray, lenslets: FocusedLenslets) -> np.ndarray:
    """Fourier amplitudes of the lenslets' shortest periods, shape (periods, parts).

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
    return np.array(out)
