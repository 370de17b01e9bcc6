import keras
import numpy as np
import pytest
from skimage.metrics import structural_similarity

from lf_flame.systems.similarity import SCALE_WEIGHTS, ms_ssim, scales, ssim
from lf_flame.systems.sparse_unet import unet_loss


@pytest.fixture
def pictures(rng):
    """Two batches: smooth pictures, and the same with noise."""
    y, x = np.mgrid[:96, :112] / 20
    smooth = np.stack([0.5 + 0.4 * np.sin(k * x + y) * np.cos(y) for k in (1, 2, 3)])[..., None]
    noisy = np.clip(smooth + rng.normal(0, 0.08, smooth.shape), 0, 1)
    return smooth.astype(np.float32), noisy.astype(np.float32)


def test_ssim_is_scikit_images_inside_the_border(pictures):
    """Which pads at the edges, so its map is compared where windows lie wholly inside."""
    found = keras.ops.convert_to_numpy(ssim(*pictures))
    for value, truth, image in zip(found, *pictures, strict=True):
        _, whole = structural_similarity(
            truth[..., 0], image[..., 0], data_range=1.0, gaussian_weights=True, sigma=1.5,
            use_sample_covariance=False, full=True,
        )  # fmt: skip
        assert value == pytest.approx(whole[5:-5, 5:-5].mean(), abs=2e-5)


def test_ms_ssim_is_tensorflows(pictures):
    import tensorflow as tf

    weights = np.array(SCALE_WEIGHTS[:4]) * sum(SCALE_WEIGHTS) / sum(SCALE_WEIGHTS[:4])
    expected = tf.image.ssim_multiscale(*pictures, 1.0, power_factors=list(weights))
    np.testing.assert_allclose(keras.ops.convert_to_numpy(ms_ssim(*pictures)), expected, atol=2e-5)


@pytest.mark.slow
def test_all_five_scales_weigh_as_in_tensorflow(rng):
    """Its own weights, those of the paper, on images that are large enough for all."""
    import tensorflow as tf

    truth = rng.random((1, 22, 26, 1)).repeat(8, axis=1).repeat(8, axis=2).astype(np.float32)
    image = np.clip(truth + rng.normal(0, 0.2, truth.shape), 0, 1).astype(np.float32)
    image = (image + np.roll(image, 12, axis=1)) / 2  # the coarsest scale is unlike, too
    expected = tf.image.ssim_multiscale(truth, image, 1.0)
    assert 0.1 < float(expected[0]) < 0.9
    found = keras.ops.convert_to_numpy(ms_ssim(truth, image))
    np.testing.assert_allclose(found, expected, atol=2e-5)


def test_opposite_images_score_next_to_nothing_and_not_nan(pictures):
    smooth, _ = pictures
    found = keras.ops.convert_to_numpy(ms_ssim(smooth, 1 - smooth))
    assert np.all((found >= 0) & (found < 0.2))


@pytest.mark.parametrize(
    ("size", "count"),
    [((11, 50), 1), ((22, 22), 2), ((90, 180), 4), ((176, 400), 5), ((999, 999), 5)],
)
def test_there_are_as_many_scales_as_leave_a_window(size, count):
    assert scales(size) == count


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
