"""Bad input to the systems and their training: one clear sentence each."""

import json
import shutil
from functools import partial

import keras
import numpy as np
import pytest

from lf_flame import InputError
from lf_flame._common.config import build
from lf_flame.datasets.config import read_config
from lf_flame.systems import formulas
from lf_flame.systems.aperturenet import ApertureNet, build_aperturenet
from lf_flame.systems.formulas import ShiftAndSum
from lf_flame.systems.refnet import RefNet, build_refnet
from lf_flame.systems.refocusnet import RefocusNet, build_refocusnet
from lf_flame.systems.region_refocus import refocus_regions
from lf_flame.systems.resnet50 import ResNet50
from lf_flame.systems.similarity import scales
from lf_flame.systems.sparse_unet import NineViewUNet, build_unet
from lf_flame.systems.training import SystemsConfig, load_system, train_system


def zeros(*shape):
    return np.zeros(shape, np.float32)


def refocus(system, shape, slope=0.0, block=(1, 1), dtype=np.float32):
    return system().refocus(np.zeros(shape, dtype), slope, block)


SUM = partial(refocus, ShiftAndSum)
REFNET = partial(refocus, lambda: RefNet(build_refnet()), (9, 9, 20, 20))

SMALL = [
    (lambda: ApertureNet(build_aperturenet()), 35), (lambda: RefNet(build_refnet()), 17),
    (lambda: NineViewUNet(build_unet()), 49), (lambda: RefocusNet(build_refocusnet()), 17),
]  # fmt: skip

INPUTS = {
    "block does not divide": (partial(SUM, (3, 3, 100, 108), 0.0, (3, 3)),
                              "Blocks of 3 x 3 lenslets do not divide an image of 100 x 108"),
    "whole numbers": (partial(SUM, (3, 3, 9, 9), dtype=np.uint8),
                      r"from 0 to 1, got whole numbers \(uint8\)"),
    "two channels": (partial(SUM, (3, 3, 20, 20, 2)),
                     "takes grey light fields and those of 3 channels, got 2"),
    "slope": (partial(SUM, (3, 3, 20, 20), np.inf), "slopes must be one or more finite numbers"),
    "RefNet's slopes": (partial(REFNET, [0.2, 0.9]),
                        "takes slopes from -1 to 0.875 pixels .* got 0.9"),
    **{f"images below {side}, {k}": (
        partial(refocus, system, (9, 9, side - 1, 60)),
        f"needs images of {side} pixels or more along each side, got {side - 1} x 60",
    ) for k, (system, side) in enumerate(SMALL)},
    **{f"views, {choose.__name__}": (partial(choose, 5, 9, **more), words + " needed, got 5 x 9")
       for choose, more, words in (
           (formulas.square_of_views, {"side": 7}, "7 x 7 views are"),
           (formulas.diamond_of_views, {}, "A square of 3 x 3 views or more is"))},
    "small window": (partial(scales, (10, 50)), "11 pixels or more along each side, got 10 x 50"),
    **{f"region {region}": (
        partial(refocus_regions, zeros(9, 9, 60, 120), [region], cross=True), words,
    ) for region, words in (
        ((0, 61, 0, 50), "inside the 60 x 120 lenslets, got"),
        ((0, 50, 0, 50), "No slope is sharpest"))},
}  # fmt: skip


@pytest.mark.parametrize(("call", "words"), INPUTS.values(), ids=INPUTS)
def test_bad_input_is_refused_in_one_sentence(call, words):
    with pytest.raises(InputError, match=words) as caught:
        call()
    assert "\n" not in str(caught.value)


WEIGHTS = {
    "No such file": lambda path: None,
    "w1 and b1 must have shapes .* got missing and": lambda path: np.savez(path, b1=zeros(64)),
    r"got \(3, 3, 3, 64\)": lambda path: np.savez(path, w1=zeros(3, 3, 3, 64), b1=zeros(64)),
}


@pytest.mark.parametrize("words", WEIGHTS)
def test_a_file_without_the_weights_is_refused(tmp_path, words):
    WEIGHTS[words](tmp_path / "weights.npz")
    with pytest.raises(InputError, match=words):
        RefocusNet.of_weights(tmp_path / "weights.npz")


def test_the_papers_network_is_for_its_own_camera_and_slopes(coarse_data):
    """A network whose image k has the value k / 10."""
    inputs = keras.Input((24, 48, 1))
    images = keras.ops.stack([0 * inputs + k / 10 for k in range(4)], axis=1)
    slopes = [1.0, 0.5, 0.0, -0.5]
    system = ResNet50(keras.Model(inputs, images), read_config(coarse_data[1]), slopes)
    views = zeros(9, 9, 48, 96)
    stack = system.refocus(views, [-0.5, 0.5], (2, 2))
    np.testing.assert_allclose(stack, np.broadcast_to(np.float32([[[0.3]], [[0.1]]]), (2, 24, 48)))
    for wrong, slope, block, words in [
        (views, 0.3, (2, 2), "only takes the slopes 1.00, 0.50, 0.00, -0.50, got 0.3"),
        (views[:5, :5], 0.5, (2, 2), "a camera of 9 x 9 views, got 5 x 5"),
        (views, 0.5, (1, 1), "48 x 96 lenslets, 2 x 2 per pixel, got .* and 1 x 1"),
        (views[..., None].repeat(3, -1), 0.5, (2, 2), "trained on grey light fields"),
    ]:
        with pytest.raises(InputError, match=words):
            system.refocus(wrong, slope, block)


def config_of(data, **more):
    values = {
        "seed": 3,
        "training_samples": {"data": [str(path) for path in data]},
        "presets": {"smoke": {"training_samples": 4, "held_out": 2}},
        "systems": {"refnet": {"epochs": 1}, "volumetric": {"epochs": 1}},
    }
    return build(SystemsConfig, values | more, "test")


OPTIONS = {
    "preset": ({"presets": {"smoke": {"steps_per_epoch": 0}}},
               "Preset smoke: epochs, .* from 1 to 999999 .* got 1, 400, 20, 0, 16, 0.001."),
    "preset's options": ({"presets": {"smoke": {"steps": 1}}}, "steps is not a known key"),
    "system": ({"systems": {"x": {"epochs": 1}}}, "systems must be of aperturenet, .*got x"),
    "patch": ({"systems": {"refnet": {"epochs": 1, "patch": 11}}}, "12 or more, got 11"),
    "unknown system": ({"train": ("refocus", "smoke")}, "one of refnet, volumetric, got 'refocus'"),
    "leaves": ({"training_samples": {"data": ["x"], "leaves": 1.5}}, "got 1, 1.5, 6"),
}  # fmt: skip


@pytest.mark.parametrize(("options", "words"), OPTIONS.values(), ids=OPTIONS)
def test_bad_options_are_refused_in_one_sentence(tmp_path, options, words):
    name, preset = options.pop("train", ("refnet", "smoke"))
    with pytest.raises(InputError, match=words):
        train_system(config_of(["x"], **options), name, preset, tmp_path)


def test_a_folder_that_holds_another_run_or_network_is_refused(system_runs, coarse_data, tmp_path):
    run = tmp_path / "run"
    shutil.copytree(system_runs / "refocusnet", run)
    with pytest.raises(InputError, match="contains a run with another system"):
        train_system(config_of(coarse_data), "volumetric", "smoke", run)
    keras.Sequential([keras.Input((1,)), keras.layers.Dense(1)]).save(run / "model.keras")
    for name, words in (
        ("other", "contains no run of a refocusing system"),
        (["refocusnet"], "run.json: system: input should be a valid string"),
        ("refocusnet", "contain no keras.Sequential"),
    ):
        (run / "run.json").write_text(json.dumps({"epochs": 1, "train_s": 1.0, "system": name}))
        with pytest.raises(InputError, match=words):
            load_system(run)
    (run / "run.json").unlink()
    with pytest.raises(InputError, match="no finished run"):
        load_system(run)
