"""Numbers that follow from a camera, as tables."""

from collections.abc import Sequence
from dataclasses import MISSING, fields

from tabulate import tabulate

from lf_flame.optics.camera import PlenopticCamera
from lf_flame.optics.lens import Lens


def camera_report(camera: PlenopticCamera, depths_mm: Sequence[float]) -> str:
    """Tabulate the numbers that follow from a camera, and the slopes at given depths."""
    fov, field = camera.field_of_view_deg, camera.field_mm(0.0)
    rows = [
        ("main lens focal length", f"{camera.main_lens_focal_mm:g} mm"),
        ("focal plane to main lens", f"{camera.focus_distance_mm:g} mm"),
        ("main lens to microlens array", f"{camera.image_distance_mm:.3f} mm (thin lens)"),
        ("magnification", f"{-camera.image_distance_mm / camera.focus_distance_mm:.4f}"),
        ("aperture, f-number matched", f"{camera.aperture_mm:.2f} mm"),
        ("aperture", _aperture(camera)),
        *_imperfections(camera),
        ("view step in the aperture", f"{camera.view_step_mm:.3f} mm"),
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
    """Tabulate slope and field at given depths."""
    lens.check_depths(depths_mm)
    rows = [
        (f"{depth:g}", f"{lens.depth_to_slope(depth):+.3f}",
         "{:.2f} x {:.2f}".format(*lens.field_mm(depth)))
        for depth in depths_mm
    ]  # fmt: skip
    return table(rows, "depth (mm)", "slope (lenslets per view)", "field (mm)")


def _doubts(camera: PlenopticCamera) -> list[str]:
    """List unlikely or unfavourable properties of a camera that can still be computed."""
    matched, given = camera.aperture_mm, camera.aperture_diameter_mm
    if given is not None and given > 1.02 * matched:  # up to there, micro-images hardly overlap
        return [
            f"note: the aperture is wider than the {matched:.2f} mm that match the lenslets: "
            f"micro-images overlap, and the outer views contain light of two lenslets. At f/"
            f"{camera.main_lens_focal_mm / matched:.2f} or more, as engraved, they do not."
        ]
    lit = (given or matched) / camera.view_step_mm
    if lit < camera.views / 2:
        return [
            f"note: the aperture lights {lit:.2g} of the {camera.views} pixels under a lenslet; "
            f"the other views are dark. All lengths are in mm."
        ]
    return []


def _aperture(camera: PlenopticCamera) -> str:
    """Describe the aperture of the camera, with its f-numbers as engraved and at work."""
    shape = "round" if camera.aperture_diameter_mm else "square, matched"
    width = camera.aperture_diameter_mm or camera.aperture_mm
    return (
        f"{shape}, {width:.2f} mm, f/{camera.main_lens_focal_mm / width:.2f} "
        f"(at work f/{camera.exit_distance_mm / camera.on_exit_pupil(width):.2f})"
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
