"""Synthetic apertures: the weight of each view in a refocused image.

The views divide the square aperture of the main lens into squares. The weight of a view is the part
of its square inside the smaller, round or annular aperture.
"""

from collections.abc import Callable

import numpy as np

from lf_flame._common.arrays import as_numbers, centred
from lf_flame.errors import InputError
from lf_flame.optics.camera import PlenopticCamera


def aperture_weights(
    views: tuple[int, int],
    width: float = 1.0,
    ring: float = 0.0,
    shape: str = "round",
    centre: tuple[float, float] = (0.0, 0.0),
) -> np.ndarray:
    """Weights of views for an aperture of any size and position, full or annular.

    Parameters
    ----------
    views : (int, int)
        Number of views along v and u; if they differ, a round aperture is an ellipse.
    width : float, optional
        Width of the aperture in widths of the full one, above 0; it is cut at the full aperture.
    ring : float, optional
        Width of the covered centre of an annular aperture, 0 or more, below `width`.
    shape : {"round", "square"}, optional
        Shape of the aperture.
    centre : (float, float), optional
        Centre of the aperture, in rows and columns of views from the central view: the viewpoint.
        Objects in focus do not move with it.

    Returns
    -------
    ndarray of float64, shape (v, u), values from 0 to 1
        Fraction of each view's square inside the aperture, for `shift_and_sum` and others.

    Raises
    ------
    InputError
        If a number is out of range, or no view is inside.

    Examples
    --------
    >>> from lf_flame.refocus import aperture_weights
    >>> aperture_weights((3, 3), 1.0, shape="square").tolist()
    [[1.0, 1.0, 1.0], [1.0, 1.0, 1.0], [1.0, 1.0, 1.0]]
    """
    if np.shape(views) != (2,) or np.shape(centre) != (2,):
        raise InputError(f"Views and centre are two numbers each, got {views!r} and {centre!r}.")
    as_numbers((*views, width, ring, *centre), "Views, width, ring and centre of an aperture")
    if min(views) < 1 or not 0 < width < np.inf:
        raise InputError(
            f"An aperture needs one view or more and a finite width above 0, "
            f"got {views[0]} x {views[1]} views and width {width}."
        )
    if not 0 <= ring < width:
        raise InputError(
            f"A ring needs a covered centre, 0 or more, below its outer width, "
            f"got {ring} and {width}."
        )
    if shape not in SHAPES:
        raise InputError(f"shape must be one of {', '.join(SHAPES)}, got {shape!r}.")
    if not np.all(np.isfinite(centre)):
        raise InputError(f"The centre of an aperture must be finite, got {tuple(centre)}.")
    inside = SHAPES[shape]
    weights = inside(views, width, centre)
    if ring:
        weights = np.clip(weights - inside(views, ring, centre), 0, 1)
    if not weights.any():
        raise InputError(
            f"No view lies in an aperture of width {width:g} at {centre[0]:g}, {centre[1]:g}; the "
            f"{views[0]} x {views[1]} views reach from the centre to {(views[0] - 1) / 2:g} and "
            f"{(views[1] - 1) / 2:g}."
        )
    return weights


def round_aperture(views: tuple[int, int], diameter: float = 1.0) -> np.ndarray:
    """Weights of views for a round aperture centred on the central view.

    Parameters
    ----------
    views : (int, int)
        Number of views along v and u.
    diameter : float, optional
        Diameter in widths of the full aperture, above 0. Above 1 the square of the views cuts it;
        at sqrt(2) or more it is the full aperture.

    Returns
    -------
    ndarray of float64, shape (v, u), values from 0 to 1

    Raises
    ------
    InputError
        If a number is out of range.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.refocus import round_aperture
    >>> weights = round_aperture((9, 9))
    >>> round(float(weights.sum()) / 81, 4), round(np.pi / 4, 4)  # a disc in its square
    (0.7854, 0.7854)
    """
    return aperture_weights(views, diameter)


def f_number_aperture(camera: PlenopticCamera, f_number: float) -> np.ndarray:
    """Weights of views for the depth of field of an ordinary camera at an f-number.

    It is the working f-number: distance of the microlens array over the diameter of the aperture.
    Its smallest value is that of the lenslets, focal length over width of the micro-image.

    Parameters
    ----------
    camera : PlenopticCamera
    f_number : float
        Working f-number.

    Returns
    -------
    ndarray of float64, shape (views, views), values from 0 to 1

    Raises
    ------
    InputError
        If the f-number is below the smallest one.

    Examples
    --------
    >>> from lf_flame import PAPER_CAMERA
    >>> from lf_flame.refocus import f_number_aperture
    >>> weights = f_number_aperture(PAPER_CAMERA, 8.0)
    >>> weights.shape, bool(weights[0, 0] == 0)
    ((15, 15), True)
    """
    own = camera.lenslet_focal_mm / (camera.views * camera.pixel_mm)
    if not own * (1 - 1e-9) <= f_number < np.inf:
        raise InputError(
            f"f_number must be {np.ceil(1e3 * own) / 1e3:g} (all views) or more, got {f_number}."
        )
    return round_aperture((camera.views, camera.views), own / f_number)


def _edges(views: int, width: float, centre: float) -> np.ndarray:
    """Edges of the views' squares, from the aperture's centre, in halves of its width."""
    with np.errstate(over="ignore"):  # for a width near 0, all edges are outside
        return 2 * (centred(views + 1) - centre) / views / width


def _inside_disc(views: tuple[int, int], width: float, centre: tuple[float, float]) -> np.ndarray:
    """Fraction of each view's square inside a disc."""
    width = min(width, 1e6)  # so that nothing overflows
    down, right = (_edges(n, width, at) for n, at in zip(views, centre, strict=True))
    area = _area_to(down[:, None], right[None, :])
    inside = np.diff(np.diff(area, axis=0), axis=1)
    return np.clip(inside * views[0] * views[1] * (width / 2) ** 2, 0, 1)


def _inside_square(views: tuple[int, int], width: float, centre: tuple[float, float]) -> np.ndarray:
    """Fraction of each view's square inside a square (a rectangle if the views differ)."""
    width = min(width, 1e6)
    down, right = (
        np.diff(np.clip(_edges(n, width, at), -1, 1)) * n * width / 2
        for n, at in zip(views, centre, strict=True)
    )
    return np.clip(np.outer(down, right), 0, 1)


SHAPES: dict[str, Callable[..., np.ndarray]] = {"round": _inside_disc, "square": _inside_square}
"""Fraction by shape of each view's square, (v, u), inside an aperture (width, centre)."""


def _area_to(y: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Area of the unit disc between the axes and (y, x), with the sign of y x."""
    sign = np.sign(y) * np.sign(x)
    y, x = np.minimum(np.abs(y), 1), np.minimum(np.abs(x), 1)
    corner = np.sqrt(1 - y**2)  # x at which the circle reaches the height y
    beyond = (_under_circle(x) - _under_circle(corner)) + y * corner
    return sign * np.where(x <= corner, x * y, beyond)


def _under_circle(x: np.ndarray) -> np.ndarray:
    """Area between 0 and x under the upper half of the unit circle."""
    return (x * np.sqrt(1 - x**2) + np.arcsin(x)) / 2
