"""The command that sets refocusing systems side by side: compare."""

from pathlib import Path

import click
import cloup

from experiments.command_parts import quiet_tensorflow
from experiments.paths import DATA_SETS
from lf_flame.commands.options import FILE, FOLDER, PATH, RUN
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
@click.option(
    "--light-fields",
    type=click.IntRange(1),
    default=8,
    show_default=True,
    help="Number of light fields in a test set.",
)
@click.option(
    "--photograph",
    "photographs",
    type=(PATH, str),
    multiple=True,
    metavar="LIGHT_FIELD SLOPES",
    help="Light field of a camera, and slopes such as -1,0,1; may be repeated.",
)
@click.option("--refocusnet-weights", type=FILE, help="The authors' trained weights (.npz).")
@click.option(
    "--variant", "variants", type=RUN, multiple=True,
    help="Another run of the paper's network; may be repeated.",
)  # fmt: skip
def compare(runs, out, data, light_fields, photographs, refocusnet_weights, variants) -> None:
    """Compare refocusing systems: accuracy, views, training, time and memory.

    RUNS holds the trained networks, one folder each, as `lf-flame train-system` and
    `make tables` leave them. What is missing shows as missing. Systems are trained for about the
    same time; the report states the views, steps and seconds that each one got, and names those
    that were trained for another time.

    Test sets are light fields that no network was trained on: the test splits of the ResNet-50s in
    RUNS (where there is none, the last light fields of a data set), the same scenes with their
    objects at other depths, and photographs. The reference is shift-and-sum of all views. Run it
    on a machine that does nothing else.

    \b
      python -m experiments compare RUNS
      python -m experiments compare RUNS --photograph FOLDER_OF_VIEWS -1,0,1
    """  # noqa: D301 - click reads the backspace
    load_keras()
    quiet_tensorflow()
    from experiments.held_out import find_scenes
    from experiments.systems import compared
    from experiments.systems.comparison import run_comparison
    from lf_flame.datasets.config import read_config
    from lf_flame.formats import read_light_field

    configs = [read_config(path) for path in data]
    tested = [find_scenes(config, runs / config.kind, light_fields) for config in configs]
    test_sets = [
        test_set
        for config, held_out in zip(configs, tested, strict=True)
        for test_set in compared.paper_sets(config, held_out, light_fields)
    ]
    for path, slopes in photographs:
        try:
            numbers = [float(part) for part in slopes.split(",")]
        except ValueError:
            raise InputError(f"Slopes are numbers with commas between, got {slopes!r}.") from None
        test_sets.append(compared.photograph_set(path.name, read_light_field(path), numbers))
    entries = compared.formula_entries() + compared.trained_entries(runs, refocusnet_weights)
    for path in (*(runs / kind for kind in ("shapes", "flames")), *variants):
        entries.append(compared.resnet_entry(path, tested))
    click.echo(run_comparison(entries, test_sets, out).read_text(encoding="utf-8"))
