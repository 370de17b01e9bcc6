import numpy as np
import pytest
from scipy.ndimage import convolve
from scipy.special import expit

from lf_flame.refocus import align_views, shift_and_sum
from lf_flame.scenes.dead_leaves import DeadLeaves
from lf_flame.systems.aperturenet import WIDTHS, ApertureNet, build_aperturenet, make_boxes


@pytest.fixture(scope="module")
def system():
    return ApertureNet(build_aperturenet(seed=3))


def blurred_mean(views, k):
    """Mean of the nine views, blurred by the box of a number, where it lies in the image."""
    boxes = make_boxes()[:, :, 0, k]
    mean = views.mean(axis=-1)
    inside = convolve(np.ones_like(mean), boxes, mode="constant")
    return convolve(mean, boxes, mode="constant") / inside


@pytest.mark.parametrize(("slope", "box"), [(0.0, 0), (1.0, 2), (-1.0, 2)])
def test_nine_views_blurred_as_wide_as_their_squares_are_all_views(system, slope, box, rng):
    """The premise of the network where it is exact: leaves at one depth, out of focus.

    At a slope of 1 the three views of a square's side are a pixel apart: a box of 3.
    """
    leaves = DeadLeaves(slopes=(0.0, 0.0)).draw((9, 9), (40, 50), rng)
    nine = align_views(leaves, slope, system.view_indices(9, 9)).mean(axis=0)
    blurred = convolve(nine, make_boxes()[:, :, 0, box], mode="nearest")
    if slope == 0:
        blurred = nine
    inner = (slice(8, -8), slice(8, -8))
    every = shift_and_sum(leaves, slope)
    np.testing.assert_allclose(blurred[inner], every[inner], atol=2e-6)
    assert slope == 0 or np.abs(nine[inner] - every[inner]).max() > 0.05


def test_boxes_are_of_their_widths():
    boxes = make_boxes()
    assert boxes.shape == (9, 9, 1, len(WIDTHS))
    np.testing.assert_allclose(boxes.sum(axis=(0, 1)), 1, atol=1e-6)
    offsets = np.arange(9) - 4
    for k, width in enumerate(WIDTHS):
        line = boxes[:, :, 0, k].sum(axis=0)
        # A box of w pixels, cut into pixels that it covers in part, has this height in the middle.
        assert line[4] == pytest.approx(1 / width, rel=1e-5)
        assert (line * offsets).sum() == pytest.approx(0, abs=1e-6)


@pytest.fixture(scope="module")
def untrained():
    return build_aperturenet()


SINGLE = [(np.where(np.arange(6) == k, 30.0, -30.0), np.eye(6)[k]) for k in range(6)]
TWO = [(14.0, 15.0, expit(1.0)), (19.0, 20.0, expit(1.0)), (20.0, 1e4, 0.5), (-1e4, 0.0, 1.0)]
START = np.exp([4.0, 0, 0, 0, 0, 0]) / (np.exp(4.0) + 5)
MIXTURES = [
    *SINGLE,
    *(([-1e4, a, -1e4, -1e4, b, -1e4], [0, 1 - share, 0, 0, share, 0]) for a, b, share in TWO),
    (None, START),  # training starts with the first box e^4 times as heavy as another
]


@pytest.mark.parametrize(("logits", "weights"), MIXTURES)
def test_boxes_are_mixed_by_their_weights(untrained, logits, weights, rng):
    """Logits are clipped at 20: with two boxes beyond, each has half the weight."""
    views = rng.uniform(size=(1, 16, 20, 9)).astype(np.float32)
    layer = untrained.get_layer("box_logits")
    kernel, start = layer.get_weights()
    if logits is not None:
        layer.set_weights([kernel, np.float32(logits)])
    image = untrained.predict_on_batch(views)[0, ..., 0]
    layer.set_weights([kernel, start])
    expected = sum(w * blurred_mean(views[0], k) for k, w in enumerate(weights))
    np.testing.assert_allclose(image, expected, atol=1e-5)


@pytest.mark.slow
def test_training_changes_all_but_the_boxes(rng):
    model = build_aperturenet()
    before = [np.array(x) for x in model.get_weights()]
    fixed = {id(x) for x in model.get_layer("boxes").weights}
    model.compile("adam", "mean_squared_error", run_eagerly=True)
    for _ in range(3):  # the last layers start at zero, and those before follow them
        views = rng.uniform(size=(2, 16, 16, 9)).astype(np.float32)
        model.train_on_batch(views, views[..., :1])
    for variable, old in zip(model.weights, before, strict=True):
        assert np.array_equal(variable, old) == (id(variable) in fixed), variable.path
