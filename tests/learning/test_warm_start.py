import keras
import numpy as np
import pytest
from scipy.linalg import orth
from scipy.special import expit, logit

from lf_flame import InputError
from lf_flame.learning import ridge
from lf_flame.learning.decoder import build_decoder
from lf_flame.learning.ridge import (
    STRENGTHS,
    ProductGatherer,
    gather_products,
    ridge_regression,
)
from lf_flame.learning.warm_start import Blocks, freeze_normalisations, solve_decoder

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


def in_blocks(samples, size=1000, spoilt=True):
    """One after the other, each spoilt as soon as the next one is asked for."""

    def pairs():
        for first in range(0, len(samples[0]), size):
            pair = [x[first : first + size].copy() for x in samples]
            yield pair
            for x in pair if spoilt else ():
                x[...] = np.nan

    return Blocks(len(samples[0]), pairs())


def regression(training, held_out):
    return ridge_regression(gather_products(training[0]), training[1], held_out)


def error(decoder, samples):
    features, images = samples
    return np.mean((decoder.predict(features, verbose=0) - images) ** 2)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("neck", "bands"), [("pooled", 1), ("positions", 1), ("positions", 3), ("positions", 4)]
)
def test_warm_start_draws_images_it_has_not_seen(rng, neck, bands):
    training, held_out, test = (smooth_scene(rng, n) for n in (200, 20, 20))
    decoder = build_decoder(MAP, IMAGE, 2, dropout_place="none", neck=neck, seed=2)
    freeze_normalisations(decoder)
    before = error(decoder, test)
    solve_decoder(decoder, in_blocks(training, 30, spoilt=neck == "positions"), held_out, bands)
    assert error(decoder, test) < 0.1 * min(before, test[1].var(axis=0).mean())


@pytest.mark.slow
@pytest.mark.parametrize("frozen", [False, True])
def test_normalisations_hold_the_statistics_of_the_samples_alone(rng, frozen):
    """Nothing is left of those they started with, and they go on as they were told before."""
    training = smooth_scene(rng, 40)
    decoder = build_decoder(MAP, IMAGE, 2, dropout_place="none", neck="pooled", seed=2)
    norms = [x for x in decoder.layers if isinstance(x, keras.layers.BatchNormalization)]
    for norm, momentum in zip(norms, (0.7, 0.9), strict=True):
        norm.momentum = momentum
    if frozen:
        freeze_normalisations(decoder)
    solve_decoder(decoder, in_blocks(training, spoilt=False), smooth_scene(rng, 10))
    assert [norm.momentum for norm in norms] == [0.7, 0.9]
    assert [norm.trainable for norm in norms] == [not frozen] * 2
    for norm in norms:
        arriving = keras.Model(decoder.input, norm.input).predict(training[0], verbose=0)
        mean, spread = arriving.mean(axis=(0, 1, 2)), arriving.var(axis=(0, 1, 2))
        scale = np.sqrt(spread.max())
        stored = keras.ops.convert_to_numpy(norm.moving_mean)
        np.testing.assert_allclose(stored, mean, atol=1e-4 * scale)
        stored = keras.ops.convert_to_numpy(norm.moving_variance)
        np.testing.assert_allclose(stored, spread, rtol=1e-3, atol=1e-5 * scale**2)


@pytest.mark.slow
def test_refinements_lower_the_error_of_images(rng):
    """Few numbers, of features far off zero: the regression of logits leaves something."""
    training, held_out = (
        (5 + features, images)
        for features, images in (smooth_scene(rng, 120, 0.05), smooth_scene(rng, 30, 0.05))
    )
    errors = []
    for refinements in (0, 1, 4):
        decoder = build_decoder(MAP, IMAGE, 2, dropout_place="none", neck="positions", seed=2)
        solve_decoder(decoder, in_blocks(training), held_out, 3, refinements)
        errors.append(error(decoder, training))
    assert errors[1] < 0.7 * errors[0]
    assert errors[2] < errors[1]


def test_bands_see_only_their_part_of_the_features(rng):
    training, held_out = smooth_scene(rng, 80), smooth_scene(rng, 20)
    decoder = build_decoder(MAP, IMAGE, 2, dropout_place="none", neck="positions", seed=2)
    solve_decoder(decoder, in_blocks(training), held_out, bands=2)
    features = held_out[0][:1].copy()
    image = decoder.predict(features, verbose=0)
    features[:, :, :3] += 1.0
    changed = np.abs(decoder.predict(features, verbose=0) - image).max(axis=(0, 1, 2, 4))
    assert changed[:10].max() > 1e-3
    assert changed[10:].max() == 0


def test_more_bands_than_columns_are_refused(rng):
    decoder = build_decoder(MAP, IMAGE, 2, neck="positions")
    with pytest.raises(InputError, match="bands must be at most 6, got 7"):
        solve_decoder(decoder, in_blocks(smooth_scene(rng, 8)), smooth_scene(rng, 4), bands=7)


def test_few_samples_leave_the_rest_of_the_numbers_unused(rng):
    decoder = build_decoder(MAP, IMAGE, 2, dropout_place="none", neck="positions", seed=2)
    solve_decoder(decoder, in_blocks(smooth_scene(rng, 10)), smooth_scene(rng, 4))
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
        found = regression(training, held_out)
        assert found.strength in STRENGTHS
        strengths.append(found.strength)
        plain = np.mean((training[1].mean(axis=0) - held_out[1]) ** 2)
        images = expit((held_out[0] - found.mean) @ found.weights() + found.offset)
        assert np.mean((images - held_out[1]) ** 2) < 0.2 * plain
    assert strengths[1] > strengths[0]


def drawn_samples(rng, samples, features=7, pixels=5):
    """Features far off zero, of very different sizes, and images that follow them and noise."""
    mixing = np.random.default_rng(5).normal(size=(features, pixels))
    sizes = np.geomspace(0.03, 3, features)
    x = sizes * rng.normal(size=(samples, features))
    logits = 0.5 + x @ mixing + 0.7 * rng.normal(size=(samples, pixels))
    return 4.0 + x, expit(logits)


def test_the_regression_is_the_one_of_the_normal_equations(rng):
    """Solved for the features, not for the samples, its strength the best of all on the others."""
    training, held_out = drawn_samples(rng, 40), drawn_samples(rng, 30)
    features, images = training
    mean, logits = features.mean(axis=0), logit(np.clip(images, 1e-3, 1 - 1e-3))
    x, y = features - mean, logits - logits.mean(axis=0)
    mean_square = (x**2).sum() / len(x)

    def weights(strength):
        return np.linalg.solve(x.T @ x + strength * mean_square * np.eye(7), x.T @ y)

    errors = [
        np.mean((expit((held_out[0] - mean) @ weights(s) + logits.mean(axis=0)) - held_out[1]) ** 2)
        for s in STRENGTHS
    ]
    best = STRENGTHS[np.argmin(errors)]
    assert STRENGTHS[0] < best < STRENGTHS[-1]
    found = regression(training, held_out)
    assert found.strength == best
    np.testing.assert_allclose(found.weights(), weights(best), rtol=1e-3, atol=1e-4)
    np.testing.assert_allclose(found.mean, mean, rtol=1e-6)
    np.testing.assert_allclose(found.offset, logits.mean(axis=0), atol=1e-5)


@pytest.mark.parametrize("landmarks", [5, 40])
def test_with_many_samples_the_weights_lie_among_the_landmarks(rng, landmarks, monkeypatch):
    """The ridge, solved for weights that are sums of what sets the first samples apart."""
    monkeypatch.setattr(ridge, "LANDMARKS", landmarks)
    monkeypatch.setattr(ridge, "BLOCK", 16)
    training, held_out = drawn_samples(rng, 90), drawn_samples(rng, 30)
    found = regression(training, held_out)
    features, logits = training[0], logit(np.clip(training[1], 1e-3, 1 - 1e-3))
    x, y = features - features.mean(axis=0), logits - logits.mean(axis=0)
    first = features[:landmarks] - features[:landmarks].mean(axis=0)
    basis = orth(first.T)
    assert basis.shape[1] == min(landmarks - 1, 7)
    seen = x @ basis
    penalty = found.strength * (seen**2).sum() / len(x) * np.eye(basis.shape[1])
    expected = basis @ np.linalg.solve(seen.T @ seen + penalty, seen.T @ y)
    np.testing.assert_allclose(found.weights(), expected, rtol=2e-3, atol=5e-4)
    turn, images = found.components(3)
    numbers = (features - found.mean) @ found.of_features(turn)
    np.testing.assert_allclose(np.mean(numbers**2, axis=0), 1, rtol=1e-3)


@pytest.mark.parametrize("size", [1, 7, 30, 64, 90])
def test_products_do_not_depend_on_the_blocks(rng, size, monkeypatch):
    """Of features far off zero; the mean is that of all, the landmarks' own is taken off them."""
    monkeypatch.setattr(ridge, "LANDMARKS", 30)
    features = drawn_samples(rng, 90)[0].astype(np.float32)
    gatherer = ProductGatherer(90)
    for first in range(0, 90, size):
        block = features[first : first + size].copy()
        gatherer.add(block)
        block[...] = np.nan
    products = gatherer.finish()
    landmarks = features[:30] - features[:30].mean(axis=0, dtype=float)
    about_mean = features - features.mean(axis=0, dtype=float)
    np.testing.assert_allclose(products.landmarks, landmarks, atol=1e-5)
    np.testing.assert_allclose(products.gram, landmarks @ landmarks.T, atol=1e-3)
    np.testing.assert_allclose(products.values, about_mean @ landmarks.T, atol=1e-3)
    others = drawn_samples(rng, 4)[0]
    expected = (others - features.mean(axis=0, dtype=float)) @ landmarks.T
    np.testing.assert_allclose(products.of_others(others), expected, atol=1e-3)


@pytest.mark.slow
def test_many_samples_in_half_precision_draw_as_well(rng, monkeypatch):
    """With more samples than landmarks: their images are rounded, and the network is as good."""
    errors = []
    training, held_out, test = (smooth_scene(rng, n, 0.05) for n in (300, 30, 60))
    for landmarks in (2048, 300, 100):
        monkeypatch.setattr(ridge, "LANDMARKS", landmarks)
        decoder = build_decoder(MAP, IMAGE, 2, dropout_place="none", neck="positions", seed=2)
        solve_decoder(decoder, in_blocks(training, 70), held_out, 3, 1)
        errors.append(error(decoder, test))
    assert errors[1] == errors[0]  # as many as there are samples: nothing is rounded
    assert errors[0] != errors[2] < 1.2 * errors[0]


@pytest.mark.parametrize("landmarks", [2048, 5])
def test_samples_that_are_all_alike_leave_their_mean(landmarks, monkeypatch):
    monkeypatch.setattr(ridge, "LANDMARKS", landmarks)
    alike = np.full((9, 7), 3.0, np.float32), np.full((9, 4), 0.25, np.float32)
    found = regression(alike, alike)
    assert not found.weights().any()
    turn, images = found.components(3)
    weights = found.of_features(turn)
    assert (weights.shape, images.shape) == ((7, 3), (3, 4))
    assert not weights.any()
    np.testing.assert_allclose(expit(found.offset), 0.25, rtol=1e-6)


def test_components_are_the_best_of_their_number_where_pixels_are_seen(rng):
    """The truncated singular value decomposition of what was fitted.

    Each pixel weighs as the mean square of its value's derivative by its logit, v (1 - v).
    """
    training, held_out = drawn_samples(rng, 40), drawn_samples(rng, 30)
    found = regression(training, held_out)
    fitted = (training[0] - found.mean) @ found.weights().astype(float)
    value = expit(fitted + found.offset)
    root = np.sqrt(np.mean((value * (1 - value)) ** 2, axis=0))
    left, size, right = np.linalg.svd(fitted * root, full_matrices=False)
    for count in (1, 2, 3):
        turn, images = found.components(count)
        weights = found.of_features(turn)
        expected = (left[:, :count] * size[:count]) @ right[:count] / root
        drawn = (training[0] - found.mean) @ weights @ images
        np.testing.assert_allclose(drawn, expected, atol=1e-3 * np.abs(fitted).max())


def test_components_approach_the_whole_regression(rng):
    def flat(samples):
        return [x.reshape(len(x), -1) for x in samples]

    training, held_out = (flat(smooth_scene(rng, n, 0.1)) for n in (60, 30))
    found = regression(training, held_out)
    whole = (held_out[0] - found.mean) @ found.weights()
    errors = []
    for count in (1, 2, 59):
        turn, images = found.components(count)
        weights = found.of_features(turn)
        numbers = (training[0] - found.mean) @ weights
        np.testing.assert_allclose(np.mean(numbers**2, axis=0)[:2], 1, rtol=1e-2)
        errors.append(np.abs((held_out[0] - found.mean) @ weights @ images - whole).max())
    assert errors[0] > errors[1] > errors[2]
    assert errors[2] < 1e-2 * np.abs(whole).max()


def test_what_memory_does_not_hold_is_refused_beforehand(rng, monkeypatch):
    """Of each sample, two planes of 9 x 20 pixels and two bands' products with ten landmarks."""
    monkeypatch.setattr(ridge, "LANDMARKS", 10)
    monkeypatch.setenv("LF_FLAME_MEMORY_GB", "1.9e-5")
    decoder = build_decoder(MAP, IMAGE, 2, dropout_place="none", neck="positions", seed=2)
    words = "what is kept of 24 training samples would need 1.92e-05 GB"
    with pytest.raises(InputError, match=words):
        solve_decoder(decoder, in_blocks(smooth_scene(rng, 24)), smooth_scene(rng, 4), bands=2)
