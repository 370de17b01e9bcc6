"""The commands for data sets and networks: dataset, train, predict and train-system.

As in `lf_flame.commands.cli`, heavy modules are imported inside the commands.
"""

from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import click

from lf_flame._common.input_files import printable
from lf_flame.commands.options import (
    FILE,
    FOLDER,
    OVERWRITE,
    PATH,
    SEED,
    WORKERS,
    WorkerOptions,
    command,
    option,
    report,
    result_name,
)
from lf_flame.errors import InputError
from lf_flame.learning.keras_loading import load_keras


@command()
@click.argument("config", type=FILE)
@option("--preset", "A key of [samples] in CONFIG.", default="paper")
@option("--out", "Folder of the Zarr group to make.", FOLDER, required=True)
@option(
    "--route",
    "Route, in place of CONFIG's: through light fields, by traced rays (the default) or in closed "
    "form (exact); or directly from the scene.",
    click.Choice(["rays", "exact", "direct"]),
)
@WORKERS
def dataset(config: Path, preset: str, out: Path, workers, route, scheduler) -> None:
    """Simulate the data set that CONFIG describes; resumes an interrupted run.

    \b
      lf-flame dataset flames.toml --out flames.zarr
      lf-flame dataset big.toml --out /shared/big.zarr --scheduler tcp://node1:8786

    The workers of a cluster must have this package, and must find OUT under the same name. The
    bytes do not depend on the workers.
    """  # noqa: D301 - click reads the backspace
    from lf_flame.datasets.config import read_config
    from lf_flame.datasets.encodings import SMALLEST
    from lf_flame.datasets.making import make_dataset
    from lf_flame.datasets.store import Dataset

    crew = WorkerOptions(workers, scheduler)
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
    if (out / "zarr.json").exists():
        found = Dataset(out)
        # Further presets leave a data set as it is.
        if replace(found.config, samples=settings.samples) != settings or len(found) != samples:
            raise InputError(
                f"{out} contains a data set of another configuration or size; remove it or choose "
                f"another folder."
            )
        click.echo(f"{printable(out)} is complete: {samples} samples.")
        with suppress(OSError):  # of others: Make comes again
            (out / "zarr.json").touch()  # for Make, which compares its date with that of CONFIG
    else:
        report(f"{samples} samples into {out}; first, the slopes of sharpest focus")
        with crew.executor() as executor:
            make_dataset(settings, samples, out, crew.processes, executor)


@command()
@click.argument("config", type=FILE)
@option("--data", "Data set to train on.", FOLDER)
@option("--out", "Run folder: checkpoints, model, record.", FOLDER)
@option("--preset", "A key of [presets] in CONFIG.", default="paper")
@option("--backbone-weights", "Weights of ResNet-50: imagenet, random, or a file (.h5, .npz).")
@option(
    "--backbone-depth",
    "Stage of ResNet-50 after which it is cut; none: no ResNet, the picture itself.",
    click.Choice(["conv3", "conv4", "conv5", "none"]),
)
@option("--seed", "Seed of split, weights, batches and dropout, in place of CONFIG's.", SEED)
@option("--epochs", "Number of epochs, in place of the preset's; may be raised later.", int)
@option("--minutes", "Time limit of this call, preparation included; 0: none.", float, default=0.0)
def train(config, preset, data, out, backbone_weights, backbone_depth, seed, epochs, minutes):
    """Train the network that CONFIG describes; resumes an interrupted run.

    After --minutes, or Ctrl-C, the same command resumes after the last epoch that was saved. After
    --minutes the run folder contains the best network so far; after Ctrl-C, the last checkpoint.
    ImageNet weights are downloaded once, into Keras's cache (~/.keras/models, or KERAS_HOME).
    Without --data and --out, the weights are found and checked, and nothing is trained.

    \b
      lf-flame train flames.toml
      lf-flame train flames.toml --data flames.zarr --out runs/flames --minutes 60
    """  # noqa: D301 - click reads the backspace
    if (data is None) != (out is None):
        raise InputError("--data and --out need each other: without both, only weights are found.")
    from lf_flame.datasets.store import Dataset
    from lf_flame.learning.training_config import read_training_config

    options = {"backbone_weights": backbone_weights, "backbone_depth": backbone_depth}
    settings = read_training_config(config, **options)
    if seed is not None:
        settings = replace(settings, seed=seed)
    if epochs is not None:
        settings = settings.with_epochs(preset, epochs)
    settings.recipe(preset)
    if data is not None:
        data = data.absolute()  # "." has no name
        Dataset(data)  # refuses anything but a data set, before Keras is loaded
    load_keras()
    from lf_flame.learning.backbone import build_backbone
    from lf_flame.learning.training import find_weights, train

    if data is None:
        source, described = find_weights(settings, preset)
        build_backbone(weights=source, depth=settings.model.backbone_depth)
        click.echo(f"Weights of the backbone: {described}.")
    else:
        train(settings, preset, data, out, minutes=minutes)


@command()
@click.argument("images", type=PATH, nargs=-1, required=True)
@option("--model", "Run folder of `lf-flame train`.", FOLDER, required=True)
@option("--out", "Results folder.", FOLDER, default="predicted")
@OVERWRITE
def predict(images: tuple[Path, ...], model: Path, out: Path, overwrite: bool) -> None:
    """Let a trained network refocus IMAGES.

    The network has memorised the depth of each object, from the pictures of one camera and one
    kind of scene: its input image contains no parallax. In any other scene its output is invented,
    and looks like its training pictures. To refocus a light field as it is, use `lf-flame refocus`.
    An image is a picture of 8 or 16 bits (raw lenslet images too), or a light field in views. It is
    averaged over blocks to the network's size, or single pixels are taken (input "central"), or it
    is interpolated where no block fits. OUT/IMAGE receives the refocused images and a record.

    \b
      lf-flame predict photograph.png --model runs/paper/flames
    """  # noqa: D301 - click reads the backspace
    from lf_flame._common.atomic_files import refuse_folder

    folders = [out / result_name(image) for image in images]
    for image, folder in zip(images, folders, strict=True):
        if folders.count(folder) > 1:
            raise InputError(
                f"{image} and another image would both go into {folder}; run twice (--out)."
            )
        refuse_folder(folder, "prediction.json", overwrite=overwrite)
    from lf_flame.learning.prediction import predict, read_input
    from lf_flame.learning.run_folders import open_run

    run = open_run(model)
    encoding, size = run.config.input, run.config.image
    inputs = [read_input(image, size, encoding) for image in images]
    for seen in inputs:
        for note in seen.notes:
            report(f"{printable(seen.source)}: {note}")
    load_keras()
    network = run.load_network()
    for prediction, folder in zip(predict(network, inputs), folders, strict=True):
        prediction.write(run, folder, overwrite=overwrite)
        source, place = printable(prediction.seen.source), printable(folder)
        click.echo(f"{source}: refocused in {prediction.ms:.0f} ms, in {place}")


@command("train-system")
@click.argument("system")
@option("--config", "TOML file with [systems] and [presets].", FILE, required=True)
@option("--preset", "A key of [presets] in CONFIG.", default="equal-seconds")
@option("--seed", "Seed of samples, weights and patches, in place of CONFIG's.", SEED)
@option("--out", "Run folder: checkpoints, model, record.", FOLDER, required=True)
def train_system(system: str, config: Path, preset: str, seed: int | None, out: Path) -> None:
    """Train a refocusing SYSTEM; resumes an interrupted run.

    SYSTEM is a key of [systems] in CONFIG. All learn from the same training samples: new random
    light fields, whose objects are at other depths in each, and dead leaves, at several slopes. The
    target is shift-and-sum of all views.

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
    click.echo(f"{printable(path)} is trained")
