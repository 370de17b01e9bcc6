"""A drawing of a camera, by the ray transfer matrices that the simulation uses.

As the paper's Figures 2, 3 and 5: focal plane, main lens, microlens array and sensor, and the
marginal rays of a point on the axis at each depth.
"""

from collections.abc import Sequence

import numpy as np

from lf_flame._common.figures import subplots
from lf_flame.optics import ray_transfer
from lf_flame.optics.camera import PlenopticCamera

LENSLETS_SHOWN = 5
"""Number of lenslets in the enlarged part."""

RAYS = 61
"""Number of rays over the aperture in the enlarged part; those outside its lenslets are cut."""


def camera_figure(camera: PlenopticCamera, depths_mm: Sequence[float]):
    """Draw rays from points on the axis through main lens and lenslets to the sensor.

    Parameters
    ----------
    camera : PlenopticCamera
    depths_mm : sequence of float
        Depths of the points, in mm from the focal plane; at least one.

    Returns
    -------
    matplotlib.figure.Figure
        Left: from the planes to the microlens array. Right: from the array to the sensor, enlarged.
    """
    figure, axes = subplots(
        1, 2, figsize=(11, 4.2), width_ratios=(2.2, 1), layout="constrained", squeeze=False
    )
    whole, enlarged = axes[0]
    radius = (camera.aperture_diameter_mm or camera.aperture_mm) / 2
    for k, depth in enumerate(depths_mm):
        colour, label = f"C{k}", f"{depth:+g} mm, slope {camera.depth_to_slope(depth):+.2f}"
        for height in np.linspace(-radius, radius, 5):
            edge = abs(abs(height) - radius) < 1e-9 * radius
            style = {"color": colour, "lw": 1.2 if edge else 0.6, "alpha": 1.0 if edge else 0.6}
            z, y = trace_to_array(camera, depth, height)
            whole.plot(z, y, label=label if height == -radius else None, **style)
        for height in np.linspace(-radius, radius, RAYS):
            enlarged.plot(*trace_to_sensor(camera, depth, height), color=colour, lw=0.7)
    _draw_whole(whole, camera, depths_mm, radius)
    _draw_enlarged(enlarged, camera)
    return figure


def trace_to_array(
    camera: PlenopticCamera, depth_mm: float, height_mm: float
) -> tuple[list[float], list[float]]:
    """Trace a ray from a point on the axis, through a height on the main lens, to the array.

    Returns
    -------
    z_mm, y_mm : list of float
        Positions along and across the axis at the point, the main lens and the array; the main
        lens is at z = 0, the scene at negative z.
    """
    distance = camera.focus_distance_mm + depth_mm
    ray = np.array([0.0, height_mm / distance])
    at_lens = ray_transfer.free_space(distance) @ ray
    behind = ray_transfer.thin_lens(camera.main_lens_focal_mm) @ at_lens
    at_array = ray_transfer.free_space(camera.image_distance_mm) @ behind
    return [-distance, 0.0, camera.image_distance_mm], [0.0, at_lens[0], at_array[0]]


def trace_to_sensor(
    camera: PlenopticCamera, depth_mm: float, height_mm: float
) -> tuple[list[float], list[float]]:
    """Trace the same ray through the lenslet that it hits, to the sensor.

    Returns
    -------
    z_mm, y_mm : list of float
        Positions one lenslet focal length before the array, on the array, and on the sensor; the
        array is at z = 0. Not rotated by 180 degrees, unlike stored images.
    """
    distance, focal = camera.focus_distance_mm + depth_mm, camera.lenslet_focal_mm
    to_array = ray_transfer.chain(
        ray_transfer.free_space(distance),
        ray_transfer.thin_lens(camera.main_lens_focal_mm),
        ray_transfer.free_space(camera.image_distance_mm),
    )
    height, angle = to_array @ np.array([0.0, height_mm / distance])
    centre = round(height / camera.lenslet_pitch_mm) * camera.lenslet_pitch_mm
    below = (camera.lenslet_to_sensor() @ np.array([height - centre, angle]))[0]
    return [-focal, 0.0, focal], [height - focal * angle, height, centre + below]


def _draw_whole(axis, camera: PlenopticCamera, depths_mm: Sequence[float], radius: float) -> None:
    half = 0.5 * camera.lenslet_pitch_mm * camera.lenslets[0]
    for depth in depths_mm:
        z, side = -(camera.focus_distance_mm + depth), camera.field_mm(depth)[0] / 2
        axis.plot([z, z], [-side, side], color="0.6", lw=1, ls=":")
    axis.plot([0, 0], [-radius, radius], color="0.2", lw=3)
    axis.plot([camera.image_distance_mm] * 2, [-half, half], color="0.2", lw=2)
    axis.axhline(0, color="0.8", lw=0.5, zorder=0)
    texts = (
        (0.0, f"main lens\nf = {camera.main_lens_focal_mm:g} mm"),
        (camera.image_distance_mm, f"microlens array\n{camera.image_distance_mm:.2f} mm behind"),
        (-camera.focus_distance_mm, f"focal plane\n{camera.focus_distance_mm:g} mm before"),
    )
    top = 1.12 * max(radius, half)
    for z, text in texts:
        axis.text(z, top, text, ha="center", va="bottom", fontsize=8)
    axis.set(xlabel="along the axis (mm)", ylabel="height (mm)", ylim=(-1.1 * top, 1.45 * top))
    axis.margins(x=0.14)
    axis.legend(fontsize=8, loc="lower left", title="depth of the point", title_fontsize=8)


def _draw_enlarged(axis, camera: PlenopticCamera) -> None:
    pitch, focal = camera.lenslet_pitch_mm, camera.lenslet_focal_mm
    for k in range(LENSLETS_SHOWN):
        centre = (k - LENSLETS_SHOWN // 2) * pitch
        half = np.linspace(-0.5, 0.5, 21)
        for side in (-1, 1):  # bulges that separate the lenslets; not their true thickness
            bulge = side * 0.05 * focal * (1 - 4 * half**2)
            axis.plot(bulge, centre + half * pitch, color="0.2", lw=1)
        # The chief ray through the centre of the lenslet hits the centre of its micro-image.
        middle = centre * (1 + focal / camera.image_distance_mm)
        pixels = middle + (np.arange(camera.views) - (camera.views - 1) / 2) * camera.pixel_mm
        axis.plot(np.full_like(pixels, focal), pixels, "_", color="0.2", ms=7, mew=0.8)
    limit = LENSLETS_SHOWN / 2 * pitch
    axis.set(xlim=(-focal, 1.15 * focal), ylim=(-limit, limit))
    axis.set(xlabel="from the array (mm)", ylabel="height (mm)")
    axis.set_title(
        f"lenslets: {1e3 * pitch:.4g} µm, f = {focal:g} mm, {camera.views} pixels each",
        fontsize=9,
    )
