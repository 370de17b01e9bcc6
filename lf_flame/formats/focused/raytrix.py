"""Calibration files of Raytrix cameras (``RayCalibData``), in XML.

A file is parsed without entities, of bounded size and depth. Facts of the format, from three files
that the maker's program wrote: lengths are in pixels of the raw picture and in diameters of a
lenslet; y runs up; the offset leads from the centre of the picture to a lenslet of the first kind;
the rotation is counter-clockwise and complete, as ``lens_base_x`` repeats it only in whole steps.
"""

import math
from pathlib import Path
from xml.parsers import expat

from lf_flame._common.input_files import check_regular
from lf_flame.errors import InputError
from lf_flame.formats.focused.lenslets import KINDS, FocusedLenslets
from lf_flame.formats.raw.lenslet_grid import LensletGrid

LARGEST, DEEPEST = 1 << 16, 8
"""Largest size in bytes, and largest depth of elements; the maker's files have 1.7 kB and 4."""

ROOT = "RayCalibData"

SIXTH = math.pi / 3
"""Angle by which a hexagonal array can be turned without a change."""


def read_raytrix(path: str | Path, shape: tuple[int, ...]) -> FocusedLenslets:
    """Read the lenslets of a Raytrix camera from its calibration file.

    The radial distortion of the main lens, which the file may state, is not used.

    Parameters
    ----------
    path : str or Path
        File ``.xml`` with ``RayCalibData``.
    shape : (int, int)
        Number of rows and columns of the raw pictures; further entries are ignored.

    Returns
    -------
    FocusedLenslets

    Raises
    ------
    InputError
        If the file cannot be read, or a value is missing or out of range.

    Examples
    --------
    >>> from pathlib import Path
    >>> from lf_flame.formats import read_raytrix
    >>> place = "<x>0.0</x><y>0.0</y>"
    >>> text = f"<offset>{place}</offset><diameter>24.5</diameter><rotation>0.01</rotation>"
    >>> written = Path("camera.xml").write_text(f"<RayCalibData>{text}</RayCalibData>")
    >>> read_raytrix("camera.xml", (600, 800)).grid.describe()
    'hexagonal lenslets, pitch 24.500 pixels along rows and 21.218 between them, turned by -0.01000 rad'
    """  # noqa: E501 - as it is printed
    values = _parse(Path(path))
    try:
        return _lenslets(values, shape)
    except InputError as error:
        raise InputError(f"{path} cannot be used: {error}") from None


def is_raytrix(path: str | Path) -> bool:
    """Whether a file is a calibration by its ending."""
    return Path(path).suffix.lower() == ".xml"


def _lenslets(values: dict[str, str], shape: tuple[int, ...]) -> FocusedLenslets:
    """Lenslets by the texts of the elements."""
    turn = -_number(values, "rotation")  # y runs down in a picture
    grid = LensletGrid(
        (shape[1] - 1) / 2 + _number(values, "offset/x"),
        (shape[0] - 1) / 2 - _number(values, "offset/y"),
        _number(values, "diameter"),
        math.remainder(turn, SIXTH),
        "hexagonal",
    )
    return FocusedLenslets(grid, _number(values, "lens_border", 1.0), _ranges(values, grid))


def _ranges(values: dict[str, str], grid: LensletGrid) -> tuple[tuple[float, float], ...]:
    """Ranges of virtual depth of the kinds, in the order of `FocusedLenslets`."""
    found: dict[int, tuple[float, float]] = {}
    for number in range(KINDS):
        name = f"lens_type {number}"
        if f"{name}/offset/x" not in values:
            continue
        x, y = (_number(values, f"{name}/offset/{axis}") for axis in "xy")
        low, high = (_number(values, f"{name}/depth_range/{end}") for end in ("min", "max"))
        found[_kind(grid, grid.pitch * x, -grid.pitch * y)] = (low, high)
    if found and len(found) < KINDS:
        raise InputError(
            f"it must state none or three kinds of lenslets (lens_type) at different offsets, got "
            f"{len(found)}."
        )
    return tuple(found[kind] for kind in range(KINDS)) if found else ()


def _kind(grid: LensletGrid, right: float, down: float) -> int:
    """Kind of the lenslet nearest to a place beside that in row 0 and column 0, in pixels."""
    if max(abs(right), abs(down)) > KINDS * grid.pitch:
        raise InputError("a kind of lenslets (lens_type) is too far from the first.")
    lenslets = [(row, column) for row in range(-4, 5) for column in range(-6, 7)]

    def distance(lenslet: tuple[int, int]) -> float:
        y, x = grid.position(*lenslet)
        return math.hypot(y - grid.y0 - down, x - grid.x0 - right)

    row, column = min(lenslets, key=distance)
    return (column - row % 2) % KINDS


def _number(values: dict[str, str], name: str, default: float | None = None) -> float:
    """Finite number of an element."""
    text = values.get(name)
    if text is None and default is not None:
        return default
    try:
        number = math.nan if text is None else float(text)
    except ValueError:
        number = math.nan
    if not abs(number) <= 1e6:
        got = "nothing" if text is None else repr(text[:40])
        raise InputError(f"it must state {name} as a number, got {got}.")
    return number


def _parse(path: Path) -> dict[str, str]:
    """Texts of the elements by their paths below the root, such as ``offset/x``."""
    size = check_regular(path)
    if size > LARGEST:
        raise InputError(
            f"{path} cannot be read: it has {size:,} bytes, and {LARGEST:,} are the most."
        )
    values: dict[str, str] = {}
    names: list[str] = []

    def start(name: str, attributes: dict[str, str]) -> None:
        names.append(f"{name} {attributes['id']}" if "id" in attributes else name)
        if len(names) > DEEPEST or names[0] != ROOT:
            raise InputError(f"{path} is no calibration of a Raytrix camera ({ROOT}).")
        if values.setdefault("/".join(names[1:]), "").strip():
            raise InputError(f"{path} states {'/'.join(names[1:])[:80]} twice.")

    def text(part: str) -> None:
        values["/".join(names[1:])] += part

    def refuse(*_: object) -> None:
        raise InputError(f"{path} cannot be read: it declares a document type or entities.")

    parser = expat.ParserCreate()
    parser.StartElementHandler, parser.CharacterDataHandler = start, text
    parser.EndElementHandler = lambda _: names.pop()
    parser.StartDoctypeDeclHandler = refuse
    try:
        with path.open("rb") as file:
            parser.Parse(file.read(LARGEST), True)
    except InputError:
        raise
    except OSError as error:
        raise InputError(f"{path} cannot be read: {error.strerror}.") from None
    except (expat.ExpatError, ValueError, LookupError) as error:
        raise InputError(f"{path} cannot be read as XML: {str(error)[:200]}.") from None
    return values
