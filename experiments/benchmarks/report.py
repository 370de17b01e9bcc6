"""What the benchmarks share: times taken in turn, and the files of a table."""

import sys
from pathlib import Path

import pandas as pd

from experiments.beside_reference import set_beside
from lf_flame._common.atomic_files import together, write_json, write_text


def write_table(
    stem: Path,
    title: str,
    table: pd.DataFrame,
    formats: tuple,
    record: dict,
    missing: str = "nan",
    notes: str = "",
    repeated: str = "Best of some rounds in turn",
    command: str = "make benchmarks",
) -> None:
    """Write a table as Markdown, CSV and, with the record of its making, JSON; print the first."""
    known = table.astype(object).where(table.notna(), None)
    text = (
        f"### {title}\n\n"
        + known.to_markdown(index=False, floatfmt=formats, missingval=missing)
        + f"\n\n{notes}{repeated}; {record['machine']}, revision {record['git_revision']}. "
        f"Command: `{command}`.\n"
    )
    with together(stem.parent, last=f"{stem.name}.json") as aside:
        write_text(aside / f"{stem.name}.md", text)
        write_text(aside / f"{stem.name}.csv", table.to_csv(index=False))
        write_json(aside / f"{stem.name}.json", {**record, "rows": known.to_dict("records")})
    sys.stdout.write(set_beside(stem.with_suffix(".md"), f"benchmarks/{stem.name}.md"))
