"""Stored files of every kind, damaged, and then read by every command that reads them.

Right is the same result as of the undamaged file, where the damage does not matter; another
result where nothing guards the file, as with a picture; or one sentence and status 2.
"""

import json
import os
import random
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from campaigning.mutation import changed
from campaigning.processes import call
from campaigning.verdicts import Outcome, fault
from campaigning.workplace import Workplace

PART = "damages"

SLOWER_S = 10.0
"""By which a damaged file may take longer than a whole one, on a machine that does other things."""

LARGER = 1 << 30
"""Bytes by which it may take more memory."""

LATER = "dataset shapes.toml --preset smoke --out later.zarr --workers 1"
AGAIN = "dataset shapes.toml --preset few --out data.zarr"
TRAIN_ON = "train training.toml --preset smoke --data data.zarr --out begun"
TRAIN_AGAIN = "train training.toml --preset smoke --data data.zarr --out run"
SYSTEM = "refocus views --slope 0.5 --network system --out new"
SYSTEM_AGAIN = "train-system refocusnet --config systems.toml --preset smoke --out system"
REFOCUS_AGAIN = "refocus views --slope 0.25 --out refocused"
SIMULATE_AGAIN = "simulate scene.toml --out simulated"
PREDICT = "predict picture.png --model run --out new"
PREDICT_AGAIN = "predict picture.png --model run --out predicted"
PREDICT_NET = "predict picture.png --model net.keras --out new"
EXPORT = "export run --out new.keras"
EXPORT_AGAIN = "export run --out net.keras"
EVALUATE = "experiments evaluate run --table table1 --figure figure7 --out new"
TABLES = "experiments tables results --out new.md"
RAW = "convert raw.png new.npy --white white.png"


@dataclass(frozen=True)
class Kind:
    """A kind of stored file.

    Parameters
    ----------
    path : str
        In the home.
    readers : tuple of str
        Commands that read it, without ``lf_flame``.
    guarded : bool
        Whether a hash guards what it says.
    """

    path: str
    readers: tuple[str, ...]
    guarded: bool = False


CHECKPOINT = (TRAIN_ON, "verify begun")
DATA = ("verify data.zarr", AGAIN, EVALUATE, TRAIN_ON)

KINDS = (
    Kind("data.zarr/zarr.json", DATA, True),
    Kind("data.zarr/input/zarr.json", DATA, True),
    Kind("data.zarr/parameters/size_mm/zarr.json", DATA[:2], True),
    Kind("data.zarr/input/c/0/0/0/0", ("verify data.zarr",), True),
    Kind("data.zarr/target/c/0/0/0/0", DATA, True),
    Kind("data.zarr/complete/c/0", DATA[:2], True),
    Kind("data.zarr/parameters/size_mm/c/0/0/0", ("verify data.zarr",), True),
    Kind("later.zarr.part/zarr.json", (LATER,), True),
    Kind("later.zarr.part/target/zarr.json", (LATER,), True),
    Kind("later.zarr.part/complete/c/1", (LATER,), True),
    Kind("run/run.json", ("verify run", PREDICT, EXPORT, EVALUATE, TRAIN_AGAIN)),
    Kind("run/model.keras", ("verify run", PREDICT, EXPORT, EVALUATE, TRAIN_AGAIN), True),
    Kind("run/config.json", ("verify run", TRAIN_AGAIN)),
    Kind("run/history.csv", (EVALUATE,)),
    Kind("begun/config.json", CHECKPOINT),
    Kind("begun/checkpoint-000001/manifest.json", CHECKPOINT),
    Kind("begun/checkpoint-000001/history.json", CHECKPOINT, True),
    Kind("begun/checkpoint-000001/state.npz", CHECKPOINT, True),
    Kind("begun/checkpoint-000001/best.npz", CHECKPOINT, True),
    Kind("net.keras", ("verify net.keras", PREDICT_NET, EXPORT_AGAIN), True),
    Kind("net.json", ("verify net.keras", PREDICT_NET, EXPORT_AGAIN)),
    Kind("system/run.json", ("verify system", SYSTEM, SYSTEM_AGAIN)),
    Kind("system/model.keras", ("verify system", SYSTEM, SYSTEM_AGAIN), True),
    Kind("refocused/refocus.json", ("verify refocused", REFOCUS_AGAIN)),
    Kind("refocused/focal_stack.tif", ("convert refocused/focal_stack.tif new.npy",)),
    Kind("refocused/refocused_1_slope+0.500.png", ("verify refocused",), True),
    Kind(
        "simulated/simulation.json",
        (
            "verify simulated", SIMULATE_AGAIN, "camera simulated/simulation.json",
            "refocus views --camera simulated/simulation.json --depth-mm 2 --out new",
        ),
    ),
    Kind("simulated/light_field.npz", ("convert simulated/light_field.npz new.npy",)),
    Kind("simulated/raw.tif", ("convert simulated/raw.tif new.npy --views 3",)),
    Kind("predicted/picture/prediction.json", ("verify predicted", PREDICT_AGAIN)),
    Kind("light_field.npy", ("convert light_field.npy new", "refocus light_field.npy --out new")),
    Kind("views/view_01_01.png", ("convert views new.npy", "refocus views --slope 1 --out new")),
    Kind(
        "lenslets.tif",
        ("convert lenslets.tif new.npy --views 3", "predict lenslets.tif --model run --out new"),
    ),
    Kind("raw.png", (RAW,)),
    Kind("white.png", (RAW,)),
    Kind("picture.png", (PREDICT,)),
    Kind("card.png", ("plan scene.toml", "simulate scene.toml --out new")),
    Kind("scene.toml", ("plan scene.toml", "camera scene.toml")),
    Kind("shapes.toml", ("camera shapes.toml", AGAIN)),
    Kind("results/table1.json", (TABLES,)),
    Kind("results/table1.csv", (TABLES,)),
    Kind("results/table1_history.csv", (TABLES,)),
    Kind("results/table1.md", (TABLES,)),
)  # fmt: skip

LEARNT = ("run/", "begun/", "net.", "system/", "predicted/", "results/")


def _is_learnt(kind: Kind, reader: str) -> bool:
    """Whether a case needs a network that was trained."""
    words = reader.split()
    return kind.path.startswith(LEARNT) or words[0] in ("train", "predict", "experiments")


def cut(content: bytes, rng: random.Random) -> bytes:
    """Keep the beginning."""
    return content[: rng.randrange(max(len(content), 1))]


def flip(content: bytes, rng: random.Random) -> bytes:
    """Turn some bits around."""
    changed_bytes = bytearray(content)
    for _ in range(rng.choice((1, 1, 2, 20)) if content else 0):
        changed_bytes[rng.randrange(len(content))] ^= 1 << rng.randrange(8)
    return bytes(changed_bytes)


def garbage(content: bytes, rng: random.Random) -> bytes:
    """Put as many bytes of anything."""
    return rng.randbytes(min(len(content), 1 << 20) + 1)


def deep(content: bytes, rng: random.Random) -> bytes:
    """Put lists in lists in lists, or tables in tables."""
    times = rng.choice((100, 5000, 300_000))
    return rng.choice((b"[" * times + b"]" * times, b'{"a":' * times, b"a = " + b"[" * times))


def insert(content: bytes, rng: random.Random) -> bytes:
    """Put some bytes in between."""
    at = rng.randrange(len(content) + 1)
    more = rng.choice((b"\0", b"\xff\xfe", b"9", b"-", b'"', b"\n", b"1e999", b"," * 50))
    return content[:at] + more + content[at:]


def empty(content: bytes, rng: random.Random) -> bytes:
    """Keep nothing."""
    return b""


def other_value(content: bytes, rng: random.Random) -> bytes:
    """Change what a record says; of what is no record, insert something."""
    try:
        return json.dumps(changed(json.loads(content), rng)).encode()
    except ValueError:
        return insert(content, rng)


CHANGES: tuple[Callable[[bytes, random.Random], bytes], ...] = (
    cut, flip, garbage, deep, insert, empty, other_value, other_value, other_value, flip, cut
)  # fmt: skip

KINDS_OF_FILE = ("gone", "a folder", "a pipe", "a link to /dev/zero", "another kind")


@dataclass(frozen=True)
class Damage:
    """A damaged file, and a command that reads it.

    Parameters
    ----------
    number, seed : int
    kind : Kind
    reader : str
    how : str
        Name of one of `CHANGES`, or of `KINDS_OF_FILE`.
    """

    number: int
    seed: int
    kind: Kind
    reader: str
    how: str
    part = PART

    @property
    def name(self) -> str:
        """What the report counts it under."""
        return self.kind.path

    @property
    def what(self) -> str:
        """Say what is done."""
        return f"{self.how}, read by `{self.reader}`"

    @property
    def words(self) -> list[str]:
        """Program and arguments of the reader."""
        words = self.reader.split()
        return words if words[0] == "experiments" else ["lf_flame", *words]

    def try_out(self, workplace: Workplace) -> str:
        """Say what goes wrong; nothing if nothing does."""
        whole, result = workplace.warm_reference(self.words)
        limit_s = max(20.0, 3 * whole.seconds + SLOWER_S)
        for warm in (True, False):  # what is wrong in a warm process is tried in one of its own
            with workplace.copy() as home:
                harmless = self.damage(home)
                found = (
                    workplace.warm.call(self.words, home, limit_s)
                    if warm
                    else call(self.words, home, limit_s + 40)
                )
                wrong = self._judge(found, whole, result, workplace.home.changes(home), harmless)
                if not wrong or "memory" in wrong:
                    return wrong
        return wrong

    def damage(self, home: Path) -> bool:
        """Damage the file; whether it is still what it was."""
        rng, path = random.Random(f"{self.seed}:{self.part}:{self.number}"), home / self.kind.path
        content = path.read_bytes()
        path.unlink()  # large files have several names
        if self.how in KINDS_OF_FILE:
            _replace(home, path, self.how, rng)
            return False
        change = next(change for change in CHANGES if change.__name__ == self.how)
        new = change(content, rng)
        path.write_bytes(new)
        return new == content or _says_the_same(content, new)

    def _judge(self, found: Outcome, whole: Outcome, result: dict, changes: dict, harmless) -> str:
        if wrong := fault(found):
            return wrong
        if found.seconds > 3 * whole.seconds + 4 * SLOWER_S:
            return f"took {found.seconds:.0f} s, undamaged {whole.seconds:.0f} s"
        if found.grown > whole.grown + LARGER:
            return f"took {found.grown >> 20} MB of memory, undamaged {whole.grown >> 20} MB"
        mine = {n: what for n, what in changes.items() if not n.startswith(self.kind.path)}
        if found.status == 2:
            goes_on = self.reader in (LATER, TRAIN_ON, TRAIN_AGAIN, SYSTEM_AGAIN)
            left = [name for name in mine if not goes_on and name not in result]
            return f"left over behind status 2: {', '.join(left[:4])}" if left else ""
        expected = {n: what for n, what in result.items() if not n.startswith(self.kind.path)}
        if self.kind.guarded and not harmless:
            if self.reader.startswith("verify"):
                return "not noticed by verify"
            if mine != expected:
                return "another result without a word"
        return ""


def _replace(home: Path, path: Path, how: str, rng: random.Random) -> None:
    if how == "a folder":
        path.mkdir()
    elif how == "a pipe":
        os.mkfifo(path)
    elif how == "a link to /dev/zero":
        path.symlink_to("/dev/zero")
    elif how == "another kind":
        others = ("scene.toml", "card.png", "net.json", "light_field.npy", "lenslets.tif",
                  "simulated/light_field.npz", "results/table1.csv", "run/model.keras")  # fmt: skip
        there = [name for name in others if (home / name).is_file()]
        shutil.copy(home / rng.choice(there), path)


def _says_the_same(content: bytes, new: bytes) -> bool:
    try:
        return json.loads(content) == json.loads(new)
    except (ValueError, RecursionError):
        return False


def cases(seed: int, quick: bool) -> list[Damage]:
    """List the damages: all for each kind and reader, half where TensorFlow takes its time."""
    found: list[Damage] = []
    rng = random.Random(f"{seed}:{PART}")
    names = [change.__name__ for change in CHANGES] + list(KINDS_OF_FILE)
    for kind in KINDS:
        for reader in kind.readers:
            for how in names[len(found) % 2 :: 2] if _is_learnt(kind, reader) else names:
                found.append(Damage(len(found), seed, kind, reader, how))
    if not quick:
        return found
    return rng.sample([case for case in found if not _is_learnt(case.kind, case.reader)], 60)
