"""Classical methods beside the penalised fit, on flames that share nothing with them.

The light fields are traced by `experiments.tomography.flame_rays`.
"""

import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd

from experiments.command_parts import step_bar
from experiments.report import markdown, write_report
from experiments.tomography import flame_rays as rays
from lf_flame import LightField, PlenopticCamera
from lf_flame._common.figures import subplots
from lf_flame.tomography import (
    AxisymmetricGrid,
    FrustumGrid,
    ProjectionOperator,
    Reconstruction,
    reconstruct,
    reconstruct_axisymmetric,
)
from lf_flame.tomography.iterative_methods import STEPS, iterate

CAMERA = PlenopticCamera(
    main_lens_focal_mm=150.0,
    focus_distance_mm=rays.FOCUS_MM,
    lenslet_focal_mm=rays.LENSLET_FOCAL_MM,
    lenslet_pitch_mm=rays.PITCH_MM,
    views=rays.VIEWS,
    lenslets=(rays.LENSLETS, rays.LENSLETS),
)
SHEETS_MM, VOLUME_MM = (6.0, 2.0, -2.0, -6.0), tuple(np.arange(-4.0, 4.5))
NOISES, PATIENCE = (0.01, 0.1), 300
"""Noise relative to the brightest pixel; iterations among which the best is sought."""

SAID = {
    "unexplained": "No emission at these depths",
    "close planes": "neighbouring planes are not separated",
    "stopped": "was stopped after",
    "edge": "reaches the field's edge",
}
"""Warnings, by the words that they are known by."""

METHODS = {
    "penalised": {},
    "variation": {"penalty": "variation"},
    **{name: {"method": name} for name in ("sart", "mlem", "lsqr", "nnls")},
}


@dataclass(frozen=True, eq=False)
class Case:
    """A flame, the planes on which it is sought, and the warnings that there should be."""

    name: str
    flame: rays.Flame
    planes_mm: tuple[float, ...]
    wanted: tuple[str, ...] = ()
    pitch_mm: float = rays.PITCH_MM

    @cached_property
    def views(self) -> np.ndarray:
        """Views without noise."""
        return self.flame.record(self.pitch_mm)

    def record(self, noise: float, rng: np.random.Generator) -> LightField:
        """Light field with noise."""
        drawn = rng.standard_normal(self.views.shape)
        return LightField(self.views + noise * self.views.max() * drawn)


OFF_MM = (6.6, 1.4, -2.6, -5.4)
CASES = (
    Case("sheets, on the planes", rays.sheets(SHEETS_MM), SHEETS_MM),
    Case("sheets, 0.6 mm off, moved aside", rays.sheets(OFF_MM, 0.05), SHEETS_MM, ("unexplained",)),
    Case(
        "sheets, pitch 0.5 % wrong", rays.sheets(SHEETS_MM), SHEETS_MM, ("unexplained",),
        1.005 * rays.PITCH_MM,
    ),
    Case("disc and square", rays.sharp_edges((3.0, -4.0)), (3.0, -4.0)),
    Case("hollow flame", rays.hollow(), VOLUME_MM, ("close planes",)),
    Case("elliptic flame, twice as deep", rays.elliptic(), VOLUME_MM, ("close planes",)),
    Case("Cremers and Birkebak's profile", rays.cremers(), VOLUME_MM, ("close planes",)),
)  # fmt: skip


def _error(found: np.ndarray, truth: np.ndarray) -> float:
    return float(np.linalg.norm(found - truth) / np.linalg.norm(truth))


def measure(case: Case, noise: float, rng: np.random.Generator) -> Iterator[dict]:
    """Errors of all methods on one draw of the noise."""
    light_field, truth = case.record(noise, rng), case.flame.truth(case.planes_mm)
    grid = FrustumGrid(CAMERA, case.planes_mm)
    for name, options in METHODS.items():
        began = time.perf_counter()
        found = reconstruct(light_field, grid, **options)
        seconds = time.perf_counter() - began
        error, best = _error(found.emission, truth), np.nan
        if found.iterations is not None:
            followed = _followed(name, light_field, found)
            best = min(error, *(_error(grid.crop(one), truth) for one in followed))
        yield {
            "flame": case.name,
            "noise": noise,
            "method": name,
            "error": error,
            "best": best,
            "light": float(found.emission.sum() / truth.sum() - 1),
            "iterations": np.nan if found.iterations is None else found.iterations,
            "seconds": seconds,
            "said": ", ".join(_kinds(found)),
            "wanted": ", ".join(case.wanted),
        }


def _kinds(found: Reconstruction) -> Iterator[str]:
    for warning in found.warnings:
        yield next((kind for kind, words in SAID.items() if words in warning), "other")


def _followed(name: str, light_field: LightField, found: Reconstruction) -> Iterator[np.ndarray]:
    """Cells of a method's iterations, also beyond the one at which it stopped."""
    grid, operator = found.grid, ProjectionOperator(found.grid)
    if name == "lsqr":
        for most in (1, 2, 3, 5, 8, 12, 20, 40, 80):
            done = iterate(name, operator, light_field.views, None, found.noise / 1e3, most)
            yield done.cells.reshape(grid.shape)
        return
    steps = STEPS[name](operator, light_field.views.ravel(), found.noise)
    for _, (cells, _) in zip(range(PATIENCE + 1), steps, strict=False):
        yield cells.reshape(grid.shape)


PRINTED = {
    "Nestor and Olsen": (0.0040, 0.0071),
    "Maecker": (0.0210, 0.0308),
    "Ladenburg and others": (0.0011, 0.0030),
    "Frie": (0.0008, 0.0018),
    "Cremers and Birkebak, 3rd degree": (0.0057, 0.0149),
    "Cremers and Birkebak, 4th degree": (0.0023, 0.0073),
}
"""Root-mean-square and largest error at m / 30, m = 0 to 18, by the differences that table I of
Cremers and Birkebak prints; its further lines could not be read."""

RADII = np.arange(19) / 30


def beside_print(rng: np.random.Generator) -> Iterator[dict]:
    """Errors of `reconstruct_axisymmetric` on the profile of Cremers and Birkebak, and theirs."""
    theirs = "one projection, 31 points without noise, rounded to four digits"
    for method, (rms, worst) in PRINTED.items():
        yield {"method": f"{method}, as printed", "rms": rms, "worst": worst, "differs": theirs}
    case = CASES[-1]
    grid = AxisymmetricGrid(CAMERA, axis_mm=0.0, depth_mm=0.0, radius_mm=2.6)
    for noise in (0.0, 0.01, 0.1):
        found = reconstruct_axisymmetric(case.record(noise, rng), grid)
        row = int(np.argmin(np.abs(grid.heights_mm)))
        fade = np.exp(-((grid.heights_mm[row] / rays.FADES_MM) ** 2))
        at = rays.CREMERS_RADIUS_MM * RADII
        profile = np.interp(at, grid.radii_mm, found.emission[row]) / fade
        off = profile - rays.cremers_profile(RADII)
        yield {
            "method": f"abel, noise {noise:.0%}",
            "rms": float(np.sqrt(np.mean(off**2))),
            "worst": float(np.abs(off).max()),
            "differs": f"{rays.VIEWS**2} views of a camera, "
            f"{rays.CREMERS_RADIUS_MM / grid.radii_mm[1]:.0f} pixels to its edge",
        }


LEFT_OUT = (
    "Left out, as their temperature fields could not be read whole: J. Sun and others, Optics "
    "Express 24, 1118 (2016), and ChinaXiv 201711.00595 (cylinder of radius 80 mm and height "
    "300 mm, 8 / m, 1800 sin(...) + 273.15 K, SNR of 30 and 20 dB); L. Shan and others, Acta "
    "Phys. Sin. 71, 20211421 (2022); Optics Express 29, 13094 (2021). So no figure here can be set "
    "beside one that was printed for another light-field camera."
)


def body(record: dict) -> list[str]:
    """Text and tables of a record."""
    table = pd.DataFrame(record["rows"])
    names = list(METHODS)
    shown = {"flame": ("flame", ""), "noise": ("noise", ".0%")}
    wide = [
        table.pivot_table(values, ["flame", "noise"], "method", sort=False, dropna=False)
        for values in ("error", "best", "iterations", "seconds")
    ]
    error, best, iterations, seconds = (one.reindex(columns=names).reset_index() for one in wide)
    rivals = {name: (name, ".0f") for name in names[2:]}
    plain = table[table["method"] == "penalised"]
    return [
        f"{rays.VIEWS} x {rays.VIEWS} views of {rays.LENSLETS} x {rays.LENSLETS} lenslets, traced "
        f"by rays that share nothing with the reconstruction; noise relative to the brightest "
        f"pixel, one draw. Four sheets behind each other are sought on four planes 4 mm apart, "
        f"flames that are thick in depth on nine, 1 mm apart. Errors are root-mean-square over all "
        f"cells, relative to the truth's root-mean-square. The first two methods have a penalty "
        f"(on roughness, on total variation); the others stop where the residual falls to the "
        f"measured noise. No real flame has been measured.",
        "## Error",
        markdown(error, shown | {name: (name, ".3f") for name in names}),
        f"## Least error of any iteration, up to {PATIENCE} or where it stopped",
        "A user cannot choose it without the truth; it tells what stopping costs.",
        markdown(best, shown | {name: (name, ".3f") for name in names[2:]}),
        "## Iterations, and seconds with all setting up",
        markdown(iterations, shown | rivals),
        markdown(seconds, shown | {name: (name, ".1f") for name in names}),
        "A method that was stopped after 1000 iterations says so.",
        "## Warnings of the penalised fit",
        markdown(plain, shown | {"wanted": ("should say", ""), "said": ("said", "")}),
        "## Beside printed errors",
        "A round flame of C. J. Cremers and R. C. Birkebak, Applied Optics 5, 1057 (1966), "
        "equation 13, whose largest emission is 1; errors at radii m / 30, m = 0 to 18.",
        markdown(
            record["printed"],
            {
                "method": ("method", ""),
                "rms": ("rms error", ".4f"),
                "worst": ("largest", ".4f"),
                "differs": ("what differs", ""),
            },
        ),
        LEFT_OUT,
    ]


def run_rivals(out: Path, seed: int) -> Path:
    """Measure all flames; writes ``rivals.md`` and more."""
    began, rng, rows = time.perf_counter(), np.random.default_rng(seed), []
    for case in step_bar(CASES):
        for noise in NOISES:
            rows += measure(case, noise, rng)
    record = {"rows": rows, "printed": list(beside_print(rng)), "seed": seed}
    record["wall_s"] = time.perf_counter() - began
    return write_report(
        out, "rivals", "Classical methods beside the penalised fit", record, body(record),
        tables={"rivals": pd.DataFrame(rows)}, pictures={"rivals": rivals_figure(seed)}, dpi=110,
    )  # fmt: skip


def rivals_figure(seed: int):
    """Draw a plane of the sheets, and the hollow flame along depth, by every method."""
    figure, axes = subplots(2, 1 + len(METHODS), figsize=(15, 5.6), layout="constrained")
    middle, half = rays.LENSLETS // 2, CAMERA.field_mm(0.0)[1] / 2
    for line, case in zip(axes, (CASES[0], CASES[4]), strict=True):
        light_field = case.record(NOISES[0], np.random.default_rng(seed))
        grid, truth = FrustumGrid(CAMERA, case.planes_mm), case.flame.truth(case.planes_mm)
        shown = {"truth": truth}
        for name, options in METHODS.items():
            shown[name] = reconstruct(light_field, grid, **options).emission
        deep = len(truth) > len(SHEETS_MM)
        ends = (-4.5, 4.5) if deep else (half, -half)
        for axis, (name, planes) in zip(line, shown.items(), strict=True):
            picture = planes[:, middle] if deep else planes[1]
            white = truth[:, middle].max() if deep else truth[1].max()
            extent = (-half, half, ends[1], ends[0])
            axis.imshow(picture, cmap="inferno", vmin=0, vmax=white, extent=extent)
            axis.set_title(name, fontsize=10)
            axis.tick_params(labelsize=7)
            axis.set_xlabel("across (mm)", fontsize=8)
        line[0].set_ylabel("depth (mm)" if deep else "height (mm)")
    return figure
