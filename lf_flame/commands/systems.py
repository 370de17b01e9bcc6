"""The commands of `lf-flame` for refocusing systems: train-system and compare.

As in `lf_flame.commands.cli`, heavy modules are imported inside the commands.
"""

import logging
from dataclasses import replace
from pathlib import Path

import click

from lf_flame._common.keras_loading import load_keras
from lf_flame.commands.light_fields import FILE, FOLDER
from lf_flame.errors import InputError


@click.command("train-system")
@click.argument("system")
@click.option("--config", type=FILE, default="experiments/systems.toml", show_default=True)
@click.option("--preset", default="quick", show_default=True, help="A key of [presets] in CONFIG.")
@click.option("--seed", type=int, help="Of lessons, weights and patches, instead of CONFIG's.")
@click.option("--out", type=FOLDER, required=True, help="Run folder: checkpoints, model, record.")
def train_system(system: str, config: Path, preset: str, seed: int | None, out: Path) -> None:
    """Train a refocusing SYSTEM; goes on where a run was cut off.

    SYSTEM is a key of [systems] in CONFIG. All learn from the same lessons: light fields drawn
    anew, with every object at a depth of its own, each seen at several slopes; what they should
    draw is what all views give.

    \b
      aperturenet       ours: nine aligned views, each for a ninth of the aperture
      aperturenet-dark  the same, from lessons in little light
      refocusnet        four aligned views (Ben Dayan et al. 2020), the published layers
      refnet            7 x 7 views into sixteen images (Hedayati et al. 2021), our reading
      refnet-fourier    the same, from the Fourier slice instead of shift-and-sum
      volumetric        a cross of 17 views, ghosts removed by a U-Net (Samarakoon et al. 2025)
    """  # noqa: D301 - click reads the backspace
    load_keras()
    from lf_flame.systems.training import read_systems_config, train_system

    asked = read_systems_config(config)
    asked = asked if seed is None else replace(asked, seed=seed)
    path = train_system(asked, system, preset, out)
    click.echo(f"{path} is trained")


@click.command()
@click.argument("runs", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--out", type=FOLDER, required=True, help="Results folder.")
@click.option(
    "--data",
    type=FILE,
    multiple=True,
    default=["data_gen/shapes.toml", "data_gen/flames.toml"],
    show_default=True,
    help="Data set whose scenes are refocused; may be repeated.",
)
@click.option("--light-fields", default=8, show_default=True, help="Of each test set.")
@click.option(
    "--photograph",
    "photographs",
    type=(click.Path(path_type=Path), str),
    multiple=True,
    metavar="LIGHT_FIELD SLOPES",
    help="Light field of a camera, and slopes such as -1,0,1; may be repeated.",
)
@click.option(
    "--electrons",
    type=click.FloatRange(min=0, min_open=True),
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
    type=click.Path(exists=True, file_okay=False, path_type=Path),
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
    objects at other depths, and photographs. Right is shift-and-sum of all views. Run it on a
    machine that does nothing else.

    \b
      lf-flame compare runs/quick --out compare
      lf-flame compare runs/quick --out compare --electrons 0.3 --electrons 3
      lf-flame compare runs/quick --out compare --photograph FOLDER_OF_VIEWS -1,0,1
    """  # noqa: D301 - click reads the backspace
    if light_fields < 1:
        raise InputError(f"light-fields must be 1 or more, got {light_fields}.")
    load_keras()
    # TensorFlow finds it odd that network after network is compiled.
    logging.getLogger("tensorflow").setLevel(logging.ERROR)
    from experiments.systems import benchmark
    from experiments.systems.test_sets import paper_sets, photograph_set
    from lf_flame._common.progress import step_bar
    from lf_flame.datasets.store import read_config
    from lf_flame.formats import read_light_field

    configs = [read_config(path) for path in data]
    by_data = [paper_sets(config, runs / config.kind, light_fields) for config in configs]
    test_sets = [test_set for sets in by_data for test_set in sets]
    test_sets += [sets[0].in_the_dark(light, seed) for light in electrons for sets in by_data]
    for path, slopes in photographs:
        light_field = read_light_field(path)
        test_sets.append(photograph_set(path.name, light_field, _as_numbers(slopes)))
    contestants = benchmark.classical_contestants()
    contestants += benchmark.trained_contestants(runs, refocusnet_weights)
    contestants += [
        benchmark.variant_contestant(path, configs, runs, light_fields) for path in variants
    ]
    path = benchmark.run_contest(contestants, test_sets, out, step_bar)
    click.echo(path.read_text(encoding="utf-8"))


def _as_numbers(text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise InputError(f"Slopes are numbers with commas between, got {text!r}.") from None
