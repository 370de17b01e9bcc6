import os

import numpy as np
import pytest
from hypothesis import settings

from lf_flame import PlenopticCamera

# The same examples in every run: what fails for one fails for all. For new ones:
# pytest --hypothesis-profile=default
settings.register_profile("fixed", derandomize=True)
settings.load_profile("fixed")


@pytest.fixture
def rng(request):
    """A generator of its own for each test, the same in every run."""
    return np.random.default_rng(list(request.node.name.encode()))


@pytest.fixture
def small_camera():
    """The paper's optics with few lenslets and views."""
    return PlenopticCamera(
        main_lens_focal_mm=150.0,
        focus_distance_mm=326.0,
        lenslet_focal_mm=0.4,
        lenslet_pitch_mm=0.112,
        views=5,
        lenslets=(24, 30),
    )


def pytest_collection_modifyitems(items):
    if os.environ.get("NUMBA_DISABLE_JIT", "0") == "0":
        return
    for item in items:
        if "jit" in item.keywords:
            item.add_marker(pytest.mark.skip(reason="NUMBA_DISABLE_JIT is set"))
