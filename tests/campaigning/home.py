"""A small home: one file of every kind that the commands read, made by the commands themselves."""

import os
import shutil
from pathlib import Path

import numpy as np
from PIL import Image

from campaigning.commands import PLANES
from campaigning.contents import contents, describe
from campaigning.processes import call
from campaigning.verdicts import fault
from campaigning.warm_process import WarmProcess

LARGE = 1 << 20
"""Bytes from which on a file is linked instead of copied: nothing writes into a finished file."""

CAMERA = """
[camera]
main_lens_focal_mm = 150.0
focus_distance_mm = 326.0
lenslet_focal_mm = {focal}
lenslet_pitch_mm = {pitch}
views = 3
lenslets = {lenslets}
"""

SCENE = (
    CAMERA.format(focal=0.4, pitch=0.112, lenslets=[40, 48])
    + """
[[layers]]
shape = "circle"
depth_mm = 5.0
size_mm = [1.5, 1.5]
centre_mm = [0.0, -0.8]
brightness = 0.6

[[layers]]
image = "card.png"
depth_mm = -10.0
size_mm = [1.0, 1.0]
centre_mm = [0.0, 1.5]
brightness = 0.7
"""
)

OBJECT = """
[[template.objects]]
shape = "{}"
depth_mm = {}
size_mm = [8.0, 6.0]
centre_mm = [0.0, {}]
"""

OBJECTS = (("rectangle", 20.0, -12), ("triangle", 10.0, -4), ("circle", 0.0, 4),
           ("square", -10.0, 12))  # fmt: skip

SHAPES = (
    'kind = "shapes"\nseed = 5\nimage = [32, 64]\n[samples]\nfew = 10\nsmoke = 40\n'
    + CAMERA.format(focal=2.4, pitch=0.672, lenslets=[32, 64])
    + "[template]\nposition_mm = 0.4\nsize = 0.08\nbrightness = [0.85, 1.0]\n"
    + "".join(OBJECT.format(*one) for one in OBJECTS)
)

TRAINING = """
title = "Shapes"
seed = 1
split = [0.6, 0.2, 0.2]

[model]
backbone_weights = "random"
backbone_depth = "conv4"

[presets.smoke]
epochs = 2
batch_size = 2
checkpoint_s = 0
"""

SYSTEMS = """
seed = 1
checkpoint_s = 0

[training_samples]
data = ["shapes.toml"]
slopes = 2

[presets.smoke]
training_samples = 2
held_out = 1
steps_per_epoch = 2

[systems.refocusnet]
epochs = 2
patch = 24
"""

TEXTS = {"scene.toml": SCENE, "shapes.toml": SHAPES, "training.toml": TRAINING,
         "systems.toml": SYSTEMS}  # fmt: skip

LIGHT = (
    "simulate scene.toml --out simulated",
    "convert simulated/light_field.npz light_field.npy",
    "convert simulated/light_field.npz views --bits 8",
    "convert views lenslets.tif",
    "refocus views --slope 0.5 --out refocused",
    f"reconstruct light_field.npy {PLANES} --out emission",
    "dataset shapes.toml --preset few --out data.zarr --workers 1",
    "dataset shapes.toml --preset smoke --out later.zarr --workers 1",
)
"""Commands that fill the home, in seconds."""

LEARNT = (
    "train training.toml --preset smoke --data data.zarr --out run",
    "train training.toml --preset smoke --data data.zarr --out begun --epochs 1",
    "train-system refocusnet --config systems.toml --preset smoke --out system",
    "export run --out net.keras",
    "predict picture.png --model run --out predicted",
)
"""... and with TensorFlow."""

EVALUATED = "evaluate run --table table1 --figure figure7 --out results"


class Home:
    """The files, and copies of them.

    Parameters
    ----------
    folder : Path
        Where to make them; a folder for each copy comes beside.
    learning : bool
        Whether to train networks too, which takes a minute.
    """

    def __init__(self, folder: Path, learning: bool = True):
        self.folder = folder
        folder.mkdir(parents=True)
        self._write_inputs()
        warm = WarmProcess(folder.with_name("warm-home"), learning)
        try:
            for line in LIGHT + (LEARNT if learning else ()):
                self._call(warm, ["lf_flame", *line.split()])
            if learning:
                self._call(warm, ["experiments", *EVALUATED.split()])
                _take_back(folder / "begun", "model.keras", "run.json")
        finally:
            warm.end()
        self._begin_dataset()
        self.known = {
            path.stat().st_ino: describe(path)
            for path in folder.rglob("*")
            if path.is_file() and path.stat().st_size > LARGE
        }
        self.contents = contents(folder, self.known)

    def _write_inputs(self) -> None:
        for name, text in TEXTS.items():
            (self.folder / name).write_text(text, encoding="utf-8")
        rng = np.random.default_rng(1)
        Image.fromarray(np.full((8, 8), 128, np.uint8)).save(self.folder / "card.png")
        picture = rng.integers(0, 255, (96, 192), np.uint8)
        Image.fromarray(picture).save(self.folder / "picture.png")
        (self.folder / "frames").mkdir()
        for k, flame in enumerate(_frames()):
            Image.fromarray(flame).save(self.folder / "frames" / f"frame{k:02d}.png")
        white, raw = _raw_images(rng)
        Image.fromarray(white).save(self.folder / "white.png")
        Image.fromarray(raw).save(self.folder / "raw.png")

    def _call(self, warm: WarmProcess, words: list[str]) -> None:
        outcome = warm.call(words, self.folder, 300.0)
        if wrong := fault(outcome, (0,)):
            raise RuntimeError(f"{' '.join(words)}: {wrong}\n{outcome.err}")

    def _begin_dataset(self) -> None:
        """Make a data set that was cut off: its last shard is missing."""
        part = (self.folder / "later.zarr").rename(self.folder / "later.zarr.part")
        for chunk in (*part.glob("*/c/2"), *part.glob("parameters/*/c/2")):
            shutil.rmtree(chunk) if chunk.is_dir() else chunk.unlink()

    def check(self) -> None:
        """Refuse to go on if a command has changed the files through one of the copies."""
        if contents(self.folder) != self.contents:
            raise RuntimeError("A command has written into a file that was finished.")

    def copy(self, place: Path) -> Path:
        """Copy it, large files by a second name for the same content."""
        shutil.copytree(self.folder, place, symlinks=True, copy_function=_copy_or_link)
        return place

    def changes(self, place: Path) -> dict[str, str]:
        """Describe what a copy holds that is new or has changed; what is gone is "gone"."""
        now = contents(place, self.known)
        new = {name: what for name, what in now.items() if self.contents.get(name) != what}
        return new | dict.fromkeys(self.contents.keys() - now.keys(), "gone")


def _raw_images(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Draw the white image of round micro-images, 10 pixels apart, and a raw image behind it."""
    y, x = np.indices((160, 200)) % 10 - 4.7
    white = 0.05 + 0.95 * np.clip(5.0 - np.hypot(y, x), 0, 1)
    scene = np.kron(rng.uniform(0.2, 1.0, (16, 20)), np.ones((10, 10)))
    return tuple(np.rint(255 * image).astype(np.uint8) for image in (white, white * scene))


def _frames() -> list[np.ndarray]:
    """Draw a column of light that flickers, as lenslet images of 3 x 3 views."""
    y, x = np.indices((24, 24))
    column = abs(x - 12) < 5
    return [np.where(column & (y > 8 + 4 * np.sin(k)), 200, 0).astype(np.uint8) for k in range(16)]


def _copy_or_link(source: str, target: str) -> None:
    if Path(source).stat().st_size > LARGE:
        os.link(source, target)
    else:
        shutil.copy2(source, target)


def _take_back(folder: Path, *names: str) -> None:
    for name in names:
        (folder / name).unlink()


def reference(command, home: Home, place: Path) -> tuple[dict[str, str], float]:
    """Call a command undisturbed: what has changed, and after how many seconds."""
    copy = home.copy(place)
    outcome = call(command.words, copy)
    if wrong := fault(outcome, (0,)):
        raise RuntimeError(f"{command.name}: {wrong}\n{outcome.err}")
    return home.changes(copy), outcome.seconds
