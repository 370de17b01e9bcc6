"""The command that makes data sets.

As in `lf_flame.commands.cli`, heavy modules are imported inside the command.
"""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click
import cloup

from lf_flame.commands.options import FILE, FOLDER
from lf_flame.commands.workers import WORKERS, Crew
from lf_flame.errors import InputError

if TYPE_CHECKING:
    from lf_flame.datasets.config import DatasetConfig


@cloup.command()
@click.argument("config", type=FILE)
@click.option("--preset", default="paper", show_default=True, help="A key of [samples] in CONFIG.")
@click.option("--out", type=FOLDER, required=True, help="Folder of the Zarr group to make.")
@click.option(
    "--route",
    type=click.Choice(["rays", "exact", "direct"]),
    help="Route, in place of CONFIG's: through light fields, by traced rays (the default) or in "
    "closed form (exact); or directly from the scene.",
)
@WORKERS
def dataset(
    config: Path,
    preset: str,
    out: Path,
    workers: int,
    route: Literal["rays", "exact", "direct"] | None,
    scheduler: str | None,
) -> None:
    """Simulate the data set that CONFIG describes; resumes an interrupted run.

    \b
      lf-flame dataset flames.toml --out flames.zarr
      lf-flame dataset big.toml --out /shared/big.zarr --scheduler tcp://node1:8786

    The workers of a cluster must have this package, and must find OUT under the same name. The
    bytes do not depend on the workers.
    """  # noqa: D301 - click reads the backspace
    from lf_flame._common.progress import progress_bar
    from lf_flame.datasets.config import read_config
    from lf_flame.datasets.encodings import SMALLEST
    from lf_flame.datasets.making import make_dataset

    crew = Crew(workers, scheduler)
    settings = read_config(config)
    height, width, _ = settings.input.shape(settings.image)
    if min(height, width) < SMALLEST:
        raise InputError(
            f"{config}: the input of the network would have {height} x {width} pixels, and "
            f"ResNet-50 needs {SMALLEST} or more along each side."
        )
    if route:
        settings = replace(settings, route=route)
    samples = settings.sample_count(preset)
    if out.exists():
        _check_finished(out, settings, samples)
        (out / "zarr.json").touch()  # for Make, which compares its date with that of CONFIG
        click.echo(f"{out} is complete: {samples} samples.")
        return
    click.echo(f"{samples} samples into {out}; first, the slopes of sharpest focus", err=True)
    with crew.executor() as executor:
        make_dataset(settings, samples, out, crew.processes, progress_bar, executor)
    (out / "zarr.json").touch()


def _check_finished(out: Path, settings: "DatasetConfig", samples: int) -> None:
    """Refuse a finished data set of another configuration or size."""
    from lf_flame.datasets.store import Dataset

    found = Dataset(out)
    if found.config != settings or len(found) != samples:
        raise InputError(
            f"{out} contains a data set of another configuration or size; remove it or choose "
            f"another folder."
        )
