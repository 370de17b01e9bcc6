"""The program `lf-flame`: thin commands over the package; the Makefile calls them.

Heavy modules are imported inside the commands, so that ``--help`` answers at once.
"""

import sys
from dataclasses import replace
from pathlib import Path

import click

from experiments.recipes.commands import study, swap_test
from lf_flame import __version__
from lf_flame._common.keras_loading import load_keras
from lf_flame.commands.light_fields import FILE, FOLDER, convert, refocus, refocus_regions
from lf_flame.commands.networks import export, latency, predict
from lf_flame.commands.systems import compare, train_system
from lf_flame.errors import InputError

PAPER = NEW_FILE = click.Path(dir_okay=False, path_type=Path)


def main() -> None:
    """Run the program: bad input is one sentence and status 2, an interruption status 130."""
    try:
        status = commands.main(standalone_mode=False)
    except click.exceptions.Abort:
        _fail(
            "Stopped. Files that were finished are kept; dataset and train go on from there.", 130
        )
    except click.ClickException as error:
        error.show()
        sys.exit(2)
    except InputError as error:
        _fail(str(error), 2)
    except MemoryError as error:
        _fail(f"There is not enough memory for this camera or scene: {error}.", 2)
    except OSError as error:
        name = f" ({error.filename})" if error.filename else ""
        _fail(f"{error.strerror or error}{name}. Nothing that was there before is lost.", 2)
    sys.exit(status or 0)


def _fail(message: str, status: int) -> None:
    click.echo(f"lf-flame: {message}", err=True)
    sys.exit(status)


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__)
def commands() -> None:
    """Simulate a plenoptic camera, refocus its light fields, and train a network to do it.

    \b
    A first tour:
      lf-flame camera                                    the paper's camera in numbers
      lf-flame plan data_gen/scenes/example.toml         which effects a scene calls for
      lf-flame simulate data_gen/scenes/example.toml     a scene of your own, as pictures
      lf-flame refocus FOLDER                            anybody's light field, refocused
      make tables                                        the paper's two tables, from nothing
    """  # noqa: D301 - click reads the backspace


@commands.command()
@click.argument("config", type=FILE, required=False)
@click.option("--depth-mm", "depths", multiple=True, type=float, help="Depth; may be repeated.")
def camera(config: Path | None, depths: tuple[float, ...]) -> None:
    """Print what follows from a camera: image distance, aperture, field, slopes.

    CONFIG is any TOML file with a [camera] table; without it, the paper's camera.
    """
    from lf_flame.commands.camera_report import camera_report
    from lf_flame.optics.camera import PAPER_CAMERA
    from lf_flame.scenes.scene_files import read_camera

    chosen = read_camera(config) if config else PAPER_CAMERA
    click.echo(camera_report(chosen, depths or (20.0, 10.0, 0.0, -10.0)))


def _effect_options(command):
    """Add the options that decide what is simulated."""
    options = (
        click.option(
            "--tolerance",
            default=1e-3,
            show_default=True,
            help="Error to accept, relative to the brightest pixel.",
        ),
        click.option("--on", multiple=True, metavar="EFFECT", help="Force an effect on."),
        click.option("--off", multiple=True, metavar="EFFECT", help="Force an effect off."),
    )
    for option in reversed(options):
        command = option(command)
    return command


def _read_scene(scene: Path, on: tuple[str, ...], off: tuple[str, ...]):
    """Read a scene file; what the command line forces comes before what the file forces."""
    from lf_flame.scenes.scene_files import read_scene

    both = set(on) & set(off)
    if both:
        raise InputError(f"{', '.join(sorted(both))} cannot be forced both on and off.")
    layers, camera, effects = read_scene(scene)
    return layers, camera, effects | dict.fromkeys(on, True) | dict.fromkeys(off, False)


@commands.command()
@click.argument("scene", type=FILE)
@_effect_options
def plan(scene: Path, tolerance: float, on: tuple[str, ...], off: tuple[str, ...]) -> None:
    """Print which physical effects a SCENE file calls for, and why, without rendering it.

    For each effect: by how much at most the image would change if it were left out, the decision
    at this tolerance, the criterion with its numbers, and roughly the time that it adds.
    """
    from lf_flame.simulation.plan import plan_effects

    layers, camera, effects = _read_scene(scene, on, off)
    click.echo(plan_effects(layers, camera, tolerance, effects))


@commands.command()
@click.argument("scene", type=FILE)
@click.option("--out", type=FOLDER, help="Folder for the files; default simulated/SCENE.")
@_effect_options
@click.option("--seed", default=0, show_default=True, help="Seed of the sensor's noise.")
@click.option(
    "--integrator",
    type=click.Choice(["auto", "exact", "rays"]),
    default="auto",
    show_default=True,
    help="Closed-form integrals or backward rays; auto takes the cheapest that will do.",
)
def simulate(scene: Path, out: Path | None, tolerance, on, off, seed, integrator: str) -> None:
    """Render a SCENE file: raw image, views, and the stack refocused at each layer's depth.

    Only the effects that the scene calls for are simulated; `lf-flame plan SCENE` shows which.
    data_gen/scenes/example.toml shows what a scene file may hold.
    """
    from lf_flame.commands.simulation_output import simulate

    out = out or Path("simulated") / scene.stem
    layers, camera, effects = _read_scene(scene, on, off)
    options = {"tolerance": tolerance, "effects": effects, "seed": seed, "integrator": integrator}
    record = simulate(layers, camera, out, **options)
    kept = [effect["name"] for effect in record["plan"]["effects"] if effect["kept"]]
    click.echo(f"simulated: {', '.join(kept) or 'no effect'} ({record['plan']['integrator']})")
    for depth, slope in zip(record["depths_mm"], record["slopes"], strict=True):
        click.echo(f"refocused at depth {depth:+g} mm, slope {slope:+.3f}")
    click.echo(
        f"raw.tif, raw.png, views.png, refocused.tif, refocused_*.png, light_field.npz, "
        f"plan.txt and simulation.json are in {out}"
    )


@commands.command()
@click.argument("configs", type=FILE, nargs=-1, required=True)
@click.option("--paper", type=PAPER, default="experiments/paper_values.toml", show_default=True)
@click.option("--out", type=FOLDER, help="Folder for slopes.csv, .md, .json and .png.")
def slopes(configs: tuple[Path, ...], paper: Path, out: Path | None) -> None:
    """Search the slope of sharpest focus of each object in data-set CONFIGS.

    Printed beside the slope that the camera's geometry gives and the paper's.
    """
    from experiments.paper.slopes import slope_report
    from lf_flame.datasets.store import read_config

    click.echo(slope_report([read_config(path) for path in configs], paper, out))


@commands.command()
@click.argument("config", type=FILE)
@click.option("--preset", default="quick", show_default=True, help="A key of [samples] in CONFIG.")
@click.option("--out", type=FOLDER, required=True, help="Folder of the Zarr group to make.")
@click.option("--workers", default=0, show_default=True, help="Processes; 0 = one per core.")
def dataset(config: Path, preset: str, out: Path, workers: int) -> None:
    """Simulate the data set that CONFIG describes; goes on where a run was cut off."""
    from lf_flame._common.progress import progress_bar
    from lf_flame._common.provenance import cpu_count
    from lf_flame.datasets.store import Dataset, make_dataset, read_config

    if workers < 0:
        raise InputError(f"workers must be 0 (one per core) or more, got {workers}.")
    settings = read_config(config)
    samples = settings.sample_count(preset)
    if out.exists():
        found = Dataset(out)
        if found.config != settings or len(found) != samples:
            raise InputError(
                f"{out} holds a data set of another configuration or size; remove it or choose "
                f"another folder."
            )
        (out / "zarr.json").touch()  # make compares it with the configuration file
        click.echo(f"{out} is complete: {samples} samples.")
        return
    click.echo(f"{samples} light fields into {out}; first, the slopes of sharpest focus", err=True)
    make_dataset(settings, samples, out, workers or cpu_count(), progress_bar)
    (out / "zarr.json").touch()


@commands.command()
@click.argument("config", type=FILE)
@click.option("--preset", default="quick", show_default=True, help="A key of [presets] in CONFIG.")
@click.option("--data", type=FOLDER, required=True, help="Data set to train on.")
@click.option("--out", type=FOLDER, required=True, help="Run folder: checkpoints, model, record.")
@click.option("--backbone-weights", help="imagenet, random, or a weights file (.h5, .npz).")
@click.option("--backbone-depth", type=click.Choice(["conv4", "conv5"]), help="Where to cut it.")
@click.option("--seed", type=int, help="Instead of CONFIG's: of split, weights, batches, dropout.")
@click.option("--epochs", type=int, help="Instead of the preset's; a run may go on with more.")
def train(config, preset, data, out, backbone_weights, backbone_depth, seed, epochs) -> None:
    """Train the network that CONFIG describes; goes on where a run was cut off."""
    load_keras()
    from lf_flame.learning.training import read_training_config, train

    options = {"backbone_weights": backbone_weights, "backbone_depth": backbone_depth}
    settings = read_training_config(config, **options)
    if seed is not None:
        settings = replace(settings, seed=seed)
    if epochs is not None:
        settings = settings.with_epochs(preset, epochs)
    train(settings, preset, data, out)


@commands.command()
@click.argument("run", type=FOLDER)
@click.option("--table", required=True, type=click.Choice(["table1", "table2"]))
@click.option("--figure", required=True, help="Name of the figure's PNG file, without its ending.")
@click.option("--paper", type=PAPER, default="experiments/paper_values.toml", show_default=True)
@click.option("--out", type=FOLDER, required=True, help="Results folder.")
def evaluate(run: Path, table: str, figure: str, paper: Path, out: Path) -> None:
    """Score the test split of a finished RUN and write its table and figure."""
    load_keras()
    from experiments.paper.tables import evaluate_run

    evaluate_run(run, table, figure, paper, out)


@commands.command()
@click.option("--out", type=FOLDER, default="experiments/results/costs", show_default=True)
@click.option(
    "--chapter",
    type=click.Choice(["all", "simulation", "refocusing"]),
    default="all",
    show_default=True,
)
@click.option(
    "--budget-s",
    default=420.0,
    show_default=True,
    help="Seconds for the ways to integrate; effects take a minute or two on top.",
)
@click.option(
    "--run",
    type=FOLDER,
    default="runs/quick",
    show_default=True,
    help="Folder of trained networks, RUN/shapes and RUN/flames, to set beside refocusing.",
)
def costs(out: Path, chapter: str, budget_s: float, run: Path) -> None:
    """Measure what accuracy costs in time; run it on a machine that does nothing else.

    Simulation: error against seconds for each way to integrate, on the shape scene, a flame and an
    occluding scene; for each effect the seconds that it adds and the error of leaving it out. On
    one thread.

    Refocusing: SSIM and PSNR against the exact result over milliseconds, for each interpolation,
    for fewer views, for light fields stored in fewer bits, in the Fourier domain, and for the
    trained networks. On all cores, in two or three minutes.
    """
    from experiments.costs import rendering_report
    from experiments.costs.rendering import measure_costs
    from lf_flame._common.progress import step_bar

    if not budget_s > 0:
        raise InputError(f"budget-s must be above 0 seconds, got {budget_s}.")
    if chapter != "refocusing":
        path = rendering_report.write_report(out, *measure_costs(step_bar, budget_s))
        click.echo(path.read_text(encoding="utf-8"))
    if chapter != "simulation":
        load_keras()
        from experiments.costs import refocusing_report
        from experiments.costs.refocusing import measure_refocusing

        path = refocusing_report.write_report(out, *measure_refocusing(run, step_bar))
        click.echo(path.read_text(encoding="utf-8"))


@commands.command()
@click.argument("results", type=FOLDER, nargs=-1, required=True)
@click.option("--paper", type=PAPER, default="experiments/paper_values.toml", show_default=True)
@click.option(
    "--out",
    type=NEW_FILE,
    help="Keep this in an .md file; numbers in a .csv, the learning in a .png beside.",
)
def tables(results: tuple[Path, ...], paper: Path, out: Path | None) -> None:
    """Print Tables I and II of RESULTS folders; a run that is missing shows as missing.

    Several folders are set side by side; runs of one recipe that differ in their seed alone are
    pooled into mean and standard deviation over the seeds.
    """
    from experiments.paper.comparison import compare_runs

    click.echo(compare_runs(results, paper, out))


commands.add_command(refocus)
commands.add_command(refocus_regions)
commands.add_command(convert)
commands.add_command(export)
commands.add_command(predict)
commands.add_command(latency)
commands.add_command(study)
commands.add_command(swap_test)
commands.add_command(train_system)
commands.add_command(compare)


if __name__ == "__main__":
    main()
