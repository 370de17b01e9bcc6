"""The refocused pictures of a light field, and their record, in a folder."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import click
import numpy as np
from PIL import Image
from scipy.signal import find_peaks
from tqdm import tqdm

from lf_flame._common import figures
from lf_flame._common.atomic_files import OutputFolder
from lf_flame.errors import InputError
from lf_flame.formats.images import to_levels, white_of, write_focal_stack, write_image
from lf_flame.lightfield import LightField
from lf_flame.refocus import all_in_focus, farthest_slope, find_sharpest_slope, refocus
from lf_flame.refocus._arguments import as_weights
from lf_flame.refocus.figures import regions_figure, search_figure, slope_map_figure, with_depth
from lf_flame.refocus.focus_map import MAP_STEPS, TRUSTED, distinct_by

RECORD = "refocus.json"

SWEEP_FRAMES = 41
"""Number of frames from one end of a sweep to the other; the movie goes there and back."""


@dataclass(frozen=True, eq=False)
class RefocusJob:
    """A light field, and the options of its refocused images.

    `options` are those of `lf_flame.refocus.refocus`; `network`, a system of `lf_flame.systems`,
    refocuses instead, from values from 0 to 1. `camera`, if known, gives the depths of slopes in
    names, figures and the record. `gain` and `gamma` are for display.
    """

    light_field: LightField
    options: dict[str, Any]
    network: Any = None
    camera: Any = None
    gain: float = 1.0
    gamma: float = 1.0

    @cached_property
    def white(self) -> float:
        """Radiance shown as white."""
        return white_of(self.light_field)

    @property
    def views_to_white(self) -> LightField:
        """Light field with values from 0 to 1, as input of networks."""
        if self.white == 1:
            return self.light_field
        return replace(self.light_field, views=self.light_field.views / np.float32(self.white))

    def preview(self, image: np.ndarray) -> np.ndarray:
        """Scale to 8-bit levels for display, ``(gain image / white) ** (1 / gamma)``, clipped.

        Images narrower than 600 pixels are enlarged by a whole factor, each pixel repeated, so that
        a screen shows them well.
        """
        shown = np.clip(image / np.float32(self.white / self.gain), 0, 1)
        levels = to_levels(shown if self.gamma == 1 else shown ** np.float32(1 / self.gamma), 8)
        times = math.ceil(600 / levels.shape[1])
        return levels.repeat(times, axis=0).repeat(times, axis=1)

    def refocus(self, slopes: Sequence[float]) -> np.ndarray:
        """Refocus at given slopes: float32, shape (n, t, s) or with a last axis of channels."""
        if self.network is None:
            return refocus(self.light_field, slopes, **self.options)
        return self.white * self.network.refocus(self.views_to_white, slopes)

    def depths(self, slopes: Sequence[float]) -> list[float | None]:
        """Find the depths of slopes; None where no layer at a finite depth has one."""
        if self.camera is None:
            return [None] * len(slopes)
        depths = self.camera.slope_to_real_depth(np.asarray(slopes, float))
        return [float(depth) if np.isfinite(depth) else None for depth in depths]

    def named(self, slope: float) -> str:
        """Slope as text, with its depth if the camera is known."""
        return with_depth(f"{slope:+.3f}", slope, self.camera)

    def check(
        self, slopes: Sequence[float], sweep: Sequence[float], slope_map: Sequence[float]
    ) -> None:
        """Refuse slopes, and ends of a sweep or a map (empty: none), that cannot be used."""
        limit = farthest_slope(self.light_field)
        wrong = [slope for slope in (*slopes, *sweep, *slope_map) if not abs(slope) <= limit]
        if wrong:
            raise InputError(
                f"Slopes must be finite and from {-limit:g} to {limit:g}, beyond which views are "
                f"shifted by more than the image, got {wrong[0]:g}."
            )
        if sweep and sweep[0] == sweep[1]:
            raise InputError(f"A sweep needs two slopes, got {sweep[0]} twice.")
        if slope_map and not slope_map[0] < slope_map[1]:
            raise InputError(
                f"A slope map needs the lower slope first, got {slope_map[0]} and {slope_map[1]}."
            )
        if self.light_field.channels not in (1, 3):
            many = self.light_field.channels
            raise InputError(f"Refocused images have 1 or 3 channels; this light field has {many}.")
        if self.network is not None:
            self.network.check(self.light_field, [*slopes, *sweep])

    def describe(self, out: OutputFolder) -> None:
        """Record the size of the light field, the options of refocusing, and levels of PNGs."""
        v, u, t, s = self.light_field.shape[:4]
        options = {name: value for name, value in self.options.items() if name != "weights"}
        out.facts |= {"views": [v, u], "lenslets": [t, s], **options}
        out.facts |= {"radiance_of_white_in_png": self.white / self.gain, "gamma": self.gamma}
        if self.network is not None:
            out.facts["network"] = self.network.name


def write_refocused(job: RefocusJob, slopes: Sequence[float], out: OutputFolder) -> None:
    """Write ``focal_stack.tif`` (float32) and ``refocused_N_slopeS.png`` for given slopes.

    With a camera, names and record contain depths too: ``refocused_N_slopeS_DEPTHmm.png``.
    """
    stack, depths = job.refocus(slopes), job.depths(slopes)
    write_focal_stack(stack, slopes, out.path("focal_stack.tif"))
    digits = len(str(len(slopes)))
    for number, (slope, depth, image) in enumerate(zip(slopes, depths, stack, strict=True), 1):
        ending = "" if depth is None else f"_{depth + 0.0:+.4g}mm"
        name = f"refocused_{number:0{digits}}_slope{slope + 0.0:+.3f}{ending}.png"
        write_image(out.path(name), job.preview(image))
    if job.camera is not None:
        out.facts["depths_mm"] = depths
    out.facts["slopes"] = [float(slope) for slope in slopes]


def write_search(job: RefocusJob, out: OutputFolder) -> float:
    """Find and print the slope of sharpest focus; write its curve as ``slope_search.png``."""
    found = find_sharpest_slope(job.light_field)
    figures.save(search_figure([found], camera=job.camera), out.path("slope_search.png"))
    out.facts["search"] = {"slope": found.slope, "confidence": found.confidence}
    named = job.named(found.slope)
    click.echo(f"sharpest at slope {named}, confidence {found.confidence:.2f}")
    if found.confidence < 0.3:
        tops, _ = find_peaks(found.sharpness, prominence=0.1 * np.ptp(found.sharpness))
        peaks = ", ".join(f"{slope:+.2f}" for slope in found.slopes[tops]) or "one peak only"
        click.echo(
            f"The slope is not certain: {found.doubt} ({peaks}). Find the slope of a part with "
            f"--region, or of each pixel with --map auto.",
            err=True,
        )
    return found.slope


def write_sweep(job: RefocusJob, ends: tuple[float, float], out: OutputFolder) -> None:
    """Write ``sweep.gif``, a movie through focus, from one slope to another and back."""
    slopes = np.linspace(*ends, SWEEP_FRAMES)
    # Slopes refocused in one call share one reading, or one transform, of the views.
    count = 1 if job.options["interpolation"] == "sinc" else SWEEP_FRAMES // 8
    first, *others = (
        Image.fromarray(job.preview(image))
        for some in tqdm(np.array_split(slopes, count), "sweeping", unit="stack")
        for image in job.refocus(some)
    )
    back = [*others, *others[-2::-1]]
    first.save(out.path("sweep.gif"), save_all=True, append_images=back, duration=83, loop=0)
    out.facts["sweep"] = list(ends)
    if job.camera is not None:
        out.facts["sweep_mm"] = job.depths(ends)


def write_slope_map(
    job: RefocusJob, ends: tuple[float, float], out: OutputFolder, auto: bool
) -> None:
    """Write ``all_in_focus`` and each pixel's slope, ``slope_map``, both as ``.tif`` and ``.png``.

    ``slope_confidence.tif`` says how certain each slope is, from 0 to 1. With a camera,
    ``depth_map.tif`` contains the depth of each pixel in mm, infinite or NaN where no layer at a
    finite depth has its slope. The share of certain pixels is printed.
    """
    slopes = np.linspace(*ends, MAP_STEPS)
    found = all_in_focus(job.light_field, slopes, **job.options)
    write_image(out.path("all_in_focus.tif"), found.all_in_focus)
    write_image(out.path("all_in_focus.png"), job.preview(found.all_in_focus))
    write_image(out.path("slope_map.tif"), found.slope.astype(np.float32))
    write_image(out.path("slope_confidence.tif"), found.confidence.astype(np.float32))
    figures.save(slope_map_figure(found, job.camera), out.path("slope_map.png"))
    out.facts["slope_map"] = list(ends)
    if job.camera is not None:
        depth = job.camera.slope_to_real_depth(found.slope)
        write_image(out.path("depth_map.tif"), depth.astype(np.float32))
        out.facts["slope_map_mm"] = job.depths(ends)
    certain = found.slope[found.confidence >= TRUSTED]
    share, span = certain.size / found.slope.size, " to ".join(map(job.named, ends))
    click.echo(f"slope map, searched from {span}: {share:.0%} of the pixels are certain")
    if share:
        most = " to ".join(map(job.named, np.percentile(certain, (5, 95))))
        click.echo(f"nine tenths of them have slopes from {most}")
    apart = distinct_by(as_weights(job.options["weights"], job.light_field))
    if not share and ends[1] - ends[0] <= apart:
        click.echo(
            f"The range must be wider than {apart:.2g}, the smallest difference of slopes that "
            f"these views distinguish, got {ends[1] - ends[0]:.2g}; --map auto finds a range.",
            err=True,
        )
    elif not share:
        click.echo(
            f"No slope is certain: there is too little texture, slopes are outside the range "
            f"({'state one: --map FROM TO' if auto else '--map auto finds a range'}), or the scene "
            f"is transparent, as flames are (lf-flame reconstruct).",
            err=True,
        )


def write_regions(
    job: RefocusJob,
    regions: Sequence[tuple[int, int, int, int]],
    background: float | None,
    out: OutputFolder,
) -> None:
    """Write ``regions.tif`` and ``.png``, and the slope of each pixel, ``regions_slope.*``.

    With a camera, the record contains the depths of the regions too.
    """
    from lf_flame.systems.region_refocus import refocus_regions

    image, surface, found = refocus_regions(
        job.views_to_white, regions, background=background, unet=job.network, **job.options
    )
    image = image * np.float32(job.white)
    write_image(out.path("regions.tif"), image)
    write_image(out.path("regions.png"), job.preview(image))
    write_image(out.path("regions_slope.tif"), surface.astype(np.float32))
    figure = regions_figure(image / job.white, surface, regions)
    figures.save(figure, out.path("regions_slope.png"))
    depths = job.depths([one.slope for one in found])
    out.facts["regions"] = [
        {"region": list(one.region), "slope": one.slope, "depth_mm": depth,
         "confidence": one.confidence}
        for one, depth in zip(found, depths, strict=True)
    ]  # fmt: skip
    some = "all that are used" if job.options["weights"] is None else "those in the aperture"
    out.facts["views_used"] = "a cross of 17" if job.network else some
    for one in found:
        click.echo(
            f"region {' '.join(map(str, one.region))}: slope {job.named(one.slope)}, confidence "
            f"{one.confidence:.2f}"
        )
