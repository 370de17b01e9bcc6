"""A trained network in a file, and the card that describes it.

In a run folder the network is ``model.keras``; the run's record and its data set describe it. An
exported network is ``NAME.keras``, which Keras loads without this package, and ``NAME.json``, its
card.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lf_flame._common import provenance
from lf_flame._common.atomic_files import atomic_write, write_json
from lf_flame._common.config import load_record, to_json
from lf_flame._common.locks import exclusive
from lf_flame.datasets.encodings import InputEncoding
from lf_flame.errors import InputError
from lf_flame.learning.keras_loading import load_model
from lf_flame.learning.run_folders import open_run
from lf_flame.optics.camera import PlenopticCamera

if TYPE_CHECKING:
    import keras

USAGE = (
    "network.predict(x)[..., 0] with x float32 [n, {}, {}, {}], from 0 to 1, linear in radiance, "
    "averaged over blocks of pixels: {}; gives [n, planes, height, width] from 0 to 1, sized as "
    "`image` says, refocused at `depths_mm`, positive = behind the focal plane."
)

SHOWN = {
    "raw": "a grey picture",
    "views": "the leftmost, central and rightmost view of the middle row, as channels",
    "grid": "views from all over the main lens, side by side",
}
"""Description of the input by its kind."""


@dataclass(frozen=True)
class NetworkCard:
    """Description of a trained network for its users.

    Parameters
    ----------
    title, preset : str
        Title and preset of the training.
    backbone_weights : str
        Weights of the backbone that were used.
    image : (int, int)
        Height and width of the output.
    depths_mm, slopes : list of float
        Depth and slope at which each output image is refocused; positive = behind the focal plane
        of `camera`, slopes in its lenslets per view step.
    objects : list of str
        Names of the objects at these depths in every training image.
    camera : PlenopticCamera
        Camera of the training images.
    training : dict
        Other entries of the run's record.
    input : InputEncoding, optional
        Encoding of a light field as the network's input.
    exported : dict, optional
        Program that exported it, see `lf_flame._common.provenance.environment`.
    usage : str, optional
        Description of inputs and outputs.
    """

    title: str
    preset: str
    backbone_weights: str
    image: tuple[int, int]
    depths_mm: list[float]
    slopes: list[float]
    objects: list[str]
    camera: PlenopticCamera
    training: dict[str, Any]
    input: InputEncoding = InputEncoding()
    exported: dict[str, Any] = field(default_factory=dict)
    usage: str = ""

    def __post_init__(self):
        planes = len(self.depths_mm)
        if min(self.image) < 1 or not planes == len(self.slopes) == len(self.objects) > 0:
            raise InputError(
                f"image must be two numbers above 0, and depths_mm, slopes and objects as many as "
                f"there are planes, got {self.image}, {planes}, {len(self.slopes)} and "
                f"{len(self.objects)}."
            )


def read_card(path: str | Path) -> NetworkCard:
    """Read the description of a trained network, without loading it.

    Parameters
    ----------
    path : str or Path
        Folder of a finished run, or an exported ``.keras`` file.

    Raises
    ------
    InputError
        If there is no network, or its card is missing or damaged.
    """
    path = Path(path)
    if path.is_dir():
        return _card_of_run(path)
    if not path.is_file():
        raise InputError(
            f"There is no trained network {path}: it must be a run folder, or a .keras file that "
            f"`lf-flame export` wrote."
        )
    beside = path.with_suffix(".json")
    if not beside.is_file():
        raise InputError(
            f"{path} has no {beside.name} beside it, which `lf-flame export` writes; of a network "
            f"that was not exported, name the run folder."
        )
    return load_record(NetworkCard, beside)


def _card_of_run(folder: Path) -> NetworkCard:
    run = open_run(folder)
    config, record = run.config, dict(run.record)
    shape = config.input.shape(config.image)
    named = {key: record.pop(key) for key in ("title", "preset", "backbone_weights")}
    model = {k: v for k, v in record["model"].items() if k != "backbone_weights"}  # asked for
    left_out = ("test_indices", "dataset", "data", "model")
    training = {k: v for k, v in record.items() if k not in left_out} | {"model": model}
    return NetworkCard(
        **named,
        image=config.image,
        depths_mm=config.depths_mm,
        slopes=run.slopes,
        objects=run.objects,
        camera=config.camera,
        training=training,
        input=config.input,
        usage=USAGE.format(*shape, SHOWN[config.input.kind]),
    )


def load_network(path: str | Path, card: NetworkCard) -> "keras.Model":
    """Load a trained network; only Keras's own code is run.

    Parameters
    ----------
    path : str or Path
        Folder of a finished run, or an exported ``.keras`` file.
    card : NetworkCard
        Card of the network, from `read_card`.

    Returns
    -------
    keras.Model
        Network for prediction, not compiled.

    Raises
    ------
    InputError
        If the file is not a Keras file, is damaged, needs other code, or has inputs or outputs of
        other shapes than the card states.
    """
    stated = card.input.shape(card.image), (len(card.depths_mm), *card.image, 1)
    return load_model(_model_file(Path(path)), stated)


def export_network(run: str | Path, out: str | Path) -> None:
    """Write a run's network for use elsewhere: ``NAME.json``, its card, and ``NAME.keras``.

    Parameters
    ----------
    run : str or Path
        Folder of a finished run.
    out : str or Path
        Name of the ``.keras`` file, outside that folder.

    Raises
    ------
    InputError
        If the run is not finished, `out` is not such a file, or ``NAME.json`` is not a card.
    """
    run, out = Path(run), Path(out)
    beside = out.with_suffix(".json")
    if out.suffix != ".keras" or out.resolve().parent == run.resolve():
        raise InputError(f"A network is exported to a .keras file outside of its run, got {out}.")
    card = read_card(run)
    with exclusive(out):
        if beside.exists() and not _is_card(beside):
            raise InputError(f"{beside} is no network's card, and is not replaced; name another.")
        network = load_network(run, card)
        with atomic_write(out) as aside, atomic_write(beside) as card_aside:
            network.save(aside)
            write_json(card_aside, to_json(replace(card, exported=provenance.environment())))
            out.unlink(missing_ok=True)  # a kill leaves no older network beside the new card


def _is_card(path: Path) -> bool:
    try:
        load_record(NetworkCard, path)
    except InputError:
        return False
    return True


def _model_file(path: Path) -> Path:
    return path / "model.keras" if path.is_dir() else path
