"""The command that trains refocusing systems: train-system.

As in `lf_flame.commands.cli`, heavy modules are imported inside the commands.
"""

from dataclasses import replace
from pathlib import Path

import click
import cloup

from lf_flame.commands.options import FILE, FOLDER, SEED
from lf_flame.learning.keras_loading import load_keras


@cloup.command("train-system")
@click.argument("system")
@click.option("--config", type=FILE, required=True, help="TOML file with [systems] and [presets].")
@click.option(
    "--preset", default="equal-seconds", show_default=True, help="A key of [presets] in CONFIG."
)
@click.option(
    "--seed",
    type=SEED,
    help="Seed of training samples, weights and patches, in place of CONFIG's.",
)
@click.option("--out", type=FOLDER, required=True, help="Run folder: checkpoints, model, record.")
def train_system(system: str, config: Path, preset: str, seed: int | None, out: Path) -> None:
    """Train a refocusing SYSTEM; continues an interrupted run.

    SYSTEM is a key of [systems] in CONFIG. All learn from the same training samples: new random
    light fields, with every object at its own depth, each at several slopes. The target is
    shift-and-sum of all views.

    \b
      aperturenet      ours: nine aligned views, each for a ninth of the aperture
      refocusnet       four aligned views (Ben Dayan et al. 2020), the published layers
      refnet           7 x 7 views into sixteen images (Hedayati et al. 2021), our reading
      volumetric       a cross of 17 views, ghosts removed by a U-Net (Samarakoon et al. 2025)
      unet-nine-views  the same U-Net after ApertureNet's nine views
    """  # noqa: D301 - click reads the backspace
    load_keras()
    from lf_flame.systems.training import read_systems_config, train_system

    asked = read_systems_config(config)
    asked = asked if seed is None else replace(asked, seed=seed)
    path = train_system(asked, system, preset, out)
    click.echo(f"{path} is trained")
