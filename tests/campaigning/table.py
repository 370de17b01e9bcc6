"""How each command is called and what it writes: every case of the campaign follows from here."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Call:
    """A call of a command on the small files of `campaigning.home`.

    Its line is typed behind ``lf-flame``, or behind ``python -m`` from ``experiments`` on. A word
    that begins with ``out`` names an output; one that names a file of the home, an input.
    """

    line: str
    also: str = ""  # inputs that those name in turn
    goes_on: bool = False  # a call that fails leaves what is done, and the next one goes on from it
    once: bool = False  # it refuses an output that exists, even one of its own
    learns: bool = False  # it needs TensorFlow, or a network; the quick campaign leaves it out
    minutes: bool = False  # nothing makes it shorter, so nothing waits for its result

    @property
    def words(self) -> list[str]:
        """Module behind ``python -m``, and its arguments."""
        words = self.line.split()
        return words if words[0] == "experiments" else ["lf_flame", *words]

    @property
    def command(self) -> str:
        """Name of the command, by which reports count."""
        words = self.words
        return " ".join(words[:2]) if words[0] == "experiments" else words[1]

    @property
    def outputs(self) -> list[str]:
        """Names of what it writes; files beside these have the same name and another ending."""
        return [word for word in self.line.split() if word.startswith("out")]

    @property
    def reads(self) -> list[str]:
        """Names that may be of files in the home."""
        return [word for word in (*self.words, *self.also.split()) if word not in self.outputs]


LENS = "--camera simulated/simulation.json"
PLANES = f"{LENS} --depth-mm 0 --depth-mm 5 --bootstrap 2"
BOARDS = "near.png@-20 middle.png@0 far.png@25"
SOURCES = "cold.png@1500 warm.png@1520 hot.png@1540"
DATASET = "dataset shapes.toml --preset smoke"
MODEL = "--backbone-weights random --backbone-depth conv4"
TRAIN = f"train training.toml --preset smoke --data data.zarr {MODEL}"
SYSTEM = "train-system refocusnet --config systems.toml --preset smoke"
EVALUATE = "experiments evaluate runs/shapes --table table1 --figure figure7"

MADE = (
    Call("simulate scene.toml --out simulated"),
    Call("convert simulated/light_field.npz light_field.npy"),
    Call("convert simulated/light_field.npz views --bits 8"),
    Call("convert views lenslets.tif"),
    Call("refocus views --slope 0.5 --out refocused"),
    Call(f"reconstruct light_field.npy {PLANES} --out emission"),
    Call("process frames --views 3 --steps refocus@0,height --workers 1 --out video"),
    Call(f"{DATASET} --workers 1 --out data.zarr"),
    Call(f"{TRAIN} --out runs/shapes", learns=True),
    Call(f"{SYSTEM} --out runs/refocusnet", learns=True),
    Call("export runs/shapes --out net.keras", learns=True),
    Call(f"{EVALUATE} --out results", learns=True),
)
"""Calls that make what others read."""

CALLS = (
    Call("camera scene.toml --figure out.png"),
    Call("plan scene.toml --tolerance 0.01", "card.png"),
    Call("simulate scene.toml --out out", "card.png"),
    Call("demo --single-file out.html --save out.npy"),
    Call("info views --thumbnail out.png"),
    Call("info photo.lfr --thumbnail out.jpg"),
    Call("view light_field.npy --single-file out.html"),
    Call("refocus views --slope 0.5 --sweep -1 1 --map -1 1 --out out"),
    Call("refocus views --camera scene.toml --depth-mm 2 --f-number 4 --out out"),
    Call("refocus views --slope 0.5 --network runs/refocusnet --out out", learns=True),
    Call("refocus-regions views --region 4 20 4 20 --slopes -1 1 --out out"),
    Call("convert views out.npy"),
    Call("convert views out.tif"),
    Call("convert light_field.npy out", once=True),
    Call("convert simulated/light_field.npz out.npy"),
    Call("convert lenslets.tif out.npy --views 3"),
    Call("convert raw.png out.npy --white white.png"),
    Call("convert focused.png out.npy --focused focused.xml --views 3"),
    Call("convert views.zip out.npy"),
    Call("convert views.csv out.npy", "view_0.png view_1.png"),
    Call("convert picture.png out.npy --mosaic 3x6"),
    Call("convert hci.h5 out.npy"),
    Call("convert toolbox.mat out.npy"),
    Call(f"calibrate {BOARDS} --square-mm 5 --views 3 --out out", "near.png middle.png far.png"),
    Call(f"calibrate-colours {SOURCES} --responses colours.csv --views 3 --out out", "hot.png"),
    Call(f"resolution {LENS} --figure out.png"),
    Call(f"reconstruct light_field.npy {PLANES} --out out"),
    Call(f"abel light_field.npy {LENS} --bootstrap 2 --out out"),
    Call("profiles emission --out out"),
    Call("temperature emission emission --wavelengths 550 650 --out out"),
    Call("flicker frames --views 3 --frames-per-second 100 --out out"),
    Call("process frames --views 3 --steps height --workers 1 --out out", goes_on=True),
    Call(
        "process frames --views 3 --frames-per-second 100 --steps refocus@0,height,contour "
        "--workers 2 --out out --film out.gif", goes_on=True,
    ),
    Call("status video"),
    Call(f"{DATASET} --workers 1 --out out", goes_on=True),
    Call(f"{DATASET} --workers 2 --out out", goes_on=True),
    Call(f"weights training.toml --preset smoke {MODEL}", learns=True),
    Call(f"{TRAIN} --out out", goes_on=True, learns=True),
    Call(f"{SYSTEM} --out out", "shapes.toml", goes_on=True, learns=True),
    Call("export runs/shapes --out out.keras", learns=True),
    Call("predict picture.png --model runs/shapes --out out", learns=True),
    Call("predict picture.png --model net.keras --out out", "net.json", learns=True),
    Call("verify data.zarr refocused simulated emission video"),
    Call("verify runs net.keras", "net.json", learns=True),
    Call("report emission --out out.html"),
    Call("experiments slopes shapes.toml --out out"),
    Call(f"{EVALUATE} --out out", "data.zarr", learns=True),
    Call("experiments tables results --out out.md", learns=True),
    Call("experiments bounds --scenes 1 --workers 1 --out out", goes_on=True),
    Call(
        "experiments study study.toml --workers 1 --work out-work --out out",
        "shapes.toml training.toml", goes_on=True, learns=True,
    ),
    Call("experiments depth-test runs/shapes --samples 1 --out out", "data.zarr", learns=True),
    Call(
        "experiments compare runs --data shapes.toml --light-fields 1 --electrons 10 --out out",
        "data.zarr", learns=True, minutes=True,
    ),
    Call(
        "experiments system-scenes --config systems.toml --system refocusnet --light-fields 2 "
        "--held-out 1 --scored 1 --work out-work --out out",
        "shapes.toml", goes_on=True, learns=True, minutes=True,
    ),
    Call("experiments latency runs/shapes --repeats 3 --out out", learns=True, minutes=True),
    Call("experiments costs --run runs --out out", learns=True, minutes=True),
    Call("experiments effects --out out", minutes=True),
    Call("experiments slope-maps --out out", minutes=True),
    Call("experiments hard-cases --out out", learns=True, minutes=True),
    Call("experiments emission --out out", minutes=True),
    Call("experiments dataset-making --out out", minutes=True),
)  # fmt: skip

# Commands that the campaign leaves alone, and why.
UNTRIED = {
    "experiments results": "lists, and writes nothing",
    "experiments screenshots": "needs a browser",
}
# Names of the parameters by which commands are told what to write.
WRITING = {"out", "target", "figure", "film", "single_file", "save", "work", "thumbnail"}


def registered() -> dict:
    """Every registered command of both programs, by the name that a call has it by."""
    from experiments.__main__ import commands as experiments
    from lf_flame.commands.cli import commands

    others = experiments.commands.items()
    return dict(commands.commands) | {f"experiments {name}": command for name, command in others}
