"""Table of effects beside their references (`experiments.effects.absolute`)."""

from pathlib import Path

import pandas as pd

from lf_flame._common.atomic_files import together, write_json, write_text

HEADINGS = {
    "effect": "effect",
    "reference": "reference",
    "library": "library",
    "difference": "difference",
    "rms_difference": "rms",
    "reference_error": "error of the reference",
    "change": "largest change",
    "bound": "bound",
    "looseness": "bound / change",
}
"""Columns of the tables in the text."""

FORMATS = ("", ".4f", ".4f", ".1e", ".1e", ".0e", ".2g", ".2g", ".1f")


def write_report(out: Path, table: pd.DataFrame, record: dict) -> Path:
    """Write what `experiments.effects.absolute.measure_effects` found.

    Parameters
    ----------
    out : Path
        Folder for ``absolute.csv``, ``absolute.md`` and ``absolute.json``.
    table, record
        See there.

    Returns
    -------
    Path
        ``absolute.md``.
    """
    with together(out, last="absolute.json") as aside:
        write_text(aside / "absolute.csv", table.to_csv(index=False))
        write_json(aside / "absolute.json", record)
        write_text(aside / "absolute.md", text(table, record))
    return out / "absolute.md"


def text(table: pd.DataFrame, record: dict) -> str:
    """Put the tables and what they rest on into Markdown.

    Parameters
    ----------
    table : DataFrame
        A row for each effect and camera.
    record : dict
        With the values of `provenance.environment`.
    """
    versions = ", ".join(f"{name} {version}" for name, version in record["versions"].items())
    parts = "\n".join(_part(name, table, camera) for name, camera in record["cameras"].items())
    return f"""# Every effect in absolute terms

`{record["command"]}`, {record["date"]}, revision {record["git_revision"]}, {record["machine"]};
{versions}; {record["wall_s"]:.0f} s.

A small flame with what calls for the effect, rendered at tolerance {record["tolerance"]:g}, beside
`experiments/effects/ray_tracer.py`: {record["rays"]} rays through each lenslet in each of
{record["repeats"]} randomisations, in {record["pixels"]} pixels, half of them those that
change most. Behind the tracer saturation and quantisation are closed forms; noise is the
closed form of EMVA 1288, as a root-mean-square over the image.

All values are relative to the brightest pixel without the effect. Reference and library: in the
pixel where they differ most. rms: of the differences over all pixels that were traced. Error of the
reference: standard error in that pixel. Largest change: that the effect makes, by the reference.
Bound: the plan's, for any pixel.

{parts}"""


def _part(name: str, table: pd.DataFrame, camera: dict) -> str:
    """Table of one camera."""
    rows = table[table["camera"] == name].drop(columns="camera").rename(columns=HEADINGS)
    lines, columns = camera["lenslets"]
    return f"""## {name}

Main lens of {camera["main_lens_focal_mm"]:g} mm, focused on {camera["focus_distance_mm"]:g} mm; a
window of {lines} x {columns} lenslets of {camera["lenslet_pitch_mm"]:g} mm, each with
{camera["views"]} x {camera["views"]} views.

{rows.to_markdown(index=False, floatfmt=FORMATS)}
"""
