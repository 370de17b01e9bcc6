"""Malformed input: configurations, texts and values on the command line.

Values come from the configurations' own schema, and from the command line's own options: of the
right type and out of range, or of another type; keys that are missing, and that nobody knows.
"""

import copy
import random
import tomllib
from dataclasses import dataclass
from functools import cache

import click

from campaigning.home import TEXTS
from campaigning.mutation import NUMBERS, as_toml, changed, changes, strange
from campaigning.processes import call
from campaigning.verdicts import Outcome, fault
from campaigning.workplace import Workplace

PART = "malformed"

COUNT = 2000
LIMIT_S = 20.0
LARGEST = 3 << 30
"""Bytes of memory that a command may take for what it is asked, on these small inputs."""

LONG_WORK = ("simulate", "dataset", "train", "train-system")
"""What may rightly be at work for long, if it is asked for much."""

CONFIGURATIONS = {
    "camera": ("scene.toml", ("camera scene.toml",)),
    "scene": ("scene.toml", ("plan scene.toml", "simulate scene.toml --out out")),
    "data set": ("shapes.toml", ("dataset shapes.toml --preset smoke --out out --workers 1",)),
    "training": (
        "training.toml",
        ("train training.toml --preset smoke --data none.zarr --out out",),
    ),
    "systems": (
        "systems.toml",
        ("train-system refocusnet --config systems.toml --preset none --out out",),
    ),
}  # fmt: skip
"""For each kind its file, and the commands that read it."""

CALLS = (
    "camera scene.toml --depth-mm 3",
    "plan scene.toml --tolerance 0.01 --on defocus",
    "simulate scene.toml --out out --seed 1 --tolerance 0.01",
    "refocus views --slope 0.5 --out out",
    "refocus views --sweep -1 1 --out out --aperture 0.5",
    "refocus views --map -1 1 --out out",
    "refocus views --camera scene.toml --depth-mm 2 --f-number 4 --out out",
    "refocus-regions views --region 4 20 4 20 --slopes -1 1 --out out",
    "convert views out.npy",
    "convert lenslets.tif out --views 3 --bits 8",
    "convert raw.png out.npy --white white.png",
    "convert raw.png out.npy --pitch 10 --layout rectangular",
    "dataset shapes.toml --preset few --out data.zarr --workers 1",
    "train training.toml --preset smoke --data none.zarr --out out --seed 1 --epochs 2",
    "train-system refocusnet --config systems.toml --preset none --out out",
    "verify data.zarr",
    "experiments tables results --out out.md",
)
"""Calls whose options and arguments are changed."""

TEXT_CASES = {
    "nested lists": "a = " + "[" * 100_000,
    "nested tables": "a = " + "{a=" * 20_000,
    "dotted keys": ".".join(["a"] * 50_000) + " = 1",
    "a null byte": 'title = "\0"',
    "half a letter": 'title = "\\ud800"',
    "an escaped null byte": 'kind = "\\u0000"',
    "a huge number": "seed = " + "9" * 5000,
    "a huge exponent": "seed = 1e99999",
    "a date that is none": "seed = 2020-13-45",
    "a date": "seed = 2020-01-01",
    "nothing": "",
    "one name twice": "seed = 1\nseed = 2",
    "a mark of byte order": "\ufeffseed = 1",
    "not TOML": "{",
    "a list of tables and a table": "[[camera]]\n[camera]",
    "too long": "# " + "x" * (3 << 20),
}


@cache
def schema_of(kind: str) -> dict:
    """Schema of a configuration, as pydantic has it."""
    from pydantic import TypeAdapter

    from lf_flame.datasets.config import DatasetConfig
    from lf_flame.datasets.templates import TEMPLATES
    from lf_flame.learning.training import TrainingConfig
    from lf_flame.scenes.scene_files import SceneFile
    from lf_flame.systems.training import SystemsConfig

    if kind == "data set":
        whole = TypeAdapter(DatasetConfig).json_schema()
        template = TypeAdapter(TEMPLATES["shapes"]).json_schema()
        whole = copy.deepcopy(whole)
        whole["$defs"] |= template.pop("$defs", {})
        whole["properties"]["template"] = template
        return whole
    types = {"camera": SceneFile, "scene": SceneFile, "training": TrainingConfig,
             "systems": SystemsConfig}  # fmt: skip
    return TypeAdapter(types[kind]).json_schema()


@dataclass(frozen=True)
class Malformed:
    """A call with malformed input.

    Parameters
    ----------
    number, seed : int
    name : str
        Kind of the input.
    """

    number: int
    seed: int
    name: str
    part = PART

    @property
    def what(self) -> str:
        """Say what is done."""
        files, words = self.drawn()
        shown = "; ".join(f"{name}: {_short(_told(name, text))}" for name, text in files.items())
        return f"`{_short(' '.join(words[1:]), 300)}`{' with ' if shown else ''}{shown}"

    def drawn(self) -> tuple[dict[str, str], list[str]]:
        """Draw the files to write, and the command."""
        rng = random.Random(f"{self.seed}:{self.part}:{self.number}")
        if self.name in CONFIGURATIONS:
            file, readers = CONFIGURATIONS[self.name]
            values = changed(tomllib.loads(TEXTS[file]), rng, schema_of(self.name))
            return {file: as_toml(values)}, ["lf_flame", *rng.choice(readers).split()]
        if self.name == "text":
            file, readers = CONFIGURATIONS[rng.choice(list(CONFIGURATIONS))]
            what = rng.choice(list(TEXT_CASES))
            return {file: TEXT_CASES[what]}, ["lf_flame", *rng.choice(readers).split()]
        return {}, _changed_words(rng.choice(CALLS), rng)

    def try_out(self, workplace: Workplace) -> str:
        """Say what goes wrong; nothing if nothing does."""
        files, words = self.drawn()
        for warm in (True, False):
            with workplace.copy() as home:
                for name, text in files.items():
                    (home / name).write_text(text, encoding="utf-8")
                try:
                    found = (
                        workplace.warm.call(words, home, LIMIT_S)
                        if warm
                        else call(words, home, 3 * LIMIT_S)
                    )
                except ValueError:  # a null byte, which no command line can hold
                    return ""
                wrong = self._judge(found, words, workplace.home.changes(home), files)
                if not wrong or "memory" in wrong:
                    return wrong
        return wrong

    def _judge(self, found: Outcome, words: list[str], changes: dict, files: dict) -> str:
        if found.status is None and words[1] in LONG_WORK:
            return ""
        if wrong := fault(found):
            return wrong
        if found.grown > LARGEST:
            return f"took {found.grown >> 20} MB of memory"
        if found.status != 2 or words[1].startswith("train"):
            return ""
        left = [n for n in changes if n not in files and not n.startswith("out.part")]
        return f"left behind status 2: {', '.join(left[:4])}" if left else ""


def _told(file: str, text: str) -> str:
    """Say what is changed in a configuration; of a text that is none, the text."""
    if text in TEXT_CASES.values():
        return text
    try:
        return ", ".join(changes(tomllib.loads(text), tomllib.loads(TEXTS[file]))) or text
    except ValueError:
        return text


def _short(text: str, most: int = 160) -> str:
    line = " ".join(text.encode("unicode_escape").decode().split())
    return line if len(line) <= most else f"{line[:most]} ... ({len(text)} letters)"


def _changed_words(line: str, rng: random.Random) -> list[str]:
    """Change one or two options or arguments of a call."""
    words = line.split() if line.startswith("experiments") else ["lf_flame", *line.split()]
    command = _command(words[0], words[1])
    for _ in range(rng.choice((1, 1, 2))):
        parameter = rng.choice(command.params)
        if isinstance(parameter, click.Argument):
            words[2] = _strange_word(parameter, rng)
            continue
        name = parameter.opts[-1]
        count = 0 if getattr(parameter, "is_flag", False) else parameter.nargs
        if name in words:
            at = words.index(name)
            del words[at : at + 1 + count]
        words += [name, *(_strange_word(parameter, rng) for _ in range(count))]
    return words


def _command(program: str, name: str) -> click.Command:
    from experiments import __main__ as experiments
    from lf_flame.commands import cli

    gathered = experiments.commands if program == "experiments" else cli.commands
    return gathered.commands[name]


def _strange_word(parameter: click.Parameter, rng: random.Random) -> str:
    kind = parameter.type
    if isinstance(kind, click.Path) and rng.random() < 0.8:
        return rng.choice((
            "/dev/zero", "/dev/null", "/dev/full", "/", ".", "..", "", "x" * 300, "a\nb", "none",
            "scene.toml", "views", "data.zarr", "card.png", "light_field.npy", "/proc/self/mem",
            "simulated/simulation.json", "results", "later.zarr.part", "\udcff",
        ))  # fmt: skip
    if isinstance(kind, click.Choice) and rng.random() < 0.5:
        return rng.choice(list(kind.choices))
    if rng.random() < 0.75:
        return str(rng.choice(NUMBERS[:-10] + (math_like(rng),)))
    return str(strange(rng, {"type": "string"})).replace("\0", "")[:5000]


def math_like(rng: random.Random) -> str:
    """Draw a number as a user might type it."""
    return rng.choice(("nan", "inf", "-inf", "1e400", "0x10", "1_000", "١", "+3", "1e308", "-0"))


def cases(seed: int, quick: bool) -> list[Malformed]:
    """Name the kinds of input in turn; each draws its own."""
    kinds = [*CONFIGURATIONS, "call", "call", "scene", "call", "text"]
    found = [Malformed(n, seed, kinds[n % len(kinds)]) for n in range(COUNT)]
    return found[:120] if quick else found
