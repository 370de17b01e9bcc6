import gc
import json
import os
from dataclasses import replace
from pathlib import Path

# Tests run side by side. Threads of TensorFlow and of BLAS wait by spinning, and several of them on
# a core take many times as long. To be set before these load.
if "PYTEST_XDIST_WORKER" in os.environ:
    for name in ("TF_NUM_INTRAOP_THREADS", "TF_NUM_INTEROP_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")

import numpy as np  # noqa: E402
import pytest  # noqa: E402
from click.testing import CliRunner  # noqa: E402
from filelock import FileLock  # noqa: E402
from hypothesis import Phase, settings  # noqa: E402

from lf_flame import PAPER_CAMERA  # noqa: E402
from lf_flame.commands.cli import commands  # noqa: E402

# The same examples in every run: what fails for one fails for all. For new ones:
# pytest --hypothesis-profile=default
settings.register_profile("fixed", derandomize=True)
# ... and for runs in which a test's failure alone counts, not its simplest example.
settings.register_profile(
    "first_failure", derandomize=True, phases=[Phase.explicit, Phase.generate]
)
settings.load_profile("fixed")


@pytest.hookimpl(wrapper=True)
def pytest_collection():
    """Keep Python's garbage collector off what imports make, a million objects that stay."""
    gc.disable()
    yield
    gc.freeze()
    gc.enable()


@pytest.fixture
def rng(request):
    """A generator of its own for each test, the same in every run."""
    return np.random.default_rng(list(request.node.name.encode()))


@pytest.fixture
def small_camera():
    """The paper's optics with few lenslets and views."""
    return replace(PAPER_CAMERA, views=5, lenslets=(24, 30))


COARSE_CAMERA = """
[camera]
main_lens_focal_mm = 150.0
focus_distance_mm = 326.0
lenslet_focal_mm = 0.4
lenslet_pitch_mm = 0.672
views = 9
lenslets = [48, 96]
"""


@pytest.fixture(scope="session")
def coarse_data(tmp_path_factory):
    """Configurations of the paper's shapes and flames, seen in images of 24 x 48 pixels."""
    folder = tmp_path_factory.mktemp("data_gen")
    paths = []
    for kind in ("shapes", "flames"):
        text = Path(__file__).parents[1].joinpath("data_gen", f"{kind}.toml").read_text()
        before, _, behind = text.partition("[camera]")
        before = before.replace("[90, 180]", "[24, 48]")
        paths.append(folder / f"{kind}.toml")
        template = behind.partition("[template]")[2]
        paths[-1].write_text(f"{before}{COARSE_CAMERA}[template]{template}")
    return paths


SLOW_FIXTURES = {"run_folder", "runs", "exported", "system_runs", "chromium"}
"""Fixtures that train a network or drive a browser: whatever test takes one is slow."""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    for item in items:
        if SLOW_FIXTURES & set(getattr(item, "fixturenames", ())):
            item.add_marker(pytest.mark.slow)
    if os.environ.get("NUMBA_DISABLE_JIT", "0") == "0":
        return
    for item in items:
        if "jit" in item.keywords:
            item.add_marker(pytest.mark.skip(reason="NUMBA_DISABLE_JIT is set"))


@pytest.fixture(scope="session")
def system_runs(tmp_path_factory, coarse_data):
    """A folder of runs in which two networks were trained, for a moment.

    Tests side by side share it: whoever comes first makes it.
    """
    own = tmp_path_factory.getbasetemp()
    folder = (own.parent if "PYTEST_XDIST_WORKER" in os.environ else own) / "system_runs"
    with FileLock(folder.with_suffix(".lock")):
        if not folder.exists():
            _train_systems(folder, coarse_data)
    return folder


def _train_systems(folder, coarse_data):
    aside = folder.with_suffix(".part")
    aside.mkdir()
    text = "\n".join(
        [
            "seed = 1\n[training_samples]",
            f"data = {json.dumps([str(path) for path in coarse_data])}",
            "slopes = 2\n[presets.smoke]\ntraining_samples = 2\nheld_out = 1\n"
            "epochs = 1\nsteps_per_epoch = 2\nbatch_size = 2",
            "[systems.refocusnet]\nepochs = 1\npatch = 24",
            "[systems.volumetric]\nepochs = 1\npatch = 24",
        ]
    )
    (aside / "systems.toml").write_text(text)
    for name in ("refocusnet", "volumetric"):
        arguments = ["train-system", name, "--config", aside / "systems.toml", "--preset",
                     "smoke", "--seed", 9, "--out", aside / name]  # fmt: skip
        CliRunner().invoke(commands, [str(x) for x in arguments], catch_exceptions=False)
        assert json.loads((aside / name / "run.json").read_text())["seed"] == 9
    aside.rename(folder)
