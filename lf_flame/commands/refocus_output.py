"""The refocused pictures for display, and their record, in a folder."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from lf_flame._common import figures
from lf_flame._common.output_folders import OutputFolder, output_folder, recorded_path
from lf_flame.commands.refocus_job import RefocusJob
from lf_flame.commands.refocus_options import Focus
from lf_flame.formats.images import write_image
from lf_flame.formats.movie import write_movie
from lf_flame.formats.stacks import write_focal_stack
from lf_flame.refocus import SlopeSearch, all_in_focus, find_sharpest_slope
from lf_flame.refocus.figures import regions_figure, search_figure, slope_map_figure
from lf_flame.refocus.focus_map import MAP_STEPS, TRUSTED

RECORD = "refocus.json"

SWEEP_FRAMES = 41
"""Number of frames from one end of a sweep to the other; the movie goes there and back."""


@contextmanager
def picture_folder(folder: Path, source: Path, overwrite: bool) -> Iterator[OutputFolder]:
    """Make a folder for pictures of the light field `source`, with ``refocus.json``."""
    with output_folder(folder, RECORD, overwrite=overwrite) as out:
        out.facts["source"] = recorded_path(source, folder)
        yield out


def describe_job(job: RefocusJob, out: OutputFolder) -> None:
    """Record the size of the light field, and the options of refocusing."""
    v, u, t, s = job.light_field.shape[:4]
    options = {name: value for name, value in job.options.items() if name != "weights"}
    out.facts |= {"views": [v, u], "lenslets": [t, s], **options}


def write_refocused(job: RefocusJob, slopes: Sequence[float], out: OutputFolder) -> None:
    """Write ``focal_stack.tif`` (float32) and ``refocused_N_slopeS.png`` for some slopes.

    With a camera, names and record hold depths too: ``refocused_N_slopeS_DEPTHmm.png``.
    """
    stack = job.refocus(slopes)
    write_focal_stack(stack, slopes, out.path("focal_stack.tif"))
    digits = len(str(len(slopes)))
    for number, (slope, image) in enumerate(zip(slopes, stack, strict=True), 1):
        name = f"refocused_{number:0{digits}}_slope{slope + 0.0:+.3f}{_depth_name(job, slope)}.png"
        write_image(out.path(name), job.preview(image))
    if job.camera is not None:
        out.facts["depths_mm"] = _depths(job, slopes)
    out.facts["slopes"] = [float(slope) for slope in slopes]
    out.facts["radiance_of_white_in_png"] = job.white


def _depth_name(job: RefocusJob, slope: float) -> str:
    depth = _depths(job, [slope])[0] if job.camera is not None else None
    return "" if depth is None else f"_{depth + 0.0:+.4g}mm"


def _depths(job: RefocusJob, slopes: Sequence[float]) -> list[float | None]:
    """Find the depths of slopes, for a record; None where no layer at a finite depth has one."""
    assert job.camera is not None
    depths = job.camera.slope_to_real_depth(np.asarray(slopes, float))
    return [float(depth) if np.isfinite(depth) else None for depth in depths]


def write_search(job: RefocusJob, out: OutputFolder) -> SlopeSearch:
    """Find the slope of sharpest focus; write its curve as ``slope_search.png``."""
    search = find_sharpest_slope(job.light_field)
    figures.save(search_figure([search], camera=job.camera), out.path("slope_search.png"))
    out.facts["search"] = {"slope": search.slope, "confidence": search.confidence}
    return search


def write_sweep(
    job: RefocusJob,
    ends: tuple[float, float],
    movie: str,
    out: OutputFolder,
    progress: Callable = iter,
) -> None:
    """Write a movie through focus, from one slope to another and back.

    Parameters
    ----------
    job : RefocusJob
    ends : (float, float)
        First and last slope.
    movie : str
        Name of the file, ending in .gif or .mp4.
    out : OutputFolder
    progress : callable, optional
        Wrapper of the list of groups of slopes, such as a progress bar.
    """
    slopes = np.linspace(*ends, SWEEP_FRAMES)
    # Slopes refocused in one call share one reading, or one transform, of the views.
    count = 1 if job.options.get("interpolation") == "sinc" else SWEEP_FRAMES // 8
    frames = [
        job.preview(image)
        for some in progress(np.array_split(slopes, count))
        for image in job.refocus(some)
    ]
    write_movie(out.path(movie), np.stack(frames + frames[-2:0:-1]))
    out.facts["sweep"] = list(ends)
    if job.camera is not None:
        out.facts["sweep_mm"] = _depths(job, ends)


def write_slope_map(job: RefocusJob, ends: tuple[float, float], out: OutputFolder) -> float:
    """Write ``all_in_focus.png`` and each pixel's slope, ``slope_map.tif`` and ``.png``.

    With a camera, ``depth_map.tif`` holds the depth of each pixel in mm, infinite or NaN where no
    layer at a finite depth has its slope.

    Returns
    -------
    float
        Share of the pixels whose slope is certain.
    """
    slopes = np.linspace(*ends, MAP_STEPS)
    options = {k: job.options[k] for k in ("interpolation", "weights") if k in job.options}
    found = all_in_focus(job.light_field, slopes, **options)
    write_image(out.path("all_in_focus.png"), job.preview(found.all_in_focus))
    write_image(out.path("slope_map.tif"), found.slope.astype(np.float32))
    figures.save(slope_map_figure(found, job.camera), out.path("slope_map.png"))
    out.facts["slope_map"] = list(ends)
    if job.camera is not None:
        depth = job.camera.slope_to_real_depth(found.slope)
        write_image(out.path("depth_map.tif"), depth.astype(np.float32))
        out.facts["slope_map_mm"] = _depths(job, ends)
    return float(np.mean(found.confidence >= TRUSTED))


def write_regions(job: RefocusJob, focus: Focus, out: OutputFolder) -> list[SlopeSearch]:
    """Write ``regions.tif`` and ``.png``, and the slope of each pixel, ``regions_slope.*``.

    With a camera, the record holds the depths of the regions too.
    """
    from lf_flame.systems.region_refocus import refocus_regions

    image, surface, found = refocus_regions(
        job.views_to_white, focus.regions, background=focus.background, cross=focus.cross,
        unet=job.network,
    )  # fmt: skip
    image = image * np.float32(job.white)
    write_image(out.path("regions.tif"), image)
    write_image(out.path("regions.png"), job.preview(image))
    write_image(out.path("regions_slope.tif"), surface.astype(np.float32))
    figure = regions_figure(image / job.white, surface, focus.regions)
    figures.save(figure, out.path("regions_slope.png"))
    depths: list[float | None] = [None] * len(found)
    if job.camera is not None:
        depths = _depths(job, [one.slope for one in found])
    out.facts["regions"] = [
        {"region": list(one.region), "slope": one.slope, "depth_mm": depth,
         "confidence": one.confidence}
        for one, depth in zip(found, depths, strict=True)
    ]  # fmt: skip
    out.facts["views_used"] = "a cross of 17" if focus.cross or job.network else "all"
    out.facts["radiance_of_white_in_png"] = job.white
    return found
