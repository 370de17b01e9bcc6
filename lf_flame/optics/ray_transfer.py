"""Ray transfer (ABCD) matrices of paraxial optics.

A ray is the column vector ``(y, theta)``: height in mm and angle in rad at a plane. A matrix, 2 x 2
in float64, maps the ray at one plane to the ray at a later plane; all have determinant 1.
"""

import numpy as np


def free_space(distance_mm: float) -> np.ndarray:
    """Propagation over a distance along the axis: ``[[1, d], [0, 1]]`` (paper, equation 4).

    A negative distance leads back to a virtual plane.

    Examples
    --------
    >>> from lf_flame.optics import free_space
    >>> free_space(2.0).tolist()
    [[1.0, 2.0], [0.0, 1.0]]
    """
    return np.array([[1.0, distance_mm], [0.0, 1.0]])


def thin_lens(focal_mm: float) -> np.ndarray:
    """Thin lens: ``[[1, 0], [-1/f, 1]]`` (paper, equation 5); f > 0 converges, infinity is none.

    Examples
    --------
    >>> from lf_flame.optics import thin_lens
    >>> thin_lens(2.0).tolist()
    [[1.0, 0.0], [-0.5, 1.0]]
    """
    return np.array([[1.0, 0.0], [-1.0 / focal_mm, 1.0]])


def chain(*elements: np.ndarray) -> np.ndarray:
    """Matrix of several elements, given in the order in which light passes them.

    Examples
    --------
    >>> from lf_flame.optics import chain, free_space, thin_lens
    >>> system = chain(free_space(4.0), thin_lens(2.0), free_space(4.0))
    >>> float(system[0, 1])  # object and image stand at twice the focal length
    0.0
    """
    system = np.eye(2)
    for element in elements:
        system = element @ system
    return system


def inverse(system: np.ndarray) -> np.ndarray:
    """Inverse ``[[D, -B], [-C, A]]`` of ``[[A, B], [C, D]]``: from the ray behind to that before.

    It is not the matrix of the system turned round, ``[[D, B], [C, A]]``, where angles change their
    sign. It is exact for determinant 1. Nothing is divided, so it holds for imaging (B = 0), afocal
    (C = 0) and telecentric (A or D = 0) systems.

    Examples
    --------
    >>> from lf_flame.optics import free_space, inverse
    >>> inverse(free_space(2.0)).tolist()
    [[1.0, -2.0], [-0.0, 1.0]]
    """
    (a, b), (c, d) = system
    return np.array([[d, -b], [-c, a]])
