"""The commands that set refocusing systems side by side: compare, system-scenes."""

from pathlib import Path

import click
import cloup

from experiments.beside_reference import show
from experiments.command_parts import quiet_tensorflow
from experiments.paths import DATA_SETS, EXPERIMENTS
from lf_flame.commands.options import FILE, FOLDER, PATH, RUN, FiniteRange
from lf_flame.errors import InputError
from lf_flame.learning.keras_loading import load_keras


@cloup.command()
@click.argument("runs", type=RUN)
@click.option("--out", type=FOLDER, default=Path("results/compare"), show_default=True)
@click.option(
    "--data",
    type=FILE,
    multiple=True,
    default=DATA_SETS,
    show_default="the paper's shapes and flames",
    help="Data set whose scenes are refocused; may be repeated.",
)
@click.option("--light-fields", default=8, show_default=True, help="Of each test set.")
@click.option(
    "--photograph",
    "photographs",
    type=(PATH, str),
    multiple=True,
    metavar="LIGHT_FIELD SLOPES",
    help="Light field of a camera, and slopes such as -1,0,1; may be repeated.",
)
@click.option(
    "--electrons",
    type=FiniteRange(min=0, min_open=True),
    multiple=True,
    default=[1, 10, 100, 1000],
    show_default=True,
    help="Also in less light: electrons of a pixel at full scale; may be repeated.",
)
@click.option("--seed", type=click.IntRange(0), default=1, show_default=True, help="Of that noise.")
@click.option("--refocusnet-weights", type=FILE, help="The authors' trained weights (.npz).")
@click.option(
    "--variant",
    "variants",
    type=RUN,
    multiple=True,
    help="Another run of the paper's network, as `make encodings` leaves some; may be repeated.",
)
def compare(
    runs, out, data, light_fields, photographs, electrons, seed, refocusnet_weights, variants
) -> None:
    """Set refocusing systems side by side: accuracy, views, time and memory.

    RUNS holds the trained networks, one folder each, as `make train-refocusnet` and the like, and
    `make tables`, leave them. What is missing shows as missing.

    Test sets are light fields that no network was trained on: the test splits of the ResNet-50s in
    RUNS (where there is none, the last light fields of a data set), the same scenes with their
    objects at other depths, and photographs. The reference is shift-and-sum of all views. Run it
    on a machine that does nothing else.

    \b
      python -m experiments compare runs/closed-form
      python -m experiments compare runs/closed-form --electrons 0.3 --electrons 3
      python -m experiments compare runs/closed-form --photograph FOLDER_OF_VIEWS -1,0,1
    """  # noqa: D301 - click reads the backspace
    if light_fields < 1:
        raise InputError(f"light-fields must be 1 or more, got {light_fields}.")
    load_keras()
    quiet_tensorflow()
    from experiments.systems import benchmark
    from experiments.systems import entries as systems
    from experiments.systems.compared_sets import paper_sets, photograph_sets
    from lf_flame.datasets.config import read_config
    from lf_flame.formats import read_light_field

    configs = [read_config(path) for path in data]
    by_data = [paper_sets(config, runs / config.kind, light_fields) for config in configs]
    test_sets = [test_set for sets in by_data for test_set in sets]
    test_sets += [sets[0].in_low_light(light, seed) for light in electrons for sets in by_data]
    for path, slopes in photographs:
        light_field = read_light_field(path)
        test_sets += photograph_sets(path.name, light_field, _as_numbers(slopes))
    entries = systems.formula_entries()
    entries += systems.trained_entries(runs, refocusnet_weights)
    entries += [systems.variant_entry(path, configs, runs, light_fields) for path in variants]
    show(benchmark.run_benchmark(entries, test_sets, out), "compare")


@cloup.command("system-scenes")
@click.option(
    "--config", type=FILE, default=EXPERIMENTS / "system_scenes.toml", show_default="our recipes"
)
@click.option(
    "--system",
    "systems",
    multiple=True,
    default=["aperturenet"],
    show_default=True,
    help="Of the configuration; may be repeated.",
)
@click.option(
    "--light-fields",
    "counts",
    type=click.IntRange(min=1),
    multiple=True,
    default=[25, 100, 400, 1600],
    show_default=True,
    help="To learn from; may be repeated.",
)
@click.option("--held-out", default=20, show_default=True, help="That choose the best epoch.")
@click.option("--scored", default=40, show_default=True, help="Others, to score with.")
@click.option("--work", type=FOLDER, default=Path("runs/system_scenes"), show_default=True)
@click.option("--out", type=FOLDER, default=Path("results/system_scenes"), show_default=True)
def system_scenes(config, systems, counts, held_out, scored, work, out) -> None:
    """Measure what systems reach against the number of light fields to learn from.

    Each system is trained by its own recipe on fewer and more light fields, with as many steps, and
    scored on others, beside shift-and-sum of the views that it looks at. WORK holds the runs: what
    is done is not done again. It takes six minutes on two cores.

    \b
      python -m experiments system-scenes
      python -m experiments system-scenes --system aperturenet --light-fields 25 --light-fields 1600
    """  # noqa: D301 - click reads the backspace
    load_keras()
    quiet_tensorflow()
    from experiments.systems.scene_counts import run_scene_counts
    from lf_flame.systems.training_config import read_systems_config

    recipes = read_systems_config(config)
    path = run_scene_counts(recipes, systems, counts, held_out, scored, work, out)
    show(path, "system_scenes")


def _as_numbers(text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise InputError(f"Slopes are numbers with commas between, got {text!r}.") from None
