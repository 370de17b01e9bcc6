"""Inputs that are known to have been mistaken somewhere, by this package or by another."""

import io
import json
import os
import pickle
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tifffile
from PIL import Image

from campaigning.contents import contents, differences
from campaigning.processes import call
from campaigning.verdicts import fault
from campaigning.workplace import Workplace

PART = "known"

SMALL_MEMORY = {"LF_FLAME_MEMORY_GB": "0.5"}
LIMIT_S = 60.0

EPS = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\n(pwned) (w) file closefile showpage\n"


class _Bomb:
    """What pickle would call."""

    def __reduce__(self):
        return os.system, ("touch pwned",)


def _write(name: str, content: bytes | str) -> Callable[[Path], None]:
    data = content.encode() if isinstance(content, str) else content
    return lambda home: _replace(home / name, data)


def _replace(path: Path, content: bytes) -> None:
    path.unlink(missing_ok=True)
    path.write_bytes(content)


def _edit(name: str, old: str, new: str) -> Callable[[Path], None]:
    def edit(home: Path) -> None:
        text = (home / name).read_text()
        assert old in text, f"{old} is not in {name}"
        (home / name).write_text(text.replace(old, new))

    return edit


def _record(name: str, **values) -> Callable[[Path], None]:
    def change(home: Path) -> None:
        record = json.loads((home / name).read_text())
        (home / name).write_text(json.dumps(record | values))

    return change


def _header(shape: tuple[int, ...]) -> bytes:
    file = io.BytesIO()
    described = {"descr": "<f4", "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(file, described)
    return file.getvalue()


def _npz_bomb(home: Path) -> None:
    """Pack a light field of 1.6 GB into some megabytes of zeros."""
    with (
        zipfile.ZipFile(home / "bomb.npz", "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open("views.npy", "w", force_zip64=True) as file,
    ):
        file.write(_header((9, 9, 2222, 2222)))
        for _ in range(100):
            file.write(bytes(16_000_000))


def _large_pictures(home: Path) -> None:
    (home / "large").mkdir()
    Image.new("L", (13_000, 13_000)).save(home / "large" / "view_00_00.png", compress_level=1)
    for name in ("00_01", "01_00", "01_01"):
        os.link(home / "large" / "view_00_00.png", home / "large" / f"view_{name}.png")


def _many_arrays(home: Path) -> None:
    np.savez(home / "many.npz", **{f"w{k}": np.zeros(1, np.float32) for k in range(10_000)})


def _pickled(home: Path) -> None:
    np.save(home / "pickled.npy", np.array([_Bomb()], object), allow_pickle=True)
    np.savez(home / "pickled.npz", views=np.array([_Bomb()], object))
    (home / "plain.npy").write_bytes(pickle.dumps(_Bomb()))


def _no_array(home: Path) -> None:
    with zipfile.ZipFile(home / "none.npz", "w") as archive:
        archive.writestr("views.npy", "text")


def _strange_axes(home: Path) -> None:
    views = np.zeros((3, 3, 8, 8), np.float32)
    tifffile.imwrite(home / "axes.tif", views, metadata={"axes": "QQYX"})


def _png_bomb(home: Path) -> None:
    """Write a picture of which the head alone is there, of 60,000 x 60,000 pixels."""
    size = (60_000).to_bytes(4, "big")

    def chunk(name: bytes, data: bytes) -> bytes:
        check = zlib.crc32(name + data).to_bytes(4, "big")
        return len(data).to_bytes(4, "big") + name + data + check

    head = chunk(b"IHDR", size + size + b"\x08\x00\x00\x00\x00")
    packed = chunk(b"IDAT", zlib.compress(bytes(10**6)))
    _replace(home / "card.png", b"\x89PNG\r\n\x1a\n" + head + packed + chunk(b"IEND", b""))


def _own(name: str) -> Callable[[Path], None]:
    def make(home: Path) -> None:
        (home / name).parent.mkdir(parents=True, exist_ok=True)
        (home / name).write_text("years of work")

    return make


def _nothing(home: Path) -> None:
    pass


def _forget(name: str) -> Callable[[Path], None]:
    return lambda home: (home / name).unlink()


@dataclass(frozen=True)
class Known:
    """A call with an input of the list.

    Parameters
    ----------
    what : str
    line : str
        Program and arguments; "''" stands for an empty one.
    prepare : callable, optional
        Takes the home.
    environment : dict of str, optional
    refused : bool, optional
        Whether it has to end with status 2.
    number : int
    """

    what: str
    line: str
    prepare: Callable[[Path], None] = _nothing
    environment: tuple[tuple[str, str], ...] = ()
    refused: bool = True
    number: int = 0
    part = PART

    @property
    def name(self) -> str:
        """Command."""
        words = self.line.split()
        return words[1] if words[0] == "experiments" else words[0]

    @property
    def words(self) -> list[str]:
        """Program and arguments."""
        words = ["" if word == "''" else word for word in self.line.split()]
        return words if words[0] == "experiments" else ["lf_flame", *words]

    def try_out(self, workplace: Workplace) -> str:
        """Say what goes wrong; nothing if nothing does."""
        with workplace.copy() as home:
            self.prepare(home)
            os.mkfifo(home / "pipe")
            _own("thesis.txt")(home)
            before = contents(home, workplace.home.known)
            environment = SMALL_MEMORY | dict(self.environment)
            found = call(self.words, home, LIMIT_S, environment=environment)
            after = contents(home, workplace.home.known)
        if wrong := fault(found, (2,) if self.refused else (0, 2)):
            return wrong
        if "pwned" in after or after.get("thesis.txt") != before["thesis.txt"]:
            return f"what is not its own: {differences(after, before)}"
        return differences(after, before) if found.status == 2 else ""


SCENE_HUGE = _edit("scene.toml", "centre_mm = [0.0, -0.8]", "centre_mm = [1e308, 1e308]")
NET_EMPTY = _edit("net.json", '"image": [\n  32,\n  64\n ]', '"image": [0, 0]')
EVALUATE = "experiments evaluate run --table table1 --out new --figure"
REFOCUS = "refocus views --slope 0.5 --out new"
TRAIN = "train training.toml --preset smoke --data data.zarr --out"

CALLS = (
    Known("a centre at 1e308", "simulate scene.toml --out new", SCENE_HUGE),
    Known("a centre at 1e308", "plan scene.toml", SCENE_HUGE),
    Known("aperture 1e308", f"{REFOCUS} --aperture 1e308", refused=False),
    *(Known(f"aperture {x}", f"{REFOCUS} --aperture {x}") for x in ("inf", "nan", "-1", "0")),
    *(Known(f"slope {x}", f"refocus views --out new --slope {x}") for x in ("nan", "inf", "1e308")),
    *(
        Known(f"sweep to {x}", f"refocus views --out new --sweep 0 {x}")
        for x in ("nan", "inf", "1e308")
    ),
    *(Known(f"map to {x}", f"refocus views --out new --map 0 {x}") for x in ("nan", "1e308", "0")),
    Known("a region beyond", "refocus-regions views --region 0 99999 0 9 --slopes 0 1 --out new"),
    Known("a region of nothing", "refocus-regions views --region 4 4 4 9 --slopes 0 1 --out new"),
    *(
        Known(
            f"samples {x}", "dataset shapes.toml --preset smoke --out new",
            _edit("shapes.toml", "smoke = 40", f"smoke = {x}"),
        )
        for x in ("1e39", "1000000000000000000", "0", "-1", "nan")
    ),
    Known("no figure", f"{EVALUATE} ''"),
    Known("a figure elsewhere", f"{EVALUATE} ../../x"),
    Known("a figure elsewhere", f"{EVALUATE} /tmp/x"),
    Known("a figure of a null name", f"{EVALUATE} ."),
    Known("KERAS_BACKEND bogus", f"{TRAIN} new", environment=(("KERAS_BACKEND", "bogus"),)),
    Known("MPLBACKEND bogus", REFOCUS, environment=(("MPLBACKEND", "bogus"),), refused=False),
    *(
        Known(
            f"NUMBA_NUM_THREADS {x}", "simulate scene.toml --out new",
            environment=(("NUMBA_NUM_THREADS", x),),
        )
        for x in ("0", "-1", "x", "100000", "")
    ),
    Known("LF_FLAME_MEMORY_GB 0", REFOCUS, environment=(("LF_FLAME_MEMORY_GB", "0"),)),
    Known("LF_FLAME_MEMORY_GB x", REFOCUS, environment=(("LF_FLAME_MEMORY_GB", "x"),)),
    *(
        Known(f"{x} as input", f"{line} {x}{more}")
        for x in ("/dev/zero", "/dev/random", "/proc/self/mem", "pipe")
        for line, more in (
            ("camera", ""), ("plan", ""), ("simulate", " --out new"), ("convert", " new.npy"),
            ("refocus", " --out new"), ("dataset", " --out new"), ("verify", ""),
            ("predict", " --model run --out new"),
        )
    ),
    Known("a bomb", "convert bomb.npz new.npy", _npz_bomb),
    Known("a bomb", "refocus bomb.npz --out new", _npz_bomb),
    Known("pictures of 13,000 x 13,000", "convert large new.npy", _large_pictures),
    Known("a picture's head of 60,000 x 60,000", "plan scene.toml", _png_bomb),
    Known("a picture's head of 60,000 x 60,000", "predict card.png --model run --out new",
          _png_bomb),
    Known("PostScript as a view", "convert views new.npy", _write("views/view_01_01.png", EPS)),
    Known("PostScript as a layer", "simulate scene.toml --out new", _write("card.png", EPS)),
    Known("PostScript as a picture", "predict picture.png --model run --out new",
          _write("picture.png", EPS)),
    Known("PostScript as a white image", "convert raw.png new.npy --white white.png",
          _write("white.png", EPS)),
    Known("weights of 10,000 arrays", f"{REFOCUS} --network many.npz", _many_arrays),
    Known("weights of 10,000 arrays", f"{TRAIN} new --backbone-weights many.npz", _many_arrays),
    Known("weights elsewhere", f"{TRAIN} new --backbone-weights /dev/zero"),
    *(
        Known("pickled objects", f"convert {name} new.npy", _pickled)
        for name in ("pickled.npy", "pickled.npz", "plain.npy")
    ),
    Known("a member that is no array", "convert none.npz new.npy", _no_array),
    Known("axes QQYX", "convert axes.tif new.npy", _strange_axes, refused=False),
    Known("a card of no image", "predict picture.png --model net.keras --out new", NET_EMPTY),
    Known("a card of one object", "predict picture.png --model net.keras --out new",
          _record("net.json", objects=["rectangle"])),
    Known("a run of a system", "experiments evaluate system --table table1 --figure f --out new"),
    Known("a run of a system", "export system --out new.keras"),
    Known("a run of a system", "predict picture.png --model system --out new"),
    Known("a run of the paper's network", f"{REFOCUS} --network run"),
    *(
        Known(
            f"a record that names {name}", "refocus views --slope 0.25 --out refocused",
            _record("refocused/refocus.json", files=files), refused=False,
        )
        for name, files in (
            ("../thesis.txt", ["../thesis.txt"]),
            ("../thesis.txt by its hash", {"../thesis.txt": "0" * 64}),
            ("/etc/passwd", ["/etc/passwd"]),
        )
    ),
    Known("a null byte in a record", "refocus views --slope 0.25 --out refocused",
          _record("refocused/refocus.json", source="\0")),
    Known("what is read", "convert lenslets.tif lenslets.tif --views 3"),
    Known("the user's package.json", "export run --out package.keras", _own("package.json")),
    Known("the user's mine.part", "dataset shapes.toml --preset smoke --out mine",
          _own("mine.part/thesis.txt")),
    Known("another seed", f"{TRAIN} run --seed 2"),
    Known("another seed, no config.json", f"{TRAIN} begun --seed 2", _forget("begun/config.json")),
    Known("another batch size", f"{TRAIN} run",
          _edit("training.toml", "batch_size = 2", "batch_size = 3")),
)  # fmt: skip


def cases(seed: int, quick: bool) -> list[Known]:
    """Number the list."""
    found = [
        Known(one.what, one.line, one.prepare, one.environment, one.refused, number)
        for number, one in enumerate(CALLS)
    ]
    return [one for one in found if one.name in ("plan", "refocus")][:10] if quick else found
