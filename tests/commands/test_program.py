import os
import subprocess
import sys

import numba
import pytest

PROGRAM = """
import click, numba, numpy as np
from lf_flame.commands import program

@numba.njit(parallel=True)
def double(x):
    for k in numba.prange(x.size):
        x[k] *= 2

@click.command()
def show():
    double(np.ones(100))
    print(numba.threading_layer())

program.run(show, "show")
"""


@pytest.mark.jit
@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="no threads without compiled loops")
@pytest.mark.parametrize(("before", "after"), [(None, "PASSIVE"), ("ACTIVE", "ACTIVE")])
def test_idle_threads_leave_the_cores_to_networks_unless_a_user_says_otherwise(before, after):
    """What OpenMP itself says of its settings, as it starts inside a program."""
    known = {k: v for k, v in os.environ.items() if k != "OMP_WAIT_POLICY"}
    known |= {"OMP_WAIT_POLICY": before} if before else {}
    known |= {"NUMBA_THREADING_LAYER": "omp", "OMP_DISPLAY_ENV": "TRUE"}
    shown = subprocess.run(
        [sys.executable, "-c", PROGRAM], env=known, capture_output=True, text=True, check=True
    )
    assert shown.stdout.strip() == "omp"
    assert f"OMP_WAIT_POLICY = '{after}'" in shown.stderr
