"""The half section of a round flame: from all views, from one, and by PyAbel from either."""

import textwrap
import time
from collections.abc import Callable, Iterator
from functools import partial

import numpy as np
from matplotlib.figure import Figure

from experiments.tomography.phantoms import BLOCK, Recorder, round_glow, volume_flame
from experiments.tomography.tasks import NOISE, Row
from lf_flame import PAPER_CAMERA, LightField
from lf_flame.tomography import AxisymmetricGrid, find_axis, reconstruct_axisymmetric

HEIGHT_MM, RADIUS_MM, REACH_MM = 25.0, 4.0, 12.0

COMPARED = (0.03, 0.97)
"""Shares of the flame's height between which sections are compared: PyAbel knows no burner, and the
tip is finer than a pixel."""

STRENGTHS = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)
"""Strengths of PyAbel's penalty; that of least true error is shown, which no user could choose."""

SHOWN_HEIGHTS = (-9.0, 0.0, 7.0)
"""Heights in mm at which the figure shows errors along the radius."""

TASK = "round flame"

ALL, CENTRAL = "abel, all views", "abel, the middle view"

ACCEPTED = {(ALL, "1 %"): 0.015, (CENTRAL, "1 %"): 0.04}

Section = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Heights and radii in mm, and the emission there, (heights, radii)."""


def _recorder() -> tuple[Recorder, float]:
    """Record the flame; also the side of a pixel in the focal plane, in mm."""
    camera = PAPER_CAMERA
    pixel = camera.field_mm(0.0)[1] / camera.lenslets[1] * BLOCK
    # In the middle of a pixel column, as PyAbel takes its axis to be.
    scene = volume_flame(HEIGHT_MM, RADIUS_MM, 0.25, REACH_MM, 0.1, across_mm=pixel / 2)
    return Recorder(scene, camera), pixel


def round_flame(rng: np.random.Generator) -> Iterator[Row]:
    """Find the half section of a round flame whose axis is to be found, too."""
    recorder, pixel = _recorder()
    for noise in ("none", "1 %", "5 %"):
        light_field = NOISE[noise](recorder, rng)
        for method, find in METHODS.items():
            begin = time.perf_counter()
            sections = list(find(light_field, pixel))
            seconds = time.perf_counter() - begin
            if not sections:
                continue
            volume, section = min(_errors(*one) for one in sections)
            limit = ACCEPTED.get((method, noise))
            yield Row(TASK, noise, method, "error of the volume", volume, limit, seconds)
            yield Row(TASK, noise, method, "error of the section", section, None, seconds)


def _errors(heights: np.ndarray, radii: np.ndarray, found: np.ndarray) -> tuple[float, float]:
    """Root-mean-square errors over the volume and over the section, relative to the truth's."""
    h = heights / HEIGHT_MM + 0.5
    rows = (h > COMPARED[0]) & (h < COMPARED[1])
    truth = _truth(heights[rows], radii)
    weight = np.sqrt(radii)
    volume, section = (
        float(np.linalg.norm((found[rows] - truth) * w) / np.linalg.norm(truth * w))
        for w in (weight, 1.0)
    )
    return volume, section


def _by_abel(light_field: LightField, pixel_mm: float, which: str) -> Iterator[Section]:
    axis = find_axis(light_field, PAPER_CAMERA)
    grid = AxisymmetricGrid(
        PAPER_CAMERA, axis.across_mm, axis.depth_mm, REACH_MM, BLOCK, which, -HEIGHT_MM / 2
    )
    found = reconstruct_axisymmetric(light_field, grid)
    yield grid.heights_mm, grid.radii_mm, found.emission


def _halves(light_field: LightField, every: bool) -> np.ndarray:
    """Average the halves of the middle view or of the mean view, from the axis outwards."""
    v, u, t, s = light_field.views.shape
    image = light_field.photograph if every else light_field.views[v // 2, u // 2]
    image = image.reshape(t // BLOCK, BLOCK, s // BLOCK, BLOCK)
    image = image.mean(axis=(1, 3), dtype=np.float64)
    axis = s // BLOCK // 2  # the column right of the optical axis
    right = image[:, axis:]
    return (right + image[:, axis::-1][:, : right.shape[1]]) / 2


def _by_pyabel(
    light_field: LightField, pixel_mm: float, regularised: bool, every: bool
) -> Iterator[Section]:
    """Take PyAbel's transform, by three points (Dasch 1992) or with a penalty (Daun 2006)."""
    try:
        from abel import dasch, daun
    except ImportError:  # also where a folder of results is called abel
        return
    half = _halves(light_field, every)
    count = int(np.ceil(REACH_MM / pixel_mm))
    heights = ((len(half) - 1) / 2 - np.arange(len(half))) * pixel_mm
    radii = np.arange(half.shape[1]) * pixel_mm
    options = {"dr": pixel_mm, "basis_dir": None, "verbose": False}
    if regularised:
        found = [
            daun.daun_transform(half, reg=("diff", strength), degree=1, **options)
            for strength in STRENGTHS
        ]
    else:
        found = [dasch.three_point_transform(half, **options)]
    for one in found:
        yield heights, radii[:count], one[:, :count]


METHODS: dict[str, Callable[[LightField, float], Iterator[Section]]] = {
    ALL: partial(_by_abel, which="all"),
    CENTRAL: partial(_by_abel, which="central"),
    **{
        f"PyAbel, {how}, the {seen}": partial(_by_pyabel, regularised=regularised, every=every)
        for regularised, how in ((False, "three points"), (True, "Daun, best of seven penalties"))
        for every, seen in ((False, "middle view"), (True, "mean of all views"))
    },
}


def round_figure():
    """Show the section at 1 % of noise, by every method, and its error at three heights."""
    recorder, pixel = _recorder()
    light_field = recorder.with_noise(0.01, np.random.default_rng(0))
    sections = {}
    for name, find in METHODS.items():
        found = list(find(light_field, pixel))
        if found:
            sections[name] = min(found, key=lambda one: _errors(*one))
    heights, radii, _ = sections[ALL]
    white = float(_truth(heights, radii).max())
    shown = {"truth": (heights, radii, _truth(heights, radii)), **sections}
    figure = Figure(figsize=(11, 7.4), layout="constrained")
    parts = figure.subfigures(2, 1, height_ratios=[1.4, 1])
    above = parts[0].subplots(1, len(shown), sharey=True)
    for axis, (name, (rows, columns, section)) in zip(above, shown.items(), strict=True):
        drawn = _draw_half(axis, rows, columns, section, white)
        axis.set_title("\n".join(textwrap.wrap(name, 18)), fontsize=8)
    above[0].set_ylabel("height (mm)", fontsize=8)
    parts[0].colorbar(drawn, ax=above, label="emission per mm")
    below = parts[1].subplots(1, len(SHOWN_HEIGHTS), sharey=True)
    for axis, height in zip(below, SHOWN_HEIGHTS, strict=True):
        _draw_errors(axis, sections, height, white)
    below[0].set_ylabel("error, % of the peak", fontsize=8)
    handles = below[0].get_legend_handles_labels()
    parts[1].legend(*handles, loc="outside lower center", ncols=2, fontsize=8)
    return figure


def _truth(heights: np.ndarray, radii: np.ndarray) -> np.ndarray:
    return round_glow(heights[:, None] / HEIGHT_MM + 0.5, radii[None, :], RADIUS_MM)


def _draw_half(axis, heights, radii, section, white: float):
    edge = float(radii[1] - radii[0]) / 2
    extent = (0, radii[-1] + edge, heights[-1] - edge, heights[0] + edge)
    drawn = axis.imshow(section, cmap="inferno", vmin=0, vmax=white, extent=extent)
    axis.set_xlim(0, 9)
    axis.set_ylim(-14, 14)
    axis.set_xlabel("from the axis (mm)", fontsize=8)
    return drawn


def _draw_errors(axis, sections: dict[str, Section], height: float, white: float) -> None:
    """Draw what each method finds more than the truth, along the radius at a height."""
    for name, (heights, radii, section) in sections.items():
        row = int(np.argmin(np.abs(heights - height)))
        error = section[row] - _truth(heights[[row]], radii)[0]
        axis.plot(radii, 100 * error / white, linewidth=1.2, label=name)
    axis.axhline(0, color="k", linewidth=0.8)
    axis.set_xlim(0, 9)
    axis.set_ylim(-8, 8)
    axis.set_title(f"at {height:g} mm", fontsize=8)
    axis.set_xlabel("from the axis (mm)", fontsize=8)
    axis.grid(alpha=0.3)
