"""The commands that write, each called upon the small files of `campaigning.home`."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Command:
    """A call of a program that writes.

    Parameters
    ----------
    name : str
        By which reports know it.
    arguments : str
        As typed, behind the program; what it writes is `out`, or begins so.
    out : str
    program : str
        Module behind ``python -m``.
    kills : int
        How often it is killed, of 280 times.
    refuses_again : bool
        Whether it wants a new folder, and refuses what it has made.
    goes_on : bool
        Whether what it has begun stays there when it fails.
    """

    name: str
    arguments: str
    out: str = "out"
    program: str = "lf_flame"
    kills: int = 10
    refuses_again: bool = False
    goes_on: bool = False

    @property
    def words(self) -> list[str]:
        """Program and arguments."""
        return [self.program, *self.arguments.split()]

    @property
    def is_folder(self) -> bool:
        """Whether it writes a folder."""
        return "." not in self.out

    def to(self, out: str) -> "Command":
        """Give the same command with another output."""
        arguments = [out if word == self.out else word for word in self.arguments.split()]
        return Command(
            self.name, " ".join(arguments), out, self.program, self.kills, self.refuses_again,
            self.goes_on,
        )  # fmt: skip


LENS = "--camera simulated/simulation.json"
PLANES = f"{LENS} --depth-mm 0 --depth-mm 5 --redraws 2"
SHAPES = "dataset shapes.toml --preset smoke --out out"
TRAIN = "train training.toml --preset smoke --data data.zarr --out out"

WRITING = (
    Command("simulate", "simulate scene.toml --out out", kills=22),
    Command(
        "refocus", "refocus views --slope 0.5 --sweep -1 1 --map -1 1 --out out", kills=22
    ),
    Command(
        "refocus-regions", "refocus-regions views --region 4 20 4 20 --slopes -1 1 --out out",
        kills=16,
    ),
    Command("convert to .npy", "convert views out.npy", "out.npy", kills=12),
    Command("convert to .tif", "convert views out.tif", "out.tif", kills=12),
    Command("convert to a folder", "convert light_field.npy out", kills=14, refuses_again=True),
    Command("reconstruct", f"reconstruct light_field.npy {PLANES} --out out"),
    Command("profiles", "profiles emission --out out"),
    Command("temperature", "temperature emission emission --wavelengths 550 650 --out out"),
    Command("abel", f"abel light_field.npy {LENS} --redraws 2 --out out"),
    Command("flicker", "flicker frames --views 3 --frames-per-second 100 --out out"),
    Command("resolution", f"resolution {LENS} --figure out.png", "out.png"),
    Command("view", "view light_field.npy --single-file out.html", "out.html"),
    Command("demo", "demo --single-file out.html", "out.html"),
    Command("dataset, 1 process", f"{SHAPES} --workers 1", kills=20, goes_on=True),
    Command("dataset, 2 processes", f"{SHAPES} --workers 2", kills=20, goes_on=True),
    Command("train", TRAIN, kills=12, goes_on=True),
    Command(
        "train-system", "train-system refocusnet --config systems.toml --preset smoke --out out",
        goes_on=True,
    ),
    Command("export", "export run --out out.keras", "out.keras"),
    Command("predict", "predict picture.png --model run --out out"),
    Command(
        "evaluate", "evaluate run --table table1 --figure figure7 --out out",
        program="experiments",
    ),
    Command("tables", "tables results --out out.md", "out.md", program="experiments"),
)  # fmt: skip

LEARNING = ("train", "train-system", "export", "predict", "evaluate", "tables")
"""Those that start TensorFlow, and so take seconds, or need what it has made."""

BY_NAME = {command.name: command for command in WRITING}
