import keras
import numpy as np

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
