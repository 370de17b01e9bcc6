"""Prediction: the refocused images that a trained network makes from one image."""

import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from skimage.color import rgb2gray
from skimage.transform import resize

from lf_flame._common.atomic_files import output_folder, recorded_path
from lf_flame.datasets.encodings import InputEncoding
from lf_flame.errors import InputError
from lf_flame.formats import write_focal_stack
from lf_flame.formats.images import to_preview, write_image
from lf_flame.formats.reading import find_light_field, kind_of
from lf_flame.learning.run_folders import TrainedRun
from lf_flame.lightfield import LightField

if TYPE_CHECKING:
    import keras

ASPECT_TOLERANCE = 0.02
"""Largest relative difference between an image's aspect ratio and the network's."""


@dataclass(frozen=True, eq=False)
class NetworkInput:
    """An image in the form that the network receives: float32, shape (h, w), values in [0, 1].

    `notes` are sentences on changes to it, other than area averaging.
    """

    source: Path
    image: np.ndarray
    notes: list[str]


def read_input(
    source: str | Path, size: tuple[int, int], encoding: InputEncoding | None = None
) -> NetworkInput:
    """Read an image or a light field, and bring it to the network's size as in training.

    It is area-averaged if the network's size divides its size (deviation 5: a raw lenslet image and
    the photograph of its light field therefore are the same input), else interpolated. With the
    encoding "central", pixels of the image, or of the central view, are picked, not averaged.

    Parameters
    ----------
    source : str or Path
        Image or light field, see `lf_flame.formats.read_light_field`; colours become luminance
        (Rec. 709).
    size : (int, int)
        Height and width of the network's images.
    encoding : InputEncoding, optional
        Encoding of the network's input, "raw" (the default) or "central".

    Raises
    ------
    InputError
        If it cannot be read, has NaN or infinite values, or another aspect ratio than `size`, or
        if the encoding takes several views.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.learning import read_input
    >>> np.save("picture.npy", np.random.default_rng(1).uniform(size=(3, 3, 90, 180)))
    >>> read_input("picture.npy", (90, 180)).image.shape
    (90, 180)
    """
    source, encoding = Path(source), encoding or InputEncoding()
    if encoding.kind not in ("raw", "central"):
        raise InputError(
            f"This network takes several views ({encoding.kind!r}), not a picture; in Python, "
            f"`lf_flame.systems.ResNet50.of_run(RUN).refocus(light_field, slopes, block)` does."
        )
    picture, notes = _read_grey(source, encoding)
    (height, width), (rows, columns) = picture.shape, size
    if abs((width * rows) / (height * columns) - 1) > ASPECT_TOLERANCE:
        raise InputError(
            f"{source} has {height} x {width} pixels, {width / height:.3g} times as wide as high; "
            f"crop it to {columns / rows:.3g} times, as the network's {rows} x {columns} are "
            f"(within {ASPECT_TOLERANCE:.0%})."
        )
    low, high = picture.min(), picture.max()
    if low < 0 or high > 1:
        notes.append(f"values from {low:.3g} to {high:.3g}: cut off below 0 and above 1")
    if height % rows or width % columns:
        notes.append(f"{height} x {width} is not a multiple of {rows} x {columns}: interpolated")
        picture = resize(picture, size, anti_aliasing=encoding.kind == "raw")
    shown = encoding.encode(LightField(picture[None, None]), size)
    return NetworkInput(source, shown[..., 0], notes)


def _read_grey(source: Path, encoding: InputEncoding) -> tuple[np.ndarray, list[str]]:
    """Read the mean view of a light field, or its central one, and notes; an image is one view."""
    try:
        takes_views = "views" in kind_of(source, {})[2].split()
        found = find_light_field(source, views=1 if takes_views else None)
        light_field = found.light_field
        views = light_field.filled[encoding.view_mesh(*light_field.shape[:2])]
        shown = views.any(axis=tuple(range(2, views.ndim)))
        if light_field.weights is not None and not shown.all():
            raise InputError("a view of the network's input is missing, or black; give raw images.")
        picture = views.mean(axis=(0, 1), dtype=np.float64)  # excluded ones, too, as in training
    except InputError as error:
        if str(source) in str(error):
            raise
        raise InputError(f"{source}: {error}") from None
    if picture.shape[2:] not in ((), (3,)):
        raise InputError(f"{source} must be grey or have 3 channels, got {picture.shape[2]}.")
    return rgb2gray(picture) if picture.ndim == 3 else picture, list(filter(None, [found.coded]))


@dataclass(frozen=True, eq=False)
class Prediction:
    """Refocused images `stack`, float32, shape (planes, h, w), that a network made from one image.

    `ms` is the time from input to stack in milliseconds, for a network that is loaded and compiled.
    """

    seen: NetworkInput
    stack: np.ndarray
    ms: float

    def write(self, run: TrainedRun, out: Path, *, overwrite: bool = False) -> None:
        """Write images, stack and record into a folder; `overwrite` that of an earlier run.

        The folder `out` receives ``refocused.tif`` (stack, float32), ``refocused_N_DEPTHmm.png``
        and ``prediction.json`` (record).
        """
        planes = enumerate(zip(run.config.depths_mm, self.stack, strict=True), 1)
        with output_folder(out, "prediction.json", overwrite=overwrite) as folder:
            write_focal_stack(self.stack, run.slopes, folder.path("refocused.tif"))
            for number, (depth, image) in planes:
                picture = folder.path(f"refocused_{number}_{depth:+g}mm.png")
                write_image(picture, to_preview(image, 1.0))
            folder.facts |= {
                "source": recorded_path(self.seen.source, out),
                "notes": self.seen.notes,
                "ms": round(self.ms, 3),
                "network": run.record,
            }


def predict(network: "keras.Model", inputs: Iterable[NetworkInput]) -> Iterator[Prediction]:
    """Refocus images with a network, one by one.

    Parameters
    ----------
    network : keras.Model
        Network from `lf_flame.learning.run_folders.TrainedRun.load_network`.
    inputs : iterable of NetworkInput
        Inputs from `read_input`.

    Yields
    ------
    Prediction
        Refocused images for each input, with the time taken.
    """
    network.predict_on_batch(np.zeros((1, *network.input_shape[1:]), np.float32))  # compiles
    for seen in inputs:
        started = time.perf_counter()
        stack = network.predict_on_batch(seen.image[None, ..., None])[0, ..., 0]
        yield Prediction(seen, stack, 1e3 * (time.perf_counter() - started))
