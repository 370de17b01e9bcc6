"""The commands for the paper's network: train and predict.

As in `lf_flame.commands.cli`, heavy modules are imported inside the commands.
"""

from dataclasses import replace
from pathlib import Path

import click
import cloup

from lf_flame._common.printable import printable
from lf_flame.commands.options import FILE, FOLDER, OVERWRITE, PATH, SEED
from lf_flame.errors import InputError
from lf_flame.learning.keras_loading import load_keras


@cloup.command()
@click.argument("images", type=PATH, nargs=-1, required=True)
@click.option("--model", type=FOLDER, required=True, help="Run folder of `lf-flame train`.")
@click.option("--out", type=FOLDER, default="predicted", show_default=True, help="Results folder.")
@OVERWRITE
def predict(images: tuple[Path, ...], model: Path, out: Path, overwrite: bool) -> None:
    """Let a trained network refocus IMAGES.

    The network has memorised the depth of each object, from the pictures of one camera and one
    kind of scene: its input image holds no parallax. In any other scene its output is invented,
    and looks like its training pictures. To refocus a light field as it is, use `lf-flame refocus`.

    An image is a picture of 8 or 16 bits (.png, .jpg, .tif, ...; raw lenslet images too, colours
    become luminance), or a light field in views (folder, .npy, .npz, .tif of many pages). It is
    averaged over blocks of pixels to the network's size, or interpolated where that does not divide
    the image's size. Levels are taken as linear in radiance.

    OUT/IMAGE receives refocused_N_DEPTHmm.png, refocused.tif (float32), prediction.png (input and
    refocused images side by side) and prediction.json, the record.

    \b
      lf-flame predict photograph.png --model runs/paper/flames
      lf-flame predict raw.png light_field.npz --model runs/paper/flames
    """  # noqa: D301 - click reads the backspace
    from lf_flame._common.output_folders import refuse_folder

    folders = _result_folders(images, out)
    for folder in folders:
        refuse_folder(folder, "prediction.json", overwrite=overwrite)
    from lf_flame.learning.prediction import input_size, predict, read_input
    from lf_flame.learning.run_folders import open_run

    run = open_run(model)
    size = input_size(run)
    inputs = [read_input(image, size) for image in images]
    for seen in inputs:
        for note in seen.notes:
            click.echo(f"{printable(seen.source)}: {note}", err=True)
    load_keras()
    network = run.load_network()
    for prediction, folder in zip(predict(network, inputs), folders, strict=True):
        prediction.write(run, folder, overwrite=overwrite)
        source, place = printable(prediction.seen.source), printable(folder)
        click.echo(f"{source}: refocused in {prediction.ms:.0f} ms, in {place}")


def _result_folders(images: tuple[Path, ...], out: Path) -> list[Path]:
    """Give each image its own folder, named like it."""
    folders = []
    for image in images:
        folder = out / (image.resolve().name if image.is_dir() else image.stem)
        if folder in folders:
            raise InputError(
                f"{image} and another image would both go into {folder}; call twice (--out)."
            )
        folders.append(folder)
    return folders


@cloup.command()
@click.argument("config", type=FILE)
@click.option("--data", type=FOLDER, help="Data set to train on.")
@click.option("--out", type=FOLDER, help="Run folder: checkpoints, model, record.")
@click.option("--preset", default="paper", show_default=True, help="A key of [presets] in CONFIG.")
@click.option(
    "--backbone-weights", help="Weights of ResNet-50: imagenet, random, or a file (.h5, .npz)."
)
@click.option(
    "--backbone-depth",
    type=click.Choice(["conv3", "conv4", "conv5", "none"]),
    help="Stage of ResNet-50 after which it is cut; none: no ResNet, the picture itself.",
)
@click.option(
    "--seed",
    type=SEED,
    help="Seed of the split, the weights, the batches and the dropout, in place of CONFIG's.",
)
@click.option(
    "--epochs",
    type=int,
    help="Number of epochs, in place of the preset's; a finished run can continue to a larger one.",
)
@click.option(
    "--minutes",
    default=0.0,
    show_default=True,
    help="Time to stop at, at the nearest end of an epoch, with the best network so far; 0: none.",
)
def train(config, preset, data, out, backbone_weights, backbone_depth, seed, epochs, minutes):
    """Train the network that CONFIG describes; resumes an interrupted run.

    After --minutes, or Ctrl-C, the same command resumes after the last epoch that was saved. The
    run folder then holds the best network so far, and run.json the number of epochs.

    ImageNet weights are downloaded once, into Keras's cache (~/.keras/models, or KERAS_HOME).
    Without --data and --out, the weights are found and checked, and nothing is trained.

    \b
      lf-flame train flames.toml
      lf-flame train flames.toml --data flames.zarr --out runs/flames --minutes 60
    """  # noqa: D301 - click reads the backspace
    if (data is None) != (out is None):
        raise InputError("--data and --out go together: without both, only weights are found.")
    load_keras()
    from lf_flame.learning.backbone import build_backbone
    from lf_flame.learning.training import find_weights, train
    from lf_flame.learning.training_config import read_training_config

    options = {"backbone_weights": backbone_weights, "backbone_depth": backbone_depth}
    settings = read_training_config(config, **options)
    if seed is not None:
        settings = replace(settings, seed=seed)
    if epochs is not None:
        settings = settings.with_epochs(preset, epochs)
    if data is None:
        source, described = find_weights(settings, preset)
        build_backbone(weights=source, depth=settings.model.backbone_depth)
        click.echo(f"Weights of the backbone: {described}.")
    else:
        train(settings, preset, data, out, minutes=minutes)
