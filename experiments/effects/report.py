"""Table of effects beside their references (`experiments.effects.absolute`)."""

from pathlib import Path

import pandas as pd

from experiments.report import markdown, write_report

COLUMNS = {
    "effect": ("effect", ""),
    "reference": ("reference", ".4f"),
    "library": ("library", ".4f"),
    "difference": ("difference", ".1e"),
    "rms_difference": ("rms", ".1e"),
    "reference_error": ("error of the reference", ".0e"),
    "change": ("largest change", ".2g"),
    "bound": ("bound", ".2g"),
    "looseness": ("bound / change", ".1f"),
}


def write(out: Path, record: dict) -> Path:
    """Write ``absolute.*`` from the record of `experiments.effects.absolute.measure_effects`."""
    tables = {"absolute": pd.DataFrame(record["rows"])}
    title = "Every effect in absolute terms"
    return write_report(out, "absolute", title, record, body(record), tables=tables)


def body(record: dict) -> list[str]:
    """Write the tables and what they rest on as Markdown."""
    parts = [
        "A small flame with what calls for the effect, rendered at tolerance "
        f"{record['tolerance']:g}, beside `experiments/effects/ray_tracer.py`: {record['rays']} "
        f"rays through each lenslet in each of {record['repeats']} randomisations, in "
        f"{record['pixels']} pixels, half of them those that change most. Behind the tracer "
        "saturation and quantisation are closed forms; noise is the closed form of EMVA 1288, as a "
        "root-mean-square over the image.",
        "All values are relative to the brightest pixel without the effect. Reference and library: "
        "in the pixel where they differ most. rms: of the differences over all pixels that were "
        "traced. Error of the reference: standard error in that pixel. Largest change: that the "
        "effect makes, by the reference. Bound: the plan's, for any pixel.",
    ]
    for name, camera in record["cameras"].items():
        lines, columns = camera["lenslets"]
        parts += [
            f"## {name}",
            f"Main lens of {camera['main_lens_focal_mm']:g} mm, focused on "
            f"{camera['focus_distance_mm']:g} mm; a window of {lines} x {columns} lenslets of "
            f"{camera['lenslet_pitch_mm']:g} mm, each with {camera['views']} x {camera['views']} "
            "views.",
            markdown(
                [row for row in record["rows"] if row["camera"] == name], COLUMNS, missing="inf"
            ),
        ]
    return parts
