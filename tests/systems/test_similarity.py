import keras
import numpy as np
import pytest
from skimage.metrics import structural_similarity

from lf_flame.systems.similarity import SCALE_WEIGHTS, ms_ssim, ssim
from lf_flame.systems.sparse_unet import unet_loss


@pytest.fixture
def pictures(rng):
    """Two batches: smooth pictures, and the same with noise."""
    y, x = np.mgrid[:96, :112] / 20
    smooth = np.stack([0.5 + 0.4 * np.sin(k * x + y) * np.cos(y) for k in (1, 2, 3)])[..., None]
    noisy = np.clip(smooth + rng.normal(0, 0.08, smooth.shape), 0, 1)
    return smooth.astype(np.float32), noisy.astype(np.float32)


def test_ssim_is_scikit_images_inside_the_border(pictures):
    """Its map pads at the edges, so it is compared where windows lie wholly inside."""
    found = keras.ops.convert_to_numpy(ssim(*pictures))
    for value, truth, image in zip(found, *pictures, strict=True):
        _, whole = structural_similarity(
            truth[..., 0], image[..., 0], data_range=1.0, gaussian_weights=True, sigma=1.5,
            use_sample_covariance=False, full=True,
        )  # fmt: skip
        assert value == pytest.approx(whole[5:-5, 5:-5].mean(), abs=2e-5)


@pytest.mark.parametrize("count", [4, pytest.param(5, marks=pytest.mark.slow)])
def test_ms_ssim_is_tensorflows(rng, count):
    """At four scales the weights have the same sum as those of the paper, at five."""
    import tensorflow as tf

    truth = rng.random((1, 22, 26, 1)).repeat(8, axis=1).repeat(8, axis=2).astype(np.float32)
    image = np.clip(truth + rng.normal(0, 0.2, truth.shape), 0, 1).astype(np.float32)
    image = (image + np.roll(image, 12, axis=1)) / 2  # the coarsest scale is unlike, too
    side = 96 if count == 4 else 176
    truth, image = truth[:, :side], image[:, :side]
    weights = np.array(SCALE_WEIGHTS[:count]) * sum(SCALE_WEIGHTS) / sum(SCALE_WEIGHTS[:count])
    expected = tf.image.ssim_multiscale(truth, image, 1.0, power_factors=list(weights))
    assert 0.1 < float(expected[0]) < 0.9
    found = keras.ops.convert_to_numpy(ms_ssim(truth, image))
    np.testing.assert_allclose(found, expected, atol=2e-5)


def test_loss_is_the_published_sum(rng):
    truth = rng.uniform(size=(2, 24, 24, 1)).astype(np.float32)
    image = np.clip(truth + rng.normal(0, 0.1, truth.shape), 0, 1).astype(np.float32)
    squared = ((truth - image) ** 2).mean(axis=(1, 2, 3))
    absolute = np.abs(truth - image).mean(axis=(1, 2, 3))
    likeness = keras.ops.convert_to_numpy(ms_ssim(truth, image))
    psnr = -10 * np.log10(squared)
    expected = squared + 0.65 * (1 - likeness) + 0.35 * absolute + 500 / psnr
    found = keras.ops.convert_to_numpy(unet_loss(truth, image))
    np.testing.assert_allclose(found, expected, rtol=1e-5)


@pytest.mark.parametrize(
    ("error", "psnr_term"),
    [
        (0.0, 500 / 100),  # as of a mean square of 1e-10: 100 dB
        (0.5, 500 / (20 * np.log10(2))),
        (0.88, 500 / (-20 * np.log10(0.88))),  # 1.11 dB
        (0.9, 500.0),  # 0.92 dB, and below that 0 dB and less
        (1.0, 500.0),
        (1.5, 500.0),
    ],
)
def test_peak_signal_to_noise_counts_from_1_to_100_db(error, psnr_term):
    """Images of one grey value each, so that only the luminance of the likeness counts."""
    truth, image = (np.full((1, 16, 16, 1), x, np.float32) for x in (0.0, error))
    likeness = (1e-4 / (error**2 + 1e-4)) ** 1.0  # one scale, of the whole weight
    expected = error**2 + 0.65 * (1 - max(likeness, 1e-6)) + 0.35 * error + psnr_term
    found = keras.ops.convert_to_numpy(unet_loss(truth, image))
    np.testing.assert_allclose(found, [expected], rtol=1e-4)
