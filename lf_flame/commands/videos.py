"""The commands for videos: flicker and process.

As in `lf_flame.commands.cli`, heavy modules are imported inside the commands.
"""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import click
import cloup
from click.core import ParameterSource

from lf_flame._common import progress
from lf_flame._common.input_files import printable
from lf_flame.commands.emission import DEPTHS, fit_options
from lf_flame.commands.options import (
    ABOVE_0,
    FOLDER,
    PATH,
    WORKERS,
    FiniteRange,
    WorkerOptions,
    camera_option,
    command,
    open_lens,
    option,
    out_options,
    pick,
    print_files,
    print_notes,
    report,
    result_name,
)
from lf_flame.commands.reading_options import READING, Reading, note_on_pixels
from lf_flame.errors import InputError

RATE = option("--frames-per-second", "Frames per second.", FiniteRange(1e-9, 1e15), metavar="RATE")

SHAPE = (
    option(
        "--level",
        "Brightness of the contour, relative to the peak of the frame.",
        FiniteRange(0, 1, min_open=True, max_open=True),
        default=0.5,
        rare=True,
    ),
    option("--pixel-mm", "Size in mm of a pixel at the flame.", ABOVE_0),
    option(
        "--burner-row",
        "Row from which the height is measured; 0 is the top row (default: the bottom edge).",
        float,
        rare=True,
    ),
)
"""Options for how a flame is measured in an image."""

MEASURES = cloup.option_group(
    "How the flame is measured",
    option("--slope", "Refocus each light field at this slope.", float),
    option("--depth-mm", "Refocus at this depth; needs --camera.", float),
    camera_option(),
    *SHAPE,
)

STEPS = cloup.option_group(
    "What is done with each frame",
    option("--steps", "Steps in order, such as refocus@10mm,height.", required=True),
    camera_option(),
    *fit_options(rare=True),
    *SHAPE,
)

NEEDED = dict.fromkeys(
    ("depths", "planes", "block", "noise", "strength", "background"), "emission"
) | dict.fromkeys(("level", "pixel_mm", "burner_row"), "height")
"""Step of `process` that each option is for."""


@command()
@click.argument("sources", nargs=-1, required=True, type=PATH, metavar="SOURCE...")
@RATE
@MEASURES
@READING
@out_options("flicker/NAME")
def flicker(
    sources, frames_per_second, slope, depth_mm, camera, level, pixel_mm, burner_row,
    out, overwrite, **options,
) -> None:  # fmt: skip
    """Follow a flame through a video: height and flicker frequency.

    SOURCE are still pictures, or light fields with the options of `lf-flame refocus`: files, or one
    folder of them, but no film files; or the result of `lf-flame process`.

    \b
      lf-flame flicker video --frames-per-second 100 --pixel-mm 0.13
      lf-flame flicker flame.zarr
      lf-flame flicker video --frames-per-second 100 --views 15 --camera camera.toml --depth-mm 10
    \f

    The numbers in the names give the order, and a missing number is a gap in time. Pictures must be
    linear in light and black at 0. A light field is measured in its central view, or in the image
    that is refocused by --slope or --depth-mm. The flame is the largest region above a share of the
    peak (--level); its height is from the bottom edge to its tip. flicker.json contains the
    frequency, its resolution (1 / duration) and the probability that noise alone has such a peak;
    if it is above 1 %, no frequency is reported.
    """  # noqa: D301 - click reads the backspace
    from lf_flame._common.atomic_files import output_folder, recorded_path
    from lf_flame.flame_video import find_steps
    from lf_flame.flame_video.flicker import LEAST_FRAMES
    from lf_flame.flame_video.frames import RECORD, find_frames, write_flicker
    from lf_flame.flame_video.processing import is_video
    from lf_flame.flame_video.steps import Refocus

    reading, done = Reading(**options), len(sources) == 1 and is_video(sources[0])
    given = [slope, depth_mm, camera, pixel_mm, burner_row, *reading.given()]
    if done and (level != 0.5 or any(x is not None for x in given)):
        raise InputError(
            f"{sources[0]} is already processed: only --frames-per-second, --out and "
            f"--overwrite apply to it."
        )
    if not done and frames_per_second is None:
        raise InputError("State when the frames were taken: --frames-per-second.")
    if slope is not None and depth_mm is not None:
        raise InputError("State where to focus: either --slope or --depth-mm.")
    if (camera is None) != (depth_mm is None):
        raise InputError("--depth-mm and --camera need each other.")
    lens = open_lens(camera)
    place = f"{slope!r}" if depth_mm is None else f"{depth_mm!r}mm"
    names = "height" if slope is depth_mm is None else f"refocus@{place},height"
    measures = {"level": level, "pixel_mm": pixel_mm, "burner_row": burner_row}
    steps = find_steps(names, camera=lens, **measures)
    paths = sources if done else find_frames(sources, (reading.white, reading.dark))
    if not done and len(paths) < LEAST_FRAMES:
        named = paths[0] if len(paths) == 1 else f"{len(paths)} frames"
        raise InputError(f"A frequency needs at least {LEAST_FRAMES} frames, got {named}.")
    source = sources[0] if len(sources) == 1 and sources[0].is_dir() else paths[0].parent
    out = out or Path("flicker") / result_name(source)
    if not done:
        refuse_among_frames(out, sources, ())
        steps = tuple(replace(x, kept=False) if isinstance(x, Refocus) else x for x in steps)
    with output_folder(out, RECORD, overwrite=overwrite) as folder, TemporaryDirectory() as beside:
        notes = []
        if done:
            found, warnings = write_flicker(sources[0], folder, frames_per_second=frames_per_second)
        else:
            made = Path(beside) / "frames.zarr"
            one = WorkerOptions(workers=1)
            _, notes = _process(paths, reading, lens, steps, frames_per_second, made, one)
            found, warnings = write_flicker(made, folder)
        folder.facts |= {
            **reading.facts(),
            "frames_per_second": frames_per_second,
            "notes": notes,
            "slope": slope,
            "depth_mm": depth_mm,
            "burner_row": burner_row,
            "first": recorded_path(paths[0], folder.folder),
            "last": recorded_path(paths[-1], folder.folder),
        }
    print_notes("Warning", warnings)
    if found:
        click.echo(found)
    print_files(folder)


@command()
@click.argument("sources", nargs=-1, required=True, type=PATH, metavar="FRAMES...")
@STEPS
@RATE
@DEPTHS
@READING
@WORKERS
@option("--out", "Folder of the Zarr group to make.", FOLDER, required=True)
def process(sources, steps, camera, frames_per_second, depths, planes, out, **options) -> None:
    """Process every frame of a video of light fields; resumes an interrupted run.

    FRAMES are pictures, or light fields with the options of `lf-flame refocus`: files, or one
    folder of them. Steps are refocus@10mm (or refocus@0.5, a slope), emission and height; decode
    alone keeps the light fields.

    \b
      lf-flame process raw --white white.png --camera camera.toml --depths -12 12 4 \\
          --steps refocus@0mm,height,emission --out flame.zarr
    \f

    \b
      lf-flame process raw --white white.png --frames-per-second 1000 --out flame.zarr \\
          --steps refocus@0.5,height

    height, with contour, width, area and brightness, measures the image refocused before it, or the
    central view. With --strength, a fit of the emission starts from that of the frame before, in a
    third of the time. A missing number in the names, a damaged frame, and one of another size than
    the first are named, counted, and stay gaps (NaN). The result is one Zarr group with named axes,
    for xarray and others. The workers of a cluster must have this package and see all files under
    the same names; the bytes do not depend on the workers.
    """  # noqa: D301 - click reads the backspace
    from lf_flame.flame_video import find_steps
    from lf_flame.flame_video.frames import find_frames
    from lf_flame.tomography.frustum_grid import planes_between

    crew, reading = pick(WorkerOptions, options), pick(Reading, options)
    lens = open_lens(camera)
    if depths and planes:
        raise InputError("State the planes: either --depths FROM TO STEP or --depth-mm.")
    planes = planes_between(*depths) if depths else planes
    context = click.get_current_context()
    for one in context.command.params:
        needed, given = NEEDED.get(one.name or ""), context.get_parameter_source(one.name or "")
        if needed and needed not in steps and given is not ParameterSource.DEFAULT:
            raise InputError(f"{one.opts[0]} needs the step {needed}.")
    chosen = find_steps(steps, camera=lens, depths_mm=planes, **options)
    paths = find_frames(sources, (reading.white, reading.dark))
    refuse_among_frames(out, sources, paths)
    old = "; made before, remove it to process the frames anew" if out.exists() else ""
    made, _ = _process(paths, reading, lens, chosen, frames_per_second, out, crew)
    click.echo(f"{made.describe()}; in {printable(out)}{old}")


def _process(
    paths, reading: Reading, lens, steps, rate: float | None, out: Path, crew: WorkerOptions
):
    """Process frames into a Zarr group; return counts of frames, and notes, which are printed."""
    from lf_flame.flame_video import process_frames
    from lf_flame.flame_video.frames import FrameReader, find_times

    paths = [path.absolute() for path in paths]
    rows, times, notes = find_times(paths, rate or 1.0)
    reading = reading.for_camera(paths[0], lens)
    # Workers may run in other folders.
    files = {name: x.absolute() for name, x in reading.stated.items() if isinstance(x, Path)}
    with progress.stage(f"Reading {printable(paths[0])}"):
        reader, said = FrameReader(paths[0], reading.stated | files), FrameWarnings()
        found = reader.notes
    reading.orders.append(reader.order)
    notes = [*filter(None, [reader.coded]), *notes]
    print_notes("Note", notes)
    on_camera = [] if lens is None else note_on_pixels(lens, reader.shape)
    for line in (*found, *on_camera):
        report(printable(line, 600))
    with crew.executor() as executor:
        made = process_frames(
            rows, out, steps, times_s=times, time_unit="s" if rate else "frame", read=reader,
            camera=lens, workers=crew.processes, executor=executor, on_frame=said,
        )  # fmt: skip
    said.end()
    return made, notes


def refuse_among_frames(out: Path, sources: Sequence[Path], frames: Sequence[Path]) -> None:
    """Refuse a result beside the frames, or anywhere in a folder of which all files are frames."""
    around = {path.resolve() for path in sources if path.is_dir()} & set(out.resolve().parents)
    if around or out.absolute().parent in {path.absolute().parent for path in frames}:
        raise InputError(f"The result cannot be in the frames' own folder, got {out} (--out).")


class FrameWarnings:
    """Warnings on frames: the first ten skipped frames, and the first frame of any other warning.

    All are counted at the end.
    """

    def __init__(self):
        self._counts: Counter[str] = Counter()

    def __call__(self, done) -> None:
        """Print the sentences on a frame, unless many like them were printed."""
        from lf_flame.flame_video.processing import MISSING, WHOLE

        least = 1 if done.state == WHOLE else 10
        said = done.said or ((f"frame {done.frame} is missing",) if done.state == MISSING else ())
        for sentence in said:
            kind = re.sub(r"-?\d[\d.e-]*", "#", sentence.partition(": ")[2] or sentence)
            self._counts[kind] += 1
            if self._counts[kind] <= least:
                report(f"Warning: {sentence}")

    def end(self) -> None:
        """Print how often each warning was given, if more than once."""
        for kind, count in self._counts.items():
            if count > 1:
                report(f"Warning: {count} frames: {kind}")
