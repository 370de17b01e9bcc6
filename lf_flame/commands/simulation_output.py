"""The files of `lf-flame simulate`."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from lf_flame._common import figures
from lf_flame._common.atomic_files import OutputFolder, write_text
from lf_flame._common.config import to_json
from lf_flame.formats import write_focal_stack
from lf_flame.formats.images import to_preview, white_of, write_image
from lf_flame.lightfield import LightField
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.refocus import shift_and_sum
from lf_flame.scenes.scene import Scene


def write_simulation(
    light_field: LightField, scene: Scene, camera: PlenopticCamera, out: OutputFolder
) -> None:
    """Write raw image, views, plan, and the light field refocused at the depth of each layer."""
    depths = np.array(sorted({layer.depth_mm for layer in scene.layers}, reverse=True))
    slopes = camera.depth_to_slope(depths)
    stack, raw = shift_and_sum(light_field, slopes), light_field.to_raw()
    white = white_of(light_field)
    write_image(out.path("raw.tif"), raw)
    write_image(out.path("raw.png"), to_preview(raw, white), linear=True)
    write_focal_stack(stack, slopes, out.path("refocused.tif"))
    for number, (depth, image) in enumerate(zip(depths, stack, strict=True), 1):
        write_image(out.path(f"refocused_{number}_{depth:+g}mm.png"), to_preview(image, white))
    figures.save(_view_sheet(light_field.views), out.path("views.png"))
    arrays: dict[str, Any] = {
        "views": light_field.views, "refocused": stack, "slopes": slopes, "depths_mm": depths
    }  # fmt: skip
    if light_field.weights is not None:
        arrays["weights"] = light_field.weights
    np.savez_compressed(out.path("light_field.npz"), **arrays)
    write_text(out.path("plan.txt"), f"{light_field.plan}\n")
    out.facts |= {
        "camera": to_json(camera),
        "depths_mm": depths.tolist(),
        "slopes": slopes.tolist(),
        "radiance_of_white_in_png": white,
        "plan": light_field.plan.to_json(),
    }


def _view_sheet(views: np.ndarray) -> Figure:
    """Draw sub-aperture views, (v, u, t, s): up to 5 x 5, spread evenly over the aperture."""
    rows, columns = (
        np.unique(np.linspace(0, n - 1, min(n, 5)).round().astype(int)) for n in views.shape[:2]
    )
    height, width = views.shape[2:]
    aspect = np.clip(height / width, 0.1, 10)  # a line of lenslets would make an endless sheet
    figure, axes = figures.subplots(
        len(rows),
        len(columns),
        figsize=(2 * len(columns), 2 * len(rows) * aspect + 0.8),
        squeeze=False,
        layout="constrained",
    )
    for v, line in zip(rows, axes, strict=True):
        for u, axis in zip(columns, line, strict=True):
            axis.imshow(views[v, u], cmap="gray", vmin=0, vmax=max(views.max(), 1e-9))
            axis.set_title(f"v = {v}, u = {u}", fontsize=7, pad=2)
            axis.axis("off")
    figure.suptitle("Sub-aperture views", fontsize=10)
    return figure
