"""Each pixel's refined drawing is the least-squares one, as SciPy's own solver finds it."""

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.special import expit, logit

from lf_flame.learning import sigmoid_regression
from lf_flame.learning.sigmoid_regression import refine

SAMPLES, NUMBERS, PIXELS = 60, 3, 7


@pytest.fixture
def drawn(rng):
    """Numbers, images of them with noise, and a rough start."""
    numbers = rng.normal(size=(SAMPLES, NUMBERS)).astype(np.float32)
    drawings = rng.normal(size=(NUMBERS, PIXELS))
    offset = rng.uniform(-2, 2, PIXELS)
    images = expit(numbers @ drawings + offset) + 0.05 * rng.normal(size=(SAMPLES, PIXELS))
    start = (0.7 * drawings).astype(np.float32), (offset + 0.3).astype(np.float32)
    return numbers, np.clip(images, 0, 1).astype(np.float32), start


def squared_error(numbers, images, drawings, offset):
    return np.sum((expit(numbers @ drawings + offset).astype(float) - images) ** 2, axis=0)


def test_many_steps_end_where_scipy_ends(drawn):
    numbers, images, start = drawn
    drawings, offset = refine(numbers, images, *start, steps=30)
    for pixel in range(PIXELS):
        found = least_squares(
            lambda w, y=images[:, pixel]: expit(numbers.astype(float) @ w[:-1] + w[-1]) - y,
            np.append(start[0][:, pixel], start[1][pixel]),
            xtol=1e-12,
            ftol=1e-12,
        )
        got = np.append(drawings[:, pixel], offset[pixel])
        np.testing.assert_allclose(got, found.x, atol=2e-5 * max(1, np.abs(found.x).max()))


def test_a_step_is_marquardts(drawn):
    """One step of one pixel, written out in float64."""
    numbers, images, start = drawn
    drawings, offset = refine(numbers, images, *start, steps=1)
    x = np.column_stack([numbers, np.ones(SAMPLES)]).astype(float)
    for pixel in range(PIXELS):
        begin = np.append(start[0][:, pixel], start[1][pixel]).astype(float)
        value = expit(x @ begin)
        jacobian = (value * (1 - value))[:, None] * x
        normal = jacobian.T @ jacobian
        normal += sigmoid_regression.DAMPING * np.diag(np.diag(normal))
        step = np.linalg.solve(normal, jacobian.T @ (images[:, pixel] - value))
        got = np.append(drawings[:, pixel], offset[pixel]) - begin
        np.testing.assert_allclose(got, step, atol=1e-5 * np.abs(step).max())


def test_no_pixel_ever_gets_worse(rng):
    """From a start so far off that undamped steps run away."""
    numbers = (4 * rng.normal(size=(30, 5))).astype(np.float32)
    images = (rng.uniform(size=(30, 40)) > 0.5).astype(np.float32)
    drawings = rng.normal(size=(5, 40)).astype(np.float32)
    offset = rng.normal(size=40).astype(np.float32)
    errors = [
        squared_error(numbers, images, *refine(numbers, images, drawings, offset, steps))
        for steps in range(6)
    ]
    np.testing.assert_allclose(errors[0], squared_error(numbers, images, drawings, offset))
    for before, after in zip(errors, errors[1:], strict=False):
        assert (after <= before * (1 + 1e-6)).all()
    assert errors[-1].sum() < 0.9 * errors[0].sum()


@pytest.mark.parametrize(
    "bytes_of", [{"MATRIX_BYTES": 2 * 8 * (NUMBERS + 1) ** 2 + 5}, {"IMAGE_BYTES": 4 * SAMPLES}]
)
def test_pieces_change_nothing(drawn, monkeypatch, bytes_of):
    numbers, images, start = drawn
    whole = refine(numbers, images, *start, steps=3)
    for name, value in bytes_of.items():
        monkeypatch.setattr(sigmoid_regression, name, value)
    monkeypatch.setattr(sigmoid_regression, "SAMPLES", 7)
    for got, expected in zip(refine(numbers, images, *start, steps=3), whole, strict=True):
        np.testing.assert_allclose(got, expected, atol=1e-5)


def test_numbers_that_say_nothing_stay_as_they_were(drawn):
    numbers, images, start = drawn
    numbers[:, 1] = 0
    drawings, _ = refine(numbers, images, *start, steps=4)
    np.testing.assert_array_equal(drawings[1], start[0][1])


def test_saturated_pixels_keep_their_drawing(drawn):
    """Where the sigmoid is flat for every sample, no number has any effect."""
    numbers, _, _ = drawn
    images = np.zeros((SAMPLES, 2), np.float32)
    drawings, offset = refine(
        numbers, images, np.zeros((NUMBERS, 2), np.float32), np.full(2, -90, np.float32), steps=2
    )
    assert np.isfinite(drawings).all()
    assert (expit(numbers @ drawings + offset) < 1e-6).all()
    assert logit(1e-6) > offset.max()
