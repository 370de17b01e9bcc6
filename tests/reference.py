"""Slow, obvious twins of the compiled code, in float64."""

import numpy as np
from numpy.linalg import inv

from lf_flame import transfer


def trace_one_pixel(layer, camera, v, u, t, s, rays):
    """Mean radiance over a grid of rays, each pushed through the matrices by itself."""

    def heights(axis, view, lenslet):
        n, k = camera.lenslets[axis], camera.views
        i0, f = camera.image_distance_mm, camera.lenslet_focal_mm
        # The sensor is stored turned by 180 degrees: undo that to get physical positions.
        axis_mm = -(lenslet - (n - 1) / 2) * camera.lenslet_pitch_mm
        chief_mm = axis_mm * (1 + f / i0)
        pixel_mm = chief_mm - (view - (k - 1) / 2) * camera.pixel_mm
        sub = (np.arange(rays) + 0.5) / rays - 0.5
        object_to_array = camera.object_to_array(layer.depth_mm)
        lens = transfer.chain(transfer.thin_lens(f), transfer.free_space(f))
        found = []
        for on_lenslet in axis_mm + sub * camera.lenslet_pitch_mm:
            for on_pixel in pixel_mm + sub * camera.pixel_mm:
                # angle in front of the lenslet for which the ray ends on the pixel
                height = on_lenslet - axis_mm
                angle = (on_pixel - axis_mm - lens[0, 0] * height) / lens[0, 1]
                found.append((inv(object_to_array) @ [on_lenslet, angle])[0])
        return np.array(found)

    rows, columns = (
        np.floor(
            (heights(axis, *pixel) - layer.cell_edges_mm(axis)[0])
            / (layer.size_mm[axis] / layer.texture.shape[axis])
        )
        for axis, pixel in ((0, (v, t)), (1, (u, s)))
    )
    padded = np.pad(layer.texture, 1)
    inside = [
        np.clip(index + 1, 0, length + 1).astype(int)
        for index, length in zip((rows, columns), layer.texture.shape, strict=True)
    ]
    return padded[np.ix_(*inside)].mean()


def shift_and_sum(views, slope):
    """Bilinear shift-and-sum, coordinates clamped, one view after the other."""
    rows, columns, height, width = views.shape
    total = np.zeros((height, width))
    for v in range(rows):
        for u in range(columns):
            t = np.clip(np.arange(height) + slope * (v - (rows - 1) / 2), 0, height - 1)
            s = np.clip(np.arange(width) + slope * (u - (columns - 1) / 2), 0, width - 1)
            t0 = np.minimum(np.floor(t).astype(int), max(height - 2, 0))
            s0 = np.minimum(np.floor(s).astype(int), max(width - 2, 0))
            t1, s1 = np.minimum(t0 + 1, height - 1), np.minimum(s0 + 1, width - 1)
            ft, fs = (t - t0)[:, None], (s - s0)[None, :]
            view = views[v, u].astype(np.float64)
            total += (1 - ft) * ((1 - fs) * view[np.ix_(t0, s0)] + fs * view[np.ix_(t0, s1)])
            total += ft * ((1 - fs) * view[np.ix_(t1, s0)] + fs * view[np.ix_(t1, s1)])
    return total / (rows * columns)
