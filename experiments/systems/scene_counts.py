"""What refocusing systems reach, against the number of light fields that they learn from."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd

from experiments.command_parts import step_bar
from experiments.report import markdown, write_report
from lf_flame._common.config import to_json
from lf_flame.errors import InputError
from lf_flame.learning.run_folders import load_run
from lf_flame.learning.scores import psnr, ssim
from lf_flame.systems.base import RefocusingSystem
from lf_flame.systems.formulas import ShiftAndSum
from lf_flame.systems.registry import NETWORKS
from lf_flame.systems.training import load_system, train_system
from lf_flame.systems.training_config import SystemsConfig, SystemsPreset
from lf_flame.systems.training_scenes import PROJECTED, TrainingSamples

FIRST_SCORED = 2_000_000
"""Index of the first sample to score with: none of those that are learnt from or held out."""

PRESET = "scenes"

KEPT = ("system", "seed", "recipe", "counts", "epochs", "best_epoch", "git_revision", "date")
"""Entries that are kept of a run's record."""


def run_scene_counts(
    config: SystemsConfig,
    names: Sequence[str],
    counts: Sequence[int],
    held_out: int,
    scored: int,
    work: Path,
    out: Path,
) -> Path:
    """Train systems on more and more light fields, and score them on the same others.

    Every run of a system takes the same steps of the same recipe; only the light fields that its
    patches are cut from are more. Beside it stands shift-and-sum of the views that it looks at.
    Those held out choose the best epoch, others are scored. `work` holds the runs; those that are
    done are not done again. An InputError says that there is no such system, or that a number
    cannot be used.
    """
    if not counts or min(*counts, held_out, scored) < 1:
        raise InputError(
            f"Light fields to learn from, to hold out and to score must be 1 or more, got "
            f"{list(counts)}, {held_out} and {scored}."
        )
    jobs = {
        f"{name}-{count}": (name, count)
        for name in dict.fromkeys(names)
        for count in sorted(set(counts))
    }
    for name, count in jobs.values():
        _job(config, count, held_out).recipe(name, PRESET)  # refuses an unknown one now
    for folder, (name, count) in step_bar(jobs.items()):
        train_system(_job(config, count, held_out), name, PRESET, work / folder)
    records = {folder: load_run(work / folder) for folder in jobs}
    rows = []
    for name in dict.fromkeys(names):
        rows += _score_system(
            config, name, work, [n for one, n in jobs.values() if one == name], scored
        )
    table = pd.DataFrame(rows)
    record = {
        "training_samples": to_json(config.training_samples),
        "seed": config.seed,
        "held_out": held_out,
        "scored": scored,
        "runs": {
            folder: {key: one[key] for key in KEPT if key in one} for folder, one in records.items()
        },
        "rows": rows,
    }
    return write_report(
        out, "scene_counts", "What systems reach against the light fields that they learn from",
        record, body(record), tables={"scene_counts": table.round(4)},
    )  # fmt: skip


def _job(config: SystemsConfig, count: int, held_out: int) -> SystemsConfig:
    return replace(config, presets={PRESET: SystemsPreset(count, held_out)})


def _score_system(
    config: SystemsConfig, name: str, work: Path, counts: Sequence[int], scored: int
) -> list[dict]:
    """Score the runs of a network, and the formula that looks at the same views; a row each."""
    trained = {count: load_system(work / f"{name}-{count}") for count in counts}
    any_one = next(iter(trained.values()))
    formula = ShiftAndSum("shift-and-sum of the same views", any_one.view_indices)
    systems = [formula, *trained.values()]
    scores = score_systems(
        systems, config.training_samples, config.seed, scored, any_one, NETWORKS[name].truth
    )
    camera = config.training_samples.configs[0].camera
    about = {
        "system": NETWORKS[name].title,
        "views": len(any_one.view_indices(camera.views, camera.views)),
    }
    recipe = config.systems[name]
    steps = recipe.epochs * recipe.steps_per_epoch
    methods = [{"method": formula.name, "light_fields": np.nan, "steps": np.nan}]
    methods += [{"method": "trained", "light_fields": n, "steps": steps} for n in trained]
    return [about | method | score for method, score in zip(methods, scores, strict=True)]


def score_systems(
    systems: Sequence[RefocusingSystem],
    training_samples: TrainingSamples,
    seed: int,
    count: int,
    learner,
    truth: str = PROJECTED,
) -> list[dict[str, float]]:
    """Score systems that look at the same views on samples that no run has seen.

    Samples have the views of the learner, at the slopes from which it learns; the truth is a key of
    `lf_flame.systems.formulas.REFERENCES`. Returns for each system mean PSNR in dB (peak 1) and
    SSIM over all images, PSNR of their mean squared error, and their number.
    """
    looks = learner.view_indices if truth == PROJECTED else None
    found: list[list[tuple[float, float, float]]] = [[] for _ in systems]
    for index in range(FIRST_SCORED, FIRST_SCORED + count):
        sample = training_samples.draw(seed, index, looks=looks)
        slopes = learner.slopes_to_learn(sample.slopes, sample.block)
        wanted = sample.truth(slopes, truth)
        for scores, system in zip(found, systems, strict=True):
            drawn = system.refocus(sample.seen, slopes, sample.block)
            for one, image in zip(wanted, drawn, strict=True):
                error = float(np.mean(np.square(image - one, dtype=np.float64)))
                scores.append((psnr(one, image), ssim(one, image), error))
    return [
        {
            "psnr_db": float(np.mean(psnrs)),
            "ssim": float(np.mean(ssims)),
            "psnr_of_mean_error_db": float(-10 * np.log10(np.mean(errors))),
            "images": len(psnrs),
        }
        for psnrs, ssims, errors in (zip(*scores, strict=True) for scores in found)
    ]


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
    """Write the table as Markdown."""
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
