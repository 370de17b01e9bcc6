"""The commands that calibrate a camera: calibrate (mm) and calibrate-colours.

As in `lf_flame.commands.cli`, heavy modules are imported inside the commands.
"""

from collections.abc import Iterator
from pathlib import Path

import click
import cloup

from lf_flame.commands.options import (
    ABOVE_0,
    FILE,
    FiniteRange,
    PlacedFile,
    command,
    flag,
    option,
    out_options,
    print_files,
    print_notes,
    report,
)
from lf_flame.commands.reading_options import READING, Reading
from lf_flame.errors import InputError


@command()
@click.argument(
    "placed",
    nargs=-1,
    required=True,
    type=PlacedFile("a light field and its depth in mm", "board.npz@-20", optional=True),
    metavar="TARGET[@DEPTH_MM]...",
)
@cloup.option_group(
    "The target",
    option("--square-mm", "Side of a square, or distance between dots.", ABOVE_0, required=True),
    option("--step-mm", "Step between targets, which are given nearest first.", ABOVE_0),
    flag("--dots", "The target is a square grid of round dots."),
    option("--lenslet-mm", "Lenslet pitch; with it, camera.toml is written too.", ABOVE_0),
    flag("--hexagonal", "The lenslets are hexagons; --lenslet-mm is their full pitch."),
    option("--focal-mm", "Focal length on the lens; adds the exit pupil to camera.toml.", ABOVE_0),
)
@READING
@out_options("calibration")
def calibrate(
    placed, square_mm, step_mm, dots, lenslet_mm, hexagonal, focal_mm, out, overwrite, **options
) -> None:
    """Measure a camera in mm, from pictures of a flat target at known depths.

    TARGET@DEPTH_MM is the picture of a checkerboard (or of dots), and its depth along the optical
    axis; choose any zero; depths increase away from the camera.

    \b
      lf-flame calibrate b1.npz@-20 b2.npz@-10 b3.npz@0 b4.npz@10 --square-mm 5
      lf-flame calibrate b1.npz b2.npz b3.npz b4.npz --step-mm 10 --square-mm 5
      lf-flame refocus flame.npz --camera calibration/calibration.toml --depth-mm 4
    \f

    Take three depths or more, better five, over the range of use, with the target parallel to
    the lens, filling the picture, its squares 6 lenslets wide or more. Neither focus nor zoom may
    change. With --step-mm the first target is the zero, and its distance from the point where the
    views meet is printed, with its error. calibration.toml contains the law of slope and scale by
    depth; the table and calibration.png show how far each target is from it.
    """  # noqa: D301 - click reads the backspace
    from tqdm import tqdm

    from lf_flame._common.atomic_files import output_folder, recorded_path
    from lf_flame.calibration import fit_targets, measure_target, output, thin_lens
    from lf_flame.calibration.fit import refuse_few_depths

    if lenslet_mm is None and (hexagonal or focal_mm is not None):
        raise InputError("--hexagonal and --focal-mm need --lenslet-mm.")
    placed = _with_depths(placed, step_mm)
    depths = [depth for _, depth in placed]
    refuse_few_depths(depths)  # before any picture is read
    reading = Reading(**options)
    with output_folder(out or Path("calibration"), output.RECORD, overwrite=overwrite) as folder:
        targets = []
        for source, depth in tqdm(placed, "calibrating", unit="target"):
            try:
                targets.append(measure_target(reading.read(source), dots=dots))
            except InputError as error:
                raise InputError(f"{source}, at {depth:g} mm: {error}") from None
        fit = fit_targets(depths, targets, square_mm=square_mm)
        facts = output.target_facts(fit, targets)
        notes, camera = output.notes(fit, facts), None
        if lenslet_mm is not None:
            try:
                camera = thin_lens(fit.law, lenslet_mm, focal_mm=focal_mm, hexagonal=hexagonal)
            except InputError as error:
                notes.append(f"{error} {output.CAMERA} is not written.")
        for one, (source, _) in zip(facts, placed, strict=True):
            one["source"] = recorded_path(source, folder.folder)
        output.write_calibration(fit, facts, folder, camera)
        folder.facts |= {
            "square_mm": square_mm,
            "step_mm": step_mm,
            "dots": dots,
            "lenslet_mm": lenslet_mm,
            "hexagonal": hexagonal,
            "focal_mm": focal_mm,
            **reading.facts(),
        }
    click.echo(output.table(facts))
    click.echo(output.summary(fit))
    print_notes("Note", notes)
    print_files(folder)


def _with_depths(
    placed: list[tuple[Path, float | None]], step_mm: float | None
) -> list[tuple[Path, float]]:
    """Find the depth of each target: the stated one, or one step more than the target before it."""
    stated = [depth is not None for _, depth in placed]
    if step_mm is not None and any(stated):
        raise InputError("Give depths (TARGET@DEPTH_MM) or --step-mm, and not both.")
    if step_mm is None and not all(stated):
        missing = placed[stated.index(False)][0]
        raise InputError(
            f"{missing} needs its depth in mm, such as {missing.name}@-20; or state --step-mm for "
            f"targets at equal steps."
        )
    return [
        (path, number * (step_mm or 0.0) if depth is None else depth)
        for number, (path, depth) in enumerate(placed)
    ]


@command("calibrate-colours")
@click.argument(
    "placed",
    nargs=-1,
    required=True,
    type=PlacedFile("a picture and its temperature in K", "f1.tif@1273"),
    metavar="PICTURE@KELVIN...",
)
@cloup.option_group(
    "The source",
    option(
        "--responses",
        "Spectral responses with lens and filters, a CSV file: a column wavelength_nm, and one "
        "for each channel, in their order.",
        FILE,
        required=True,
    ),
    option(
        "--exposure exposures",
        "Exposure of each picture, in their order, divided by that of the flame (default: 1).",
        ABOVE_0,
        multiple=True,
    ),
    option(
        "--emissivity",
        "Emissivity of the source: 1 for a furnace, less for a lamp.",
        FiniteRange(min=0, min_open=True, max=1),
        default=1.0,
    ),
)
@READING
@out_options("colours")
def calibrate_colours(placed, responses, exposures, emissivity, out, overwrite, **options) -> None:
    """Measure the gains of a camera's colours, from pictures of a furnace at known temperatures.

    PICTURE@KELVIN is a picture of the opening of a furnace (black body) or of a lamp, and its
    temperature in K. Aperture, gain and filters must be those of the flame's picture.

    \b
      lf-flame calibrate-colours f1.tif@1273 f2.tif@1473 f3.tif@1673 --responses camera.csv \\
          --bayer rggb --white white.tif --dark dark.tif
      lf-flame temperature abel/flame --colours colours/colours.toml
    \f

    Take two temperatures or more, better three, around the flame's. The source must be
    in the same place in all pictures, evenly bright, and not saturated. colours.toml contains
    gains, their errors, and the responses. The table and colours.png show how far each picture is
    from the fit; the responses must distinguish temperatures above 1,000 K.
    """  # noqa: D301 - click reads the backspace
    from lf_flame._common.atomic_files import output_folder, recorded_path
    from lf_flame.tomography import soot_output as output
    from lf_flame.tomography.colour_calibration import MOST_UNEVEN, measure_source
    from lf_flame.tomography.colour_calibration import calibrate_colours as fit_colours
    from lf_flame.tomography.pyrometry import least_temperature
    from lf_flame.tomography.spectra import read_responses

    kelvin = [temperature for _, temperature in placed]
    curves = read_responses(responses)
    if exposures and len(exposures) != len(placed):
        raise InputError(
            f"--exposure must be given once for each of the {len(placed)} pictures, or not at all, "
            f"got {len(exposures)}."
        )
    reading = Reading(**options)
    out = out or Path("colours")
    with output_folder(out, output.COLOURS_RECORD, overwrite=overwrite) as folder:
        sources = [path for path, _ in placed]
        photographs, known = zip(*_photographs(reading, sources, len(curves.names)), strict=True)
        least = least_temperature(curves)
        source = measure_source(photographs)
        for path, share in zip(sources, known, strict=True):
            if share is not None and (lost := 1 - share[source.mask].mean()) > 0.01:
                raise InputError(
                    f"{path} is saturated or unknown in {lost:.1%} of the source, more than 1 %: "
                    f"its mean would be too dark; expose less."
                )
        fit = fit_colours(
            kelvin, source.signals, curves, exposures=exposures or None, emissivity=emissivity
        )
        output.write_colours(fit, kelvin, folder)
        folder.facts |= {
            "pictures": [recorded_path(path, folder.folder) for path, _ in placed],
            "signals": source.signals.tolist(),
            "pixels": int(source.mask.sum()),
            "uneven": source.uneven,
            "exposures": list(exposures) or None,
            "emissivity": emissivity,
            "least_temperature_K": least,
            **reading.facts(),
        }
    click.echo(output.colours_table(fit, kelvin))
    click.echo(f"these colours determine temperatures of soot above {least:.0f} K")
    if source.uneven > MOST_UNEVEN:
        report(f"Warning: the averaged part of the source is uneven, by {source.uneven:.0%}.")
    if not exposures:
        report("Note: all pictures are assumed to be exposed as the flame; else give --exposure.")
    print_files(folder)


def _photographs(reading: Reading, sources: list[Path], colours: int) -> Iterator[tuple]:
    """Read pictures of one camera: the mean of the views of each, and the share that is known."""
    from tqdm import tqdm

    again = None
    for source in tqdm(sources, "reading", unit="picture"):
        if again is not None:
            light_field = again(source)
        elif reading.is_raw:
            # The lenslets of all pictures are found once, as they are of one camera.
            first = reading.find(source)
            light_field, again = first.light_field, first.again
        else:
            light_field = reading.read(source)
        if light_field.channels != colours or colours < 2:
            raise InputError(
                f"{source} must have a channel for each of the {colours} spectral responses, got "
                f"{light_field.channels}."
            )
        valid = light_field.valid
        yield light_field.photograph, None if valid is None else valid.mean(axis=(0, 1))
