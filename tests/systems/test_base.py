"""What all refocusing systems must do, and the classical ones; networks are untrained here."""

import keras
import numpy as np
import pytest

from lf_flame import LightField
from lf_flame.refocus import fourier_slice, shift_and_sum
from lf_flame.systems.aperturenet import ApertureNet, build_aperturenet
from lf_flame.systems.formulas import (
    FourierSlice,
    ShiftAndSum,
    cross_of_views,
    diamond_of_views,
    every_view,
    only_views,
    outer_square_of_views,
    square_of_views,
)
from lf_flame.systems.refnet import SLOPES, RefNet, build_refnet
from lf_flame.systems.refocusnet import RefocusNet, build_refocusnet
from lf_flame.systems.sparse_unet import NineViewUNet, SparseUNet, build_unet

SYSTEMS = {
    "shift-and-sum": ShiftAndSum,
    "fourier slice": FourierSlice,
    "refocusnet": lambda: RefocusNet(build_refocusnet()),
    "refnet": lambda: RefNet(build_refnet()),
    "unet": lambda: SparseUNet(build_unet()),
    "nine views": lambda: NineViewUNet(build_unet()),
    "aperturenet": lambda: ApertureNet(build_aperturenet()),
}


@pytest.fixture(scope="module", params=SYSTEMS)
def system(request):
    return SYSTEMS[request.param]()


@pytest.fixture(scope="module", params=["refocusnet", "refnet", "unet", "aperturenet"])
def network(request):
    return SYSTEMS[request.param]()


@pytest.fixture(scope="module")
def views():
    return np.random.default_rng(4).uniform(size=(9, 9, 100, 108)).astype(np.float32)


@pytest.mark.slow
def test_images_are_float32_from_0_to_1_for_every_slope(system, views):
    stack = system.refocus(views, [-0.4, 0.0, 0.3])
    assert stack.dtype == np.float32
    assert stack.shape == (3, 100, 108)
    assert 0 <= stack.min() <= stack.max() <= 1
    assert system.refocus(views, 0.5, (2, 2)).shape == (1, 50, 54)
    assert system.refocus(views[..., :49, :53], 0.0).shape == (1, 49, 53)
    np.testing.assert_allclose(system.refocus(views, 0.3)[0], stack[2], atol=2e-6)


@pytest.mark.slow
def test_colours_are_refocused_apart(system, views):
    colours = np.stack([views, views[::-1], views * 0.5], axis=-1)
    stack = system.refocus(colours, 0.25)
    assert stack.shape == (1, 100, 108, 3)
    np.testing.assert_allclose(stack[..., 2], system.refocus(views * 0.5, 0.25), atol=2e-6)


@pytest.mark.slow
def test_only_the_selected_views_are_used(system, views):
    used = np.zeros((9, 9), bool)
    used[tuple(np.transpose(system.view_indices(9, 9)))] = True
    other = np.where(used[..., None, None], views, 1 - views)
    np.testing.assert_array_equal(system.refocus(other, 0.3), system.refocus(views, 0.3))


@pytest.mark.parametrize("selection", [every_view, square_of_views, cross_of_views])
def test_formulas_are_shift_and_sum_of_their_views(views, selection):
    """With the weights of the light field, and without its unknown pixels."""
    own, weights = np.arange(1, 82).reshape(9, 9), only_views((9, 9), selection(9, 9))
    views = LightField(views, weights=own, valid=views < 0.9)
    stack, few = shift_and_sum(views, [0.7, -0.4], weights=weights), ShiftAndSum("few", selection)
    np.testing.assert_allclose(few.refocus(views, [0.7, -0.4]), stack, atol=1e-6)
    blocks = stack.reshape(2, 50, 2, 36, 3).mean(axis=(2, 4))
    np.testing.assert_allclose(few.refocus(views, [0.7, -0.4], (2, 3)), blocks, atol=1e-6)
    sliced = fourier_slice(views, [0.7, -0.4], edges="clamp")
    np.testing.assert_allclose(FourierSlice().refocus(views, [0.7, -0.4]), sliced, atol=1e-6)


def test_selected_views():
    assert len(every_view(3, 4)) == 12
    assert outer_square_of_views(15, 15, 3)[:4] == [(0, 0), (0, 7), (0, 14), (7, 0)]
    for count, rows in ((3, (0, 1, 2)), (7, (1, 3, 5)), (9, (1, 4, 7)), (15, (2, 7, 12))):
        assert square_of_views(count, count) == [(v, u) for v in rows for u in rows]
    assert set(square_of_views(7, 7, 7)) == set(every_view(7, 7))
    # RefocusNet's are the authors' on 9 x 9 views, and as far out on others.
    assert diamond_of_views(9, 9) == [(4, 2), (2, 4), (4, 6), (6, 4)]
    for count in range(3, 20):
        indices = np.array(diamond_of_views(count, count))
        assert 0 <= np.ptp(indices) - (count - 1) / 2 < 2
        assert 0 <= indices.min() < indices.max() < count
        assert len(np.unique(indices, axis=0)) == 4
    cross = cross_of_views(9, 9)
    assert len(set(cross)) == 17
    assert all(4 in place for place in cross)


@pytest.mark.slow
def test_refnet_interpolates_between_its_sixteen_slopes(views):
    system = RefNet(build_refnet(seed=2))
    every = system.refocus(views, SLOPES)
    np.testing.assert_array_equal(SLOPES, np.arange(7, -9, -1) / 8)
    np.testing.assert_allclose(system.refocus(views, SLOPES[5])[0], every[5], atol=1e-6)
    middle = system.refocus(views, (SLOPES[5] + SLOPES[6]) / 2)[0]
    np.testing.assert_allclose(middle, (every[5] + every[6]) / 2, atol=1e-6)
    averaged = system.refocus(views, 2 * SLOPES[5], (2, 2))[0]
    inputs = system.prepare_input(views, np.zeros(1), (2, 2))
    np.testing.assert_allclose(averaged, system.predict(inputs)[0, ..., 5], atol=1e-6)
    for some, spacing in ((views, 8 / 6 / 2), (views[:7, :7], 0.5)):  # the last channel
        inputs = system.prepare_input(some, np.zeros(1), (1, 1))
        np.testing.assert_allclose(inputs[..., 49], spacing)
    np.testing.assert_allclose(system.training_slopes(np.zeros(3), (3, 3)), 3 * SLOPES)


@pytest.mark.slow
def test_smallest_is_the_receptive_field(network):
    """A changed pixel changes the image as far as half of it, and no farther."""
    rng = np.random.default_rng(5)
    model = keras.models.clone_model(network.model)
    model.set_weights([w + rng.normal(0, 0.1, w.shape) for w in network.model.get_weights()])
    system = type(network)(model)
    side = 2 * (network.smallest // network.multiple + 1) * network.multiple
    inputs = rng.uniform(size=(1, side, side, model.input_shape[-1])).astype(np.float32)
    before, reaches = system.predict(inputs), []
    for at in range(side // 2, side // 2 + network.multiple):
        other = inputs.copy()
        other[0, at, at] += 1
        changed = np.flatnonzero(np.any(system.predict(other) != before, axis=(0, 2, 3)))
        reaches += [at - changed.min(), changed.max() - at]
    assert 2 * max(reaches) + 1 == network.smallest
