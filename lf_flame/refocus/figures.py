"""Figures of slopes: sharpness curves, slope maps, and regions in focus."""

from functools import partial
from itertools import product

import numpy as np
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from lf_flame._common.figures import subplots
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.optics.lens import Lens


def with_depth(text: str, slope: float, camera: Lens | None) -> str:
    """Add the depth in mm to a slope's text, if the camera is known and has such a layer."""
    depth = None if camera is None else camera.slope_to_real_depth(slope)
    return text if depth is None or not np.isfinite(depth) else f"{text} ({depth + 0.0:+.4g} mm)"


def _slope_axis(axis, camera: Lens | None) -> str:
    """Write depths below an axis's slopes, if the camera is known; returns the label."""
    if camera is None:
        return "slope (lenslets per view step)"
    axis.set_major_locator(MaxNLocator(5))  # the depths below more of them would collide
    axis.set_major_formatter(
        lambda slope, _: with_depth(f"{slope:g}", slope, camera).replace(" (", "\n(")
    )
    zero = "focal plane" if isinstance(camera, PlenopticCamera) else "calibration's zero"
    return f"slope, lenslets per view step (depth from the {zero})"


def search_figure(searches, camera=None):
    """Sharpness against slope: one curve per search, with its peak marked.

    Parameters
    ----------
    searches : list of SlopeSearch
        Searches; those without a peak are drawn without a mark.
    camera : PlenopticCamera or CameraLaw, optional
        Camera for depths in mm next to the slopes.

    Returns
    -------
    matplotlib.figure.Figure
    """
    shown = partial(_shown_slope, camera=camera)
    labels = [
        "rows {}-{}, columns {}-{}".format(*search.region)
        + f": {shown(search.slope)}, confidence {search.confidence:.2f}"
        for search in searches
    ]
    figure, axis = subplots(figsize=(7, 3.6 + 0.25 * len(labels)), layout="constrained")
    draw_searches(axis, searches, labels)
    axis.set_ylim(bottom=0)
    axis.set_xlabel(_slope_axis(axis.xaxis, camera))
    figure.legend(fontsize=9, loc="outside lower center")
    return figure


def draw_searches(axis, searches, labels) -> None:
    """Draw the curves of searches, each relative to its peak."""
    for k, (search, label) in enumerate(zip(searches, labels, strict=True)):
        scale = max(search.sharpness.max(), np.finfo(float).tiny)
        axis.plot(search.slopes, search.sharpness / scale, color=f"C{k}", label=label)
        axis.plot(search.slope, 1, "o", color=f"C{k}", markersize=5)
    axis.set_ylabel("gradient energy,\nrelative to its peak")
    axis.set_yticks(np.linspace(0, 1, 6))
    axis.grid(alpha=0.3)


def _shown_slope(slope: float, camera: PlenopticCamera | None) -> str:
    """Write a slope, without a minus sign before zero, and its depth."""
    return with_depth(f"{round(slope, 3) + 0.0:.3f}", slope, camera)


def slope_map_figure(focus_map, camera=None):
    """Everything in focus beside the slope of each pixel, paler where it is less certain.

    Parameters
    ----------
    focus_map : lf_flame.refocus.FocusMap
    camera : PlenopticCamera or CameraLaw, optional
        Camera for depths in mm next to the slopes.

    Returns
    -------
    matplotlib.figure.Figure
    """
    picture = focus_map.all_in_focus
    titles = "everything in focus", "slope of sharpest focus, paler where less certain"
    trust = np.clip(focus_map.confidence / 0.5, 0.15, 1)
    shown = picture / max(picture.max(), 1e-30), focus_map.slope
    return _image_beside_slopes(*shown, titles, camera, alpha=trust)[0]


def regions_figure(image: np.ndarray, surface: np.ndarray, regions):
    """Draw an image, from 0 to 1, with given regions in focus, beside the slope of each pixel."""
    titles = "the framed regions in focus", "slope that each pixel is refocused at"
    figure, axes = _image_beside_slopes(image, surface, titles)
    for axis, (t0, t1, s0, s1) in product(axes, regions):
        frame = Rectangle((s0 - 0.5, t0 - 0.5), s1 - s0, t1 - t0, fill=False, color="orange")
        axis.add_patch(frame)
    return figure


def _image_beside_slopes(image, slopes, titles, camera=None, **options):
    """Draw an image beside a slope map; returns the figure and both axes."""
    height, width = slopes.shape
    figure, axes = subplots(1, 2, figsize=(12, 1.2 + 5.2 * height / width), layout="constrained")
    axes[0].imshow(np.clip(image, 0, 1), cmap="gray", vmin=0, vmax=1)
    drawn = axes[1].imshow(slopes, cmap="viridis", interpolation="none", **options)
    for axis, title in zip(axes, titles, strict=True):
        axis.set_title(title, fontsize=10)
        axis.axis("off")
    bar = figure.colorbar(drawn, ax=axes[1], shrink=0.85)
    bar.set_label(_slope_axis(bar.ax.yaxis, camera))
    return figure, axes
