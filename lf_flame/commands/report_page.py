"""The report of a folder as one HTML file: tables, curves, pictures, a paragraph on the methods."""

import base64
import io
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, StrictUndefined
from PIL import Image

from lf_flame import __version__
from lf_flame._common.printable import printable
from lf_flame.commands.report_folder import Folder, Table, facts_of, read_folder, tables_of, written
from lf_flame.commands.report_viewer import viewer_page
from lf_flame.commands.verification import Finding
from lf_flame.errors import InputError
from lf_flame.formats.images import read_image

LARGEST_PAGE = 5_000_000
"""Largest size of a report in bytes."""

WIDTHS = (1400, 1000, 700, 400)
"""Widths in pixels to which pictures are reduced, until all of them fit."""

SHOWN_ROWS = 40
"""Largest number of rows of a table that are shown."""

LARGEST_NUMBER = 1e100
"""Largest absolute value that is drawn in a curve."""

CURVE_ROWS = 12
"""Least number of rows of a table that are drawn as a curve."""

PROVENANCE = ("command", "date", "git_revision", "machine", "versions", "wall_s")


def report_page(path: Path, findings: list[Finding]) -> str:
    """Report of a folder of results.

    The same folder gives the same text: it holds neither time nor place of its making.

    Parameters
    ----------
    path : Path
    findings : list of Finding
        Verdicts of the hashes, from `lf_flame.commands.verification.verify`.

    Raises
    ------
    InputError
        If the folder holds no record, or a file in it is not the one that was written.
    """
    for finding in findings:
        if finding.verdict == "DAMAGED":
            raise InputError(f"No report is written of damaged results: {finding.text}")
    folder = read_folder(path)
    template = resources.files("lf_flame.commands").joinpath("report.html").read_text("utf-8")
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    page = environment.from_string(template)
    tables = [*folder.tables, *_record_tables(folder)]
    facts: dict[str, Any] = {"folder": printable(path.resolve().name), "version": __version__}
    facts |= {"findings": findings, "verdict": _verdict(folder, findings), "left": folder.left_out}
    facts |= {"short": [_shown(table) for table in tables if len(table.rows) < CURVE_ROWS]}
    facts |= {"long": [_shown(table) for table in tables if len(table.rows) >= CURVE_ROWS]}
    facts |= {"hashes": folder.hashes}
    facts |= {"curves": [curve for table in tables for curve in curves_of(table)]}
    facts |= {"records": {name: _split(record) for name, record in folder.records.items()}}
    facts |= {"warnings": _warnings(folder), "methods": methods_of(folder)}
    facts |= {"commands": _commands(folder)}

    def room_beside(viewer: str) -> int:
        return LARGEST_PAGE - len(page.render(**facts, pictures=[], viewer=viewer).encode())

    if (room := room_beside("")) < 0:
        raise InputError(f"Records and tables of {path} need more than the 5 MB of a report.")
    viewer = viewer_page(folder, room // 2)
    return page.render(**facts, pictures=_pictures(folder, room_beside(viewer)), viewer=viewer)


def _record_tables(folder: Folder) -> list[Table]:
    """Tables in records, but for those that stand in a file of the same folder too."""
    known = {(tuple(table.columns), len(table.rows)) for table in folder.tables}
    return [
        Table(f"{name}: {table.name}", table.columns, table.rows)
        for name, record in folder.records.items()
        for table in tables_of(record)
        if (tuple(table.columns), len(table.rows)) not in known
    ]


def _verdict(folder: Folder, findings: list[Finding]) -> str:
    """First sentence of a report: whether results are as written, and what commands warned of."""
    checked = any(finding.verdict == "whole" for finding in findings)
    sound = "All files are as they were written" if checked else "No record here holds hashes"
    unfinished = any(record.get("finished") is False for record in folder.records.values())
    count = len(_warnings(folder))
    said = f"{count} warning{'s' * (count != 1)}, below" if count else "no warnings"
    return f"{sound}; {said}.{' The work is not finished.' if unfinished else ''}"


def _warnings(folder: Folder) -> list[str]:
    lists = [record.get(key) for record in folder.records.values() for key in ("warnings", "notes")]
    return [printable(one, 600) for found in lists if isinstance(found, list) for one in found]


def _split(record: dict[str, Any]) -> dict[str, list[tuple[str, str]]]:
    """Facts of a record, its provenance apart."""
    own = {key: value for key, value in record.items() if key not in (*PROVENANCE, "warnings")}
    origin = {key: record[key] for key in PROVENANCE if key in record}
    if isinstance(versions := origin.get("versions"), dict):
        origin["versions"] = ", ".join(f"{name} {version}" for name, version in versions.items())
    return {"facts": facts_of(own), "provenance": facts_of(origin)}


def _commands(folder: Folder) -> list[str]:
    found = (record.get("command") for record in folder.records.values())
    return list(dict.fromkeys(printable(one, 2000) for one in found if isinstance(one, str)))


def _shown(table: Table) -> dict[str, Any]:
    rows = [[_short(cell) for cell in row] for row in table.rows[:SHOWN_ROWS]]
    more = len(table.rows) - len(rows)
    columns = [printable(column).replace("_", " ") for column in table.columns]
    return {"name": printable(table.name), "columns": columns, "rows": rows, "more": more}


def _short(cell: str) -> str:
    try:
        return written(float(cell)) if "." in cell or "e" in cell.lower() else printable(cell)
    except ValueError:
        return printable(cell)


def methods_of(folder: Folder) -> list[str]:
    """Sentences for the methods part of a paper, from what the records hold."""
    facts: dict[str, Any] = {}
    parts: list[Any] = list(folder.records.values())
    for part in parts:  # of data sets and runs, what their configuration says too
        facts = {**part, **facts}
        nested = (part.get(name) for name in ("attributes", "dataset", "config"))
        parts += [one for one in nested if isinstance(one, dict)]

    def of(value: Any, *names: str) -> list[Any] | None:
        held = value if isinstance(value, dict) else {}
        found = [held.get(name) for name in names]
        return found if all(isinstance(x, (int, float, str, list)) for x in found) else None

    sentences = []
    camera = facts.get("camera")
    if found := of(camera, "main_lens_focal_mm", "focus_distance_mm", "lenslet_pitch_mm", "views"):
        sentences.append(
            "The plenoptic camera had a main lens of {} mm focused at {} mm, lenslets of {} mm and "
            "{} views each way.".format(*map(written, found))
        )
    for name, sentence in METHODS.items():
        value = facts.get(name)
        if isinstance(value, list) and value and not isinstance(value[0], (dict, list)):
            sentences.append(sentence.format(", ".join(map(written, value[:12]))))
        elif isinstance(value, (int, float, str)) and not isinstance(value, bool):
            sentences.append(sentence.format(written(value)))
    if found := of(facts.get("recipe"), "batch_size", "learning_rate"):
        sentences.append(
            "Batches held {} samples; the learning rate was {}.".format(*map(written, found))
        )
    versions = facts.get("versions")
    if isinstance(versions, dict):
        named = ", ".join(f"{printable(k)} {printable(v)}" for k, v in versions.items())
        sentences.append(f"Software: {named}.")
    return sentences


METHODS = {
    "title": "Data: {}.",
    "depths_mm": "Depth planes were at {} mm from the focal plane.",
    "slopes": "Images were refocused at slopes of {} lenslets per view.",
    "interpolation": "Views were interpolated by the method {}.",
    "noise": "The noise of a pixel was {} in the unit of the light field.",
    "strength": "The strength of the regularisation was {}.",
    "bootstrap": "Error bars come from {} bootstrap draws.",
    "wavelengths_nm": "The wavelengths were {} nm.",
    "soot_exponent": "Soot was taken to absorb as the wavelength to the power of minus {}.",
    "frequency_hz": "The frequency was {} Hz.",
    "backbone_weights": "Weights of the backbone: {}.",
    "epochs": "Training took {} epochs.",
    "seed": "The seed of all random draws was {}.",
    "data_sha256": "The data set's SHA-256 is {}.",
}
"""Sentence for each entry of a record that a methods part should state."""


def curves_of(table: Table) -> list[dict[str, Any]]:
    """Curves of a long table of numbers: each column over the first, where that rises.

    Returns
    -------
    list of dict
        Title, and for an SVG picture of 300 x 120 the points, and the ends of both axes. Values
        that are above 0 and span a factor of 30 and more are drawn by their logarithms.
    """
    try:
        values = np.array([[float(cell or "nan") for cell in row] for row in table.rows])
    except ValueError:
        return []
    across = values[:, 0]
    if len(values) < CURVE_ROWS or not (np.abs(across) < LARGEST_NUMBER).all():
        return []
    if not (np.diff(across) > 0).all():
        return []
    curves = []
    for column, heights in zip(table.columns[1:], values[:, 1:].T, strict=True):
        known = np.abs(heights) < LARGEST_NUMBER
        if known.sum() < CURVE_ROWS:
            continue
        x, y = across[known], heights[known]
        low, high = float(y.min()), float(y.max())
        log = low > 0 and high > 30 * low
        y = np.log(y) if log else y
        span = float(np.ptp(y)) or 1.0
        right = 300 * (x - x[0]) / (x[-1] - x[0])
        down = 120 - 120 * (y - y.min()) / span
        step = max(len(x) // 600, 1)
        points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(right[::step], down[::step]))  # noqa: B905
        title = f"{printable(table.name)}: {printable(column).replace('_', ' ')}"
        curves.append(
            {"title": title, "points": points, "log": log}
            | {"low": written(low), "high": written(high), "over": printable(table.columns[0])}
            | {"first": written(float(x[0])), "last": written(float(x[-1]))}
        )
    return curves


def _pictures(folder: Folder, room: int) -> list[dict[str, str]]:
    """Pictures as data, reduced until all of them fit into a number of bytes."""
    images = {}
    for path in folder.pictures:
        try:
            levels = np.rint(255 * np.clip(read_image(path), 0, 1)).astype(np.uint8)
        except InputError as error:
            folder.left_out.append(printable(f"{path.name} is not shown: {error}", 400))
            continue
        images[path.name] = Image.fromarray(levels)
    for width in WIDTHS:
        shown = [(name, _as_data(image, width)) for name, image in images.items()]
        if sum(len(data) + 500 for _, data in shown) <= room:
            break
    while sum(len(data) + 500 for _, data in shown) > room:
        name, _ = shown.pop()
        folder.left_out.append(f"{name} is not shown: the report would exceed 5 MB.")
    titles = [printable(Path(name).stem).replace("_", " ") for name, _ in shown]
    return [{"title": t, "data": data} for t, (_, data) in zip(titles, shown, strict=True)]


def _as_data(image: Image.Image, width: int) -> str:
    small = image.copy()
    small.thumbnail((width, 4 * width), Image.Resampling.LANCZOS)
    file = io.BytesIO()
    small.save(file, "PNG", optimize=True)
    return base64.b64encode(file.getvalue()).decode("ascii")
