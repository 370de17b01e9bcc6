"""Table and picture of what systems reach against the light fields that they learn from."""

import pandas as pd

from lf_flame._common.figures import subplots


def text(table: pd.DataFrame, record: dict) -> str:
    """Write the table as Markdown.

    Parameters
    ----------
    table : DataFrame
        Columns system, views, method, light_fields, steps, psnr_db, psnr_of_mean_error_db, ssim,
        images.
    record : dict
        See `experiments.systems.scene_counts.run_scene_counts`.
    """
    shown = pd.DataFrame(
        {
            "system": table["system"],
            "views": table["views"],
            "method": table["method"],
            "light fields to learn from": table["light_fields"].map(_whole),
            "steps": table["steps"].map(_whole),
            "PSNR (dB)": table["psnr_db"].map("{:.2f}".format),
            "of the mean error (dB)": table["psnr_of_mean_error_db"].map("{:.2f}".format),
            "SSIM": table["ssim"].map("{:.4f}".format),
        }
    )
    sides = ("left", "right", "left", *["right"] * 5)
    return f"""# What systems reach against the light fields that they learn from

`{record["command"]}`, {record["date"]}, revision {record["git_revision"]}, {record["machine"]}.

Each run of a system takes the same steps of its own recipe (`experiments/system_scenes.toml`), from
the same start; only the light fields that its patches are cut from are more. {record["held_out"]}
others choose its best epoch, and {record["scored"]} again others are scored here, the same for all
runs: whole images against all views, at the slopes that the system learns. PSNR is the mean over
{int(table["images"].min())} images or more; beside it that of the mean squared error, in which the
worst images count most. The formula has nothing to learn. One seed ({record["seed"]}).

{shown.to_markdown(index=False, disable_numparse=True, colalign=sides)}
"""


def _whole(number: float) -> str:
    return "-" if pd.isna(number) else f"{number:,.0f}"


def figure(table: pd.DataFrame):
    """Draw PSNR against light fields to learn from, each system beside the sum of its views.

    Returns
    -------
    matplotlib.figure.Figure
    """
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
    axis.plot([], [], "--", color="grey", label="shift-and-sum of the same views")
    axis.set_xscale("log")
    axis.set_xlabel("light fields to learn from")
    axis.set_ylabel("PSNR against all views (dB)")
    axis.grid(alpha=0.3, which="both")
    axis.legend(fontsize=9)
    return drawn
