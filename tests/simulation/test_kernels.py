"""What only the compiled kernels can show: signatures and rounding."""

import math
from unittest.mock import patch

import numpy as np
import pytest
from numba import njit
from numba.core.caching import NullCache

from lf_flame import Layer, Scene, render
from lf_flame._common.threads import Kernel
from lf_flame.refocus import _kernels as refocus_kernels
from lf_flame.refocus import shift_and_sum
from lf_flame.simulation import _ray_kernels
from lf_flame.simulation.integration import integrate_columns, integrate_rows
from lf_flame.simulation.optical_pass import OpticalPass
from lf_flame.simulation.rays import trace
from lf_flame.simulation.slabs import slice_scene


def test_rays_summed_along_one_axis_first_are_the_same_rays(small_camera, rng):
    """Against the kernel that traces every ray of every pixel by itself."""
    layer = Layer(rng.uniform(size=(9, 7)), 20.0, (2.0, 1.6), (0.1, -0.2))
    planes = slice_scene(Scene([layer]), {}, absorption=False, attenuating=set())

    calls = []

    def each_by_itself(planes, rays, weights, *rest):
        calls.append(planes)
        _ray_kernels.trace_planes(planes, rays, weights, None, None, None, *rest)

    images = []
    for kernel in (_ray_kernels.trace_apart, each_by_itself):
        image = np.zeros((5, 5, 24, 30), np.float32)
        with patch.object(_ray_kernels, "trace_apart", kernel):
            trace(planes, OpticalPass(small_camera), "views", 3, image)
        images.append(image)
    assert images[0].any()
    assert len(calls) == 1
    np.testing.assert_allclose(*images, rtol=1e-6)


@pytest.mark.jit
def test_kernels_compile_once_for_the_types_they_are_called_with(small_camera, rng):
    """However they are reached: another scene, layout or number of rays compiles nothing."""
    kernels = [
        _ray_kernels.trace_apart,
        integrate_columns,
        integrate_rows,
        refocus_kernels.sum_bands,
    ]

    def use(cells, layout, rays):
        scene = Scene([Layer(rng.uniform(size=cells), 5.0, (1.0, 1.0))])
        shift_and_sum(render(scene, small_camera), 1.0)
        render(scene, small_camera, layout=layout)
        render(scene, small_camera, integrator="rays", rays=rays, layout=layout)
        return [len(kernel.compiled.signatures) for kernel in kernels]

    compiled = use((3, 3), "views", 2)
    assert min(compiled) > 0
    assert use((1, 7), "raw", 3) == compiled


@njit
def rooted(x):
    return math.sqrt(x) + math.floor(x)


@pytest.mark.slow
@pytest.mark.jit
def test_a_kernel_has_no_code_for_what_is_left_out(small_camera, rng):
    """The types select it: without a stop, no root is taken, no skew is floored."""
    kernel = Kernel(_ray_kernels.trace_apart.count, _ray_kernels.trace_apart.body)
    kernel.compiled._cache = NullCache()  # Numba shows no code that it loaded from its files
    scene = Scene([Layer(rng.uniform(size=(3, 3)), 5.0, (1.0, 1.0))])
    planes = slice_scene(scene, {}, absorption=False, attenuating=set())
    image = np.zeros((5, 5, 24, 30), np.float32)
    with patch.object(_ray_kernels, "trace_apart", kernel):
        trace(planes, OpticalPass(small_camera), "views", 2, image)
    assert kernel.compiled.signatures
    rooted(2.5)
    for instruction in ("sqrt", "llvm.floor"):
        assert instruction not in "".join(kernel.compiled.inspect_llvm().values())
        assert instruction in "".join(rooted.inspect_llvm().values())
