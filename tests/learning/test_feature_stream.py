"""The training samples' features, block by block."""

import numpy as np
import pytest
from builders import DATA

from lf_flame import InputError
from lf_flame.datasets import fresh_scenes
from lf_flame.datasets.config import config_from_json
from lf_flame.datasets.making import make_dataset
from lf_flame.datasets.store import Dataset
from lf_flame.learning import feature_stream
from lf_flame.learning.decoder import build_refocus_resnet50
from lf_flame.learning.feature_stream import BATCH, FeatureStream, compute_features

INDICES = np.array([2, 0, 3])


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Nine samples of which a data set holds the first four."""
    folder, config = tmp_path_factory.mktemp("data"), config_from_json(DATA, "here")
    for count in (4, 9):
        make_dataset(config, count, folder / f"{count}.zarr")
    return folder


@pytest.fixture
def stream(whole, monkeypatch):
    """Without a backbone, which cannot see so small an image, the features are the picture."""
    monkeypatch.setattr(feature_stream, "TOGETHER", 2)
    monkeypatch.setattr(fresh_scenes, "TOGETHER", 2)
    monkeypatch.setattr(fresh_scenes, "cpu_count", lambda: 1)  # processes take seconds to start
    monkeypatch.setattr(feature_stream, "REMEMBERED", 4)
    model = build_refocus_resnet50((10, 16), 1, backbone_depth="none")
    dataset = Dataset(whole / "4.zarr")
    return lambda keep_all: FeatureStream(model, dataset, INDICES, 5, keep_all)


@pytest.fixture
def expected(whole):
    found, order = Dataset(whole / "9.zarr"), [*INDICES, 4, 5, 6, 7, 8]
    return found.inputs[order], found.targets[order][..., None]


@pytest.mark.slow
def test_it_gives_the_stored_samples_and_then_the_fresh_ones(stream, expected):
    some = stream(False)
    blocks = list(some)
    assert len(some) == 8
    assert [len(features) for features, _ in blocks] == [2, 1, 2, 2, 1]
    for found, wanted in zip(zip(*blocks, strict=True), expected, strict=True):
        np.testing.assert_array_equal(np.concatenate(found), wanted)


@pytest.mark.parametrize(("keep_all", "count"), [(False, 4), (True, 8)])
@pytest.mark.parametrize("iterated", [False, True])
def test_only_the_first_ones_stay_unless_all_are_asked_for(
    stream, expected, keep_all, count, iterated
):
    some = stream(keep_all)
    if iterated:
        list(some)
    for found, wanted in zip(some.kept(), expected, strict=True):
        np.testing.assert_array_equal(found, wanted[:count])


def test_features_of_many_samples_are_those_of_each(rng):
    """More than the backbone sees together; its picture is rescaled by 1."""
    model = build_refocus_resnet50((10, 16), 1, backbone_depth="none")
    inputs = rng.uniform(size=(2 * BATCH + 3, 10, 16, 1)).astype(np.float32)
    np.testing.assert_array_equal(compute_features(model, inputs), inputs)


def test_nothing_is_computed_twice(stream, monkeypatch):
    some, calls = stream(True), []
    list(some)
    monkeypatch.setattr(feature_stream, "compute_features", lambda *a: calls.append(a))
    some.kept()
    assert not calls


def test_what_memory_does_not_hold_is_refused_beforehand(stream, monkeypatch):
    """Features and images of 10 x 16 pixels, in float32: 1,280 bytes a sample."""
    monkeypatch.setenv("LF_FLAME_MEMORY_GB", "6e-6")
    stream(False)
    words = "features and images of 8 training samples would need 1.02e-05 GB"
    with pytest.raises(InputError, match=words):
        stream(True)
