"""The commands of `lf-flame` that use a trained network: export, predict and latency.

As in `lf_flame.commands.cli`, heavy modules are imported inside the commands.
"""

import logging
from pathlib import Path

import click

from lf_flame._common.keras_loading import load_keras
from lf_flame.commands.light_fields import FOLDER
from lf_flame.errors import InputError


@click.command()
@click.argument("run", type=FOLDER)
@click.option(
    "--out",
    type=click.Path(dir_okay=False, path_type=Path),
    required=True,
    help="The .keras file to write.",
)
def export(run: Path, out: Path) -> None:
    """Write the network of a finished RUN so that others can use it.

    FILE.keras holds the whole network, backbone included, in layers of Keras's own: no pickled
    code, and none of this package is needed to load it. FILE.json beside it, its card, says what
    the network takes and makes, and how it was trained.

    \b
      lf-flame export runs/quick/flames --out flames.keras
      python -c 'import keras; keras.saving.load_model("flames.keras").summary()'
    """  # noqa: D301 - click reads the backspace
    load_keras()
    from lf_flame.learning.model_card import export_network

    export_network(run, out)
    size = out.stat().st_size / 1e6
    click.echo(f"{out} ({size:.0f} MB) and {out.with_suffix('.json')} are written")


@click.command()
@click.argument("images", type=click.Path(path_type=Path), nargs=-1, required=True)
@click.option(
    "--model",
    type=click.Path(path_type=Path),
    required=True,
    help="Run folder, or a .keras file that `lf-flame export` wrote.",
)
@click.option("--out", type=FOLDER, default="predicted", show_default=True, help="Results folder.")
def predict(images: tuple[Path, ...], model: Path, out: Path) -> None:
    """Let a trained network refocus IMAGES.

    The network has learnt by heart which object stands at which depth, from the pictures of one
    camera and one kind of scene: the image that it sees holds no parallax. Of any other scene it
    makes something up, which looks like what it has learnt. To refocus a light field as it is,
    use `lf-flame refocus`.

    An image is a picture of 8 or 16 bits (.png, .jpg, .tif, ...; raw lenslet images too, colours
    become luminance), or a light field in views (folder, .npy, .npz, .tif of many pages). It is
    averaged over blocks of pixels to the network's size; where that does not divide its size, it
    is interpolated. Levels are taken as linear in radiance.

    Into OUT/IMAGE go refocused_N_DEPTHmm.png, refocused.tif (float32), prediction.png (input and
    planes side by side) and prediction.json, the record.

    \b
      lf-flame predict photograph.png --model runs/quick/flames
      lf-flame predict raw.png light_field.npz --model flames.keras
    """  # noqa: D301 - click reads the backspace
    folders = _result_folders(images, out)
    from lf_flame.learning.model_card import load_network, read_card
    from lf_flame.learning.prediction import input_size, predict, read_input

    card = read_card(model)
    size = input_size(card)
    inputs = [read_input(image, size) for image in images]
    for seen in inputs:
        for note in seen.notes:
            click.echo(f"{seen.source}: {note}", err=True)
    load_keras()
    network = load_network(model, card)
    for prediction, folder in zip(predict(network, inputs), folders, strict=True):
        prediction.write(card, folder)
        click.echo(f"{prediction.seen.source}: refocused in {prediction.ms:.0f} ms, in {folder}")


@click.command()
@click.argument("networks", type=click.Path(path_type=Path), nargs=-1, required=True)
@click.option("--out", type=FOLDER, required=True, help="Results folder.")
@click.option("--repeats", default=30, show_default=True, help="Rounds that count; 3 or more.")
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    help="Seed of the random raw image.",
)
def latency(networks: tuple[Path, ...], out: Path, repeats: int, seed: int) -> None:
    """Time trained NETWORKS on one picture; run it on a machine that does nothing else.

    A NETWORK is a run folder, or a .keras file that `lf-flame export` wrote. The clock runs from a
    raw lenslet image in memory, of the size of the network's camera, to the refocused images:
    stage by stage (resize, backbone, decoder) and in one go, at batch 1.

    Each network is timed in float32, bfloat16 and float16, and with its dense layers in int8 (Keras
    has no convolutions in int8), compiled by each compiler that the backend has. Fewer bits cost
    accuracy: beside each time stands how far the images are from float32's (PSNR in dB, higher is
    closer), and from the truth where a run folder names its test split. What this machine cannot do
    shows as missing, with the reason. Fewer bits need not be faster: that takes a processor, and a
    library, with arithmetic for them.

    The floor is the time to read weights and raw image once, at the bandwidth measured meanwhile.

    OUT gets latency.csv, .md, .png and .json, the record.

    \b
      lf-flame latency runs/quick/flames --out latency
      lf-flame latency flames.keras runs/quick/shapes --out latency --repeats 100
    """  # noqa: D301 - click reads the backspace
    load_keras()
    # TensorFlow finds it odd that network after network is compiled.
    logging.getLogger("tensorflow").setLevel(logging.ERROR)
    from experiments.costs import latency_report
    from experiments.costs.latency import measure_latency
    from lf_flame._common.progress import step_bar

    path = latency_report.write_report(out, *measure_latency(networks, repeats, seed, step_bar))
    click.echo(path.read_text(encoding="utf-8"))


def _result_folders(images: tuple[Path, ...], out: Path) -> list[Path]:
    """Give each image a folder of its own, named like it."""
    folders = []
    for image in images:
        folder = out / (image.resolve().name if image.is_dir() else image.stem)
        if folder in folders:
            raise InputError(
                f"{image} and another image would both go into {folder}; call twice (--out)."
            )
        if folder.resolve() == image.resolve():
            raise InputError(f"The pictures cannot go into the light field's own folder, {image}.")
        folders.append(folder)
    return folders
