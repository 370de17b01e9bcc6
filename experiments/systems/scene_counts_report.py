"""Table and picture of what systems reach against the light fields that they learn from."""

import pandas as pd

from experiments.report import markdown
from lf_flame._common.figures import subplots


def _whole(number: float) -> str:
    return "-" if pd.isna(number) else f"{number:,.0f}"


COLUMNS = {
    "system": ("system", ""),
    "views": ("views", ""),
    "method": ("method", ""),
    "light_fields": ("light fields to learn from", _whole),
    "steps": ("steps", _whole),
    "psnr_db": ("PSNR (dB)", ".2f"),
    "psnr_of_mean_error_db": ("of the mean error (dB)", ".2f"),
    "ssim": ("SSIM", ".4f"),
}


def body(record: dict) -> list[str]:
    """Write the table as Markdown, from the record of `experiments.systems.scene_counts`."""
    images = min(row["images"] for row in record["rows"])
    return [
        "Each run of a system takes the same steps of its own recipe "
        "(`experiments/system_scenes.toml`), from the same start; only the light fields that its "
        f"patches are cut from are more. {record['held_out']} others choose its best epoch, and "
        f"{record['scored']} again others are scored here, the same for all runs: whole images "
        "against all views, at the slopes that the system learns. PSNR is the mean over "
        f"{images} images or more; beside it that of the mean squared error, in which the worst "
        f"images count most. The formula has nothing to learn. One seed ({record['seed']}).",
        markdown(record["rows"], COLUMNS),
    ]


def figure(table: pd.DataFrame):
    """Draw PSNR against light fields to learn from, each system beside the sum of its views."""
    drawn, axis = subplots(figsize=(7.5, 5), layout="constrained")
    for number, (name, rows) in enumerate(table.groupby("system", sort=False)):
        colour = f"C{number}"
        learnt = rows[rows["light_fields"].notna()].sort_values("light_fields")
        views = int(rows["views"].iloc[0])
        axis.plot(
            learnt["light_fields"], learnt["psnr_db"], "o-", color=colour,
            label=f"{name}, {views} views",
        )  # fmt: skip
        for level in rows.loc[rows["light_fields"].isna(), "psnr_db"]:
            axis.axhline(level, color=colour, linestyle="--", linewidth=1)
            axis.annotate("shift-and-sum of the same views", (learnt["light_fields"].min(), level),
                          (0, 4), textcoords="offset points", color=colour, fontsize=9)  # fmt: skip
    axis.set_xscale("log")
    counts = sorted(table["light_fields"].dropna().unique())
    axis.set_xticks(counts, [f"{count:,.0f}" for count in counts])
    axis.minorticks_off()
    axis.set_xlabel("light fields to learn from")
    axis.set_ylabel("PSNR against all views (dB)")
    axis.grid(alpha=0.3, which="both")
    axis.legend(fontsize=9)
    return drawn
