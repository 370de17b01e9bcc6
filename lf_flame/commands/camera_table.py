"""What the program prints and writes: reports put together from the parts of the package."""

from collections.abc import Iterable

import pandas as pd

from lf_flame.optics.camera import PlenopticCamera


def camera_report(camera: PlenopticCamera, depths_mm: Iterable[float]) -> str:
    """Table of the numbers that follow from a camera, and of the slopes at some depths."""
    fov, field = camera.field_of_view_deg, camera.field_mm(0.0)
    rows = [
        ("main lens focal length", f"{camera.main_lens_focal_mm:g} mm"),
        ("focal plane to main lens", f"{camera.focus_distance_mm:g} mm"),
        ("main lens to microlens array", f"{camera.image_distance_mm:.3f} mm (thin lens)"),
        ("magnification", f"{-camera.image_distance_mm / camera.focus_distance_mm:.4f}"),
        ("aperture, f-number matched", f"{camera.aperture_mm:.2f} mm"),
        ("view step on the main lens", f"{camera.view_step_mm:.3f} mm"),
        ("lenslets (rows x columns)", f"{camera.lenslets[0]} x {camera.lenslets[1]}"),
        ("views", f"{camera.views} x {camera.views}"),
        ("pixel pitch", f"{camera.pixel_mm * 1e3:.3f} um"),
        ("field of view (down x across)", f"{fov[0]:.2f} x {fov[1]:.2f} degrees"),
        ("field at the focal plane", f"{field[0]:.2f} x {field[1]:.2f} mm"),
    ]
    numbers = pd.DataFrame(rows, columns=["camera", "value"])
    layers = pd.DataFrame({"depth (mm)": [f"{z:g}" for z in depths_mm]})
    slopes = [camera.depth_to_slope(z) for z in depths_mm]
    layers["slope (lenslets per view)"] = [f"{s:+.3f}" for s in slopes]
    layers["alpha"] = [f"{camera.slope_to_alpha(s):.4f}" for s in slopes]
    fields = [camera.field_mm(z) for z in depths_mm]
    layers["field (mm)"] = [f"{height:.2f} x {width:.2f}" for height, width in fields]
    style = {"index": False, "disable_numparse": True, "tablefmt": "simple"}
    return f"{numbers.to_markdown(**style)}\n\n{layers.to_markdown(**style)}"
