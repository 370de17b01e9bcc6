"""What ships against numbers typed from the paper: network, recipe, data sets and camera."""

from functools import cache
from pathlib import Path

import pytest
from keras import layers

from lf_flame.datasets.config import read_config
from lf_flame.datasets.store import split_indices
from lf_flame.learning.decoder import build_decoder
from lf_flame.learning.training_config import read_training_config

ROOT = Path(__file__).parents[3]

DECODER = [
    (layers.Conv2D, {"filters": 512, "kernel_size": (3, 3), "activation": "linear"}),
    (layers.BatchNormalization, {}),
    (layers.LeakyReLU, {"negative_slope": 0.3}),
    (layers.Conv2D, {"filters": 256, "kernel_size": (3, 3), "activation": "linear"}),
    (layers.BatchNormalization, {}),
    (layers.LeakyReLU, {"negative_slope": 0.3}),
    (layers.GlobalAveragePooling2D, {}),
    (layers.Dense, {"units": 90 * 180 * 4, "activation": "linear"}),
    (layers.Reshape, {"target_shape": (90, 180, 4)}),
    (layers.Dropout, {"rate": 0.3}),
    (layers.Conv2D, {"filters": 4, "kernel_size": (3, 3), "activation": "sigmoid"}),
]
"""Section II.C, in its order; where it is silent, Keras's defaults (deviation 10)."""


@cache
def built_once(image, planes, **options):
    """The decoder for the features of all five stages, from 90 x 180 pixels."""
    return build_decoder((3, 6, 2048), image, planes, **options)


@pytest.mark.parametrize(
    ("kind", "epochs", "samples", "parts"),
    [("shapes", 5000, 1600, (1280, 160, 160)), ("flames", 1000, 200, (160, 20, 20))],
    ids=["shapes", "flames"],
)
def test_what_ships_is_what_the_paper_says(kind, epochs, samples, parts):
    training = read_training_config(ROOT / "experiments" / f"{kind}.toml")
    recipe = training.presets["paper"]
    assert (recipe.epochs, recipe.batch_size, recipe.learning_rate) == (epochs, 2, 1e-4)
    model = vars(training.model)
    assert (model["backbone_weights"], model["backbone_depth"]) == ("imagenet", "conv5")
    options = {name: value for name, value in model.items() if not name.startswith("backbone")}
    data = read_config(ROOT / "data_gen" / f"{kind}.toml")
    assert data.sample_count("paper") == samples
    split = split_indices(samples, training.split, training.seed)
    assert tuple(len(split[part]) for part in ("train", "validation", "test")) == parts
    camera = data.camera
    lengths = camera.main_lens_focal_mm, camera.focus_distance_mm
    assert (*lengths, camera.lenslet_focal_mm, camera.lenslet_pitch_mm) == (150, 326, 0.4, 0.112)
    assert data.depths_mm == [20, 10, 0, -10]
    assert (data.route, data.input.kind, data.shuffled_depths) == ("rays", "raw", False)
    decoder = built_once(data.image, len(data.depths_mm), **options)
    assert decoder.output_shape[1:] == (4, 90, 180, 1)
    built = [layer for layer in decoder.layers if not isinstance(layer, layers.InputLayer)]
    for layer, (wanted, values) in zip(built, DECODER, strict=False):
        assert type(layer) is wanted
        config = layer.get_config()
        assert {name: config[name] for name in values} == values
        assert config.get("padding", "same") == "same"
    after = built[len(DECODER) :]
    assert all(isinstance(layer, layers.Permute | layers.Reshape) for layer in after)
