"""Figures: pictures of light fields, of results, and of sharpness curves."""

from pathlib import Path

import matplotlib

matplotlib.use("Agg")  # files only; works without a screen

import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402

from lf_flame.files import written_aside  # noqa: E402


def save(figure, path: Path, dpi: int = 150) -> None:
    """Write a figure as PNG."""
    with written_aside(path) as aside:
        figure.savefig(aside, dpi=dpi)
    plt.close(figure)


def result_figure(light_field_image, targets, predictions, depths_mm, title: str):
    """Figures 7 and 8 of the paper: input, ground truth, prediction, and the error they leave out.

    Parameters
    ----------
    light_field_image : ndarray, shape (h, w), values in [0, 1]
    targets, predictions : ndarray, shape (planes, h, w), values in [0, 1]
    depths_mm : sequence of float
    title : str

    Returns
    -------
    matplotlib.figure.Figure
    """
    planes = len(targets)
    errors = predictions - targets
    limit = max(np.abs(errors).max(), 1e-6)
    figure, axes = plt.subplots(
        3, planes + 1, figsize=(2.7 * (planes + 1), 4.9), layout="constrained"
    )
    for axis in axes.flat:
        axis.set_xticks([])
        axis.set_yticks([])
    axes[0, 0].imshow(light_field_image, cmap="gray", vmin=0, vmax=1)
    axes[0, 0].set_title("(a) light-field image,\nas the network sees it", fontsize=10)
    for axis in axes[1:, 0]:
        axis.axis("off")
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


def sharpness_figure(searches, labels, geometry, paper):
    """Sharpness against slope, one curve a layer, with the geometry's and the paper's slopes.

    Parameters
    ----------
    searches : list of SlopeSearch
    labels : list of str
    geometry, paper : sequences of float
        Slopes to mark, in the order of the searches.

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure, axis = plt.subplots(figsize=(9.5, 4.2), layout="constrained")
    for k, (search, label) in enumerate(zip(searches, labels, strict=True)):
        color = f"C{k}"
        relative = search.sharpness / search.sharpness.max()
        axis.plot(
            search.slopes,
            relative,
            color=color,
            label=f"{label}: {round(search.slope, 3) + 0.0:.3f}",
        )
        axis.plot([geometry[k]] * 2, [1.02, 1.07], color=color)
        axis.plot(paper[k], 1.1, "v", color=color, markersize=6)
    axis.plot([], [], "k-", label="tick above: geometry")
    axis.plot([], [], "kv", label="triangle: paper")
    axis.set_xlabel("slope (lenslets per view step)")
    axis.set_ylabel("gradient energy of the region,\nrelative to its peak")
    axis.set_ylim(0, 1.15)
    axis.grid(alpha=0.3)
    figure.legend(fontsize=9, loc="outside right upper")
    return figure


def view_sheet(views: np.ndarray, per_side: int = 5):
    """Draw a sheet of sub-aperture views, spread evenly over the aperture.

    Parameters
    ----------
    views : ndarray, shape (v, u, t, s), values from 0
    per_side : int
        Views along each axis, at most.

    Returns
    -------
    matplotlib.figure.Figure
    """
    rows, columns = (
        np.unique(np.linspace(0, n - 1, min(n, per_side)).round().astype(int))
        for n in views.shape[:2]
    )
    height, width = views.shape[2:]
    figure, axes = plt.subplots(
        len(rows),
        len(columns),
        figsize=(2 * len(columns), 2 * len(rows) * height / width + 0.8),
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
