from functools import cache

import keras
import numpy as np
import pytest

from lf_flame import InputError
from lf_flame.learning.backbone import build_backbone, describe_weights
from lf_flame.learning.decoder import build_refocus_resnet50
from lf_flame.learning.keras_loading import load_model

IMAGE = (40, 64)
GREY = (*IMAGE, 1)


@pytest.fixture(scope="module", autouse=True)
def built_once():
    """Build a ResNet-50 of each size once, which takes a second: all backbones share its layers."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(keras.applications, "ResNet50", cache(keras.applications.ResNet50))
        yield


@pytest.fixture(scope="module")
def paper_model():
    return build_refocus_resnet50(backbone_weights="random")


@pytest.fixture
def resnet():
    return keras.applications.ResNet50(include_top=False, weights=None, input_shape=(*IMAGE, 3))


@pytest.fixture
def resnet_arrays(resnet):
    """Weights of a ResNet-50 as the flat names of an .npz file has them."""
    return {
        f"{layer.name}/{w.name}": keras.ops.convert_to_numpy(w)
        for layer in resnet.layers
        for w in layer.weights
    }


@pytest.mark.slow
def test_backbone_is_frozen_and_in_inference_mode(paper_model, rng):
    assert paper_model.get_layer("backbone").trainable_weights == []
    images = rng.uniform(size=(2, 90, 180, 1)).astype(np.float32)
    model = paper_model.get_layer("backbone")
    before = [keras.ops.convert_to_numpy(w) for w in model.weights]
    calm = np.array(model(images, training=False))
    np.testing.assert_array_equal(np.array(model(images, training=True)), calm)
    for weight, old in zip(model.weights, before, strict=True):
        np.testing.assert_array_equal(keras.ops.convert_to_numpy(weight), old)


@pytest.mark.slow
def test_the_first_channel_is_the_last_of_resnet(rng):
    """Keras feeds ResNet-50 blue first."""
    model = build_backbone((*IMAGE, 3), "random", "conv3")
    resnet = model.get_layer("resnet50")
    image = rng.uniform(size=(1, *IMAGE, 3)).astype(np.float32)
    fed = (255 * image - [123.68, 116.779, 103.939])[..., ::-1].astype(np.float32)
    np.testing.assert_allclose(np.array(model(image)), np.array(resnet(fed)), rtol=1e-4, atol=1e-4)


@pytest.mark.slow
def test_output_planes_are_not_scrambled(paper_model, rng):
    """Channel k of the last convolution becomes image k."""
    decoder = paper_model.get_layer("decoder")
    features = rng.normal(size=(1, *decoder.input_shape[1:])).astype(np.float32)
    channels = keras.Model(decoder.input, decoder.layers[-3].output)(features)
    stack = np.array(decoder(features))[0, ..., 0]
    np.testing.assert_array_equal(stack, np.moveaxis(np.array(channels)[0], -1, 0))


@pytest.mark.slow
def test_random_weights_depend_on_the_seed_alone():
    kernels = []
    for seed in (1, 1, 2):
        layers = build_backbone(GREY, "random", "conv3", seed).get_layer("resnet50")
        kernels.append(keras.ops.convert_to_numpy(layers.get_layer("conv1_conv").kernel))
    np.testing.assert_array_equal(kernels[0], kernels[1])
    assert np.abs(kernels[0] - kernels[2]).max() > 0
    assert kernels[0].std() == pytest.approx(np.sqrt(2 / (7 * 7 * 3)), rel=0.02)


@pytest.mark.slow
def test_preprocessing_is_the_backbones_own(paper_model, rng):
    grey = rng.uniform(size=(1, 90, 180, 1)).astype(np.float32)
    model = paper_model.get_layer("backbone")
    inner = keras.Model(model.input, model.get_layer("imagenet_preprocessing").output)
    colours = np.repeat(grey, 3, axis=-1) * 255
    expected = keras.applications.resnet.preprocess_input(colours.copy())
    np.testing.assert_allclose(np.array(inner(grey)), expected, atol=1e-4)


@pytest.mark.slow
def test_weights_file_reaches_the_features(resnet, resnet_arrays, tmp_path, rng):
    np.savez(tmp_path / "all.npz", **resnet_arrays)
    resnet.save_weights(tmp_path / "all.weights.h5")
    images = rng.uniform(size=(1, *IMAGE, 1)).astype(np.float32)
    colours = keras.applications.resnet.preprocess_input(np.repeat(images, 3, axis=-1) * 255)
    expected = {
        depth: np.array(keras.Model(resnet.input, resnet.get_layer(last).output)(colours))
        for depth, last in (("conv4", "conv4_block6_out"), ("conv5", "conv5_block3_out"))
    }
    for name, depth in (("all.npz", "conv4"), ("all.weights.h5", "conv5")):
        for weight in resnet.weights:
            weight.assign(weight + 1)
        found = build_backbone(GREY, tmp_path / name, depth)(images)
        np.testing.assert_allclose(np.array(found), expected[depth], rtol=1e-4, atol=1e-4)


@pytest.mark.slow
def test_wrong_weights_files_are_refused_and_a_pruned_one_is_taken(resnet_arrays, tmp_path):
    short = {k: v for k, v in resnet_arrays.items() if k[:5] not in ("conv4", "conv5")}
    kernel = "conv2_block1_1_conv/kernel"
    pruned = np.where(np.arange(64) == 5, short[kernel], 0)  # many zeros
    np.savez(tmp_path / "pruned.npz", **{**short, kernel: pruned})
    build_backbone(GREY, tmp_path / "pruned.npz", "conv3")
    with pytest.raises(InputError, match=r"lacks conv4_block1.*goes with backbone_depth conv4"):
        build_backbone(GREY, tmp_path / "pruned.npz", "conv4")
    for bad, said in (
        (np.ones((3, 3, 3, 64)), r"must have shape \(1, 1, 64, 64\), got \(3, 3, 3, 64\)"),
        (0 * short[kernel], rf"{kernel} in .*bad\.npz is all zeros, or contains NaN"),
        (np.nan * short[kernel], rf"{kernel} in .*bad\.npz is all zeros, or contains NaN"),
    ):
        np.savez(tmp_path / "bad.npz", **{**short, kernel: bad})
        with pytest.raises(InputError, match=said):
            build_backbone(GREY, tmp_path / "bad.npz", "conv3")
    (tmp_path / "text.h5").write_text("no weights")
    with pytest.raises(InputError, match="does not contain the weights of"):
        build_backbone(GREY, tmp_path / "text.h5")


@pytest.mark.slow
def test_without_a_backbone_the_picture_is_the_feature_map(rng, tmp_path):
    model = build_refocus_resnet50((32, 40), 2, backbone_depth="none")
    picture = rng.uniform(size=(3, 32, 40, 1)).astype(np.float32)
    backbone = model.get_layer("backbone")
    np.testing.assert_array_equal(backbone.predict(picture, verbose=0), picture)
    assert backbone.weights == []
    model.save(tmp_path / "model.keras")
    again = load_model(tmp_path / "model.keras")
    np.testing.assert_array_equal(
        again.predict(picture, verbose=0), model.predict(picture, verbose=0)
    )
    assert describe_weights("imagenet", "none", 1) == "no backbone"
