"""Scores of images: closed forms, and means over samples."""

import numpy as np
import pytest

from lf_flame.learning.scores import psnr, psnr_foreground, score, ssim


def test_psnr_is_the_papers_equation_7(rng):
    truth = rng.uniform(size=(20, 30))
    image = truth + rng.normal(scale=0.02, size=truth.shape)
    assert psnr(truth, image) == pytest.approx(10 * np.log10(1 / np.mean((truth - image) ** 2)))
    assert psnr(truth, truth) == np.inf


def test_ssim_of_flat_images_is_its_luminance_term():
    """No structure: (2 m1 m2 + c1) / (m1^2 + m2^2 + c1), c1 = 0.01^2."""
    flat = np.full((20, 30), 0.4), np.full((20, 30), 0.5)
    expected = (2 * 0.4 * 0.5 + 1e-4) / (0.4**2 + 0.5**2 + 1e-4)
    assert ssim(*flat) == pytest.approx(expected, rel=1e-6)
    assert ssim(flat[0], flat[0]) == pytest.approx(1)


def test_ssim_of_colours_is_the_mean_over_the_channels(rng):
    truth = rng.uniform(size=(20, 30, 3))
    image = truth + rng.normal(scale=[0.01, 0.05, 0.2], size=truth.shape)
    each = [ssim(truth[..., k], image[..., k]) for k in range(3)]
    assert np.ptp(each) > 0.1
    assert ssim(truth, image) == pytest.approx(np.mean(each), rel=1e-12)


def test_psnr_over_foreground_does_not_see_the_background(rng):
    """The same object and error, in a field nine times as large: PSNR alone rises, by 10 lg 9."""
    truth = rng.uniform(0.02, 1, size=(20, 30))
    image = truth + rng.normal(scale=0.05, size=truth.shape)
    wide, wide_image = (np.pad(x, ((20, 20), (30, 30))) for x in (truth, image))
    assert psnr_foreground(wide, wide_image) == pytest.approx(psnr(truth, image))
    assert psnr(wide, wide_image) == pytest.approx(psnr(truth, image) + 10 * np.log10(9))
    assert psnr_foreground(wide, np.where(wide > 0, wide, 0.5)) == np.inf
    assert np.isnan(psnr_foreground(np.full((5, 5), 0.01), truth[:5, :5]))


def test_foreground_is_what_is_brighter_than_a_hundredth_of_the_peak():
    """Of four pixels, two above: their errors of 0.1 and 0.3 make 10 lg (1 / 0.05) = 13.01 dB."""
    truth = np.array([0.0099, 0.01, 0.0101, 0.9])
    image = truth + np.array([0.7, 0.7, 0.1, -0.3])
    assert psnr_foreground(truth, image) == pytest.approx(10 * np.log10(20), rel=1e-12)


def test_planes_without_foreground_are_left_out_of_the_mean(rng):
    targets = rng.uniform(0.1, 1, size=(4, 2, 16, 20))
    predictions = targets + rng.normal(scale=0.05, size=targets.shape)
    targets[1, 0] = 0
    targets[:, 1] = 0
    table = score(targets, predictions)
    plane = [psnr(a, b) for a, b in zip(targets[:, 0], predictions[:, 0], strict=True)]
    assert table.psnr_db[0] == pytest.approx(np.mean(plane))
    assert table.psnr_sd[0] == pytest.approx(np.std(plane, ddof=1))
    bright = [psnr_foreground(targets[k, 0], predictions[k, 0]) for k in (0, 2, 3)]
    assert table.psnr_foreground_db[0] == pytest.approx(np.mean(bright))
    assert table.psnr_foreground_sd[0] == pytest.approx(np.std(bright, ddof=1))
    assert table[["psnr_foreground_db", "psnr_foreground_sd"]].isna().to_numpy()[1].all()
    assert list(table.n_test) == [4, 4]
