"""The benchmarks of refocusing and training run, and say how far the baselines' outputs are off."""

import json
import sys

import numpy as np
import pytest

from experiments.benchmarks import decoding, refocusing, report, speed, starting
from experiments.timing import in_turn

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def training():
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("OPENBLAS_NUM_THREADS", "1")  # which it sets, so that this is undone
        from experiments.benchmarks import training

        patch.setattr(training, "TURN_S", 0.01)
        yield training


@pytest.fixture(scope="module")
def rows():
    """Rows of all small cases, without programs in another Python."""
    return [row for case in refocusing.cases(True) for row in refocusing.measure(case, True, None)]


@pytest.fixture(scope="module")
def steps(training):
    (case,) = training.cases(small=True)
    return {row["step"]: row for row in training.measure(case, 1)}


def test_raw_images_are_decoded_beside_their_rivals(tmp_path, monkeypatch):
    monkeypatch.setattr("sys.argv", ["decoding", "--small", "--out", str(tmp_path)])
    decoding.main()
    record = json.loads((tmp_path / "decoding.json").read_text())
    assert record["baselines"] == {}
    rows = record["rows"]
    assert [row["baseline"] for row in rows] == ["floor", "SciPy map_coordinates"]
    assert float(rows[1]["correlation"]) > 0.999
    assert all(row["ratio"] > 0 for row in rows)
    assert (tmp_path / "decoding.csv").read_text().count("\n") == 1 + len(rows)


def test_another_python_is_handed_arrays_and_answers(tmp_path):
    """A program that answers as `baselines.py` does: half the views, by its second call in 7 s."""
    program = tmp_path / "baselines.py"
    program.write_text(
        "import json, sys, numpy as np\n"
        "print(json.dumps({'plenpy': '1'}), flush=True)\n"
        "for line in sys.stdin:\n"
        "    asked = json.loads(line)\n"
        "    if 'out' in asked: np.save(asked['out'], np.load(asked['views']) / 2)\n"
        "    print(json.dumps({'seconds': 7}), flush=True)\n"
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(report, "__file__", str(tmp_path / "report.py"))
        with report.OtherPython(sys.executable) as other:
            assert other.versions == {"plenpy": "1"}
            half = other.refocus("plenpy", np.arange(4.0), (1.0,))
            assert other.seconds("plenpy") == 7
    np.testing.assert_array_equal(half, [0, 0.5, 1, 1.5])


def test_kernels_with_no_effect_kept_compute_what_bare_ones_do(monkeypatch):
    monkeypatch.setattr(speed, "in_turn", lambda *calls, rounds: in_turn(*calls, rounds=1))
    for row in speed.bare_rows():
        assert row["ratio"] > 0, row
        assert float(row["outputs differ by"]) < 1e-6, row


def test_opponents_here_are_timed_and_refocus_as_we_do(rows):
    names = "NumPy, separable, tuned", "NumPy, separable, matrix product", "SciPy ndimage.shift"
    for name in names:
        found = [row for row in rows if row["baseline"] == name]
        assert len({row["what"] for row in found}) >= 4
        for row in found:
            assert float(row["baseline ms"]) > 0
            ratio = float(row["baseline ms"]) / float(row["ours ms"])
            assert float(row["ratio"]) == pytest.approx(ratio)  # of the one round
            assert 0 <= float(row["largest difference"]) <= 1e-6


def test_another_interpolant_is_seen_in_the_differences(rows):
    for name in ("our fourier_refocus", "SciPy ndimage.shift, order 3"):
        differences = [float(row["largest difference"]) for row in rows if row["baseline"] == name]
        assert differences
        assert min(differences) > 1e-3


def test_an_opponent_that_is_not_installed_is_shown_as_such(rows):
    missing = [row for row in rows if row["remarks"].startswith("not installed")]
    assert {row["baseline"] for row in missing} == {"plenpy", "PlenoptiCam"}
    assert all(row["baseline ms"] is row["ratio"] is None for row in missing)
    assert "not installed" in report.table_of(rows, refocusing.COLUMNS)


def test_every_target_has_a_row(rows):
    wanted = {(row["what"].split(",")[0], row["wanted"]) for row in rows if row["wanted"]}
    assert wanted == {
        ("four planes", "at least 0.25"),
        ("four planes", "at least 15"),
        ("15 planes", "at least 10"),
        ("four planes", "at least 1"),
    }


def test_images_that_differ_end_the_program(rng):
    image = rng.random((1, 6, 7))
    assert float(refocusing.compared(refocusing.SHIFT, image, image)) == 0
    with pytest.raises(SystemExit, match="differs by"):
        refocusing.compared(refocusing.SHIFT, image, 1.001 * image)


def test_the_floor_reads_every_pixel(rng):
    views = rng.random((3, 2, 9, 11)).astype(np.float32)
    assert refocusing.read_once(views, (0.0,)) == pytest.approx(views.sum(dtype=float), rel=1e-6)


def test_training_is_timed_and_gives_the_losses_of_keras(steps):
    for step in ("plain Keras", "plain Keras, XLA", "floor"):
        ratio = float(steps[step]["ms"]) / float(steps["ours"]["ms"])
        assert float(steps[step]["ratio"]) == pytest.approx(ratio)
    for step in ("ours", "plain Keras, XLA"):
        assert 0 <= float(steps[step]["largest difference"]) <= 1e-4


def test_the_floor_is_its_parts(steps):
    parts = [float(row["ms"]) for step, row in steps.items() if step.startswith("floor:")]
    assert len(parts) == 2
    assert min(parts) > 0
    assert sum(parts) == pytest.approx(float(steps["floor"]["ms"]))


def test_losses_that_differ_end_the_program(training):
    assert float(training.largest_difference([0.5, 0.25], [0.5, 0.25])) == 0
    for other in (0.2501, np.nan):
        with pytest.raises(SystemExit, match="differ by"):
            training.largest_difference([0.5, other], [0.5, 0.25])


def test_the_floor_counts_what_the_layers_multiply(training):
    """By hand, for the feature map 3 x 6 x 32, two samples, and the image 9 x 18 x 4."""
    (case,) = training.cases(small=True)
    found = [(a.shape[0], *b.shape) for a, b, _ in training.matrix_products(case.decoder(), 2)]
    first, second, dense = (36, 9 * 32, 512), (36, 9 * 512, 256), (2, 256, 9 * 18 * 4)
    forward = [first, second, dense]
    to_inputs = [(rows, outputs, inner) for rows, inner, outputs in (second, dense)]
    to_kernels = [(inner, rows, outputs) for rows, inner, outputs in (first, second)]
    assert sorted(found) == sorted(forward + to_inputs + to_kernels)


def test_starting_tells_the_first_start_from_the_second(monkeypatch):
    compiling = (  # for as long as nothing is kept
        "import os, pathlib, time; kept = pathlib.Path(os.environ['NUMBA_CACHE_DIR'], 'kept')\n"
        "if not kept.exists(): time.sleep(2); kept.touch()"
    )
    monkeypatch.setattr(starting, "COMMANDS", {"a": ("-c", compiling), "b": ("-c", compiling)})
    for row in starting.measure(repetitions=1):
        assert row["first start"] >= 2 > row["second start"] > 0
