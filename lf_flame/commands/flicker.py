"""The command that follows a flame through a video of light fields: flicker.

As in `lf_flame.commands.cli`, heavy modules are imported inside the command.
"""

import math
from pathlib import Path

import click
import cloup

from lf_flame._common.printable import printable
from lf_flame.commands.options import (
    FILE,
    FOLDER,
    OVERWRITE,
    PATH,
    FiniteRange,
    camera_option,
    tell_all,
)
from lf_flame.commands.reading_options import READING, Reading
from lf_flame.errors import InputError

TIMES = cloup.option_group(
    "When the frames were taken",
    cloup.option(
        "--frames-per-second",
        type=FiniteRange(1e-9, 1e15),
        help="Number of frames a second, more than twice the frequency of interest; the numbers in "
        "the file names count the frames.",
    ),
    cloup.option(
        "--timestamps",
        type=FILE,
        help="File with the time of each frame in seconds, in place of --frames-per-second: one "
        "number a line, or a CSV table with a column time_s.",
    ),
)

SHAPE = (
    cloup.option(
        "--level",
        type=FiniteRange(0, 1, min_open=True, max_open=True),
        default=0.5,
        show_default=True,
        help="Brightness of the contour, relative to the peak of the frame.",
    ),
    cloup.option(
        "--pixel-mm",
        type=FiniteRange(min=0, min_open=True),
        help="Size in mm of a lenslet's image at the flame (default: by the camera; without a "
        "camera, lengths are in pixels).",
    ),
    cloup.option(
        "--burner-row",
        type=float,
        help="Row from which the height is measured; 0 is the top row (default: the bottom edge).",
    ),
)
"""Options for how a flame is measured in an image."""

MEASURES = cloup.option_group(
    "How the flame is measured",
    cloup.option("--slope", type=float, help="Refocus each frame at this slope."),
    cloup.option(
        "--depth-mm", type=float, help="Refocus each frame at this depth; needs --camera."
    ),
    camera_option("; lengths are then in mm"),
    *SHAPE,
)


@cloup.command()
@click.argument("sources", nargs=-1, required=True, type=PATH, metavar="SOURCE...")
@TIMES
@MEASURES
@READING
@click.option("--out", type=FOLDER, help="Folder for the files; default flicker/NAME.")
@OVERWRITE
def flicker(
    sources, frames_per_second, timestamps, slope, depth_mm, camera, out, overwrite, **options
) -> None:
    """Follow a flame through a video of light fields: height, contour and flicker frequency.

    SOURCE are light fields, each read as by `lf-flame refocus`, or one folder of them, or one
    pattern in quotes. The numbers in their names give the order, and a missing number is a gap in
    time. Pictures must be linear in light and black at 0. Each frame is measured in its central
    view, or, with --slope or --depth-mm, in the image refocused there, which averages the noise of
    all views. The flame is the region above a share of the peak (--level) that includes the
    brightest pixel; its height is from the bottom edge of the picture to its tip. Memory holds one
    frame at a time.

    \b
      lf-flame flicker video --frames-per-second 100
      lf-flame flicker 'video/frame*.npy' --frames-per-second 100 --slope 0.5 --pixel-mm 0.13
      lf-flame flicker video --frames-per-second 100 --camera camera.toml --depth-mm 10
      lf-flame flicker video --timestamps times.csv
      lf-flame flicker raw --white white.png --frames-per-second 100 --burner-row 250

    flame.csv has a row for each frame, flicker.png shows the heights, their spectrum and some
    contours, and flicker.json holds the frequencies, their resolution (1 / duration) and the
    probability that noise alone, white or correlated like these heights, has such a peak. If it
    is above 1 %, no frequency is reported.
    """  # noqa: D301 - click reads the backspace
    from lf_flame._common.output_folders import output_folder, recorded_path
    from lf_flame._common.progress import frame_bar
    from lf_flame.calibration import read_lens
    from lf_flame.commands.frames import find_frames, read_frames
    from lf_flame.flame_video import output
    from lf_flame.flame_video.flame_series import measure_frames
    from lf_flame.formats.coding import notes_on_coding

    _check_rate(frames_per_second, timestamps)
    lens = _checked_lens(read_lens(camera) if camera else None, slope, depth_mm)
    names = ("level", "pixel_mm", "burner_row")
    asked = {name: options.pop(name) for name in names}
    measures = _measures(lens, slope, depth_mm, **asked)
    paths = find_frames(sources, Reading(**options).files)
    reading = Reading(**options).for_camera(paths[0], lens)
    _refuse_few(paths)
    times = _times(paths, frames_per_second, timestamps)
    source = sources[0] if len(sources) == 1 and sources[0].is_dir() else paths[0].parent
    out = out or Path("flicker") / (source.resolve().name or "frames")
    with output_folder(out, output.RECORD, overwrite=overwrite) as folder:
        frames = _checked_frames(read_frames(paths, reading), lens, measures.slope)
        series = measure_frames(
            paths,
            frames,
            measures,
            times.seconds,
            folder.path(output.TABLE),
            lambda images: frame_bar(images, len(paths)),
        )
        found, warnings = output.write_flicker(
            series, measures, folder, times_stated=timestamps is not None
        )
        notes = [*times.notes, *notes_on_coding(paths[0])]
        folder.facts |= {
            "frames_per_second": frames_per_second,
            "timestamps": None if timestamps is None else str(timestamps),
            "notes": notes,
            "depth_mm": depth_mm,
            "first": recorded_path(paths[0], folder.folder),
            "last": recorded_path(paths[-1], folder.folder),
            "reading": reading.given(),
        }
    tell_all("Note", notes)
    tell_all("Warning", warnings)
    if found:
        click.echo(found.describe(unit=measures.unit))
    click.echo(
        f"{output.TABLE}, {output.PICTURE} and {output.RECORD} are in {printable(folder.folder)}"
    )


def _check_rate(frames_per_second: float | None, timestamps: Path | None) -> None:
    if (frames_per_second is None) == (timestamps is None):
        raise InputError(
            "Say when the frames were taken: either --frames-per-second or --timestamps FILE."
        )


def _times(paths: list[Path], frames_per_second: float | None, timestamps: Path):
    """Find the times of the frames, and print their number and duration."""
    from lf_flame.commands.frame_times import read_timestamps, times_by_names

    if frames_per_second is not None:
        times = times_by_names(paths, frames_per_second)
    else:
        times = read_timestamps(timestamps, len(paths))
    duration = times.seconds[-1] - times.seconds[0]
    click.echo(f"{len(paths)} frames within {duration:.4g} s", err=True)
    return times


def _checked_lens(lens, slope: float | None, depth_mm: float | None):
    """Refuse combinations of options that have no meaning."""
    if slope is not None and depth_mm is not None:
        raise InputError("Say where to focus: either --slope or --depth-mm.")
    if (lens is None) != (depth_mm is None):
        raise InputError("--depth-mm and --camera need each other.")
    if slope is not None and not math.isfinite(slope):
        raise InputError(f"--slope must be finite, got {slope}.")
    return lens


def _measures(lens, slope: float | None, depth_mm: float | None, **asked):
    """Choose slope and pixel size from the options."""
    from lf_flame.flame_video.flame_series import Measures
    from lf_flame.flame_video.flame_shape import check_measures

    if lens is not None:
        lens.check_depths(depth_mm)
        slope = float(lens.depth_to_slope(depth_mm))
        if asked["pixel_mm"] is None:
            asked["pixel_mm"] = lens.field_mm(depth_mm)[0] / lens.lenslets[0]
    check_measures(asked["level"], 1.0 if asked["pixel_mm"] is None else asked["pixel_mm"])
    return Measures(slope, **asked)


def _refuse_few(paths: list[Path]) -> None:
    """Refuse too few frames before any is read."""
    from lf_flame.flame_video.flicker import LEAST_FRAMES

    if len(paths) < LEAST_FRAMES:
        named = paths[0] if len(paths) == 1 else f"{len(paths)} frames"
        raise InputError(f"A frequency needs {LEAST_FRAMES} frames at least, got {named}.")


def _checked_frames(frames, lens, slope: float | None):
    """Check that each light field is the camera's and large enough for the slope; yield it."""
    from lf_flame.refocus import farthest_slope

    for light_field in frames:
        if lens is not None:
            lens.check_views(light_field.views.shape)
        limit = farthest_slope(light_field)
        if slope is not None and not abs(slope) <= limit:
            raise InputError(
                f"The slope must lie from {-limit:g} to {limit:g}, beyond which views are shifted "
                f"by more than the image, got {slope:g}."
            )
        yield light_field
        del light_field
