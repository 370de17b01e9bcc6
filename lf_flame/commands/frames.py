"""Frames of a video of light fields: their files in order, and reading them one at a time."""

import glob
import io
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import redirect_stderr
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import click

from lf_flame.commands.frame_times import number_key
from lf_flame.commands.reading_options import Reading
from lf_flame.errors import InputError
from lf_flame.formats.arrays import ARRAY_SUFFIXES
from lf_flame.formats.images import IMAGE_SUFFIXES
from lf_flame.formats.lytro.picture import LYTRO_SUFFIXES
from lf_flame.formats.view_files.folder import ARCHIVE
from lf_flame.lightfield import LightField


def find_frames(sources: Sequence[Path], not_frames: Sequence[Path] = ()) -> list[Path]:
    """Find the light fields of a sequence, in the order of the numbers in their names.

    Parameters
    ----------
    sources : sequence of Path
        Light fields; or one folder that holds them, as files or as folders of views; or one
        pattern with ``*``, ``?`` or ``[]``.
    not_frames : sequence of Path, optional
        Other files in that folder, such as a white image and a dark image.

    Returns
    -------
    list of Path

    Raises
    ------
    InputError
        If there is no frame, one is missing or repeated, or a folder holds several kinds.
    """
    found = list(sources)
    if len(found) == 1 and found[0].is_dir():
        found = _frames_of_folder(found[0], {path.resolve() for path in not_frames})
    elif len(found) == 1 and not found[0].exists() and glob.has_magic(str(found[0])):
        # A pattern may be absolute, which `Path.glob` refuses.
        found = [Path(name) for name in glob.glob(str(found[0]))]  # noqa: PTH207
        if not found:
            raise InputError(f"No file is of the pattern {sources[0]}.")
    missing = [path for path in found if not path.exists()]
    if missing:
        raise InputError(f"There is no light field {missing[0]}: no such file or folder.")
    twice = [path for path, count in Counter(found).items() if count > 1]
    if twice:
        raise InputError(f"Each frame may be given once, got {twice[0]} more than once.")
    keys = dict(zip(found, number_key(found), strict=True))
    return sorted(found, key=keys.__getitem__)


def _frames_of_folder(folder: Path, not_frames: set[Path]) -> list[Path]:
    kinds: dict[str, list[Path]] = {}
    for path in folder.iterdir():
        kind = "folder" if path.is_dir() else path.suffix.lower()
        known = kind in ("folder", ARCHIVE, *ARRAY_SUFFIXES, *IMAGE_SUFFIXES, *LYTRO_SUFFIXES)
        if known and not path.name.startswith(".") and path.resolve() not in not_frames:
            kinds.setdefault(kind, []).append(path)
    if not kinds:
        raise InputError(
            f"{folder} holds no light fields: neither folders of views, nor arrays "
            f"({', '.join(ARRAY_SUFFIXES)}), nor images ({', '.join(IMAGE_SUFFIXES)})."
        )
    if len(kinds) > 1:
        counted = ", ".join(f"{len(paths)} x {kind}" for kind, paths in sorted(kinds.items()))
        raise InputError(
            f"{folder} holds light fields of several kinds ({counted}): name the frames by a "
            f"pattern, as '{folder}/*{min(kinds)}'."
        )
    return next(iter(kinds.values()))


def read_frames(paths: Sequence[Path], reading: Reading) -> Iterator[LightField]:
    """Read light fields one at a time, on demand; print what was found in the first.

    Slow searches, and those that fail on a dark frame, are done once, on the first frame: the
    lenslets of a raw image, and the order of the views of a folder.

    Yields
    ------
    LightField
        Light fields, all of one shape.

    Raises
    ------
    InputError
        If a frame cannot be read, or its shape is not that of the first.
    """
    read, first = _reader(paths[0], reading)
    v, u, t, s = first.views.shape[:4]
    click.echo(f"{len(paths)} frames of {v} x {u} views of {t} x {s} pixels", err=True)
    shape = first.views.shape
    yield first
    del first  # like each later frame: it would stay in memory while the next is read
    for path in paths[1:]:
        frame = read(path)
        if frame.views.shape != shape:
            raise InputError(
                f"All frames must be of one shape: {path} has {frame.views.shape}, {paths[0]} has "
                f"{shape}."
            )
        yield frame
        del frame


def _reader(path: Path, reading: Reading) -> tuple[Callable[[Path], LightField], LightField]:
    """Read the first frame, and choose the reader of the others."""
    found = reading.find(path)
    return found.again, found.light_field


@dataclass(frozen=True)
class FrameReader:
    """Reader of frames in other processes, which repeat the searches in the same frame, in silence.

    Attributes
    ----------
    model : Path
        Frame in which lenslets or the order of views are found.
    reading : Reading
        Options.
    """

    model: Path
    reading: Reading

    @classmethod
    def by_first_sound(cls, paths: Sequence[Path], reading: Reading) -> "FrameReader":
        """Make a reader with the first of some frames that can be read."""
        refusal = InputError("There is no frame.")
        for number, path in enumerate(paths):
            try:
                read, _ = _reader(path, reading)
            except InputError as error:
                refusal = refusal if number else error
                continue
            reader = cls(path, reading)
            reader.__dict__["_read"] = read
            return reader
        raise refusal

    @property
    def description(self) -> str:
        """Options, and size and time of change of the files that they name, as text."""
        found = [path.stat() for path in self.reading.files if path.is_file()]
        return f"{self.reading.given()} {[(one.st_size, one.st_mtime_ns) for one in found]}"

    @cached_property
    def _read(self) -> Callable[[Path], LightField]:
        with redirect_stderr(io.StringIO()):
            return _reader(self.model, self.reading)[0]

    def __call__(self, path: Path) -> LightField:
        """Read a frame."""
        return self._read(path)

    def __reduce__(self):
        return FrameReader, (self.model, self.reading)
