"""Bad input to the systems and their training: one clear sentence each."""

import json
import shutil
from functools import partial

import keras
import numpy as np
import pytest
from sentences import each, refusals

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

REGIONS = partial(refocus_regions, zeros(9, 9, 60, 120), cross=True)

INPUTS = [
    (partial(SUM, (3, 3, 100, 108), 0.0, (3, 3)), "Blocks of 3 x 3 lenslets do .* of 100 x 108"),
    (partial(SUM, (3, 3, 9, 9), dtype=np.uint8), r"from 0 to 1, got whole numbers \(uint8\)"),
    (partial(SUM, (3, 3, 20, 20, 2)), "takes grey light fields and those of 3 channels, got 2"),
    (partial(SUM, (3, 3, 20, 20), np.inf), "slopes must be one or more finite numbers"),
    (partial(REFNET, [0.2, 0.9]), "takes slopes from -1 to 0.875 pixels .* got 0.9"),
    *((partial(refocus, system, (9, 9, side - 1, 60)),
       f"needs images of {side} pixels or more along each side, got {side - 1} x 60")
      for system, side in SMALL),
    (partial(formulas.square_of_views, 5, 9, side=7), "7 x 7 views are needed, got 5 x 9"),
    (partial(formulas.diamond_of_views, 5, 9), "3 x 3 views or more is needed, got 5 x 9"),
    (partial(scales, (10, 50)), "11 pixels or more along each side, got 10 x 50"),
    (partial(REGIONS, [(0, 61, 0, 50)]), "inside the 60 x 120 lenslets, got"),
    (partial(REGIONS, [(0, 50, 0, 50)]), "No slope is sharpest"),
]  # fmt: skip

test_bad_input_is_refused_in_one_sentence = refusals(INPUTS)


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


def train(name="refnet", **options):
    train_system(config_of(["no data"], **options), name, "smoke", "no folder")


test_bad_options_are_refused_in_one_sentence = refusals(
    each(
        train,
        ({"presets": {"smoke": {"steps_per_epoch": 0}}}, "Preset smoke: .* got 1, 400, 20, 0, 16"),
        ({"presets": {"smoke": {"steps": 1}}}, "steps is not a known key"),
        ({"systems": {"x": {"epochs": 1}}}, "systems must be of aperturenet, .*got x"),
        ({"systems": {"refnet": {"epochs": 1, "patch": 11}}}, "12 or more, got 11"),
        ({"name": "refocus"}, "one of refnet, volumetric, got 'refocus'"),
        ({"training_samples": {"data": ["x"], "leaves": 1.5}}, "got 1, 1.5, 6"),
    )
)


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
