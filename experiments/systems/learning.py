"""How the systems learnt, side by side: after the same steps, and after the same seconds."""

import pandas as pd

from experiments.report import markdown
from lf_flame._common.figures import subplots

AXES = {"seconds": "seconds of training", "steps": "steps of the optimiser"}


def learning_table(about: dict[str, dict]) -> pd.DataFrame:
    """Compare systems where the quickest to stop had stopped, in seconds and in steps.

    One row for each system that has a ``curve``: PSNR on held-out samples after as many seconds,
    after as many steps, and at the end; seconds, steps, and at_seconds and at_steps, what all have
    had.
    """
    curves = {name: one["curve"] for name, one in about.items() if "curve" in one}
    common = {axis: min((c[axis][-1] for c in curves.values()), default=0) for axis in AXES}
    return pd.DataFrame(
        [
            {
                "system": name,
                "after_seconds_db": _reached(curve, "seconds", common["seconds"]),
                "after_steps_db": _reached(curve, "steps", common["steps"]),
                "end_db": max(curve["psnr_db"]),
                "seconds": curve["seconds"][-1],
                "steps": curve["steps"][-1],
                "at_seconds": common["seconds"],
                "at_steps": common["steps"],
            }
            for name, curve in curves.items()
        ]
    )


def _reached(curve: dict, axis: str, limit: float) -> float:
    """Best PSNR of the epochs that were done by then; the best one's weights are kept."""
    done = [
        psnr for at, psnr in zip(curve[axis], curve["psnr_db"], strict=True) if at <= limit + 1e-6
    ]
    return max(done)


def learning_text(about: dict[str, dict]) -> str:
    """Write the table as Markdown; nothing where no system says how it learnt."""
    table = learning_table(about)
    if table.empty:
        return ""
    first = table.iloc[0]
    columns = {
        "system": ("system", ""),
        "after_seconds_db": (f"after {first.at_seconds:,.0f} s", ".2f"),
        "after_steps_db": (f"after {first.at_steps:,.0f} steps", ".2f"),
        "end_db": ("at the end", ".2f"),
        "seconds": ("seconds", ",.0f"),
        "steps": ("steps", ",.0f"),
    }
    return f"""## While learning, PSNR (dB)

On held-out training samples, whole images, the best epoch so far; each system learns at its own
pace, whose rate of learning falls towards its own end. Those trained in low light, on the round
aperture or on the Fourier slice are held against samples of their own kind.

{markdown(table, columns)}

"""


def learning_figure(about: dict[str, dict]):
    """Draw PSNR on held-out samples against seconds and against steps."""
    figure, axes = subplots(1, 2, figsize=(11, 5), sharey=True, layout="constrained")
    curves = {name: one["curve"] for name, one in about.items() if "curve" in one}
    for axis, (key, words) in zip(axes, AXES.items(), strict=True):
        for number, (name, curve) in enumerate(curves.items()):
            axis.plot(
                curve[key][1:], curve["psnr_db"][1:], ".-", markersize=3, linewidth=1,
                color=f"C{number}", label=name,
            )  # fmt: skip
        axis.set_xscale("log")
        axis.set_xlabel(words)
        axis.grid(alpha=0.3, which="both")
    axes[0].set_ylabel("PSNR on held-out samples (dB)")
    axes[1].legend(fontsize=8)
    return figure
