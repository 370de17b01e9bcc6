"""Synthetic apertures: the weight that each view has in a refocused image.

The views divide the square aperture of the main lens into as many squares. A smaller, round or
annular aperture takes of each view the part of its square that lies inside.
"""

from collections.abc import Sequence

import numpy as np

from lf_flame._common.arrays import centred
from lf_flame.errors import InputError
from lf_flame.optics.camera import PlenopticCamera


def round_aperture(views: tuple[int, int], diameter: float = 1.0) -> np.ndarray:
    """Weights of the views for a round aperture.

    Parameters
    ----------
    views : (int, int)
        Views along v and u; where they differ, the aperture is an ellipse.
    diameter : float, optional
        In widths of the full aperture, above 0. Beyond 1 it is cut by the square of the views,
        from sqrt(2) on it is the full aperture.

    Returns
    -------
    ndarray of float64, shape (v, u), values from 0 to 1
        Part of each view's square that lies inside, for `shift_and_sum` and the like.

    Raises
    ------
    InputError
        If the numbers are out of range.
    """
    if min(views) < 1 or not 0 < diameter < np.inf:
        raise InputError(
            f"A round aperture needs one view or more and a finite diameter above 0, "
            f"got {views[0]} x {views[1]} views and diameter {diameter}."
        )
    diameter = min(diameter, 2.0)
    # Edges of the views' squares in radii of the aperture, and the area between them.
    edges = [2 * centred(n + 1) / n / diameter for n in views]
    area = _area_to(edges[0][:, None], edges[1][None, :])
    inside = np.diff(np.diff(area, axis=0), axis=1)
    return np.clip(inside * views[0] * views[1] * (diameter / 2) ** 2, 0, 1)


def sparse_aperture(views: tuple[int, ...], view_indices: Sequence[tuple[int, int]]) -> np.ndarray:
    """Weights of the views where only some are used, all alike.

    Parameters
    ----------
    views : (int, int)
    view_indices : sequence of (int, int)
        Row and column of each view that is used.

    Returns
    -------
    ndarray of float64, shape (v, u), 0 or 1
    """
    weights = np.zeros(views)
    weights[tuple(np.transpose(view_indices))] = 1
    return weights


def annular_aperture(views: tuple[int, int], inner: float, outer: float = 1.0) -> np.ndarray:
    """Weights of the views for a ring: a round aperture with its middle covered.

    Parameters
    ----------
    views : (int, int)
    inner, outer : float
        Diameters in widths of the full aperture, inner below outer.

    Returns
    -------
    ndarray of float64, shape (v, u), values from 0 to 1
    """
    if not 0 <= inner < outer:
        raise InputError(
            f"A ring needs an inner diameter, 0 or more, below the outer one, got {inner}, {outer}."
        )
    weights = round_aperture(views, outer)
    return np.clip(weights - round_aperture(views, inner), 0, 1) if inner else weights


def f_number_aperture(camera: PlenopticCamera, f_number: float) -> np.ndarray:
    """Weights of the views for the depth of field of an ordinary camera stopped to an f-number.

    The f-number is the working one, distance of the microlens array over the diameter of the
    aperture; the lenslets' own, focal length over width of the micro-image, is the smallest.

    Parameters
    ----------
    camera : PlenopticCamera
    f_number : float

    Returns
    -------
    ndarray of float64, shape (views, views), values from 0 to 1

    Raises
    ------
    InputError
        If the views do not reach that far.
    """
    own = camera.lenslet_focal_mm / (camera.views * camera.pixel_mm)
    if not own * (1 - 1e-9) <= f_number < np.inf:
        raise InputError(
            f"f_number must be {own:.3g}, at which all views are used, or more, got {f_number}."
        )
    return round_aperture((camera.views, camera.views), own / f_number)


def _area_to(y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Area of the unit disc between the axes and (y, x), with the sign of y x."""
    sign = np.sign(y) * np.sign(x)
    y, x = np.minimum(np.abs(y), 1), np.minimum(np.abs(x), 1)
    corner = np.sqrt(1 - y**2)  # where the circle meets the height y
    beyond = (_under_circle(x) - _under_circle(corner)) + y * corner
    return sign * np.where(x <= corner, x * y, beyond)


def _under_circle(x: np.ndarray) -> np.ndarray:
    """Area between 0 and x under the upper half of the unit circle."""
    return (x * np.sqrt(1 - x**2) + np.arcsin(x)) / 2
