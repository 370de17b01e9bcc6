"""Plant small errors in the numerical core, one at a time, and list those that no test notices.

    python tests/mutants.py --out results/mutants

Every mutant (`tests/mutator.py`) is planted in a copy of the checkout, and the tests of its file
run there until one fails. What was found is written down at once: after Ctrl-C the same command
goes on. A survivor either calls for a test, or computes the same, or does not matter; why, is
written in `tests/mutants_explained.toml`.
"""

import argparse
import hashlib
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
import tomllib
from collections import Counter
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from tempfile import TemporaryDirectory

from mutator import Mutant, draw_mutants, find_mutants
from tqdm import tqdm

from lf_flame._common import provenance
from lf_flame._common.atomic_files import write_json, write_text

ROOT = Path(__file__).parents[1]
EXPLAINED = Path(__file__).with_name("mutants_explained.toml")

GRID = ("formats/test_raw_lenslets.py",)
SCENES = ("scenes/test_scene.py", "simulation/test_rendering.py")
HARD = "experiments/hard_cases/test_hard_cases.py"
IMAGES = (
    "simulation/test_rendering.py", "stability/test_render.py", "simulation/test_absolute_stops.py",
    "simulation/test_absolute.py", HARD,
)  # fmt: skip
MATTER = (
    "simulation/test_absolute_matter.py", "simulation/test_polygons.py", "stability/test_light.py",
    *IMAGES,
)  # fmt: skip
PLANS = (
    "simulation/planning/test_scene_bounds.py", "simulation/planning/test_plan.py",
    "simulation/planning/test_part_counts.py", "simulation/planning/test_probes.py",
    "simulation/planning/test_effects.py",
)  # fmt: skip
SPACE = ("refocus/test_shift.py", "refocus/test_surface.py", "refocus/test_fourier.py")
SHARPNESS = ("refocus/test_sharpness.py",)
SCORES = ("experiments/paper/test_tables.py", "stability/test_scores.py", HARD)
RIDGE = ("learning/test_warm_start.py",)
DATASETS = ("datasets/test_datasets.py",)
SYSTEMS = ("systems/test_base.py",)

CORE = {
    "_common/arrays.py": ("datasets/test_encodings.py", "refocus/test_fourier.py"),
    "_common/metrics.py": SCORES,
    "lightfield.py": (),
    "optics/aperture_response.py": ("optics/test_diffraction.py",),
    "optics/camera.py": ("stability/test_conjugates.py", "stability/test_ray_bundle.py", HARD),
    "optics/diffraction.py": (),
    "optics/ray_bundle.py": ("stability/test_ray_bundle.py", *IMAGES),
    "optics/ray_transfer.py": (),
    "optics/sensor.py": (),
    "optics/slope_conventions.py": (),
    "scenes/_kernels.py": ("scenes/test_dead_leaves.py",),
    "scenes/dead_leaves.py": (),
    "scenes/flames.py": SCENES,
    "scenes/scene.py": SCENES,
    "scenes/shapes.py": SCENES,
    "simulation/_polygon_kernels.py": ("simulation/test_polygons.py",),
    "simulation/_exact_kernels.py": MATTER,
    "simulation/_falloff_kernels.py": ("simulation/test_optical_pass.py", *MATTER),
    "simulation/_ray_kernels.py": ("simulation/test_optical_pass.py", *MATTER),
    "simulation/_stop_kernels.py": ("simulation/test_optical_pass.py", *MATTER),
    "simulation/planning/absorbing_slabs.py": PLANS,
    "simulation/bundle_shifts.py": PLANS,
    "simulation/lenslet_blur.py": (
        "simulation/test_absolute_record.py",
        "simulation/test_absolute.py",
    ),
    "simulation/main_lens_blur.py": (
        "simulation/test_absolute_record.py",
        "simulation/test_absolute.py",
    ),
    "simulation/planning/pixel_parts.py": (
        "simulation/test_lenslet_blur.py",
        "simulation/test_absolute.py",
    ),
    "simulation/planning/effects.py": PLANS,
    "simulation/exact.py": MATTER,
    "simulation/layouts.py": IMAGES,
    "simulation/optical_pass.py": IMAGES,
    "simulation/planning/peak.py": PLANS,
    "simulation/polygons.py": MATTER,
    "simulation/planning/decisions.py": PLANS,
    "simulation/planning/plan.py": PLANS,
    "simulation/planning/ray_counts.py": IMAGES,
    "simulation/passes.py": IMAGES,
    "simulation/ray_tables.py": IMAGES,
    "simulation/rays.py": MATTER,
    "simulation/reference/closed_form.py": ("simulation/test_closed_form.py", *IMAGES),
    "simulation/reference/forward.py": ("simulation/test_forward.py",),
    "simulation/rendering.py": (*IMAGES, "simulation/planning/test_effects.py"),
    "simulation/planning/scene_bounds.py": PLANS,
    "simulation/planning/probes.py": PLANS,
    "simulation/slabs.py": (*MATTER, "simulation/planning/test_part_counts.py"),
    "simulation/planning/part_counts.py": PLANS,
    "simulation/planning/time_estimates.py": PLANS,
    "simulation/ray_grid.py": MATTER,
    "simulation/stops.py": PLANS,
    "formats/lenslet_grid.py": GRID,
    "formats/raw_lenslets.py": GRID,
    "formats/view_order.py": ("formats/test_view_folder.py",),
    "formats/white_image.py": GRID,
    "refocus/_alignment_kernels.py": ("refocus/test_alignment.py",),
    "refocus/_filling_kernels.py": ("refocus/test_filling.py",),
    "refocus/_kernels.py": (*SPACE, "stability/test_refocus.py", HARD),
    "refocus/_matching_kernels.py": ("refocus/test_matching.py",),
    "refocus/_semblance_kernels.py": SHARPNESS,
    "refocus/_surface_kernels.py": ("refocus/test_surface.py",),
    "refocus/alignment.py": (),
    "refocus/aperture.py": (),
    "refocus/depth_from_focus.py": (),
    "refocus/filling.py": (),
    "refocus/fourier.py": ("stability/test_refocus.py", HARD),
    "refocus/interpolation.py": SPACE,
    "refocus/matching.py": ("refocus/test_depth_from_focus.py",),
    "refocus/methods.py": SPACE,
    "refocus/semblance.py": SHARPNESS,
    "refocus/semblance_sums.py": SHARPNESS,
    "refocus/sharpness.py": ("stability/test_refocus.py", HARD),
    "refocus/shift.py": ("stability/test_refocus.py", HARD),
    "refocus/surface.py": (),
    "projection/_kernels.py": ("projection/test_projector.py",),
    "projection/line_sums.py": ("projection/test_projector.py",),
    "projection/projector.py": (),
    "tomography/_frequency_kernels.py": ("tomography/test_reconstruction.py",),
    "tomography/absorption.py": (),
    "tomography/axisymmetric.py": (),
    "tomography/axisymmetric_fit.py": ("tomography/test_axisymmetric.py",),
    "tomography/axisymmetric_grid.py": (
        "tomography/test_axisymmetric.py",
        "tomography/test_abel_pairs.py",
    ),
    "tomography/axisymmetric_operator.py": ("tomography/test_axisymmetric.py",),
    "tomography/cell_detail.py": (),
    "tomography/error_bars.py": ("tomography/test_reconstruction.py",),
    "tomography/flame_axis.py": (
        "tomography/test_axisymmetric.py",
        "tomography/test_abel_pairs.py",
    ),
    "tomography/roundness.py": ("tomography/test_abel_pairs.py",),
    "tomography/flame_shape.py": (),
    "tomography/flicker.py": (),
    "tomography/data_checks.py": ("tomography/test_reconstruction.py",),
    "tomography/foreground.py": (),
    "tomography/frequency_gram.py": ("tomography/test_reconstruction.py",),
    "tomography/frustum_grid.py": ("tomography/test_projection_operator.py",),
    "tomography/plane_fit.py": (
        "tomography/test_reconstruction.py",
        "tomography/test_foreground.py",
    ),
    "tomography/penalised_fit.py": ("tomography/test_reconstruction.py",),
    "tomography/profiles.py": (),
    "tomography/projection_operator.py": (),
    "tomography/pyrometry.py": (),
    "tomography/reconstruction.py": (),
    "tomography/resolution.py": (),
    "tomography/strength_search.py": ("tomography/test_reconstruction.py",),
    "tomography/tikhonov.py": ("tomography/test_total_variation.py",),
    "tomography/total_variation.py": (),
    "datasets/encodings.py": (),
    "datasets/sampling.py": DATASETS,
    "datasets/split.py": DATASETS,
    "datasets/templates.py": ("scenes/test_flames.py", "scenes/test_scene.py", *DATASETS),
    "learning/_adam.py": ("learning/test_trainers.py",),
    "learning/fast_decoder.py": ("learning/test_decoder.py", "learning/test_trainers.py"),
    "learning/ridge.py": RIDGE,
    "learning/sigmoid_regression.py": (),
    "learning/scoring.py": SCORES,
    "learning/warm_start.py": (),
    "systems/aperturenet.py": SYSTEMS,
    "systems/denoised.py": ("systems/test_denoised.py",),
    "systems/formulas.py": SYSTEMS,
    "systems/region_refocus.py": (),
    "systems/similarity.py": (),
    "systems/sparse_unet.py": SYSTEMS,
    "systems/view_selection.py": ("systems/test_aperturenet.py", *SYSTEMS),
}
"""Files of the numerical core, and tests of theirs beside the one that mirrors each of them."""

OUTCOMES = ("killed", "timed out", "survived", "not reached", "not started")
"""What becomes of a mutant. One that makes its tests run far longer than they do is noticed, too;
one that no test of its file works out, or that keeps the tests from starting, decides nothing."""

DECIDED = OUTCOMES[:3]

LEAST_LIMIT_S, PATIENCE = 120.0, 6.0
"""A mutant's tests may take so many times as long as without it, and at least so long."""


class Refused(Exception):
    """The tests fail as they are: nothing can be learnt from mutants."""


@dataclass(frozen=True)
class Trial:
    """A mutant, its line before and after, and the tests that may notice it."""

    mutant: Mutant
    before: str
    after: str
    tests: tuple[str, ...]
    key: str
    tests_key: str


def tests_of(file: str) -> tuple[str, ...]:
    """Name the tests of a file of the core: the one that mirrors it first."""
    room, _, name = file.rpartition("/")
    mirror = Path(room) / f"test_{name}"
    named = [str(mirror)] if (ROOT / "tests" / mirror).exists() else []
    named += [test for test in CORE[file] if test not in named]
    return tuple(f"tests/{test}" for test in named)


def draw_trials(files: list[str], count: int, seed: int) -> list[Trial]:
    """Draw so many mutants of each file of the core."""
    trials = []
    for file in files:
        source = (ROOT / "lf_flame" / file).read_text(encoding="utf-8")
        tests = tests_of(file)
        tests_key = _digest(*(path.read_text(encoding="utf-8") for path in _test_files(tests)))
        for mutant in draw_mutants(find_mutants(source, f"lf_flame/{file}"), count, seed):
            key = _digest(source, repr(mutant))
            trials.append(Trial(mutant, *mutant.lines(source), tests, key, tests_key))
    return trials


def _test_files(tests: tuple[str, ...]) -> list[Path]:
    """List the files of some tests, and what all tests share."""
    shared = [ROOT / "tests" / name for name in ("conftest.py", "reference.py")]
    named = [sorted((ROOT / t).glob("*.py")) if "." not in t else [ROOT / t] for t in tests]
    return shared + [path for paths in named for path in paths]


def _digest(*texts: str) -> str:
    return hashlib.sha256("\0".join(texts).encode()).hexdigest()[:16]


class Workplace:
    """A copy of the checkout, in a folder of its own, where tests run."""

    def __init__(self, folder: Path, stopped: threading.Event, threads: int):
        self.checkout, self.stopped = folder / "checkout", stopped
        listed = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
        names = subprocess.run(listed, cwd=ROOT, capture_output=True, text=True, check=True).stdout
        for name in filter(None, names.split("\0")):
            if (ROOT / name).is_file() and not name.startswith("experiments/results/"):
                self._copy(ROOT / name)
        for compiled in (ROOT / "lf_flame").rglob("*.nb[ic]"):
            self._copy(compiled)
        scratch = folder / "scratch"
        scratch.mkdir()
        # No compiled Python is kept: it would tell old from new by seconds and sizes.
        self.environment = os.environ | {
            "PYTHONPATH": str(self.checkout),
            "PYTHONDONTWRITEBYTECODE": "1",
            "NUMBA_NUM_THREADS": str(threads),
            "OMP_NUM_THREADS": str(threads),
            "TF_CPP_MIN_LOG_LEVEL": "3",
            "TMPDIR": str(scratch),
        }

    def _copy(self, path: Path) -> None:
        """Copy a file and its time, by which Numba knows whether what it compiled is of today."""
        copy = self.checkout / path.relative_to(ROOT)
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(path, copy)

    def test(self, tests: tuple[str, ...], limit_s: float | None = None) -> tuple[int | None, str]:
        """Run tests up to the first failure: exit status, None where time ran out, and output."""
        command = [
            sys.executable, "-m", "pytest", *tests, "-x", "-q", "-m", "not slow",
            "-p", "no:cacheprovider", "--hypothesis-profile=first_failure",
        ]  # fmt: skip
        process = subprocess.Popen(
            command, cwd=self.checkout, env=self.environment, text=True, start_new_session=True,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL,
        )  # fmt: skip
        end = time.monotonic() + (limit_s or float("inf"))
        try:
            while True:
                try:
                    output, _ = process.communicate(timeout=0.5)
                except subprocess.TimeoutExpired:
                    if self.stopped.is_set():
                        raise KeyboardInterrupt from None
                    if time.monotonic() > end:
                        return None, ""
                else:
                    return process.returncode, output
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.communicate()

    def try_out(self, trial: Trial, limit_s: float) -> dict:
        """Plant a mutant, test, and take it out again."""
        start = time.monotonic()
        with self._planted(trial.mutant, trial.mutant.apply):
            status, output = self.test(trial.tests, limit_s)
        outcome, by = judge(status, output)
        if outcome == "survived":
            with self._planted(trial.mutant, trial.mutant.sabotage):
                status, _ = self.test(trial.tests, limit_s)
            outcome = "not reached" if status == 0 else "survived"
        return {
            "key": trial.key, "tests_key": trial.tests_key, "file": trial.mutant.file,
            "line": trial.mutant.line, "kind": trial.mutant.kind, "before": trial.before,
            "after": trial.after, "outcome": outcome, "by": by, "tests": trial.tests,
            "seconds": round(time.monotonic() - start, 1),
        }  # fmt: skip

    @contextmanager
    def _planted(self, mutant: Mutant, change):
        """Change a file for a while; what Numba compiled of it comes back with it."""
        path = self.checkout / mutant.file
        kernels = partial((path.parent / "__pycache__").glob, f"{path.stem}.*.nb[ic]")
        kept = {p: p.read_bytes() for p in (path, *kernels())}
        times = path.stat().st_atime_ns, path.stat().st_mtime_ns
        path.write_text(change(kept[path].decode()), encoding="utf-8")
        try:
            yield
        finally:
            for compiled in kernels():
                compiled.unlink()
            for before, content in kept.items():
                before.write_bytes(content)
            os.utime(path, ns=times)


def judge(status: int | None, output: str) -> tuple[str, str | None]:
    """Tell from pytest's exit status and output what became of a mutant, and which test failed."""
    if status is None:
        return "timed out", None
    if status == 0:
        return "survived", None
    if status < 0:
        return "killed", f"a crash by signal {-status}"
    named = [
        line.split(" - ")[0].split(" ", 1)[1]
        for line in output.splitlines()
        if line.startswith(("FAILED ", "ERROR "))
    ]
    failed = [name for name in named if "::" in name]  # else a whole file cannot be imported
    return ("killed", failed[0]) if failed else ("not started", None)


def run(trials: list[Trial], jobs: int, record: Path) -> None:
    """Try the mutants out side by side, and write down what was found, one line each."""
    stopped, idle = threading.Event(), SimpleQueue()
    with TemporaryDirectory(prefix="mutants-") as folder, ThreadPoolExecutor(jobs) as pool:
        try:
            for k in range(jobs):
                (place := Path(folder) / str(k)).mkdir()
                idle.put(Workplace(place, stopped, max(provenance.cpu_count() // jobs, 1)))

            def at_a_workplace(work):
                workplace = idle.get()
                try:
                    return work(workplace)
                finally:
                    idle.put(workplace)

            def seconds_of(tests):
                return at_a_workplace(lambda workplace: _seconds(workplace, tests))

            def try_out(trial):
                limit_s = max(LEAST_LIMIT_S, PATIENCE * seconds[trial.tests])
                return at_a_workplace(lambda workplace: workplace.try_out(trial, limit_s))

            sets = sorted({trial.tests for trial in trials})
            first = tqdm(pool.map(seconds_of, sets), "without mutants", len(sets), unit="set")
            seconds = dict(zip(sets, first, strict=True))
            found = as_completed([pool.submit(try_out, trial) for trial in trials])
            with record.open("a", encoding="utf-8") as file:
                for future in tqdm(found, "mutants", len(trials), unit="mutant"):
                    file.write(json.dumps(future.result()) + "\n")
                    file.flush()
        except BaseException:
            stopped.set()
            pool.shutdown(cancel_futures=True)
            raise


def _seconds(workplace: Workplace, tests: tuple[str, ...]) -> float:
    """Time the tests as they are.

    Raises
    ------
    Refused
        If they fail.
    """
    start = time.monotonic()
    status, output = workplace.test(tests)
    if status != 0:
        raise Refused(f"The tests fail without a mutant: {' '.join(tests)}\n\n{output[-3000:]}")
    return time.monotonic() - start


def known(record: Path) -> dict[str, dict]:
    """Read what was found before, by key; a line that was cut off is left out."""
    rows = {}
    for line in record.read_text(encoding="utf-8").splitlines() if record.exists() else ():
        try:
            row = json.loads(line)
        except json.JSONDecodeError:
            continue
        rows[row["key"]] = row
    return rows


def is_settled(trial: Trial, rows: dict[str, dict]) -> bool:
    """Whether a mutant was noticed before, or no test of its file has changed since."""
    row = rows.get(trial.key)
    return bool(row) and (row["outcome"] in DECIDED[:2] or row["tests_key"] == trial.tests_key)


def read_explanations(path: Path = EXPLAINED) -> dict[tuple[str, str, str], str]:
    """Read why survivors do not matter, by file, line and changed line."""
    entries = tomllib.loads(path.read_text(encoding="utf-8")).get("explained", [])
    return {(e["file"], e["line"], e["mutant"]): e["why"] for e in entries}


def summary(rows: list[dict]) -> dict:
    """Count the outcomes, over all and by file."""
    counts = Counter(row["outcome"] for row in rows)
    decided = sum(counts[outcome] for outcome in DECIDED)
    killed = decided - counts["survived"]
    explained = sum(row["outcome"] == "survived" and bool(row["why"]) for row in rows)
    return {
        "mutants": len(rows), **{outcome: counts[outcome] for outcome in OUTCOMES},
        "decided": decided, "explained": explained,
        "killed_share": killed / decided if decided else None,
    }  # fmt: skip


def report(rows: list[dict], made: dict) -> str:
    """Tell in Markdown what was found: the share, file by file, and every survivor."""
    total = summary(rows)
    share = "none" if total["killed_share"] is None else f"{total['killed_share']:.1%}"
    parts = [
        "# Mutants: planted errors that the tests notice\n",
        f"{total['mutants']} small errors, planted one at a time in the numerical core. "
        f"{total['decided']} are decided; of these the tests notice **{share}** "
        f"({total['timed out']} by running out of time), {total['survived']} survive, "
        f"{total['explained']} of them explained. Not decided: {total['not reached']} in code that "
        f"the file's tests do not run, {total['not started']} with which they do not start.\n",
        f"Seed {made['seed']}, up to {made['per_file']} for each file; {made['machine']}, revision "
        f"{made['git_revision']}. Command: `{made['command']}`.\n",
        "| file | mutants | decided | killed | survived, not explained |\n|---|---|---|---|---|",
    ]
    for file in sorted({row["file"] for row in rows}):
        some = summary([row for row in rows if row["file"] == file])
        killed, left = some["decided"] - some["survived"], some["survived"] - some["explained"]
        parts.append(f"| {file} | {some['mutants']} | {some['decided']} | {killed} | {left} |")
    for title, chosen in (
        ("Survivors", lambda row: row["outcome"] == "survived" and not row["why"]),
        ("Survivors, explained", lambda row: row["outcome"] == "survived" and row["why"]),
        ("Not decided", lambda row: row["outcome"] not in DECIDED),
    ):
        if listed := [row for row in rows if chosen(row)]:
            parts.append(f"\n## {title}\n")
            parts += [_entry(row) for row in listed]
    return "\n".join(parts) + "\n"


def _entry(row: dict) -> str:
    note = row["why"] or (row["outcome"] if row["outcome"] not in DECIDED else "")
    lines = f"`{row['before']}` -> `{row['after']}`"
    return f"- {row['file']}:{row['line']} ({row['kind']}): {lines}" + (f". {note}" if note else "")


def main(arguments: list[str] | None = None) -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument(
        "files", nargs="*", help="of lf_flame/, e.g. optics/camera.py (default: all)"
    )
    parser.add_argument("--per-file", type=int, default=4, help="mutants of a file (default: 4)")
    parser.add_argument("--seed", type=int, default=1, help="of the draw (default: 1)")
    parser.add_argument("--jobs", type=int, default=provenance.cpu_count(), help="side by side")
    parser.add_argument("--out", type=Path, default=Path("results/mutants"), help="results folder")
    asked = parser.parse_args(arguments)
    files = [name.removeprefix("lf_flame/") for name in asked.files] or list(CORE)
    if strange := [name for name in files if name not in CORE]:
        parser.error(f"{strange[0]} is not a file of the core; known are {', '.join(CORE)}")
    asked.out.mkdir(parents=True, exist_ok=True)
    record = asked.out / "mutants.jsonl"
    made = provenance.environment() | {"seed": asked.seed, "per_file": asked.per_file}
    trials = draw_trials(files, asked.per_file, asked.seed)
    open_trials = [trial for trial in trials if not is_settled(trial, known(record))]
    try:
        if open_trials:
            run(open_trials, max(asked.jobs, 1), record)
    except KeyboardInterrupt:
        sys.exit(f"\nStopped; the same command goes on. {record} holds what was found so far.")
    except Refused as refused:
        sys.exit(str(refused))
    explanations, found = read_explanations(), known(record)
    rows = [found[trial.key] for trial in trials]
    for row in rows:
        row["why"] = explanations.get((row["file"], row["before"], row["after"]))
    write_json(asked.out / "mutants.json", made | summary(rows) | {"rows": rows})
    write_text(asked.out / "mutants.md", report(rows, made))
    tqdm.write(report(rows, made))


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # as Ctrl-C
    main()
