"""Numbers that follow from a camera, as tables, and a drawing of its rays."""

from collections.abc import Sequence
from dataclasses import MISSING, fields

import numpy as np
from tabulate import tabulate

from lf_flame._common.figures import subplots
from lf_flame.optics import ray_transfer
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.optics.lens import Lens

ALIKE = 1.02
"""Largest ratio of an aperture to the matched one at which micro-images hardly overlap."""

LENSLETS_SHOWN = 5
"""Number of lenslets in the enlarged part."""

RAYS = 61
"""Number of rays over the aperture in the enlarged part; those outside its lenslets are cut."""


def camera_report(camera: PlenopticCamera, depths_mm: Sequence[float]) -> str:
    """Tabulate the numbers that follow from a camera, and the slopes at some depths."""
    fov, field = camera.field_of_view_deg, camera.field_mm(0.0)
    rows = [
        ("main lens focal length", f"{camera.main_lens_focal_mm:g} mm"),
        ("focal plane to main lens", f"{camera.focus_distance_mm:g} mm"),
        ("main lens to microlens array", f"{camera.image_distance_mm:.3f} mm (thin lens)"),
        ("magnification", f"{-camera.image_distance_mm / camera.focus_distance_mm:.4f}"),
        ("aperture, f-number matched", f"{camera.aperture_mm:.2f} mm"),
        ("aperture", _aperture(camera)),
        *_imperfections(camera),
        ("view step on the main lens", f"{camera.view_step_mm:.3f} mm"),
        ("lenslets (rows x columns)", f"{camera.lenslets[0]} x {camera.lenslets[1]}"),
        ("views", f"{camera.views} x {camera.views}"),
        ("pixels from lenslet to lenslet", f"{camera.micro_image_pitch_mm / camera.pixel_mm:.3f}"),
        ("pixel pitch", f"{camera.pixel_mm * 1e3:.3f} um"),
        ("field of view (down x across)", f"{fov[0]:.2f} x {fov[1]:.2f} degrees"),
        ("field at the focal plane", f"{field[0]:.2f} x {field[1]:.2f} mm"),
    ]
    tables = [table(rows, "camera", "value"), depth_table(camera, depths_mm)]
    return "\n\n".join([*tables, *_doubts(camera)])


def depth_table(lens: Lens, depths_mm: Sequence[float]) -> str:
    """Tabulate slope and field at some depths."""
    lens.check_depths(depths_mm)
    rows = [
        (f"{depth:g}", f"{lens.depth_to_slope(depth):+.3f}",
         "{:.2f} x {:.2f}".format(*lens.field_mm(depth)))
        for depth in depths_mm
    ]  # fmt: skip
    return table(rows, "depth (mm)", "slope (lenslets per view)", "field (mm)")


def _doubts(camera: PlenopticCamera) -> list[str]:
    """List what is unlikely or unfortunate in a camera that can be computed all the same."""
    matched, given = camera.aperture_mm, camera.aperture_diameter_mm
    if given is None:
        return []
    if given > matched * ALIKE:
        return [
            f"note: the aperture is wider than the {matched:.2f} mm that match the lenslets: "
            f"micro-images overlap, and the outer views hold light of two lenslets. From f/"
            f"{camera.main_lens_focal_mm / matched:.2f} on, as engraved, they do not."
        ]
    lit = given / camera.view_step_mm
    if lit < camera.views / 2:
        return [
            f"note: the aperture lights {lit:.2g} of the {camera.views} pixels under a lenslet; "
            f"the other views are dark. All lengths are in mm."
        ]
    return []


def _aperture(camera: PlenopticCamera) -> str:
    """Describe the aperture of the camera, with its f-numbers as engraved and at work."""
    given = camera.aperture_diameter_mm
    shape = "square, matched" if given is None else "round"
    width = camera.aperture_mm if given is None else given
    return (
        f"{shape}, {width:.2f} mm, f/{camera.main_lens_focal_mm / width:.2f} "
        f"(at work f/{camera.image_distance_mm / width:.2f})"
    )


def _imperfections(camera: PlenopticCamera) -> list[tuple[str, str]]:
    """List the deviations of a camera from ideal lenses, as given."""
    shown = ("pixel_pitch_mm", "aperture_diameter_mm")  # elsewhere in the table
    optional = [one for one in fields(camera) if one.default is not MISSING]
    values = [(one.name, getattr(camera, one.name), one.default) for one in optional]
    return [(name, str(x)) for name, x, ideal in values if x != ideal and name not in shown]


def table(rows: list[tuple], *columns: str) -> str:
    """Make a table of texts for the terminal."""
    return tabulate(rows, headers=columns, tablefmt="simple", disable_numparse=True)


def camera_figure(camera: PlenopticCamera, depths_mm: Sequence[float]):
    """Draw rays from points on the axis through main lens and lenslets to the sensor.

    As the paper's Figures 2, 3 and 5, by the ray transfer matrices that the simulation uses.

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
