"""The commands that simulate: plan and simulate.

As in `lf_flame.commands.cli`, heavy modules are imported inside the commands.
"""

from dataclasses import replace
from functools import partial
from pathlib import Path

import click

from lf_flame.commands.options import (
    FILE,
    SEED,
    command,
    flag,
    option,
    out_options,
    print_files,
    report,
)
from lf_flame.errors import InputError


def _effect_options(command):
    """Add the options that decide which effects are simulated."""
    options = (
        option("--tolerance", "Largest error, relative to the brightest pixel (default: 0.001, or "
               "a quarter of the sensor's noise, if that is more).", float),
        option("--on", "Always simulate this effect (names: `lf-flame plan`).", multiple=True,
               metavar="EFFECT"),
        option("--off", "Never simulate this effect.", multiple=True, metavar="EFFECT"),
    )  # fmt: skip
    for add in reversed(options):
        command = add(command)
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


@command()
@click.argument("scene", type=FILE)
@_effect_options
@option(
    "--assume",
    "Values that the file does not state: some of 550nm,round,f/4,12bit,falloff, or typical.",
    metavar="LIST",
)
@flag("--measure", "Also render with and without each effect.")
def plan(scene, tolerance, on, off, assume, measure) -> None:
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
    from lf_flame.simulation import assumptions
    from lf_flame.simulation.planning.plan import plan_effects

    layers, camera, effects, stated = _read_scene(scene, on, off)
    if assume:
        camera = assumptions.assume(camera, assume.replace(" ", "").split(","), stated)
    found = plan_effects(layers, camera, tolerance, effects, typical=True, stated=stated)
    if measure:
        from tqdm import tqdm

        bar = partial(tqdm, desc="measuring", unit="effect", leave=False)
        found = replace(
            found, measured=assumptions.measure_changes(layers, camera, found, progress=bar)
        )
    click.echo(found)


@command()
@click.argument("scene", type=FILE)
@out_options("simulated/SCENE")
@_effect_options
@option("--seed", "Seed of the sensor's noise.", SEED, default=0)
@option(
    "--integrator",
    "Closed-form integrals (exact) or backward rays; auto takes the cheapest that is correct.",
    click.Choice(["auto", "exact", "rays"]),
    default="auto",
    rare=True,
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
    from lf_flame._common import progress
    from lf_flame._common.atomic_files import output_folder
    from lf_flame.commands.simulation_output import write_simulation
    from lf_flame.simulation.planning.plan import plan_effects
    from lf_flame.simulation.rendering import render_plan

    out = out or Path("simulated") / scene.stem
    layers, camera, effects, stated = _read_scene(scene, on, off)
    with output_folder(out, "simulation.json", overwrite=overwrite) as folder:
        with progress.stage("Finding the effects that the scene needs"):
            plan = plan_effects(
                layers, camera, tolerance, effects, stated=stated, integrator=integrator
            )
        if plan.seconds > 600:
            report(
                f"This takes about {plan.seconds / 60:.0f} minutes; a larger --tolerance than "
                f"{plan.tolerance:.2g} takes less."
            )
        light_field = render_plan(layers, camera, plan, seed)
        write_simulation(light_field, layers, camera, folder)
        folder.facts |= {"seed": seed}
    record = folder.facts
    kept = [effect["name"] for effect in record["plan"]["effects"] if effect["kept"]]
    click.echo(f"simulated: {', '.join(kept) or 'no effect'} ({record['plan']['integrator']})")
    for depth, slope in zip(record["depths_mm"], record["slopes"], strict=True):
        click.echo(f"refocused at depth {depth:+g} mm, slope {slope:+.3f}")
    print_files(folder)
