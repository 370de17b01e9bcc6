import keras
import numpy as np
import pytest
from scipy.special import expit

from lf_flame import InputError
from lf_flame.learning.decoder import build_decoder
from lf_flame.learning.ridge import STRENGTHS, ridge_regression
from lf_flame.learning.warm_start import freeze_normalisations, warm_start

IMAGE, MAP = (9, 20), (3, 6, 32)


def smooth_scene(rng, samples, noise=0.0):
    """Images that are a smooth function of two numbers, and features that are linear in them."""
    numbers = rng.uniform(-1, 1, (samples, 2))
    features = np.einsum("nk,kyxc->nyxc", numbers, np.random.default_rng(1).normal(size=(2, *MAP)))
    x = np.linspace(-1, 1, IMAGE[1])
    left, right = (expit(8 * (numbers[:, k, None] - x)) for k in (0, 1))
    images = np.stack([left, right], axis=1)[:, :, None, :, None] * np.ones((IMAGE[0], 1, 1))
    features = features + noise * rng.normal(size=features.shape)
    return features.astype(np.float32), images.astype(np.float32)


def error(decoder, samples):
    features, images = samples
    return np.mean((decoder.predict(features, verbose=0) - images) ** 2)


@pytest.mark.parametrize(
    ("neck", "bands"), [("pooled", 1), ("positions", 1), ("positions", 3), ("positions", 4)]
)
def test_warm_start_draws_images_it_has_not_seen(rng, neck, bands):
    training, held_out, test = (smooth_scene(rng, n) for n in (200, 20, 20))
    decoder = build_decoder(MAP, IMAGE, 2, dropout_place="none", neck=neck, seed=2)
    freeze_normalisations(decoder)
    before = error(decoder, test)
    warm_start(decoder, training, held_out, bands)
    assert error(decoder, test) < 0.1 * min(before, test[1].var(axis=0).mean())


def test_bands_see_only_their_part_of_the_features(rng):
    training, held_out = smooth_scene(rng, 80), smooth_scene(rng, 20)
    decoder = build_decoder(MAP, IMAGE, 2, dropout_place="none", neck="positions", seed=2)
    warm_start(decoder, training, held_out, bands=2)
    features = held_out[0][:1].copy()
    image = decoder.predict(features, verbose=0)
    features[:, :, :3] += 1.0
    changed = np.abs(decoder.predict(features, verbose=0) - image).max(axis=(0, 1, 2, 4))
    assert changed[:10].max() > 1e-3
    assert changed[10:].max() == 0


def test_more_bands_than_columns_are_refused(rng):
    decoder = build_decoder(MAP, IMAGE, 2, neck="positions")
    with pytest.raises(InputError, match="bands must be at most 6, got 7"):
        warm_start(decoder, smooth_scene(rng, 8), smooth_scene(rng, 4), bands=7)


def test_few_samples_leave_the_rest_of_the_numbers_unused(rng):
    decoder = build_decoder(MAP, IMAGE, 2, dropout_place="none", neck="positions", seed=2)
    warm_start(decoder, smooth_scene(rng, 10), smooth_scene(rng, 4))
    kernel = keras.ops.convert_to_numpy(decoder.get_layer("basis").kernel)
    assert np.isfinite(kernel).all()
    assert np.abs(kernel[:9]).max() > 0
    assert np.abs(kernel[9:]).max() == 0


def test_noise_in_the_features_asks_for_a_stronger_ridge(rng):
    def flat(samples):
        return [x.reshape(len(x), -1) for x in samples]

    strengths = []
    for noise in (0.0, 1.0):
        training, held_out = (flat(smooth_scene(rng, n, noise)) for n in (100, 100))
        found = ridge_regression(training, held_out)
        assert found.strength in STRENGTHS
        strengths.append(found.strength)
        plain = np.mean((training[1].mean(axis=0) - held_out[1]) ** 2)
        images = expit((held_out[0] - found.mean) @ found.weights() + found.offset)
        assert np.mean((images - held_out[1]) ** 2) < 0.2 * plain
    assert strengths[1] > strengths[0]


def test_components_approach_the_whole_regression(rng):
    def flat(samples):
        return [x.reshape(len(x), -1) for x in samples]

    training, held_out = (flat(smooth_scene(rng, n, 0.1)) for n in (60, 30))
    found = ridge_regression(training, held_out)
    whole = (held_out[0] - found.mean) @ found.weights()
    errors = []
    for count in (1, 2, 59):
        weights, images = found.components(count)
        numbers = (training[0] - found.mean) @ weights
        np.testing.assert_allclose(np.mean(numbers**2, axis=0)[:2], 1, rtol=1e-2)
        errors.append(np.abs((held_out[0] - found.mean) @ weights @ images - whole).max())
    assert errors[0] > errors[1] > errors[2]
    assert errors[2] < 1e-2 * np.abs(whole).max()
