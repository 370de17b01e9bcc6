"""Compiled functions where Numba finds no folder for them, a damaged one, or a full disk."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import numba
import pytest

from lf_flame._common.compiling import NOT_KEPT, _ForgivingCache, compiled

KERNEL = """
import logging, sys
import numpy as np
from lf_flame._common.compiling import compiled
from lf_flame._common.threads import pieces, shared

def _twice(value):
    return 2 * value

def _double(queue, values):
    for k in pieces(queue, values.size):
        values[k] = twice(values[k])

twice = compiled(_twice)
double = shared(_double)
if __name__ == "__main__":
    logging.basicConfig(level="INFO", format="%(message)s")
    values = np.arange(4.0)
    double(values)
    print(values.tolist())
"""

pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")


def unprivileged():
    """Give the words that let a command obey permissions, which root does not."""
    if os.geteuid() != 0:
        return []
    if shutil.which("setpriv") is None:
        pytest.skip("runs as root, and there is no setpriv")
    return ["setpriv", "--bounding-set=-all", "--inh-caps=-all"]


@pytest.mark.parametrize(
    "more", [{}, pytest.param({"NUMBA_CACHE_DIR": "/proc/nowhere"}, marks=pytest.mark.slow)]
)
def test_without_a_folder_to_write_functions_are_compiled_at_each_start(tmp_path, more):
    """In containers a package is often read-only, and HOME nowhere."""
    if not Path("/proc").is_dir():
        pytest.skip("there is no folder in which nobody can write")
    (tmp_path / "kernel.py").write_text(KERNEL)
    tmp_path.chmod(0o555)
    kept = {k: v for k, v in os.environ.items() if k not in ("XDG_CACHE_HOME", "NUMBA_CACHE_DIR")}
    done = subprocess.run(
        [*unprivileged(), sys.executable, "-B", tmp_path / "kernel.py"],
        env={**kept, "HOME": "/proc/nowhere", **more},
        capture_output=True,
        text=True,
    )
    tmp_path.chmod(0o755)
    assert (done.returncode, done.stdout) == (0, "[0.0, 2.0, 4.0, 6.0]\n"), done.stderr
    assert NOT_KEPT in done.stderr.splitlines()
    assert [path.name for path in tmp_path.iterdir()] == ["kernel.py"]


def _triple(value):
    return 3 * value


@pytest.fixture
def cache(tmp_path, monkeypatch):
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    return tmp_path


@pytest.mark.slow
def test_damaged_files_cost_a_compilation(cache):
    assert compiled(_triple)(2) == 6
    files = [path for path in cache.rglob("*.nb*") if path.is_file()]
    assert files
    for content in (b"", b"\x80\x05\x95", b"no pickle"):
        for path in files:
            path.write_bytes(content)
        assert compiled(_triple)(2) == 6


def test_a_full_disk_costs_a_compilation(cache, monkeypatch):
    def fail(self, sig, data):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(_ForgivingCache.__base__, "save_overload", fail)
    assert compiled(_triple)(2.5) == 7.5
    assert not list(cache.rglob("*.nb*"))
