"""The commands that find emission: resolution, reconstruct (by depth) and abel (axisymmetric).

As in `lf_flame.commands.cli`, heavy modules are imported inside the commands.
"""

import secrets
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import cloup

from lf_flame._common.printable import printable
from lf_flame.commands.options import (
    FILE,
    FOLDER,
    OVERWRITE,
    PATH,
    SEED,
    FiniteRange,
    camera_option,
    pick,
    tell_all,
)
from lf_flame.commands.reading_options import READING, Reading
from lf_flame.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from lf_flame.lightfield import LightField
    from lf_flame.optics.lens import Lens
    from lf_flame.tomography import AxisymmetricGrid, ColourCalibration, FrustumGrid

PERIODS_MM = (0.5, 1.0, 2.0, 5.0, 10.0)
"""Lateral periods in mm of the table if none is given."""


def _read_camera(path: Path | None) -> "Lens":
    from lf_flame.calibration import read_lens
    from lf_flame.optics.camera import PAPER_CAMERA

    return read_lens(path) if path else PAPER_CAMERA


@cloup.command()
@camera_option()
@click.option(
    "--thickness",
    "thickness_mm",
    type=FiniteRange(min=0, min_open=True),
    default=30.0,
    show_default=True,
    help="Extent in depth of the region that may emit, in mm.",
)
@click.option(
    "--period",
    "periods",
    multiple=True,
    type=FiniteRange(min=0, min_open=True),
    help="Lateral period of detail, in mm; may be repeated.",
)
@click.option("--figure", type=PATH, help="PNG of the blur and of the singular values.")
def resolution(camera, thickness_mm, periods, figure) -> None:
    """Print what one light field can resolve in depth, and what it cannot.

    A camera sees the scene within the angle of its aperture, so fine detail has a depth and an even
    glow has none. Without --camera, the paper's camera is used.
    """
    import numpy as np
    from tabulate import tabulate

    from lf_flame.tomography.data_checks import NO_DEPTH
    from lf_flame.tomography.resolution import (
        angular_width,
        depth_blur,
        depth_modes,
        finest_period,
    )

    chosen = _read_camera(camera)
    finest = finest_period(chosen)
    if periods and min(periods) < finest:
        raise InputError(
            f"--period must be at least {finest:.3g} mm, the finest detail of this camera (two "
            f"pixels), got {min(periods):g}."
        )
    periods = periods or (float(f"{finest:.3g}"), *(one for one in PERIODS_MM if one > finest))
    if figure and figure.suffix.lower() != ".png":
        raise InputError(f"--figure must end in .png, got {figure}.")
    if camera is None:
        click.echo("The paper's camera; --camera takes yours.")
    width = angular_width(chosen)
    rows = [
        (f"{period:g}", f"{depth_blur(chosen, period):.3g}",
         f"{depth_modes(chosen, period, thickness_mm):.1f}")
        for period in periods
    ]  # fmt: skip
    heads = "lateral period (mm)", "blur in depth (mm)", f"values in {thickness_mm:g} mm of depth"
    table = tabulate(rows, headers=heads, tablefmt="simple", disable_numparse=True)
    click.echo(
        f"{NO_DEPTH}.\nThe views span {width:.4f} rad ({np.degrees(width):.1f} degrees), seen from "
        f"the focal plane.\nDetail is blurred in depth over its lateral period divided by that: "
        f"{thickness_mm:g} mm of depth are resolved for periods\nbelow {thickness_mm * width:.3g} "
        f"mm, and have one value for larger ones.\n\n{table}"
    )
    if figure:
        from lf_flame._common import figures
        from lf_flame.tomography.figures import resolution_figure

        figures.save(resolution_figure(chosen, thickness_mm, periods), figure)
        click.echo(f"\n{figure} is written")


DEPTHS = cloup.option_group(
    "Where emission is sought",
    cloup.option(
        "--depths",
        nargs=3,
        type=float,
        metavar="FROM TO STEP",
        help="Evenly spaced depth planes, both ends included, in mm from the focal plane, or "
        "from the zero of a calibration.",
    ),
    cloup.option(
        "--depth-mm",
        "planes",
        multiple=True,
        type=float,
        help="Depth of one depth plane, in mm; may be repeated. For known depths.",
    ),
    cloup.option(
        "--block",
        type=click.IntRange(min=1),
        default=1,
        show_default=True,
        help="Number of lenslets along each axis that make one pixel. More: less noise, memory and "
        "time.",
    ),
)

AXIS = cloup.option_group(
    "Where the flame is",
    camera_option(required=True),
    cloup.option(
        "--axis-mm",
        type=float,
        help="Position of the axis across, in mm from the optical axis (default: found).",
    ),
    cloup.option(
        "--axis-depth",
        type=float,
        help="Depth of the axis, in mm from the focal plane, or from the zero of a calibration "
        "(default: found; required for a single picture).",
    ),
    cloup.option(
        "--radius",
        type=float,
        help="Radius in mm beyond which there is no emission (default: found from the light).",
    ),
    cloup.option(
        "--burner",
        type=float,
        help="Height in mm, upwards from the optical axis, below which there is no emission.",
    ),
    cloup.option(
        "--block",
        type=click.IntRange(min=1),
        default=1,
        show_default=True,
        help="Number of lenslets along each axis that make one pixel.",
    ),
    cloup.option("--central", is_flag=True, help="Use the central view alone."),
)

BACKGROUND = cloup.option(
    "--background",
    type=click.Choice(["fit", "none"]),
    default="fit",
    show_default=True,
    help="fit: subtract an even background of unknown level, measured in the pixels that no "
    "emission reaches, if there are any; none: black is at 0.",
)

FITTING = (
    cloup.option(
        "--noise",
        type=FiniteRange(min=0, min_open=True),
        help="Standard deviation of the noise of a pixel (default: measured).",
    ),
    cloup.option(
        "--strength",
        type=FiniteRange(min=0, min_open=True),
        help="Strength of the penalty on roughness (default: chosen from the noise).",
    ),
    BACKGROUND,
    cloup.option(
        "--bootstrap",
        type=click.IntRange(min=0),
        default=20,
        show_default=True,
        help="Number of bootstrap draws (new noise, fitted again) for the error bars; 0: none.",
    ),
    cloup.option("--seed", type=SEED, default=0, show_default=True, help="Seed of those draws."),
    cloup.option(
        "--colours",
        type=FILE,
        help="Calibration of the camera's colours, colours.toml of lf-flame calibrate-colours. "
        "SOURCE is in colour then; each colour is fitted, the soot's own absorption is corrected, "
        "and FOLDER gets a folder for each.",
    ),
    cloup.option(
        "--thin",
        is_flag=True,
        help="With --colours: take the flame for optically thin, as with a calibration whose gains "
        "are not absolute.",
    ),
    cloup.option(
        "--soot-exponent",
        type=float,
        help="With --colours: exponent a of soot's absorption, wavelength^-a, from -1 to 5 "
        "(default: 1).",
    ),
)


@cloup.command()
@click.argument("source", type=PATH)
@DEPTHS
@cloup.option_group(
    "How it is fitted",
    camera_option(),
    cloup.option(
        "--optical-thickness",
        metavar="T",
        help="Absorption by the flame itself, known from elsewhere: a light field does not show "
        "it. A TIFF holds the optical thickness of each depth plane, pixel by pixel. A number is "
        "the total along every line of sight, spread evenly over the planes, as in an even smoke "
        "that fills the field; a flame that does not fill the field gets too bright edges. "
        "Default: no absorption.",
    ),
    *FITTING,
)
@READING
@click.option("--out", type=FOLDER, help="Folder for the files; default reconstructed/SOURCE.")
@OVERWRITE
def reconstruct(source, depths, planes, block, camera, optical_thickness, **options) -> None:
    """A light field gives almost no depth information for a smooth flame.

    Find the emission at each depth that explains a light field of a flame. Refocused images do not
    show it: each holds the blurred light of all other depths. Detail is blurred in depth over its
    period divided by the angle of the aperture; `lf-flame resolution` prints the period in mm that
    your camera resolves. SOURCE is read as by `lf-flame refocus`; it must be grey, linear in light,
    divided by a white image, and its camera known.

    \b
      lf-flame simulate flames.toml
      lf-flame reconstruct simulated/flames/light_field.npz \\
          --camera simulated/flames/simulation.json --depth-mm 20 --depth-mm 10 --depth-mm 0
      lf-flame reconstruct raw.png --white white.png --camera camera.toml --depths -12 12 2
      lf-flame reconstruct flame.npy --camera camera.toml --depths -12 12 2 \\
          --optical-thickness tau.tif
    """  # noqa: D301, D401 - click reads the backspace; the first line is the finding
    import numpy as np

    from lf_flame.tomography import FrustumGrid
    from lf_flame.tomography.frustum_grid import planes_between

    if bool(depths) == bool(planes):
        raise InputError(
            "Say where emission is sought: either --depths FROM TO STEP or --depth-mm."
        )
    grid = FrustumGrid(_read_camera(camera), planes_between(*depths) if depths else planes, block)
    if options["colours"] and optical_thickness is not None:
        raise InputError("--optical-thickness does not apply with --colours, which finds it.")
    thickness = None if optical_thickness is None else read_thickness(optical_thickness)
    job = _Job.begun(source, Path("reconstructed"), options)
    job.options["optical_thickness"] = thickness
    planes_of = thickness if isinstance(thickness, float | None) else thickness.sum(axis=0)
    greatest = None if planes_of is None else float(np.max(planes_of))
    job.facts |= {"optical_thickness": optical_thickness, "greatest_optical_thickness": greatest}
    light_field, lens = job.reading.read_of_camera(source, grid.camera if camera else None)
    job.find(light_field, grid if lens is None else replace(grid, camera=lens))


@cloup.command()
@click.argument("source", type=PATH)
@AXIS
@cloup.option_group("How it is fitted", *FITTING)
@READING
@click.option("--out", type=FOLDER, help="Folder for the files; default abel/SOURCE.")
@OVERWRITE
def abel(source, camera, axis_mm, axis_depth, radius, burner, block, central, **options) -> None:
    """Find the emission of an axisymmetric flame with an upright axis.

    It is an Abel inversion from all views of a light field at once, along the camera's rays,
    without negative emission. SOURCE is read as by `lf-flame refocus`; it must be grey, linear in
    light, and divided by a white image. For other flames use `lf-flame reconstruct`.

    The assumptions are checked on the light field. A warning is printed if the axis leans, is not
    straight or is at another place, if there is light outside the radius, if the halves differ, or
    if the flame is deeper than wide. The last, and a lean in depth, are visible only by parallax; a
    note says if noise, a small aperture or a single view would hide them.

    One picture of an ordinary camera is enough, with --axis-depth and a camera file that says
    views = 1, the pixel pitch as lenslet pitch, and that pitch times the f-number (image distance
    over aperture) as lenslet focal length.

    \b
      lf-flame abel flame.npz --camera camera.toml
      lf-flame abel raw.png --white white.png --camera camera.toml --burner -12.5 --radius 10
      lf-flame abel photograph.png --camera one_view.toml --axis-depth 0
      lf-flame abel raw.tif --bayer rggb --white white.tif --camera camera.toml \\
          --colours colours.toml
    """  # noqa: D301 - click reads the backspace
    from lf_flame.tomography import AxisymmetricGrid, find_axis

    lens = _read_camera(camera)
    if radius is not None and not 0 < radius <= lens.focus_distance_mm:
        raise InputError(
            f"--radius must be above 0 and at most the camera's focus distance, "
            f"{lens.focus_distance_mm:g} mm, got {radius:g}."
        )
    job = _Job.begun(source, Path("abel"), options)
    light_field, lens = _read_views(source, job.reading, lens)
    columns = light_field.views.shape[1]
    if columns < 3 and axis_depth is None:
        raise InputError(
            f"{source} holds {columns} view columns, which do not show the axis' depth: state it, "
            f"--axis-depth."
        )
    grey = light_field if job.calibration is None else light_field.grey()
    axis = find_axis(grey, lens, None if columns >= 3 else axis_depth)
    job.find(
        light_field,
        AxisymmetricGrid(
            lens,
            axis.across_mm if axis_mm is None else axis_mm,
            axis.depth_mm if axis_depth is None else axis_depth,
            axis.radius_mm if radius is None else radius,
            block,
            "central" if central else "all",
            burner,
        ),
    )


def _read_views(source: Path, reading: Reading, lens: "Lens") -> "tuple[LightField, Lens]":
    """Read a light field of a camera, or any picture if the camera has a single view."""
    from lf_flame.formats.view_files.folder import is_view_folder

    if lens.views == 1 and reading == Reading() and not is_view_folder(source):
        reading = Reading(views=1)
    return reading.read_of_camera(source, lens)  # type: ignore[return-value]


def read_thickness(given: str) -> "float | np.ndarray":
    """Read an optical thickness: a number, or a TIFF file of planes (planes, rows, columns)."""
    from lf_flame._common.images import TIFF_SUFFIXES, read_tiff

    try:
        return float(given)
    except ValueError:
        path = Path(given)
    if path.suffix.lower() not in TIFF_SUFFIXES:
        raise InputError(f"--optical-thickness must be a number or a TIFF file, got {given}.")
    stack = read_tiff(path)
    if stack.dtype.kind != "f" or stack.ndim < 2:
        raise InputError(
            f"{path} must hold planes of optical thickness as floating-point numbers, got "
            f"{stack.dtype} of shape {stack.shape}."
        )
    return stack.reshape(-1, *stack.shape[-2:])


@dataclass
class _Job:
    """Search for emission in a light field, in grey light or in each colour of a calibration."""

    source: Path
    out: Path
    overwrite: bool
    reading: Reading
    calibration: "ColourCalibration | None"
    soot: dict[str, Any]
    options: dict[str, Any]
    facts: dict[str, Any]

    @classmethod
    def begun(cls, source: Path, folder: Path, options: dict[str, Any]) -> "_Job":
        """Check the options and folders, as reading and compiling are slow; print first notes."""
        from lf_flame._common.output_folders import refuse_folder
        from lf_flame.formats.coding import notes_on_coding
        from lf_flame.tomography.emission_folder import RECORD
        from lf_flame.tomography.fit import FitOptions, check_bootstrap

        FitOptions(options["noise"], options["strength"])
        check_bootstrap(options["bootstrap"])
        reading = pick(Reading, options)
        out, overwrite = options.pop("out") or folder / source.stem, options.pop("overwrite")
        colours, thin = options.pop("colours"), options.pop("thin")
        exponent = options.pop("soot_exponent")
        if colours is None:
            for name, given in (("--thin", thin), ("--soot-exponent", exponent is not None)):
                if given:
                    raise InputError(
                        f"{name} goes with --colours, without which no soot is fitted."
                    )
        soot = {"absorbing": not thin, "soot_exponent": 1.0 if exponent is None else exponent}
        notes, calibration = notes_on_coding(source), None
        if colours is not None:
            calibration, said = read_exposed_colours(colours, source)
            notes += said
            for name in calibration.responses.names:
                refuse_folder(out / name, RECORD, overwrite=overwrite)
        tell_all("Note", notes)
        facts = {"seed": options.pop("seed"), "bootstrap": options["bootstrap"], "notes": notes}
        return cls(source, out, overwrite, reading, calibration, soot, options, facts)

    def find(self, light_field: "LightField", grid: "FrustumGrid | AxisymmetricGrid") -> None:
        """Find the emission, write its folder or one for each colour, and say what was found."""
        from lf_flame._common.output_folders import output_folder
        from lf_flame.tomography import AxisymmetricGrid, ReconstructionPlan
        from lf_flame.tomography.emission_folder import RECORD

        if self.calibration is not None:
            self._find_soot(light_field, grid)
            return
        bootstrap = self.options.pop("bootstrap")
        with output_folder(self.out, RECORD, overwrite=self.overwrite) as folder:
            plan = ReconstructionPlan(grid, **self.options)
            found = plan.reconstruct(light_field, bootstrap=bootstrap, rng=self.facts["seed"])
            self._write(found, light_field, folder, {})
        place = ""
        if isinstance(grid, AxisymmetricGrid):
            place = f"axis {grid.axis_mm:.2f} mm across, {grid.depth_mm:.2f} mm deep; "
        click.echo(
            f"{place}noise {found.noise:.3g} a pixel, background {found.background:.3g} +- "
            f"{found.background_sigma:.1g} subtracted; {', '.join(folder.files)} are in "
            f"{printable(folder.folder)}"
        )

    def _find_soot(self, light_field: "LightField", grid: "FrustumGrid | AxisymmetricGrid") -> None:
        """Find temperature and absorption from the colours; write a folder for each colour.

        All records hold the same random `call`, as a call that is killed may leave colours of two.
        """
        from lf_flame._common.output_folders import output_folder
        from lf_flame.tomography import reconstruct_soot
        from lf_flame.tomography.emission_folder import RECORD
        from lf_flame.tomography.soot import split_colours

        calibration, call = self.calibration, secrets.token_hex(8)
        assert calibration is not None
        self.options.pop("optical_thickness", None)
        seed, names = self.facts["seed"], calibration.responses.names
        soot = reconstruct_soot(
            light_field, grid, calibration, seed=seed, **self.soot, **self.options
        )
        lights = split_colours(light_field, names)
        totals = [float(total) for total in soot.total_thickness]
        for name, found, light, total in zip(names, soot.colours, lights, totals, strict=True):
            more = {"colour": name, "call": call, "greatest_optical_thickness": total}
            with output_folder(self.out / name, RECORD, overwrite=self.overwrite) as folder:
                self._write(found, light, folder, self.soot | more, f"Warning: {name}")
        tell_all("Warning", soot.warnings)
        if any(totals):
            both = zip(names, totals, strict=True)
            thick = ", ".join(f"{name} {total:.2g}" for name, total in both)
            click.echo(f"optical thickness of the soot, at most: {thick}")
        click.echo(f"{', '.join(names)} are in {printable(self.out)}")

    def _write(self, found, light_field, folder, more, word: str = "Warning") -> None:
        from lf_flame._common.output_folders import recorded_path
        from lf_flame.tomography import write_emission

        write_emission(found, light_field, folder)
        notes = [*self.facts["notes"], *found.unseen]
        folder.facts |= self.facts | more | {"notes": notes}
        folder.facts["source"] = recorded_path(self.source, folder.folder)
        tell_all(word, found.warnings)
        tell_all("Note", found.unseen)


def read_exposed_colours(path: Path, source: Path) -> "tuple[ColourCalibration, list[str]]":
    """Read a calibration of colours with its gains for the exposure of a flame's picture.

    Beside it a sentence where one exposure is known and not the other, or they differ.
    """
    from lf_flame.formats import read_exposure
    from lf_flame.tomography import read_colours

    calibration, exposure = read_colours(path), read_exposure(source)
    if calibration.exposure is None:
        return calibration, []
    if exposure is None:
        return calibration, [
            f"{source} states no exposure: it is taken as that of the furnace's first picture, "
            f"{calibration.exposure:.3g} s at ISO 100."
        ]
    times = exposure / calibration.exposure
    if abs(times - 1) < 1e-6:
        return calibration, []
    return calibration.exposed(exposure), [
        f"{source} was exposed {times:.3g} times as the furnace's first picture, as their files "
        f"state; this is taken into account."
    ]
