"""The command that follows a flame through a video: flicker.

As in `lf_flame.commands.cli`, heavy modules are imported inside the command.
"""

from pathlib import Path

import click
import cloup

from lf_flame._common.printable import printable
from lf_flame.commands.frames import TIMES
from lf_flame.commands.options import FOLDER, OVERWRITE, PATH, FiniteRange, camera_option, tell_all
from lf_flame.commands.reading_options import READING, Reading
from lf_flame.errors import InputError

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
        help="Size in mm of a pixel (a lenslet's image) at the flame (default: by the camera; "
        "without a camera, lengths are in pixels).",
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
    cloup.option("--slope", type=FiniteRange(), help="Refocus each light field at this slope."),
    cloup.option(
        "--depth-mm", type=float, help="Refocus each light field at this depth; needs --camera."
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
    sources, frames_per_second, timestamps, slope, depth_mm, camera, level, pixel_mm, burner_row,
    out, overwrite, **options,
) -> None:  # fmt: skip
    """Follow a flame through a video: height, contour and flicker frequency.

    SOURCE are ordinary pictures, or light fields with the options of `lf-flame refocus` (--views,
    --white ...): files, one folder of them, or one pattern in quotes; or the folder of `lf-flame
    process`. The numbers in their names give the order, and a missing number is a gap in time.
    Pictures must be linear in light and black at 0. A light field is measured in its central view,
    or, with --slope or --depth-mm, in the image refocused there, which averages the noise of all
    views. The flame is the region above a share of the peak (--level) that includes the brightest
    pixel; its height is from the bottom edge of the picture to its tip. Memory holds one frame at a
    time.

    \b
      lf-flame flicker video --frames-per-second 100 --pixel-mm 0.13
      lf-flame flicker flame.zarr
      lf-flame flicker 'video/frame*.npy' --frames-per-second 100 --slope 0.5
      lf-flame flicker video --timestamps times.csv --views 15 --camera camera.toml --depth-mm 10
      lf-flame flicker raw --white white.png --frames-per-second 100 --burner-row 250

    flame.csv has a row for each frame, flicker.png shows the heights, their spectrum and some
    contours, and flicker.json holds the frequencies, their resolution (1 / duration) and the
    probability that noise alone, white or correlated like these heights, has such a peak. If it
    is above 1 %, no frequency is reported.
    """  # noqa: D301 - click reads the backspace
    from lf_flame._common.output_folders import output_folder, recorded_path
    from lf_flame.commands.frames import find_frames
    from lf_flame.flame_video import series as output
    from lf_flame.flame_video.processing import is_video

    reading, notes = Reading(**options), []
    measures = {"level": level, "pixel_mm": pixel_mm, "burner_row": burner_row}
    if len(sources) == 1 and is_video(sources[0]):
        first = sources[0]
        given = [slope, depth_mm, camera, pixel_mm, burner_row, timestamps, *reading.given()]
        if level != 0.5 or any(x is not None for x in given):
            raise InputError(
                f"{first} is processed already: of all options, only --frames-per-second, --out "
                f"and --overwrite apply to it."
            )
        last, measured = first, lambda: output.read_series(first, frames_per_second)
    else:
        if (frames_per_second is None) == (timestamps is None):
            raise InputError(
                "Say when the frames were taken: either --frames-per-second or --timestamps FILE."
            )
        paths = find_frames(sources, reading.files)
        first, last = paths[0], paths[-1]
        focus = (slope, depth_mm, camera)
        measured, notes = _measure(paths, reading, frames_per_second, timestamps, focus, measures)
    tell_all("Note", notes)
    source = sources[0] if len(sources) == 1 and sources[0].is_dir() else first.parent
    out = out or Path("flicker") / (source.resolve().stem or "frames")
    with output_folder(out, output.RECORD, overwrite=overwrite) as folder:
        series = measured()
        found, warnings = output.write_flicker(series, folder, times_stated=timestamps is not None)
        folder.facts |= {
            "frames_per_second": frames_per_second,
            "timestamps": None if timestamps is None else str(timestamps),
            "notes": notes,
            "slope": slope,
            "depth_mm": depth_mm,
            "burner_row": burner_row,
            "first": recorded_path(first, folder.folder),
            "last": recorded_path(last, folder.folder),
            "reading": reading.given(),
        }
    tell_all("Warning", warnings)
    if found:
        click.echo(found.describe(unit=series.unit))
    click.echo(
        f"{output.TABLE}, {output.PICTURE} and {output.RECORD} are in {printable(folder.folder)}"
    )


def _measure(paths, reading: Reading, frames_per_second, timestamps, focus, measures):
    """Check options, and give a function that measures all frames, and notes."""
    from lf_flame._common.progress import bar
    from lf_flame.calibration import read_lens
    from lf_flame.commands.frames import find_times, read_frames
    from lf_flame.flame_video.flicker import LEAST_FRAMES
    from lf_flame.flame_video.series import measure_frames
    from lf_flame.flame_video.steps import find_steps
    from lf_flame.formats.coding import notes_on_coding

    slope, depth_mm, camera = focus
    if slope is not None and depth_mm is not None:
        raise InputError("Say where to focus: either --slope or --depth-mm.")
    if (camera is None) != (depth_mm is None):
        raise InputError("--depth-mm and --camera need each other.")
    lens = read_lens(camera) if camera else None
    place = f"{slope!r}" if depth_mm is None else f"{depth_mm!r}mm"
    refocused = "" if slope is None and depth_mm is None else f"refocus@{place},"
    *before, height = find_steps(f"{refocused}height", camera=lens, **measures)
    reading = reading.for_camera(paths[0], lens)
    if len(paths) < LEAST_FRAMES:
        named = paths[0] if len(paths) == 1 else f"{len(paths)} frames"
        raise InputError(f"A frequency needs {LEAST_FRAMES} frames at least, got {named}.")
    times, notes = find_times(paths, frames_per_second, timestamps)
    click.echo(f"{len(paths)} frames within {times[-1] - times[0]:.4g} s", err=True)

    def frames():
        with bar("measuring", len(paths), "frame") as shown:
            for frame in read_frames(paths, reading):
                if lens is not None:
                    lens.check_views(frame.views.shape)
                yield frame
                del frame  # or it would stay in memory while the next one is read
                shown.update()

    def measured():
        return measure_frames(frames(), [x.name for x in paths], times, height, *before)

    return measured, [*notes, *notes_on_coding(paths[0])]
