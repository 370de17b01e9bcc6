import keras
import numpy as np
import pytest

from lf_flame.systems.similarity import ms_ssim
from lf_flame.systems.sparse_unet import unet_loss


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
