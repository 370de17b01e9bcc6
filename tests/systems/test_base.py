"""What all refocusing systems must do, and the classical ones; networks are untrained here."""

import subprocess
import sys

import keras
import numpy as np
import pytest

from lf_flame.refocus import shift_and_sum, sparse_aperture
from lf_flame.systems.aperturenet import ApertureNet, build_aperturenet
from lf_flame.systems.formulas import (
    FourierSlice,
    ShiftAndSum,
    cross_of_views,
    diamond_of_views,
    every_view,
    lattice_of_views,
    outer_square_of_views,
    square_of_views,
)
from lf_flame.systems.refnet import ALPHAS, SLOPES, RefNet, build_refnet
from lf_flame.systems.refocusnet import RefocusNet, build_refocusnet
from lf_flame.systems.sparse_unet import NineViewUNet, SparseUNet, build_unet

SYSTEMS = {
    "shift-and-sum": ShiftAndSum,
    "lattice": lambda: ShiftAndSum("lattice", lattice_of_views),
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
    np.testing.assert_allclose(system.refocus(views, 0.3)[0], stack[2], atol=2e-6)


@pytest.mark.slow
def test_colours_come_out_as_they_went_in(system, views):
    colours = np.stack([views, views[::-1], views * 0.5], axis=-1)
    stack = system.refocus(colours, 0.25)
    assert stack.shape == (1, 100, 108, 3)
    np.testing.assert_allclose(stack[..., 2], system.refocus(views * 0.5, 0.25), atol=2e-6)


def test_blocks_give_smaller_images(system, views):
    assert system.refocus(views, 0.5, (2, 2)).shape == (1, 50, 54)


def test_views_that_are_not_chosen_do_not_count(system, views):
    used = np.zeros((9, 9), bool)
    used[tuple(np.transpose(system.view_indices(9, 9)))] = True
    other = np.where(used[..., None, None], views, 1 - views)
    np.testing.assert_array_equal(system.refocus(other, 0.3), system.refocus(views, 0.3))


def test_all_views_are_shift_and_sum_itself(views):
    expected = shift_and_sum(views, [0.7, -0.2])
    np.testing.assert_array_equal(ShiftAndSum().refocus(views, [0.7, -0.2]), expected)


def test_some_views_are_shift_and_sum_with_the_others_left_out(views):
    weights = sparse_aperture((9, 9), square_of_views(9, 9))
    expected = shift_and_sum(views, [0.7, -0.2], weights=weights)
    found = ShiftAndSum("few", square_of_views).refocus(views, [0.7, -0.2])
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("count", [9, 11, 15, 17, 27])
def test_lattice_shares_no_row_and_no_column(count):
    indices = np.array(lattice_of_views(count, count))
    assert len(indices) == 9
    for axis in (0, 1):
        steps = np.diff(np.sort(indices[:, axis]))
        assert steps.min() >= 1
        assert np.ptp(steps) <= 1
    assert [count // 2, count // 2] in indices.tolist()
    np.testing.assert_allclose(indices.mean(axis=0), (count - 1) / 2, atol=0.5)


def test_some_views_are_averaged_over_blocks_as_all_are(views):
    few = ShiftAndSum("few", square_of_views)
    weights = sparse_aperture((9, 9), square_of_views(9, 9))
    stack = shift_and_sum(views, [0.7, -0.4], weights=weights)
    np.testing.assert_allclose(
        few.refocus(views, [0.7, -0.4], (2, 3)),
        stack.reshape(2, 50, 2, 36, 3).mean(axis=(2, 4)),
        atol=1e-6,
    )


def test_other_choices_of_views():
    assert len(every_view(3, 4)) == 12
    assert outer_square_of_views(15, 15, 3)[:4] == [(0, 0), (0, 7), (0, 14), (7, 0)]
    assert square_of_views(15, 15)[:4] == [(2, 2), (2, 7), (2, 12), (7, 2)]
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
def test_refnet_draws_its_sixteen_slopes_and_mixes_between(views):
    system = RefNet(build_refnet(seed=2))
    every = system.refocus(views, SLOPES)
    np.testing.assert_allclose(SLOPES, 1 - ALPHAS)
    np.testing.assert_allclose(system.refocus(views, SLOPES[5])[0], every[5], atol=1e-6)
    middle = system.refocus(views, (SLOPES[5] + SLOPES[6]) / 2)[0]
    np.testing.assert_allclose(middle, (every[5] + every[6]) / 2, atol=1e-6)
    averaged = system.refocus(views, 2 * SLOPES[5], (2, 2))[0]
    shown = system.show(views, np.zeros(1), (2, 2))
    np.testing.assert_allclose(averaged, system.predict(shown)[0, ..., 5], atol=1e-6)


def test_refnet_is_told_how_far_apart_its_views_stand(views):
    system = RefNet(build_refnet())
    for some, apart in ((views, 8 / 6 / 2), (views[:7, :7], 0.5)):
        np.testing.assert_allclose(system.show(some, np.zeros(1), (1, 1))[..., 49], apart)


@pytest.mark.slow
def test_unet_works_on_any_size(views):
    """What is filled up at the edges is cut off again."""
    system = SparseUNet(build_unet(seed=1))
    shown = system.show(views, np.array([0.3]), (1, 1))
    cut = system.predict(shown[:, :33, :30])
    assert cut.shape == (1, 33, 30, 1)
    np.testing.assert_allclose(cut[:, :8, :8], system.predict(shown)[:, :8, :8], atol=1e-5)


@pytest.mark.slow
def test_smallest_is_the_receptive_field(network):
    """A changed pixel changes the image as far as half of it, and no farther."""
    rng = np.random.default_rng(5)
    model = keras.models.clone_model(network.model)
    model.set_weights([w + rng.normal(0, 0.1, w.shape) for w in network.model.get_weights()])
    system = type(network)(model)
    side = 2 * (network.smallest // network.multiple + 1) * network.multiple
    shown = rng.uniform(size=(1, side, side, model.input_shape[-1])).astype(np.float32)
    before, reaches = system.predict(shown), []
    for at in range(side // 2, side // 2 + network.multiple):
        other = shown.copy()
        other[0, at, at] += 1
        changed = np.flatnonzero(np.any(system.predict(other) != before, axis=(0, 2, 3)))
        reaches += [at - changed.min(), changed.max() - at]
    assert 2 * max(reaches) + 1 == network.smallest


def test_importing_the_systems_leaves_the_environment_alone():
    code = (
        "import os; before = dict(os.environ); import lf_flame.systems.formulas; "
        "print(before == dict(os.environ))"
    )
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert shown.stdout.strip() == "True"
