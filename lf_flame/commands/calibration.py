"""The command that calibrates a camera in mm: calibrate.

As in `lf_flame.commands.cli`, heavy modules are imported inside the command.
"""

from pathlib import Path

import click
import cloup

from lf_flame._common.printable import printable
from lf_flame.commands.options import FOLDER, OVERWRITE, FiniteRange, PlacedFile, tell_all
from lf_flame.commands.reading_options import READING, Reading
from lf_flame.errors import InputError


@cloup.command()
@click.argument(
    "placed",
    nargs=-1,
    required=True,
    type=PlacedFile("a light field and its depth in mm", "board.npz@-20", optional=True),
    metavar="TARGET[@DEPTH_MM]...",
)
@cloup.option(
    "--square-mm",
    type=FiniteRange(min=0, min_open=True),
    required=True,
    help="Side of a square of the checkerboard, or distance between neighbouring dots, in mm.",
)
@cloup.option(
    "--step-mm",
    type=FiniteRange(min=0, min_open=True),
    help="Distance between neighbouring targets, given in order, the nearest to the camera first, "
    "and without depths. Their distance from the camera need not be known: it is found.",
)
@cloup.option("--dots", is_flag=True, help="The target is a square grid of round dots.")
@cloup.option(
    "--lenslet-mm",
    type=FiniteRange(min=0, min_open=True),
    help="Distance between the centres of neighbouring lenslets in mm, by their maker; with it "
    "camera.toml is written too, for simulations and f-numbers.",
)
@cloup.option(
    "--focal-mm",
    type=FiniteRange(min=0, min_open=True),
    help="Focal length of the main lens, as engraved; with --lenslet-mm, camera.toml then holds "
    "where the exit pupil is (default: the aperture is in the lens).",
)
@READING
@click.option("--out", type=FOLDER, help="Folder for the files; default calibration.")
@OVERWRITE
def calibrate(
    placed, square_mm, step_mm, dots, lenslet_mm, focal_mm, out, overwrite, **options
) -> None:
    """Measure a camera in mm, by pictures of a flat target at known depths.

    TARGET@DEPTH_MM is the picture of a checkerboard (or, with --dots, of a square grid of dots),
    read as by `lf-flame refocus`, and its depth, by which the target was moved along the optical
    axis. The zero is yours, and depths increase away from the camera. Three depths are the least;
    take five or more over the range of use, with the target parallel to the lens, filling the
    picture, its squares 6 lenslets wide or more. Neither focus nor zoom may change between them.

    \b
      lf-flame calibrate b1.npz@-20 b2.npz@-10 b3.npz@0 b4.npz@10 b5.npz@20 --square-mm 5
      lf-flame calibrate raw1.png@0 raw2.png@15 raw3.png@30 --white white.png --square-mm 2
      lf-flame calibrate b1.npz b2.npz b3.npz b4.npz --step-mm 10 --square-mm 5
      lf-flame refocus flame.npz --camera calibration/calibration.toml --depth-mm 4

    With --step-mm the first target is the zero, and how far it is from the point where the views
    meet is printed, with its error. A step that is wrong makes all depths wrong by its factor.

    calibration.toml holds the law of slope and scale by depth, for --camera of refocus, view,
    flicker, reconstruct, abel and info. The table tells how far each target is from the law, and
    from the law of the others alone. calibration.png shows both, and calibration.json holds all
    numbers.
    """  # noqa: D301 - click reads the backspace
    from tqdm import tqdm

    from lf_flame._common.output_folders import output_folder, recorded_path
    from lf_flame.calibration import fit_targets, measure_target, output
    from lf_flame.calibration.fit import refuse_few_depths

    if focal_mm is not None and lenslet_mm is None:
        raise InputError("--focal-mm goes with --lenslet-mm.")
    placed = _with_depths(placed, step_mm)
    depths = [depth for _, depth in placed]
    refuse_few_depths(depths)  # before any picture is read
    reading = Reading(**options)
    out = out or Path("calibration")
    with output_folder(out, output.RECORD, overwrite=overwrite) as folder:
        targets = []
        for source, depth in tqdm(placed, "calibrating", unit="target"):
            try:
                targets.append(measure_target(reading.read(source), dots=dots))
            except InputError as error:
                raise InputError(f"{source}, at {depth:g} mm: {error}") from None
        fit = fit_targets(depths, targets, square_mm=square_mm)
        camera, why = (None, "")
        if lenslet_mm is not None:
            camera, why = output.try_thin_lens(fit, lenslet_mm, focal_mm)
        sources = [recorded_path(source, folder.folder) for source, _ in placed]
        output.write_calibration(fit, targets, depths, sources, folder, camera)
        folder.facts |= {
            "square_mm": square_mm,
            "step_mm": step_mm,
            "dots": dots,
            "lenslet_mm": lenslet_mm,
            "focal_mm": focal_mm,
            "reading": reading.given(),
        }
    click.echo(output.table(fit, depths, targets))
    click.echo(output.summary(fit))
    tell_all("Note", [*output.notes(fit, depths, targets), *([why] if why else [])])
    click.echo(f"{', '.join(folder.files)} are in {printable(folder.folder)}")


def _with_depths(
    placed: list[tuple[Path, float | None]], step_mm: float | None
) -> list[tuple[Path, float]]:
    """Give each target its depth: the stated one, or one step more than the target before it."""
    stated = [depth is not None for _, depth in placed]
    if step_mm is not None and any(stated):
        raise InputError("Give depths (TARGET@DEPTH_MM) or --step-mm, and not both.")
    if step_mm is None and not all(stated):
        missing = placed[stated.index(False)][0]
        raise InputError(
            f"{missing} needs its depth in mm, as {missing.name}@-20; or state --step-mm for "
            f"targets at equal steps."
        )
    return [
        (path, number * (step_mm or 0.0) if depth is None else depth)
        for number, (path, depth) in enumerate(placed)
    ]
