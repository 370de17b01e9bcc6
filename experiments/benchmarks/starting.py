"""How long each command takes the first time on a machine, when its loops are compiled, and after.

Every command runs on small inputs, so that what is timed is starting: importing, compiling or
loading what was compiled. Beside it stands how long Python alone takes, and NumPy with Numba.
"""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from experiments.benchmarks.report import command_line, finish

ROOT = Path(__file__).parents[2]

SCENES = ROOT / "data_gen" / "scenes"
PROGRAM = ("-m", "lf_flame")
IMPORTS = ("pass", "import numba, numpy", "import lf_flame", "import lf_flame.refocus",
           "from lf_flame.refocus import refocus", "from lf_flame import render",
           "from lf_flame.refocus import all_in_focus")  # fmt: skip

COMMANDS = {
    **{code: ("-c", code) for code in IMPORTS},
    "lf-flame --help": (*PROGRAM, "--help"),
    "lf-flame camera": (*PROGRAM, "camera"),
    "lf-flame plan": (*PROGRAM, "plan", str(SCENES / "effects.toml")),
    "lf-flame simulate": (
        *PROGRAM, "simulate", str(SCENES / "example.toml"), "--out", "simulated",
    ),
    "lf-flame refocus --slope": (*PROGRAM, "refocus", "field.npy", "--slope", "0.5", "--out", "a"),
    "lf-flame refocus --search": (*PROGRAM, "refocus", "field.npy", "--search", "--out", "b"),
    "lf-flame refocus --map": (*PROGRAM, "refocus", "field.npy", "--map", "-2", "2", "--out", "c"),
    "lf-flame convert": (*PROGRAM, "convert", "field.npy", "views"),
    "lf-flame dataset": (
        *PROGRAM, "dataset", str(ROOT / "data_gen" / "shapes.toml"), "--out", "shapes.zarr",
        "--preset", "smoke", "--workers", "1",
    ),
}  # fmt: skip
"""What is started, by what it is called in the table."""


def write_light_field(folder: Path) -> None:
    """Write a light field of a texture at slope -1."""
    texture = np.random.default_rng(0).random((60, 80), np.float32)
    views = [[np.roll(texture, (-v, -u), (0, 1)) for u in range(5)] for v in range(5)]
    np.save(folder / "field.npy", np.array(views))


def start(arguments: tuple[str, ...], compiled: Path) -> float:
    """Seconds of one process in a new folder, with what Numba has kept in another."""
    with tempfile.TemporaryDirectory() as folder:
        write_light_field(Path(folder))
        started = time.perf_counter()
        done = subprocess.run(
            [sys.executable, *arguments], cwd=folder, capture_output=True, text=True, check=False,
            env={**os.environ, "NUMBA_CACHE_DIR": str(compiled), "PYTHONPATH": str(ROOT)},
        )  # fmt: skip
        seconds = time.perf_counter() - started
    if done.returncode:
        sys.exit(f"{' '.join(arguments)} failed:\n{done.stderr}")
    return seconds


def measure(repetitions: int) -> list[dict]:
    """Start every command with nothing compiled, and again."""
    rows = []
    for name, arguments in COMMANDS.items():
        sys.stderr.write(f"{name} ...\n")
        with tempfile.TemporaryDirectory() as compiled:
            first = start(arguments, Path(compiled))
            again = min(start(arguments, Path(compiled)) for _ in range(repetitions))
        rows.append({"command": name, "first start": first, "second start": again})
    return rows


COLUMNS = {
    "command": ("command", ""),
    "first start": ("first start (s)", ".2f"),
    "second start": ("second start (s)", ".2f"),
}


def main() -> None:
    """Measure, print and write."""
    asked = command_line(__doc__).parse_args()
    record = {"rows": measure(1 if asked.small else 3)}
    notes = ["Seconds of a whole process on small inputs; the second start is the best of three."]
    finish(asked.out, "starting", "Starting", record, COLUMNS, notes)


if __name__ == "__main__":
    main()
