"""Number of parts into which pixels are divided for diffraction by the lenslets.

Diffraction spreads light over the borders of a pixel. If the light varies within the pixel, more
leaves it on the brighter side, so that the pixel must be divided. How finely depends on the
texture; it is measured in small windows of the lenslet array where textures vary most.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from lf_flame.errors import InputError
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.optics.ray_bundle import trace_footprint
from lf_flame.simulation.slabs import Plane

TRIED = (1, 2, 4, 8, 16, 32)
"""Numbers of parts of a pixel along each axis that are tried."""

WINDOW = 8
"""Number of lenslets of a window along each axis."""

GRID = 3
"""Number of windows along each axis that are spread evenly over the array, in addition to those at
the strongest changes of the textures."""

Image = Callable[[list[Plane], PlenopticCamera, int], np.ndarray]
"""Function that renders planes in front of a camera, with diffraction by the lenslets and pixels
divided into a number of parts along each axis."""


def count_pixel_parts(
    planes: list[Plane], camera: PlenopticCamera, allowance: float, image: Image
) -> int:
    """Find the smallest number of parts of a pixel with which an image is accurate enough.

    The error falls at least as one over the number of parts. The change from one number to twice
    that number is therefore at least half the error of the first, and at least the error of the
    second.

    Parameters
    ----------
    planes : list of Plane
        Planes to render.
    camera : PlenopticCamera
    allowance : float
        Largest acceptable error: root mean square over all windows, relative to their brightest
        pixel.
    image : callable
        Function that renders planes, as `Image` describes.

    Returns
    -------
    int
        Number of parts of a pixel along each axis.

    Raises
    ------
    InputError
        If the largest number of parts in `TRIED` is not enough.
    """
    windows = list(_windows(planes, camera))
    coarser: list[np.ndarray] = []
    for parts in TRIED:
        images = [image(seen, window, parts) for seen, window in windows]
        if coarser:
            change = np.subtract(images, coarser, dtype=np.float64)
            error = math.sqrt(np.mean(change**2)) / max(float(np.max(images)), 1e-300)
            if error <= allowance:
                return parts if 2 * error > allowance else parts // 2
        coarser = images
    raise InputError(
        f"lenslet_diffraction needs more than {TRIED[-1]} x {TRIED[-1]} parts of each pixel: the "
        f"light varies too much inside the pixels; allow a larger tolerance, or force it off."
    )


def _windows(
    planes: list[Plane], camera: PlenopticCamera
) -> Iterator[tuple[list[Plane], PlenopticCamera]]:
    """Yield small cameras, each with planes displaced so that it sees what a window sees.

    A window away from the middle of the array sees the same as one in the middle with displaced
    planes.
    """
    size = min(WINDOW, camera.lenslets[0]), min(WINDOW, camera.lenslets[1])
    if all(n <= 2 * WINDOW for n in camera.lenslets):
        yield planes, camera
        return
    window = replace(camera, lenslets=size)
    for corner in _corners(planes, camera, size):
        yield [_aside(plane, camera, window, corner) for plane in planes], window


def _corners(
    planes: list[Plane], camera: PlenopticCamera, size: tuple[int, int]
) -> set[tuple[int, int]]:
    """First lenslet of each window: on an even grid, and where planes change most or are bright."""
    last = [n - m for n, m in zip(camera.lenslets, size, strict=True)]
    along = [np.round(np.linspace(0, end, GRID)).astype(int).tolist() for end in last]
    corners = {(row, column) for row in along[0] for column in along[1]}
    for layer, plane in {plane.layer: plane for plane in planes}.items():
        cells = np.pad(plane.emission, 1)
        for value in (np.abs(np.diff(cells, axis=0))[:, :-1], cells):
            cell = np.unravel_index(value.argmax(), value.shape)
            corner = []
            for axis in (0, 1):
                edges = layer.cell_edges_mm(axis)
                place = edges[min(int(cell[axis]), edges.size - 1)]
                centres = trace_footprint(camera, plane.depth_mm, axis).centres_mm
                nearest = int(np.abs(centres[camera.views // 2] - place).argmin())
                corner.append(min(max(nearest - size[axis] // 2, 0), last[axis]))
            corners.add((corner[0], corner[1]))
    return corners


def _aside(
    plane: Plane, camera: PlenopticCamera, window: PlenopticCamera, corner: tuple[int, int]
) -> Plane:
    """Displace a plane so that the middle of the array sees it as a window elsewhere does."""
    centre = list(plane.layer.centre_mm)
    for axis in (0, 1):
        there = trace_footprint(camera, plane.depth_mm, axis).centres_mm[0, corner[axis]]
        here = trace_footprint(window, plane.depth_mm, axis).centres_mm[0, 0]
        centre[axis] += here - there
    return replace(plane, layer=replace(plane.layer, centre_mm=(centre[0], centre[1])))
