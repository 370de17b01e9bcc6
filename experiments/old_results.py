"""The command that lists which committed results are older than their code: results."""

import json
import subprocess

import click
import cloup

from experiments.paths import EXPERIMENTS, REFERENCE

ROOT = EXPERIMENTS.parent

SIMULATION = "lf_flame/optics lf_flame/scenes lf_flame/simulation"
REFOCUSING = f"{SIMULATION} lf_flame/refocus"
LEARNING = f"{REFOCUSING} lf_flame/projection lf_flame/datasets lf_flame/learning data_gen"
TABLES = f"{LEARNING} experiments/paper experiments/studies experiments/depth_test"

CODE = {
    "benchmarks/installing": "setup.cfg",
    "benchmarks/training": "lf_flame/learning lf_flame/_common experiments/benchmarks",
    "benchmarks/viewer": "lf_flame/viewer experiments/benchmarks",
    "benchmarks": f"{REFOCUSING} lf_flame/_common experiments/benchmarks",
    "bounds": f"{SIMULATION} experiments/bounds",
    "compare": f"{LEARNING} lf_flame/systems experiments/systems",
    "costs": f"{LEARNING} experiments/costs experiments/effects",
    "dataset_making": f"{LEARNING} experiments/dataset_making",
    "effects": f"{SIMULATION} experiments/effects",
    "hard_cases": f"{LEARNING} lf_flame/tomography experiments/hard_cases",
    "refocus": REFOCUSING,
    "regions": f"{REFOCUSING} lf_flame/systems",
    "screenshots": "lf_flame/viewer experiments/screenshots",
    "slope_maps": f"{REFOCUSING} experiments/slope_maps",
    "system_scenes": f"{LEARNING} lf_flame/systems experiments/systems",
    "emission": f"{REFOCUSING} lf_flame/tomography experiments/emission",
}
"""Folders that a result rests on, by the beginning of its record's path; else `TABLES`."""


def age(name: str, revision: str) -> str:
    """Count the commits since a revision that changed the code of the result `name`."""
    paths = next((paths for start, paths in CODE.items() if name.startswith(start)), TABLES)
    command = ["git", "log", "--format=%cs", f"{revision.removesuffix('+')}..HEAD", "--"]
    found = subprocess.run([*command, *paths.split()], cwd=ROOT, capture_output=True, text=True)
    if found.returncode:
        return "git does not know this revision"
    dates, edited = found.stdout.split(), ", of edited files" * revision.endswith("+")
    return (f"commits since: {len(dates)}, last {dates[0]}" if dates else "current") + edited


@cloup.command()
def results() -> None:
    """List each committed result with its revision and the commits since that changed its code.

    A result whose code has changed may still hold: read the commits, or make it anew by its target
    (`make help`, experiments/README.md) and copy it to experiments/results.
    """
    for record in sorted(REFERENCE.glob("**/*.json")):
        name = str(record.relative_to(REFERENCE))
        revision = json.loads(record.read_text(encoding="utf-8"))["git_revision"]
        click.echo(f"{name:40} {revision:14} {age(name, revision)}")
