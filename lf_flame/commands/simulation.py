"""The commands that simulate: camera, plan and simulate.

As in `lf_flame.commands.cli`, heavy modules are imported inside the commands.
"""

from dataclasses import replace
from functools import partial
from pathlib import Path

import click
import cloup

from lf_flame._common.printable import printable
from lf_flame.commands.options import FILE, FOLDER, OVERWRITE, PATH, SEED
from lf_flame.errors import InputError


@cloup.command()
@click.argument("config", type=FILE, required=False)
@click.option(
    "--depth-mm",
    "depths",
    multiple=True,
    type=float,
    help="Depth of a row of the table, in mm from the focal plane; may be repeated.",
)
@click.option("--figure", type=PATH, help="PNG to write: the camera's planes, lenses and rays.")
def camera(config: Path | None, depths: tuple[float, ...], figure: Path | None) -> None:
    """Print the numbers that follow from a camera: image distance, aperture, field, slopes.

    CONFIG is any TOML file with a [camera] table; without it, the paper's camera is used.
    """
    from lf_flame.commands.camera_table import camera_report
    from lf_flame.optics.camera import PAPER_CAMERA
    from lf_flame.scenes.scene_files import read_camera

    chosen = read_camera(config) if config else PAPER_CAMERA
    shown = depths or (20.0, 10.0, 0.0, -10.0)
    click.echo(camera_report(chosen, shown))
    if figure:
        from lf_flame._common import figures
        from lf_flame.commands.camera_figure import camera_figure

        if figure.suffix.lower() != ".png":
            raise InputError(f"--figure must end in .png, got {figure}.")
        figures.save(camera_figure(chosen, shown), figure)
        click.echo(f"\n{printable(figure)} is written")


def _effect_options(command):
    """Add the options that decide which effects are simulated."""
    options = (
        click.option(
            "--tolerance",
            type=float,
            help="Largest acceptable error, relative to the brightest pixel; default 0.001, or a "
            "quarter of the sensor's noise, if that is more.",
        ),
        click.option("--on", multiple=True, metavar="EFFECT", help="Force an effect on."),
        click.option("--off", multiple=True, metavar="EFFECT", help="Force an effect off."),
    )
    for option in reversed(options):
        command = option(command)
    return command


def _read_scene(scene: Path, on: tuple[str, ...], off: tuple[str, ...]):
    """Read a scene file, and the names of the camera fields in it.

    The options --on and --off override the file.
    """
    from lf_flame._common.input_files import read_toml
    from lf_flame.scenes.scene_files import read_scene

    both = set(on) & set(off)
    if both:
        raise InputError(f"{', '.join(sorted(both))} cannot be forced both on and off.")
    layers, camera, effects = read_scene(scene)
    forced = effects | dict.fromkeys(on, True) | dict.fromkeys(off, False)
    return layers, camera, forced, set(read_toml(scene).get("camera", {}))


@cloup.command()
@click.argument("scene", type=FILE)
@_effect_options
@click.option(
    "--assume",
    metavar="LIST",
    help="Values for what the file does not state: some of 550nm,round,f/4,12bit,falloff, or "
    "typical.",
)
@click.option("--measure", is_flag=True, help="Also render with and without each effect.")
def plan(
    scene: Path,
    tolerance: float | None,
    on: tuple[str, ...],
    off: tuple[str, ...],
    assume: str | None,
    measure: bool,
) -> None:
    """Print which physical effects a SCENE file needs, and why, without rendering it.

    For each effect: the largest possible change of the image if it were left out, the decision at
    this tolerance, and the criterion with its numbers; then how finely the scene is divided, and
    how long it takes. An effect without its cause in the file (no wavelength, no sensor ...) is
    shown as not stated, with its size at a typical value. Bounds hold for any scene like this one
    and may be far above the true change, which --measure finds.

    \b
      lf-flame plan scene.toml
      lf-flame plan scene.toml --assume 550nm,round,12bit --measure
    """  # noqa: D301 - click reads the backspace
    from lf_flame.simulation.planning import assumptions
    from lf_flame.simulation.planning.decisions import plan_effects

    layers, camera, effects, stated = _read_scene(scene, on, off)
    if assume:
        camera = assumptions.assume(camera, assume.replace(" ", "").split(","), stated)
    found = plan_effects(layers, camera, tolerance, effects, typical=True, stated=stated)
    if measure:
        from tqdm import tqdm

        from lf_flame.simulation.measuring import measure_changes

        bar = partial(tqdm, desc="measuring", unit="effect", leave=False)
        found = replace(found, measured=measure_changes(layers, camera, found, progress=bar))
    click.echo(found)


@cloup.command()
@click.argument("scene", type=FILE)
@click.option("--out", type=FOLDER, help="Folder for the files; default simulated/SCENE.")
@OVERWRITE
@_effect_options
@click.option("--seed", type=SEED, default=0, show_default=True, help="Seed of the sensor's noise.")
@click.option(
    "--integrator",
    type=click.Choice(["auto", "exact", "rays"]),
    default="auto",
    show_default=True,
    help="Closed-form integrals (exact) or backward rays; auto takes the cheapest that is correct.",
)
def simulate(scene: Path, out, overwrite, tolerance, on, off, seed, integrator) -> None:
    """Render a SCENE file: raw image, views, and the stack refocused at each layer's depth.

    Only the effects that the scene needs are simulated; `lf-flame plan SCENE` shows which.
    A scene file is TOML: a camera, and layers with a shape or an image file.

    \b
      [camera]
      main_lens_focal_mm = 150.0
      focus_distance_mm = 326.0
      lenslet_focal_mm = 0.4
      lenslet_pitch_mm = 0.112
      views = 9
      lenslets = [60, 60]
      [[layers]]
      shape = "circle"
      depth_mm = 5.0
      size_mm = [3.0, 3.0]
    """  # noqa: D301 - click reads the backspace
    from lf_flame.commands.simulation_output import simulate

    out = out or Path("simulated") / scene.stem
    layers, camera, effects, stated = _read_scene(scene, on, off)
    options = {"tolerance": tolerance, "effects": effects, "seed": seed, "integrator": integrator}
    record = simulate(layers, camera, out, overwrite=overwrite, stated=stated, **options)
    kept = [effect["name"] for effect in record["plan"]["effects"] if effect["kept"]]
    click.echo(f"simulated: {', '.join(kept) or 'no effect'} ({record['plan']['integrator']})")
    for depth, slope in zip(record["depths_mm"], record["slopes"], strict=True):
        click.echo(f"refocused at depth {depth:+g} mm, slope {slope:+.3f}")
    click.echo(
        f"raw.tif, raw.png, views.png, refocused.tif, refocused_*.png, light_field.npz, "
        f"plan.txt and simulation.json are in {out}"
    )
