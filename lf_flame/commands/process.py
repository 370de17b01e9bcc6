"""The commands for long videos of light fields: process and status.

As in `lf_flame.commands.cli`, heavy modules are imported inside the commands.
"""

import re
from collections import Counter
from pathlib import Path

import click
import cloup

from lf_flame._common.printable import printable
from lf_flame.commands.flicker import SHAPE, TIMES
from lf_flame.commands.options import (
    FILE,
    FOLDER,
    PATH,
    FiniteRange,
    camera_option,
    pick,
    tell,
    tell_all,
)
from lf_flame.commands.reading_options import READING, Reading
from lf_flame.commands.tomography import BACKGROUND, DEPTHS
from lf_flame.commands.workers import WORKERS, Crew
from lf_flame.errors import InputError

NAMED = 10
"""Number of frames whose warnings are printed at once; the others are counted at the end."""

STEPS = cloup.option_group(
    "What is done with each frame",
    cloup.option(
        "--steps",
        required=True,
        help="Steps with commas between them: decode, refocus@10mm (a depth; or refocus@0.5, a "
        "slope), emission, temperature (of soot, from the emission before it), height, "
        "contour. The last two measure the image refocused before them, or the central view.",
    ),
    camera_option("; needed for depths"),
    cloup.option(
        "--noise",
        type=FiniteRange(min=0),
        help="Standard deviation of the noise of a pixel (default: measured in each frame).",
    ),
    cloup.option(
        "--strength",
        type=FiniteRange(min=0),
        help="Strength of the penalty of emission (default: chosen for the first of some "
        "frames, and again when the light changes).",
    ),
    BACKGROUND,
    cloup.option(
        "--colours",
        type=FILE,
        help="Calibration of the camera's colours, colours.toml of lf-flame calibrate-colours: "
        "emission is found in each colour of frames in colour. Needed for temperature.",
    ),
    cloup.option(
        "--soot-exponent",
        type=FiniteRange(-1, 5),
        default=1.0,
        show_default=True,
        help="Exponent a of soot's absorption, wavelength^-a, for temperature.",
    ),
    *SHAPE,
)


@cloup.command()
@click.argument("sources", nargs=-1, required=True, type=PATH, metavar="FRAMES...")
@STEPS
@TIMES
@DEPTHS
@READING
@WORKERS
@click.option("--out", type=FOLDER, required=True, help="Folder of the Zarr group to make.")
@click.option("--film", type=PATH, help="Film of the pictures with the contour: .mp4 or .gif.")
def process(
    sources, steps, camera, colours, frames_per_second, timestamps, depths, planes, out, film,
    **options,
) -> None:  # fmt: skip
    """Process every frame of a video of light fields; continues an interrupted run.

    FRAMES are light fields, each read as by `lf-flame refocus`, or one folder of them, or one
    pattern in quotes. The numbers in their names give the order; a missing number, a damaged frame,
    and one of another size or exposure than the first are named, counted, and stay gaps (NaN).

    \b
      lf-flame process raw --white white.png --frames-per-second 1000 --out flame.zarr \\
          --steps decode,refocus@0.5,height
      lf-flame process raw --white white.png --camera camera.toml --depths -12 12 4 \\
          --steps decode,refocus@0mm,height,contour,emission --out flame.zarr --film flame.mp4
      lf-flame process raw --white white.png --camera camera.toml --depths -12 12 4 \\
          --bayer rggb --colours colours.toml --steps emission,temperature --out flame.zarr
      lf-flame process raw --white white.png --steps decode,height --out flame.zarr \\
          --scheduler tcp://node1:8786

    The result is one Zarr group with named axes and a coordinate time, for xarray and others. The
    workers of a cluster must have this package and see all files under the same names. The bytes do
    not depend on the workers. `lf-flame status flame.zarr` counts what is done.
    """  # noqa: D301 - click reads the backspace
    from lf_flame._common.progress import frame_bar
    from lf_flame.calibration import read_lens
    from lf_flame.commands.frames import FrameReader, find_frames
    from lf_flame.flame_video import find_steps, process_frames
    from lf_flame.flame_video.processing.film import check_film, write_film
    from lf_flame.flame_video.processing.frames import TRIED
    from lf_flame.formats.coding import notes_on_coding
    from lf_flame.tomography.frustum_grid import planes_between

    crew, reading = pick(Crew, options), pick(Reading, options)
    lens = read_lens(camera) if camera else None
    planes = planes_between(*depths) if depths else planes
    calibration = _read_colours(colours, steps) if colours else None
    chosen = find_steps(steps, camera=lens, depths_mm=planes, colours=calibration, **options)
    check_film(film, chosen)
    paths = [path.absolute() for path in find_frames(sources, reading.files)]
    if out.absolute().parent in {path.parent for path in paths}:
        raise InputError(f"The result cannot be in the frames' own folder, {out.parent}.")
    tell_all("Note", notes_on_coding(paths[0]))
    rows, times, unit = _times(paths, frames_per_second, timestamps)
    reading = reading.for_camera(paths[0], lens)
    reader, said = FrameReader.by_first_sound(paths[:TRIED], reading), Said()
    with crew.executor() as executor:
        made = process_frames(
            rows, out, chosen, times_s=times, time_unit=unit, read=reader, camera=lens,
            workers=crew.processes, executor=executor, tell=said,
            progress=lambda finished, done, total: frame_bar(finished, total, done),
        )  # fmt: skip
    said.end()
    if film:
        write_film(out, film)
    click.echo(f"{made.describe()}; in {printable(out)}")


@cloup.command()
@click.argument("folder", type=FOLDER)
def status(folder) -> None:
    """Count the frames of a processed video that are done, missing and damaged.

    FOLDER is that of `lf-flame process`, which may be at work.
    """
    from lf_flame.flame_video import look_at

    click.echo(look_at(folder).describe())


def _read_colours(path: Path, steps: str):
    """Read the calibration of colours, and tell if temperatures rest on single wavelengths."""
    from lf_flame.tomography import read_colours
    from lf_flame.tomography.pyrometry import SINGLE_WAVELENGTHS

    if "emission" not in steps:
        raise InputError("--colours goes with the step emission, which it finds in each colour.")
    calibration = read_colours(path)
    if "temperature" in steps and calibration.responses.single_wavelengths:
        tell(f"Note: {SINGLE_WAVELENGTHS}")
    return calibration


def _times(paths: list[Path], frames_per_second: float | None, timestamps: Path | None):
    """Find frames and gaps, their times, and the unit of these."""
    from lf_flame.commands.frame_times import read_timestamps, times_by_names, with_gaps

    if timestamps is not None:
        if frames_per_second is not None:
            raise InputError("Say when the frames were taken: --frames-per-second or --timestamps.")
        return paths, read_timestamps(timestamps, len(paths)).seconds, "s"
    times = times_by_names(paths, frames_per_second or 1.0)
    if frames_per_second is None:  # by the numbers in the names
        return *with_gaps(paths, times, 1.0), "frame"
    tell_all("Note", times.notes)
    return *with_gaps(paths, times, frames_per_second), "s"


class Said:
    """Warnings on frames: each skipped frame is named, and the first frame of any other warning."""

    def __init__(self):
        self._counts: Counter[str] = Counter()

    def __call__(self, done) -> None:
        """Print the sentences on a frame, unless many like them were printed."""
        from lf_flame.flame_video.processing.result import MISSING, WHOLE

        least = 1 if done.state == WHOLE else NAMED
        said = done.said or ((f"frame {done.frame} is missing",) if done.state == MISSING else ())
        for sentence in said:
            kind = re.sub(r"-?\d[\d.e-]*", "#", sentence.partition(": ")[2] or sentence)
            self._counts[kind] += 1
            if self._counts[kind] <= least:
                tell(f"Warning: {sentence}")

    def end(self) -> None:
        """Print how often each warning was given, if more than once."""
        for kind, count in self._counts.items():
            if count > 1:
                tell(f"Warning: {count} frames: {kind}")
