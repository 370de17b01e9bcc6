"""One small file of every kind that the commands read, and copies of what a call reads."""

import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory, mkdtemp
from typing import NamedTuple
from zipfile import ZipFile

import h5py
import lytro_files
import numpy as np
from builders import scene_toml
from focused_pictures import Camera, Waves
from PIL import Image
from scipy.io import savemat

from campaigning.contents import contents
from campaigning.processes import LIMIT_S, ROOT, Outcome, Process, fault
from campaigning.table import MADE, Call

CARD = 'image = "card.png"\ndepth_mm = -10.0\nsize_mm = [1.0, 1.0]\ncentre_mm = [0.0, 1.5]\n'
TEXTS = {
    "scene": f"{scene_toml(3, (24, 32))}brightness = 0.6\n[[layers]]\n{CARD}",
    "study": """
title = "Two decoders"
data = "shapes.toml"
training = "training.toml"
preset = "smoke"
samples = 20
common.model = { backbone_weights = "random", backbone_depth = "conv3" }
variants = [{ name = "one" }, { name = "other", recipe = { epochs = 1 } }]
""",
    "systems": """
seed = 1
checkpoint_s = 0
training_samples = { data = ["shapes.toml"], slopes = 2 }
presets.smoke = { training_samples = 2, held_out = 1, steps_per_epoch = 2 }
systems.refocusnet = { epochs = 2, patch = 24 }
""",
}
SMALLER = {
    "shapes": ("data_gen/shapes.toml", {
        "image": "[32, 64]", "lenslet_focal_mm": "2.4", "lenslet_pitch_mm": "0.672", "views": "3",
        "lenslets": "[32, 64]",
    }),
    "training": ("experiments/shapes.toml", {"checkpoint_s": "0"}),
}  # fmt: skip
"""Configurations of the repository, and what is smaller in ours."""


class Copy:
    """A copy of what a call reads, in a folder of its own."""

    def __init__(self, folder: Path, asked: Call):
        self.folder, self.asked, self.before = folder, asked, contents(folder)

    def changes(self) -> dict[str, str]:
        """Describe what is new or has changed; what is gone is "gone"."""
        now = contents(self.folder)
        new = {name: what for name, what in now.items() if self.before.get(name) != what}
        return new | dict.fromkeys(self.before.keys() - now.keys(), "gone")

    def call(self, words: list[str] | None = None, limit_s: float = LIMIT_S, **options) -> Outcome:
        """Make the call, or another one, there."""
        with Process(words or self.asked.words, self.folder, **options) as process:
            return process.wait(limit_s)


class Whole(NamedTuple):
    """What an undisturbed call leaves and takes."""

    folder: Path  # with what it read and wrote
    inputs: list[str]
    outputs: dict[str, str]  # description of what it wrote
    seconds: float
    changes: int  # how often its files were seen to change

    @property
    def largest(self) -> int:
        """Bytes of the largest file that it wrote."""
        paths = [self.folder / name for name in self.outputs]
        return max(path.stat().st_size for path in paths if path.is_file())


class Home:
    """The files that commands read, and what undisturbed calls make of them."""

    def __init__(self, folder: Path, quick: bool):
        self.quick, self._aside, self._wholes = quick, folder, {}
        self._home = folder / "home"
        self._home.mkdir()
        _write_inputs(self._home)
        for made in MADE:
            if not (quick and made.learns):
                outcome = Copy(self._home, made).call(limit_s=300.0)
                assert not fault(outcome, 0), f"{made.line}: {fault(outcome, 0)}"

    @contextmanager
    def copy(self, asked: Call, finished: bool = False) -> Iterator[Copy]:
        """Give a copy of what a call reads; or of that and what it wrote."""
        with TemporaryDirectory(dir=self._aside, ignore_cleanup_errors=True) as place:
            copy = Copy(self.add_inputs(asked, Path(place)), asked)
            if finished:
                shutil.copytree(self.whole(asked).folder, place, dirs_exist_ok=True)
            yield copy

    def add_inputs(self, asked: Call, folder: Path) -> Path:
        """Copy what a call reads into a folder, where it is not yet there."""
        for name in asked.reads:
            source, target = self._home / name, folder / name
            if source.exists() and not target.exists():
                target.parent.mkdir(parents=True, exist_ok=True)
                (shutil.copytree if source.is_dir() else shutil.copy2)(source, target)
        return folder

    def whole(self, asked: Call) -> Whole:
        """Make a call undisturbed, once."""
        if asked.line not in self._wholes:
            copy = Copy(self.add_inputs(asked, Path(mkdtemp(dir=self._aside))), asked)
            with Process(asked.words, copy.folder) as process:
                changes, seconds = process.watch(), process.seconds
                wrong = fault(process.wait(), 0)
            assert not wrong, f"{asked.line}, undisturbed: {wrong}"
            whole = Whole(copy.folder, list(copy.before), copy.changes(), seconds, changes)
            self._wholes[asked.line] = whole
        return self._wholes[asked.line]


def _write_inputs(folder: Path) -> None:
    for name, (source, values) in SMALLER.items():
        text = (ROOT / source).read_text()
        for key, value in values.items():
            text = re.sub(rf"(?m)^{key} = .*$", f"{key} = {value}", text)
        (folder / f"{name}.toml").write_text(text)
    for name, text in TEXTS.items():
        (folder / f"{name}.toml").write_text(text)
    rng = np.random.default_rng(1)
    # The white image of round micro-images, 10 pixels apart, and a raw image behind it.
    y, x = np.indices((160, 200)) % 10 - 4.7
    white = 12 + 240 * np.clip(5.0 - np.hypot(y, x), 0, 1)
    views = rng.integers(0, 255, (2, 1, 24, 30, 3), np.uint8)
    images = {
        "card": np.full((8, 8), 128), "picture": rng.integers(0, 255, (96, 192)), "white": white,
        "raw": white * np.kron(rng.uniform(0.2, 1.0, (16, 20)), np.ones((10, 10))),
        "view_0": views[0, 0], "view_1": views[1, 0],
    }  # fmt: skip
    # A picture behind focused lenslets, and their calibration.
    camera = Camera(shape=(160, 180), offset=(0.0, 0.0))
    images["focused"] = 255 * camera.record(3.1, Waves())
    (folder / "focused.xml").write_text(camera.xml())
    # A column of light that flickers, as lenslet images of 3 x 3 views.
    y, x = np.indices((24, 24))
    for k in range(16):
        lit = (abs(x - 12) < 5) & (y > 8 + 4 * np.sin(k))
        images[f"frames/frame{k:02d}"] = np.where(lit, 200, 0)
    # A checkerboard at three depths, as lenslet images of 3 x 3 views.
    for name, depth in {"near": -20, "middle": 0, "far": 25}.items():
        slope, side = 2 - 800 / (depth + 400), 4000 / (depth + 400)
        t, v, s, u = np.ogrid[:48, -1:2, :56, -1:2]
        wave = np.sin((t - slope * v) * np.pi / side) * np.sin((s - slope * u) * np.pi / side)
        images[name] = (127 + 120 * wave).reshape(144, 168)
    # An evenly bright source in three colours, as lenslet images of 3 x 3 views.
    for name, light in {"cold": (120, 60, 30), "warm": (146, 75, 40), "hot": (176, 94, 52)}.items():
        images[name] = np.broadcast_to(light, (60, 72, 3))
    rows = "wavelength_nm,red,green,blue", "450,0,0,1", "550,0,1,0", "650,1,0,0"
    (folder / "colours.csv").write_text("\n".join(rows))
    (folder / "frames").mkdir()
    for name, pixels in images.items():
        Image.fromarray(np.rint(pixels).astype(np.uint8)).save(folder / f"{name}.png")
    packed = lytro_files.pack(rng.integers(64, 1024, (8, 12)), 10)
    facts = lytro_files.metadata("ILLUM", (8, 12))
    (folder / "photo.lfr").write_bytes(lytro_files.container("ILLUM", facts, packed))
    (folder / "views.csv").write_text("view_0.png,0,0\nview_1.png,1,0\n")
    with ZipFile(folder / "views.zip", "w") as archive:
        for k in range(2):
            archive.write(folder / f"view_{k}.png", f"scene/view_{k}_0.png")
    savemat(folder / "toolbox.mat", {"LF": views}, do_compression=True)
    with h5py.File(folder / "hci.h5", "w") as file:
        file.create_dataset("LF", data=views, compression="gzip")
