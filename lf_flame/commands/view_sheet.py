"""A sheet of sub-aperture views, for display."""

import numpy as np
from matplotlib.figure import Figure

from lf_flame._common.figures import subplots

PER_SIDE = 5
"""Largest number of views along each axis of a sheet."""


def view_sheet(views: np.ndarray) -> Figure:
    """Draw a sheet of sub-aperture views, spread evenly over the aperture.

    Parameters
    ----------
    views : ndarray, shape (v, u, t, s), values from 0

    Returns
    -------
    matplotlib.figure.Figure
    """
    rows, columns = (
        np.unique(np.linspace(0, n - 1, min(n, PER_SIDE)).round().astype(int))
        for n in views.shape[:2]
    )
    height, width = views.shape[2:]
    aspect = np.clip(height / width, 0.1, 10)  # a line of lenslets would make an endless sheet
    figure, axes = subplots(
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
