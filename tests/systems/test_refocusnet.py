from pathlib import Path

import numpy as np
import pytest
from skimage.metrics import structural_similarity

from lf_flame import read_light_field
from lf_flame.learning.scores import psnr
from lf_flame.refocus import align_views
from lf_flame.systems.formulas import ShiftAndSum, diamond_of_views
from lf_flame.systems.refocusnet import RefocusNet, build_refocusnet

SHARED = Path(__file__).parents[3] / "shared"
WEIGHTS = SHARED / "weights/refocusnet_weights.npz"
LYTRO = SHARED / "lightfields/lytro_2067"


@pytest.fixture(scope="module")
def model():
    return build_refocusnet(seed=3)


def convolve(image, layer):
    """Convolve [h, w, channels] by a 3 x 3 layer, term by term in float64."""
    kernel, bias = (x.numpy().astype(float) for x in layer.weights)
    padded = np.pad(image, ((1, 1), (1, 1), (0, 0)))
    height, width = image.shape[:2]
    total = np.zeros((height, width, kernel.shape[3])) + bias
    for i in range(3):
        for j in range(3):
            total += padded[i : i + height, j : j + width] @ kernel[i, j]
    return total


def test_layers_are_the_published_ones(model, rng):
    """Beside the formula of the authors' program, written out with its own numbers."""
    assert model.count_params() == 234_795
    inputs = rng.uniform(size=(18, 20, 12))
    w = {number: model.get_layer(f"w{number}") for number in (*range(1, 13), 14, 15)}
    x1 = np.maximum(convolve(inputs, w[1]), 0)
    x3 = np.maximum(convolve(x1, w[3]), 0)
    x5 = np.maximum(convolve(x3, w[5]), 0)
    x7 = np.maximum(convolve(x5, w[7]), 0)
    x9 = np.maximum(convolve(x7, w[9]), 0)
    x11 = np.maximum(convolve(x9, w[11]), 0)
    total = sum(
        convolve(x, w[n]) for x, n in [(inputs, 2), (x1, 4), (x3, 6), (x5, 8), (x7, 10), (x9, 12),
                                       (x11, 14)]
    )  # fmt: skip
    red, green, blue = (total[..., c::3].mean(axis=-1) for c in range(3))
    expected = convolve(total, w[15]) + np.stack([red, green, blue], axis=-1)
    found = model.predict_on_batch(inputs[None].astype(np.float32))[0]
    np.testing.assert_allclose(found, expected, atol=1e-5 * np.abs(expected).max())


def test_inputs_are_aligned_views_colour_by_colour(model, rng):
    """Red, green and blue of one view after the other; grey is three equal colours, then a mean."""
    views = rng.uniform(size=(5, 5, 20, 18, 3)).astype(np.float32)
    system = RefocusNet(model, colours=3)

    def drawn(views):
        aligned = align_views(views, 0.6, system.view_indices(5, 5))
        return model.predict_on_batch(np.concatenate(list(aligned), axis=-1)[None])[0]

    mixed = np.clip(drawn(views), 0, 1)
    np.testing.assert_allclose(system.refocus(views, 0.6)[0], mixed, atol=1e-6)
    grey = np.repeat(views[..., 1:2], 3, axis=-1)
    apart = np.clip(drawn(grey).mean(axis=-1), 0, 1)
    np.testing.assert_allclose(RefocusNet(model).refocus(views, 0.6)[0, ..., 1], apart, atol=1e-6)
    assert np.abs(mixed[..., 1] - apart).max() > 1e-3


# PSNR of four-view shift-and-sum and of RefocusNet against all 81 views, and SSIM of both
# (scikit-image's default window), 12 pixels cut off at each edge, as the authors' own program and
# weights give them on this scene.
OFFICIAL = {
    -1.0: (37.15, 45.55, 0.954, 0.993),
    0.0: (41.02, 45.83, 0.973, 0.993),
    1.0: (34.92, 44.04, 0.902, 0.988),
}


@pytest.mark.slow
@pytest.mark.skipif(
    not (WEIGHTS.is_file() and LYTRO.is_dir()),
    reason="no RefocusNet weights or no Lytro example light field beside the checkout",
)
@pytest.mark.parametrize("slope", OFFICIAL)
def test_authors_weights_give_the_authors_figures(slope):
    system = RefocusNet.of_weights(WEIGHTS)
    views = read_light_field(LYTRO, order="row,col").views
    four = ShiftAndSum("four", diamond_of_views)
    every, *found = (
        one.refocus(views, slope)[0, 12:-12, 12:-12] for one in (ShiftAndSum(), four, system)
    )
    np.testing.assert_allclose([psnr(every, x) for x in found], OFFICIAL[slope][:2], atol=0.1)
    likeness = [structural_similarity(every, x, data_range=1.0, channel_axis=-1) for x in found]
    np.testing.assert_allclose(likeness, OFFICIAL[slope][2:], atol=1e-3)
