"""Scores of images without structure and of images without error; a warning fails any test."""

import numpy as np

from lf_flame.learning.scores import score, ssim


def windowed_ssim(truth, image, c1=0.01**2, c2=0.03**2):
    """SSIM as defined, with variances about each window's own mean."""
    weights = np.exp(-(np.arange(-5, 6) ** 2) / (2 * 1.5**2))
    weights = np.outer(weights, weights) / weights.sum() ** 2
    a, b = (np.lib.stride_tricks.sliding_window_view(x.astype(float), (11, 11)).reshape(-1, 121)
            for x in (truth, image))  # fmt: skip
    w = weights.ravel()
    mean_a, mean_b = a @ w, b @ w
    a, b = a - mean_a[:, None], b - mean_b[:, None]
    luminance = (2 * mean_a * mean_b + c1) / (mean_a**2 + mean_b**2 + c1)
    structure = (2 * (a * b) @ w + c2) / ((a**2 + b**2) @ w + c2)
    return (luminance * structure).mean()


def test_ssim_of_saturated_images_is_finite(rng):
    """Flames clipped to white on black: windows without structure are no 0 / 0."""
    scene = np.zeros((40, 40), np.float32)
    scene[20:, 15:] = rng.uniform(0.5, 3, size=(20, 25))
    truth, image = np.minimum(scene, 1), np.minimum(0.8 * scene, 1)
    allowed = 1e-6
    assert abs(ssim(truth, image) - windowed_ssim(truth, image)) <= allowed


def test_table_of_equal_images_has_no_nan(rng):
    """Infinite PSNR of some or all samples: their spread is not infinity less infinity."""
    targets = rng.uniform(size=(3, 4, 16, 20)).astype(np.float32)
    predictions = targets.copy()
    predictions[1:, 1] *= 0.9  # one sample of three is equal
    predictions[:, 2] *= 0.9
    targets[:, 3] = predictions[:, 3] = 0
    table = score(targets, predictions)
    lit = ["psnr_foreground_db", "psnr_foreground_sd"]
    assert not table.drop(columns=lit).isna().any(axis=None)
    assert list(table[lit].isna().any(axis=1)) == [False, False, False, True]  # black: none is lit
    assert list(np.isinf(table.psnr_db)) == [True, True, False, True]
    assert list(table.psnr_sd[[0, 1, 3]]) == [0, np.inf, 0]
    assert 0 < table.psnr_sd[2] < 1
    assert list(table.ssim[[0, 3]]) == [1, 1]
    two = score(targets[:2], predictions[:2])
    assert list(two.psnr_sd[:2]) == [0, np.inf]
