"""The slopes of sharpest focus, beside geometry and the paper."""

import math
from pathlib import Path

import pandas as pd

from experiments.paper.figures import sharpness_figure
from experiments.paper.paper_values import read_paper_values
from lf_flame._common import figures, provenance
from lf_flame._common.atomic_files import write_json, write_text
from lf_flame._common.config import to_json
from lf_flame.datasets.config import DatasetConfig
from lf_flame.datasets.sampling import search_slopes


def slope_report(configs: list[DatasetConfig], paper_values: Path, out: Path | None) -> str:
    """Search the slopes of data-set templates; write and return the table.

    Writes ``slopes.png``, ``slopes.md``, ``slopes.json`` and ``slopes.csv`` into `out`.
    """
    printed = read_paper_values(paper_values, "slopes")
    paper = dict(zip(printed["depth_mm"], printed["slope"], strict=True))
    rows, records, panels = [], [], {}
    for config in configs:
        searches = search_slopes(config, whole_range=True)
        records.append({"config": to_json(config), "slopes": [s.slope for s in searches]})
        layers = panels.setdefault(f"{config.kind}: mean scene", [])
        for item, search in zip(config.template.objects, searches, strict=True):
            geometry = config.camera.depth_to_slope(item.depth_mm)
            printed_slope = paper.get(item.depth_mm, math.nan)
            rows.append(
                (config.kind, item.name, item.depth_mm, search.slope, geometry,
                 search.slope - geometry, printed_slope)
            )  # fmt: skip
            label = f"{item.name} at {item.depth_mm:g} mm"
            layers.append((label, search, geometry, printed_slope))
    columns = ["data_set", "object", "depth_mm", "slope", "geometry", "difference", "paper"]
    table = pd.DataFrame(rows, columns=columns).round(4).replace(-0.0, 0.0)
    text = (
        f"### {printed['title']} (lenslets per view step)\n\n"
        + table.to_markdown(index=False, floatfmt=("", "", "g", ".4f", ".4f", "+.4f", ".2f"))
        + "\n\nFound by gradient energy on the mean scene; geometry: the camera's closed form.\n"
    )
    if out is not None:
        figures.save(sharpness_figure(panels), out / "slopes.png")
        write_json(out / "slopes.json", {"data_sets": records, **provenance.environment()})
        write_text(out / "slopes.md", text)
        write_text(out / "slopes.csv", table.to_csv(index=False))  # last, as make looks at it
    return text
