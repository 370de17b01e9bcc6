"""Parts into which pixels are cut, so that lenslet diffraction need not take their light as even.

Light that varies inside a pixel leaves it by the side where it is. How much that matters depends on
the texture: so it is tried, in small windows of the array where the textures have most to show.
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
"""Parts of a pixel along each axis that are tried."""

WINDOW = 8
"""Lenslets of a window along each axis."""

GRID = 3
"""Windows along each axis that are spread over the array, beside those where textures change."""

Image = Callable[[list[Plane], PlenopticCamera, int], np.ndarray]
"""Makes an image, diffracted by the lenslets, of some planes before a camera in parts of pixels."""


def count_pixel_parts(
    planes: list[Plane], camera: PlenopticCamera, allowance: float, image: Image
) -> int:
    """Find the fewest parts of a pixel with which an image is as good as it has to be.

    The error falls as one over the parts, at least: so the change by twice as many is at least half
    of the error of the fewer, and no less than that of the more.

    Parameters
    ----------
    planes : list of Plane
    camera : PlenopticCamera
    allowance : float
        Error that is acceptable, root-mean-square over all windows, relative to their brightest
        pixel.
    image : callable

    Returns
    -------
    int

    Raises
    ------
    InputError
        If it takes more parts than any that are tried.
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
    """Yield small cameras in the middle of the array, each with the planes as a window sees them.

    A window elsewhere sees what one in the middle sees of planes that stand aside.
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
    """First lenslets of the windows: all over the array, and where planes are rough or bright."""
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
    """Move a plane so that the middle of the array sees of it what a window elsewhere saw."""
    centre = list(plane.layer.centre_mm)
    for axis in (0, 1):
        there = trace_footprint(camera, plane.depth_mm, axis).centres_mm[0, corner[axis]]
        here = trace_footprint(window, plane.depth_mm, axis).centres_mm[0, 0]
        centre[axis] += here - there
    return replace(plane, layer=replace(plane.layer, centre_mm=(centre[0], centre[1])))
