"""The commands of `lf-flame` for refocusing systems: train-system.

As in `lf_flame.cli`, heavy modules are imported inside the commands.
"""

from pathlib import Path

import click

from lf_flame.keras_loading import load_keras
from lf_flame.light_field_commands import FILE, FOLDER


@click.command("train-system")
@click.argument("system")
@click.option("--config", type=FILE, default="experiments/systems.toml", show_default=True)
@click.option("--preset", default="quick", show_default=True, help="A key of [presets] in CONFIG.")
@click.option("--out", type=FOLDER, required=True, help="Run folder: checkpoints, model, record.")
def train_system(system: str, config: Path, preset: str, out: Path) -> None:
    """Train a refocusing SYSTEM; goes on where a run was cut off.

    SYSTEM is a key of [systems] in CONFIG. All learn from the same lessons: light fields drawn
    anew, with every object at a depth of its own, each seen at several slopes; what they should
    draw is shift-and-sum of all views.

    \b
      refocusnet   four aligned views (Ben Dayan et al. 2020), the published layers
      refnet       7 x 7 views into sixteen images (Hedayati et al. 2021), our reading
      volumetric   a cross of 17 views, ghosts removed by a U-Net (Samarakoon et al. 2025)
    """  # noqa: D301 - click reads the backspace
    load_keras()
    from lf_flame.systems.learning import read_systems_config, train_system

    path = train_system(read_systems_config(config), system, preset, out)
    click.echo(f"{path} is trained")
