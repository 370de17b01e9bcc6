"""Noise by pixel, and as neighbouring views share it after decoding, in error bars."""

import numpy as np
import pytest
from builders import camera_of
from scipy.ndimage import convolve1d

from experiments.emission.truth import Lens, Sheet, record
from lf_flame import LightField
from lf_flame.tomography import FrustumGrid, reconstruct
from lf_flame.tomography.noise import correlation_factor, noise_by_pixel

KERNEL = np.array([0.25, 1.0, 0.25])


def test_saturated_rays_have_the_noise_of_their_light():
    """Photon noise; unknown rays, the brightest, have light of the fit and show none."""
    y, x = np.mgrid[-1:1:60j, -1:1:80j]
    light = np.broadcast_to(np.exp(-6 * (x**2 + y**2)), (5, 5, 60, 80)).astype(np.float32)
    variance = 1e-4 * light + 1e-7
    noise = np.sqrt(variance) * np.random.default_rng(0).standard_normal(light.shape)
    valid = light < 0.6
    views = np.where(valid, light + noise, light).astype(np.float32)
    uneven = noise_by_pixel(views, light, valid)
    assert uneven.dtype == np.float32
    found = uneven * np.square(views - light)[valid].mean()
    for rays in (valid, ~valid, valid & (light > 0.5)):
        assert found[rays].mean() == pytest.approx(variance[rays].mean(), rel=0.05)


def shared_noise(rng, shape):
    """Noise of variance 1 that each view shares with its neighbours along v and u."""
    v, u = shape[:2]
    noise = rng.standard_normal((v + 2, u + 2, *shape[2:]))
    for axis in (0, 1):
        noise = convolve1d(noise, KERNEL / np.sqrt(np.sum(KERNEL**2)), axis)
    return noise[1:-1, 1:-1]


def of_a_mean(views):
    """Noise of a mean over so many views each way, beside that of white noise."""
    return np.sum(np.convolve(np.ones(views), KERNEL) ** 2) / np.sum(KERNEL**2) / views


EVERY = np.ones((9, 9), bool)
FLAME = 100.0 * np.pad(np.ones((8, 8)), ((10, 22), (20, 22)))


def test_the_factor_is_that_of_a_mean_over_views(rng):
    shape = (9, 9, 40, 50)
    # Noise of the mean over a disc of views, beside that of as many views of white noise.
    disc = np.hypot(*np.mgrid[-4:5, -4:5]) < 4
    for used_views in (EVERY, disc):
        draws = shared_noise(np.random.default_rng(5), (9, 9, 150, 150))[used_views]
        wanted = draws.mean(axis=0).std() * np.sqrt(used_views.sum())
        found = correlation_factor(FLAME + shared_noise(rng, shape), used_views)
        assert found == pytest.approx(wanted, rel=0.06)
    white = rng.standard_normal(shape)
    assert correlation_factor(FLAME + white, EVERY) == 1
    beside = convolve1d(white, [1, 1], 3) / np.sqrt(2)
    assert correlation_factor(FLAME + beside, EVERY) == pytest.approx(np.sqrt(2), rel=0.07)
    # Views that do not count may hold anything.
    some = EVERY.copy()
    some[0] = False
    worse = FLAME + white
    worse[0] = worse[1]
    assert correlation_factor(worse, some) == 1


def test_light_is_no_correlation(rng):
    y, x = np.mgrid[-1:1:40j, -1:1:50j]
    faint = 1000 * np.exp(-8 * (x**2 + y**2))
    assert correlation_factor(np.broadcast_to(faint, (9, 9, 40, 50)), EVERY) == 1
    electrons = rng.poisson(5e-3 * np.broadcast_to(faint, (9, 9, 40, 50))).astype(float)
    assert correlation_factor(electrons, EVERY) == 1
    # Light of a wide flame that is as faint as the noise, and not white.
    noisy = np.broadcast_to(faint, (9, 9, 40, 50)) + 4 * rng.standard_normal((9, 9, 40, 50))
    assert correlation_factor(noisy, EVERY) == 1
    everywhere = 100 + shared_noise(rng, (9, 9, 40, 50))
    assert correlation_factor(everywhere, EVERY) == 1


@pytest.mark.slow
@pytest.mark.parametrize(("views", "is_shared"), [(5, False), (9, True)])
def test_photon_noise_is_measured_where_there_is_light(views, is_shared, rng):
    """In the dark there is no noise that could tell, and light of two sheets is in the way."""
    lens = Lens(views=views, lenslets=(48, 56))
    sheets = [Sheet(4.0, (0.0, -0.4), (0.6, 0.6)), Sheet(-2.0, (0.3, 0.5), (0.4, 0.6))]
    light = record(lens, sheets)
    noise = shared_noise(rng, light.shape) if is_shared else rng.standard_normal(light.shape)
    light_field = LightField(light + 0.03 * np.sqrt(light * light.max()) * noise)
    grid = FrustumGrid(camera_of(lens), [4.0, 1.0, -2.0])
    found = reconstruct(light_field, grid, strength=0.1, noise=0.01).fit
    assert found.shared == pytest.approx(of_a_mean(views) if is_shared else 1, rel=0.12)
