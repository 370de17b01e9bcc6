"""Depth resolution of one light field; it is worse for coarser detail.

A plenoptic camera sees the scene within the angle that its aperture spans. For detail of lateral
frequency k it records only depth frequencies within ``k theta / 2``; the rest is the missing cone
(for limited angles in general: Tuy, SIAM J. Appl. Math. 43, 546, 1983; Natterer, The Mathematics of
Computerized Tomography, chapter 6). Depth is therefore blurred over ``1 / (k theta)``, and a
uniform glow has no depth at all.
"""

import numpy as np

from lf_flame._common.arrays import Number, centred
from lf_flame.errors import InputError
from lf_flame.optics.lens import Lens


def angular_width(camera: Lens) -> float:
    """Angle that the recorded views span, seen from the focal plane, in rad.

    An aperture narrower than what the lenslets see limits it.
    """
    return camera.pupil_width_mm / camera.pupil_distance_mm


def finest_period(camera: Lens, block: int = 1) -> float:
    """Shortest period that the central view resolves, in mm in the focal plane: two pixels."""
    return 2 * block * camera.lenslet_in_focus_mm


def depth_blur(camera: Lens, period_mm: Number) -> Number:
    """Distance in depth over which detail is blurred: ``period / theta``.

    Parameters
    ----------
    camera : Lens
    period_mm : float or ndarray
        Lateral period of the detail in the focal plane in mm, above 0.

    Returns
    -------
    float or ndarray
        Blur in depth in mm.

    Raises
    ------
    InputError
        If a period is not above 0.

    Examples
    --------
    >>> from lf_flame import PAPER_CAMERA
    >>> from lf_flame.tomography import depth_blur
    >>> round(depth_blur(PAPER_CAMERA, 1.0), 1)  # mm in depth, for detail of 1 mm across
    4.2
    """
    return _checked(period_mm) / angular_width(camera)


def depth_modes(camera: Lens, period_mm: Number, thickness_mm: float) -> Number:
    """Count the values that can be distinguished along depth: ``1 + thickness / blur``.

    Parameters
    ----------
    camera : Lens
    period_mm : float or ndarray
        Lateral period of the detail in the focal plane in mm, above 0.
    thickness_mm : float
        Extent in depth of the emission, centred on the focal plane: from 0 to less than twice the
        focus distance.

    Raises
    ------
    InputError
        If a period is not above 0, or the extent reaches the lens.

    Examples
    --------
    >>> from lf_flame import PAPER_CAMERA
    >>> from lf_flame.tomography import depth_modes
    >>> round(depth_modes(PAPER_CAMERA, 1.0, 20.0), 1)  # numbers within 20 mm of depth
    5.8
    """
    limit = 2 * camera.pupil_distance_mm
    if not 0 <= thickness_mm < limit:
        raise InputError(
            f"thickness_mm must be from 0 to less than {limit:g}, twice the focus distance, where "
            f"it reaches the lens, got {thickness_mm:g}."
        )
    return 1 + thickness_mm / depth_blur(camera, period_mm)


def depth_singular_values(camera: Lens, period_mm: float, depths_mm: np.ndarray) -> np.ndarray:
    """Singular values of the light field of depth planes that glow with one lateral period.

    They have a closed form: view u sees a plane shifted by its slope times u, blurred over a
    lenslet and over the slope.

    Parameters
    ----------
    camera : Lens
    period_mm : float
        Lateral period in the focal plane in mm; it grows with distance like the grid's cells.
    depths_mm : array_like, shape (planes,)
        Depths of the planes from the focal plane in mm.

    Returns
    -------
    ndarray of float64, shape (planes,)
        Values relative to the largest, falling: noise of that fraction hides smaller ones.

    Raises
    ------
    InputError
        If the period is not above 0.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame import PAPER_CAMERA
    >>> from lf_flame.tomography import depth_singular_values
    >>> depth_singular_values(PAPER_CAMERA, 1.0, np.array([-10.0, 0.0, 10.0])).shape
    (3,)
    """
    frequency = camera.lenslet_in_focus_mm / float(_checked(period_mm))
    slopes = np.atleast_1d(camera.depth_to_slope(np.asarray(depths_mm, float)))
    turns = np.outer(centred(camera.views), slopes) * frequency
    seen = np.exp(-2j * np.pi * turns) * np.sinc(frequency * slopes)
    values = np.linalg.svd(seen, compute_uv=False)
    shown = np.zeros(len(slopes))
    shown[: len(values)] = values / values[0]
    return shown


def _checked(period_mm):
    periods = np.asarray(period_mm, float)
    if not np.all(periods > 0):
        raise InputError(f"period_mm must be above 0, got {period_mm}.")
    return periods if periods.ndim else float(periods)
