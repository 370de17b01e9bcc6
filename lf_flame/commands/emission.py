"""The commands that find emission: reconstruct (by depth) and abel (axisymmetric).

As in `lf_flame.commands.cli`, heavy modules are imported inside the commands.
"""

import secrets
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import cloup

from lf_flame._common.input_files import printable
from lf_flame.commands.options import (
    ABOVE_0,
    COUNT,
    FILE,
    PATH,
    SEED,
    FiniteRange,
    camera_option,
    command,
    flag,
    option,
    out_options,
    pick,
    print_files,
    print_notes,
    result_name,
)
from lf_flame.commands.reading_options import READING, Reading
from lf_flame.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from lf_flame.lightfield import LightField
    from lf_flame.optics.lens import Lens
    from lf_flame.tomography import AxisymmetricGrid, ColourCalibration, FrustumGrid

BLOCK = option(
    "--block",
    "Number of lenslets along each axis that make one pixel; more mean less noise, memory, time.",
    click.IntRange(min=1),
    default=1,
    rare=True,
)

DEPTHS = cloup.option_group(
    "Where to find emission",
    option(
        "--depths",
        "Depth planes in mm, both ends included.",
        float,
        nargs=3,
        metavar="FROM TO STEP",
    ),
    option("--depth-mm planes", "Depth of a plane in mm; may be repeated.", float, multiple=True),
    BLOCK,
)

AXIS = cloup.option_group(
    "Where the flame is, in mm",
    camera_option(required=True),
    option("--axis-mm", "Its axis, from the optical axis (default: found).", float),
    option("--axis-depth", "Depth of the axis; required for one picture.", float),
    option("--radius", "Radius that contains all light (default: found).", float),
    option("--burner", "Height of the burner above the optical axis.", float),
    BLOCK,
    flag("--central", "Use the central view alone.", rare=True),
)


def fit_options(rare: bool) -> tuple:
    """Options of the fit; `rare` says whether ``--help`` shows none of them."""
    return (
        option("--noise", "Noise of a pixel, 1 sigma (default: measured).", ABOVE_0, rare=rare),
        option("--strength", "Weight of smoothness (default: chosen).", ABOVE_0, rare=rare),
        option(
            "--background",
            "fit: subtract an even background of unknown level, measured in the pixels that no "
            "emission reaches, if there are any; none: black is at 0.",
            click.Choice(["fit", "none"]),
            default="fit",
            rare=True,
        ),
    )


FITTING = (
    *fit_options(rare=False),
    option("--colours", "colours.toml of `calibrate-colours`, for soot.", FILE),
    option(
        "--soot-exponent",
        "Exponent a of soot's absorption, wavelength^-a, with --colours (default: 1).",
        FiniteRange(-1, 5),
        rare=True,
    ),
    option("--bootstrap", "Draws for error bars; 0: none.", COUNT, default=20),
    option("--seed", "Seed of those draws.", SEED, default=0, rare=True),
    flag(
        "--thin",
        "With --colours: treat the flame as optically thin, as with a calibration whose gains are "
        "not absolute.",
        rare=True,
    ),
)


@command()
@click.argument("source", type=PATH)
@DEPTHS
@cloup.option_group(
    "How it is fitted",
    camera_option(required=True),
    *FITTING,
    option(
        "--optical-thickness",
        "Absorption by the flame itself, known from elsewhere. A TIFF contains the optical "
        "thickness of each depth plane, pixel by pixel. A number is the total along every line of "
        "sight, spread evenly over the planes, as in an even smoke. Default: no absorption.",
        metavar="T",
        rare=True,
    ),
)
@READING
@out_options("reconstructed/SOURCE")
def reconstruct(source, depths, planes, block, camera, optical_thickness, **options) -> None:
    """Find emission by depth; a smooth flame gives almost no depth information.

    The result is the planes' emission that best explains all views of SOURCE, which must be
    linear in light and divided by a white image: grey, or in colour with --colours.

    \b
      lf-flame reconstruct simulated/flames/light_field.npz \\
          --camera simulated/flames/simulation.json --depth-mm 20 --depth-mm 0
      lf-flame reconstruct raw.png --white white.png --camera camera.toml --depths -12 12 2
    \f

    Refocused images do not show emission: each contains the blurred light of all other depths.
    Detail is blurred in depth over its period divided by the angle of the aperture; `lf-flame
    camera` prints the period in mm that your camera resolves.
    """  # noqa: D301 - click reads the backspace
    import numpy as np

    from lf_flame.calibration import read_lens
    from lf_flame.tomography import FrustumGrid
    from lf_flame.tomography.frustum_grid import planes_between

    if bool(depths) == bool(planes):
        raise InputError("State the planes: either --depths FROM TO STEP or --depth-mm.")
    lens: Lens = read_lens(camera)
    grid = FrustumGrid(lens, planes_between(*depths) if depths else planes)
    if options["colours"] and optical_thickness is not None:
        raise InputError("--optical-thickness does not apply with --colours, which finds it.")
    thickness = None if optical_thickness is None else read_thickness(optical_thickness)
    job = _Job.checked(source, Path("reconstructed"), options)
    job.options["optical_thickness"] = thickness
    total = thickness.sum(axis=0) if isinstance(thickness, np.ndarray) else thickness
    greatest = None if total is None else float(np.max(total))
    job.facts |= {"optical_thickness": optical_thickness, "greatest_optical_thickness": greatest}
    job.reading = job.reading.for_camera(source, lens)
    light_field, read = job.reading.read_of_camera(source, lens)
    job.find(light_field, replace(grid, camera=read or lens, block=block))


@command()
@click.argument("source", type=PATH)
@AXIS
@cloup.option_group("How it is fitted", *FITTING)
@READING
@out_options("abel/SOURCE")
def abel(source, camera, axis_mm, axis_depth, radius, burner, block, central, **options) -> None:
    """Find the emission of an axisymmetric flame with an upright axis.

    It is an Abel inversion from all views at once, along the camera's rays, without negative
    emission. SOURCE must be linear in light and divided by a white image: grey, or in colour
    with --colours.

    \b
      lf-flame abel flame.npz --camera camera.toml
      lf-flame abel raw.png --white white.png --camera camera.toml --burner -12.5
      lf-flame abel photograph.png --camera one_view.toml --axis-depth 0
    \f

    A warning is printed if the axis leans, is curved or is not where stated, if there is
    light outside the radius, or if the halves differ. One picture of an ordinary camera is enough,
    with --axis-depth and a camera file that says views = 1, the pixel pitch as lenslet pitch, and
    that pitch times the f-number as lenslet focal length.
    """  # noqa: D301 - click reads the backspace
    from lf_flame.calibration import read_lens
    from lf_flame.tomography import AxisymmetricGrid, find_axis

    lens: Lens = read_lens(camera)
    if radius is not None and not 0 < radius <= lens.focus_distance_mm:
        raise InputError(
            f"--radius must be above 0 and at most the camera's focus distance, "
            f"{lens.focus_distance_mm:g} mm, got {radius:g}."
        )
    job = _Job.checked(source, Path("abel"), options)
    job.reading = job.reading.for_camera(source, lens)
    light_field, read = job.reading.read_of_camera(source, lens)
    lens, columns = read or lens, light_field.views.shape[1]
    if columns < 3 and axis_depth is None:
        raise InputError(
            f"{source} contains {columns} view columns, which do not show the axis' depth: state "
            f"it, --axis-depth."
        )
    if axis_mm is None or axis_depth is None or radius is None:
        grey = light_field if job.calibration is None else light_field.grey()
        axis = find_axis(grey, lens, None if columns >= 3 else axis_depth)
        axis_depth = axis.depth_mm if axis_depth is None else axis_depth
        # The central view sees the axis at the same pixel at any depth, which is not the same mm.
        scale = lens.field_mm(axis_depth)[1] / lens.field_mm(axis.depth_mm)[1]
        axis_mm = axis.across_mm * scale if axis_mm is None else axis_mm
        four_pixels = 4.001 * block * lens.field_mm(axis_depth)[1] / lens.lenslets[1]  # the least
        radius = max(axis.radius_mm * scale, four_pixels) if radius is None else radius
    views = "central" if central else "all"
    job.find(light_field, AxisymmetricGrid(lens, axis_mm, axis_depth, radius, block, views, burner))


def read_thickness(given: str) -> "float | np.ndarray":
    """Read an optical thickness: a number, or a TIFF file of planes (planes, rows, columns)."""
    from lf_flame._common.images import TIFF_SUFFIXES, read_pixels

    try:
        return float(given)
    except ValueError:
        path = Path(given)
    if path.suffix.lower() not in TIFF_SUFFIXES:
        raise InputError(f"--optical-thickness must be a number or a TIFF file, got {given}.")
    stack = read_pixels(path)
    if stack.dtype.kind != "f" or stack.ndim < 2:
        raise InputError(
            f"{path} must contain planes of optical thickness as floating-point numbers, got "
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
    def checked(cls, source: Path, folder: Path, options: dict[str, Any]) -> "_Job":
        """Check the options and folders, as reading and compiling are slow."""
        from lf_flame._common.atomic_files import refuse_folder
        from lf_flame.tomography.colour_calibration import read_colours
        from lf_flame.tomography.emission_folder import RECORD
        from lf_flame.tomography.fit import FitOptions, check_bootstrap

        FitOptions(options["noise"], options["strength"])
        check_bootstrap(options["bootstrap"])
        reading = pick(Reading, options)
        out = options.pop("out") or folder / result_name(source)
        overwrite = options.pop("overwrite")
        colours, thin = options.pop("colours"), options.pop("thin")
        exponent = options.pop("soot_exponent")
        for name, given in (("--thin", thin), ("--soot-exponent", exponent is not None)):
            if given and colours is None:
                raise InputError(f"{name} needs --colours, without which no soot is fitted.")
        soot = {"absorbing": not thin, "soot_exponent": 1.0 if exponent is None else exponent}
        calibration = None
        if colours is not None:
            calibration = read_colours(colours)
            for name in calibration.responses.names:
                refuse_folder(out / name, RECORD, overwrite=overwrite)
        facts = {"seed": options.pop("seed"), "bootstrap": options["bootstrap"]}
        return cls(source, out, overwrite, reading, calibration, soot, options, facts)

    def find(self, light_field: "LightField", grid: "FrustumGrid | AxisymmetricGrid") -> None:
        """Find the emission, write its folder or one for each colour, and say what was found."""
        from lf_flame._common.atomic_files import output_folder
        from lf_flame.tomography import AxisymmetricGrid, ReconstructionPlan
        from lf_flame.tomography.emission_folder import RECORD

        if self.calibration is not None:
            self._find_soot(light_field, grid, self.calibration)
            return
        bootstrap = self.options.pop("bootstrap")
        with output_folder(self.out, RECORD, overwrite=self.overwrite) as folder:
            plan = ReconstructionPlan(grid, **self.options)
            found = plan.reconstruct(light_field, bootstrap=bootstrap, rng=self.facts["seed"])
            self._write(found, light_field, folder, {})
        place = ""
        if isinstance(grid, AxisymmetricGrid):
            place = f"axis {grid.axis_mm:.2f} mm across, {grid.depth_mm:.2f} mm deep; "
        print_files(
            folder,
            f"{place}noise {found.noise:.3g} a pixel, background {found.background:.3g} +- "
            f"{found.background_sigma:.1g} subtracted; ",
        )

    def _find_soot(self, light_field: "LightField", grid, calibration: "ColourCalibration") -> None:
        """Find temperature and absorption from the colours; write a folder for each colour.

        All records contain the same random `call`: an interrupted run may leave colours of two.
        """
        from lf_flame._common.atomic_files import output_folder
        from lf_flame.tomography import reconstruct_soot
        from lf_flame.tomography.emission_folder import RECORD
        from lf_flame.tomography.soot import split_colours

        if self.soot["absorbing"] and getattr(grid.camera, "fall_off", None):
            raise InputError(
                "The calibration corrects the fall-off, and calibrate-colours does not: calibrate "
                "and decode with a white image, or add --thin."
            )
        call, seed, names = secrets.token_hex(8), self.facts["seed"], calibration.responses.names
        soot = reconstruct_soot(
            light_field, grid, calibration, seed=seed, **self.soot, **self.options
        )
        lights = split_colours(light_field, names)
        totals = [float(total) for total in soot.total_thickness]
        more = {"call": call, "gains": calibration.gains.tolist()}
        for name, found, light, total in zip(names, soot.colours, lights, totals, strict=True):
            more |= {"colour": name, "greatest_optical_thickness": total if any(totals) else None}
            with output_folder(self.out / name, RECORD, overwrite=self.overwrite) as folder:
                self._write(found, light, folder, self.soot | more, f"Warning: {name}")
                folder.facts["warnings"] += soot.warnings
        print_notes("Warning", soot.warnings)
        if any(totals):
            thick = ", ".join(f"{name} {x:.2g}" for name, x in zip(names, totals, strict=True))
            click.echo(f"largest optical thickness of the soot: {thick}")
        click.echo(f"{', '.join(names)} written to {printable(self.out)}")

    def _write(self, found, light_field, folder, more, word: str = "Warning") -> None:
        from lf_flame._common.atomic_files import recorded_path
        from lf_flame.tomography import write_emission

        write_emission(found, light_field, folder)
        folder.facts |= self.facts | more | self.reading.facts()
        folder.facts["source"] = recorded_path(self.source, folder.folder)
        print_notes(word, found.warnings)
