"""Figures 5 to 8 of the paper, and how networks learn."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from matplotlib.patches import Ellipse, Rectangle
from matplotlib.transforms import Affine2D

from experiments.report import panels
from lf_flame._common.figures import subplots
from lf_flame.datasets.config import DatasetConfig
from lf_flame.lightfield import LightField

LENSLETS_ENLARGED = 12
"""Number of lenslets along each side of the part of the raw image that is shown enlarged."""


def setup_figure(config: DatasetConfig):
    """Draw Figure 5 or 6 of the paper: the mean scene's objects at their depths, and the camera.

    Planes are as large as the field at the focal plane. Behind the main lens nothing is to scale.
    """
    camera, (scene, _), depths = config.camera, config.draw(None), np.array(config.depths_mm)
    height, width = camera.field_mm(0.0)
    figure, axis = subplots(figsize=(12, 3.6), layout="constrained")
    step = 0.48 * width
    places = np.array([0.0, *depths])
    focal, *places = 3 * step * (places.max() - places) / max(np.ptp(places), 1e-9)
    lens, array, sensor = 4.6 * step, 5.7 * step, 6.2 * step

    def oblique(place: float):
        """Turn (right, up) in a plane at a place of the axis into the drawing."""
        return Affine2D([[0.35, 0, place], [0.15, 1, 0], [0, 0, 1]]) + axis.transData

    def draw_plane(place: float, color: str, label: str) -> None:
        frame = Rectangle((-width / 2, -height / 2), width, height, fc=color, ec="0.4")
        axis.add_patch(frame).set_transform(oblique(place))
        axis.text(place, 0.75 * height, label, ha="center", va="bottom")

    for layer, item, place in zip(scene.layers, config.template.objects, places, strict=True):
        draw_plane(place, "black", f"{item.name}\n{layer.depth_mm:g} mm")
        (down, right), (h, w) = layer.centre_mm, layer.size_mm
        axis.imshow(
            layer.texture, cmap="gray", vmin=0, vmax=1, transform=oblique(place), zorder=1.5,
            extent=(right - w / 2, right + w / 2, -down - h / 2, h / 2 - down),
        )  # fmt: skip
    glass = Ellipse((0, 0), height, height, fc="lightblue", ec="C0")
    axis.add_patch(glass).set_transform(oblique(lens))
    axis.text(lens, 0.75 * height, "main lens", ha="center", va="bottom")
    draw_plane(array, "lightblue", "MLA")
    draw_plane(sensor, "0.85", "sensor")
    axis.plot([-0.6 * step, sensor], [0, 0], "--", color="C1", lw=1)  # optical axis
    for start, end, mm in (
        (focal, lens, camera.focus_distance_mm),
        (lens, array, camera.image_distance_mm),
        (array, sensor, camera.lenslet_focal_mm),
    ):
        ends = {"xy": (start, -0.8 * height), "xytext": (end, -0.8 * height)}
        axis.annotate("", **ends, arrowprops={"arrowstyle": "<->", "shrinkA": 0, "shrinkB": 0})
        axis.text((start + end) / 2, -0.83 * height, f"{mm:.5g} mm", ha="center", va="top")
    axis.set(xlim=(-0.7 * step, sensor + 0.5 * step), ylim=(-1.1 * height, 1.2 * height), aspect=1)
    axis.axis("off")
    return figure


def enlarged_part(views: np.ndarray) -> tuple[int, int]:
    """Find the part around the micro-image that varies most; returns its corner (t, s)."""
    uneven = views.std(axis=(0, 1))
    places = zip(np.unravel_index(uneven.argmax(), uneven.shape), uneven.shape, strict=True)
    t, s = (
        int(np.clip(k - LENSLETS_ENLARGED // 2, 0, max(n - LENSLETS_ENLARGED, 0)))
        for k, n in places
    )
    return t, s


def result_figure(
    light_field: LightField, light_field_image, targets, predictions, depths_mm, title: str
):
    """Draw Figure 7 or 8 of the paper: input, reference, prediction, and the error.

    The light field is drawn as the raw lenslet image, with an enlarged part in which micro-images
    can be seen; beside it the network's input, (h, w) or (h, w, 3), and images (planes, h, w).
    """
    planes = len(targets)
    errors = predictions - targets
    limit = max(np.abs(errors).max(), 1e-6)
    figure, axes = subplots(3, planes + 1, figsize=(2.7 * (planes + 1), 4.9), layout="constrained")
    for axis in axes.flat:
        axis.set(xticks=[], yticks=[])
    _draw_raw(axes[0, 0], axes[1, 0], light_field)
    axes[2, 0].imshow(light_field_image, cmap="gray", vmin=0, vmax=1)
    axes[2, 0].set_title("input of the network", fontsize=10)
    for k, depth in enumerate(depths_mm):
        axes[0, k + 1].set_title(f"{depth:g} mm", fontsize=10)
        axes[0, k + 1].imshow(targets[k], cmap="gray", vmin=0, vmax=1)
        axes[1, k + 1].imshow(predictions[k], cmap="gray", vmin=0, vmax=1)
        error = axes[2, k + 1].imshow(errors[k], cmap="RdBu_r", vmin=-limit, vmax=limit)
    labels = ("(b) ground truth", "(c) prediction", "(d) error, (c) − (b)")
    for row, label in enumerate(labels):
        axes[row, 1].set_ylabel(label, fontsize=10)
    figure.colorbar(error, ax=axes[2, 1:], fraction=0.05, aspect=12)
    figure.suptitle(title, fontsize=11)
    return figure


def _draw_raw(whole, enlarged, light_field: LightField) -> None:
    """Draw a raw lenslet image, and a part of it enlarged."""
    raw, n = light_field.to_raw(), light_field.views.shape[0]
    whole.imshow(raw, cmap="gray", vmin=0, vmax=1, interpolation_stage="data")
    whole.set_title("(a) raw light-field image", fontsize=10)
    t, s = (n * k for k in enlarged_part(light_field.views))
    side = n * LENSLETS_ENLARGED
    whole.add_patch(Rectangle((s - 0.5, t - 0.5), side, side, fill=False, color="C1", lw=1.2))
    part = raw[t : t + side, s : s + side]
    enlarged.imshow(part, cmap="gray", vmin=0, vmax=max(float(part.max()), 1e-6))
    enlarged.set_title(f"{LENSLETS_ENLARGED} x {LENSLETS_ENLARGED} of its lenslets", fontsize=10)


def learning_figure(tables: Mapping[str, tuple[Mapping[str, Sequence[pd.DataFrame]], Sequence]]):
    """Draw validation PSNR against epochs, a panel for each table, a colour for each recipe.

    Each panel shows the histories of its runs by recipe, and the PSNR values that the paper prints.
    """
    figure, axes = panels(list(tables), (6.5 * len(tables), 5), "epochs")
    for axis, (recipes, printed) in zip(axes, tables.values(), strict=True):
        axis.axhspan(min(printed), max(printed), color="0.85", label="printed, range of the planes")
        for k, (recipe, histories) in enumerate(recipes.items()):
            for number, history in enumerate(histories):
                style = {"color": f"C{k}", "label": None if number else recipe}
                axis.plot(history.epoch, history.val_psnr_db, lw=0.7, **style)
        axis.set_ylabel("PSNR of the validation split (dB)")
        axis.legend(fontsize=9, loc="lower right")
    return figure
