"""Light fields of one's own, each shown by `lf-flame view` as a user would call it."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from experiments.paths import EXPERIMENTS
from lf_flame.errors import InputError
from lf_flame.formats import write_light_field
from lf_flame.lightfield import LightField
from lf_flame.scenes.dead_leaves import DeadLeaves

SCENES = EXPERIMENTS.parent / "data_gen" / "scenes"

PROGRAM = (sys.executable, "-m", "lf_flame")

TINT = (0.6, 1.0, 1.7)
"""Exponents of red, green and blue, by which grey leaves become warm ones."""

SHOWN = {
    "viewer_folder.png": (["views", "--interpolation=sinc"], "#slope=1.5&shape=round"),
    "viewer_lenslets.png": (["simulated/raw.png", "--views=9"], "#slope=0&width=0.4&centre=0,-2"),
    "viewer_simulated.png": (
        ["simulated/light_field.npz", "--camera=simulated/simulation.json"],
        "#slope=-2.08&shape=round&width=0.9",
    ),
    "viewer_emission.png": (["emission"], ""),
}
"""What `lf-flame view` is called with for each picture, and the state in the address."""


def make_sources(folder: Path) -> None:
    """Make views in colour, a simulated scene with its lenslet image, and emission by depth."""
    leaves = DeadLeaves(leaves=250, smallest=6.0).draw((9, 9), (200, 300), np.random.default_rng(3))
    colours = leaves.views.clip(0, 1)[..., None] ** np.float32(TINT)
    write_light_field(LightField(colours), folder / "views", 8)
    _run(folder, "simulate", str(SCENES / "example.toml"), "--out", "simulated")
    _run(folder, "simulate", str(SCENES / "flames_by_depth.toml"), "--out", "flames")
    depths = ("--depths", "-14", "24", "2")
    camera = ("--camera", "flames/simulation.json")
    _run(folder, "reconstruct", "flames/light_field.npz", *camera, *depths, "--out", "emission")


def _run(folder: Path, *words: str) -> None:
    subprocess.run([*PROGRAM, *words], cwd=folder, capture_output=True, check=True)


@contextmanager
def viewed(folder: Path, words: list[str]) -> Iterator[str]:
    """Call `lf-flame view`, and give the address that it prints; InputError if it prints none."""
    with subprocess.Popen(
        [*PROGRAM, "view", *words, "--no-browser"],
        cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    ) as process:  # fmt: skip
        try:
            url = process.stdout.readline().strip()
            if not url:
                raise InputError(f"lf-flame view {' '.join(words)}: {process.stderr.read()}")
            yield url
        finally:
            process.terminate()
