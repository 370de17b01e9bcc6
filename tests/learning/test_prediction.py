"""`lf-flame predict`: a trained network on other pictures, and its file in other hands."""

import json
import re
import shutil
import zipfile

import keras
import numpy as np
import pytest
from builders import shapes
from programs import run_or_raise as run
from programs import without_graphs
from skimage.io import imread, imsave

from lf_flame import InputError, LightField
from lf_flame._common.atomic_files import write_json
from lf_flame._common.config import build
from lf_flame.datasets.config import config_from_json
from lf_flame.datasets.encodings import InputEncoding
from lf_flame.datasets.making import make_dataset
from lf_flame.formats import read_focal_stack, write_light_field
from lf_flame.formats.images import to_levels, write_image
from lf_flame.learning.prediction import read_input
from lf_flame.learning.run_folders import open_run
from lf_flame.learning.training import train
from lf_flame.learning.training_config import TrainingConfig

SIZE = (40, 64)

DATA = shapes(12, (10, 16), 3, sides_mm=(3.0, 3.0), off_axis_mm=3.0)

TRAINING = {
    "title": "Test images",
    "seed": 1,
    "split": [0.5, 0.25, 0.25],
    "model": {"backbone_weights": "random", "backbone_depth": "none"},
    "presets": {"smoke": {"epochs": 1}},
}


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory):
    """A small network, trained for a moment on images of two shapes."""
    folder = tmp_path_factory.mktemp("run")
    make_dataset(config_from_json(DATA, "here"), 12, folder / "shapes.zarr")
    config = build(TrainingConfig, TRAINING, "here")
    with without_graphs():
        train(config, "smoke", folder / "shapes.zarr", folder / "shapes")
    return folder / "shapes"


@pytest.fixture(scope="module")
def sample(run_folder):
    """The first test image, and what the network made of it."""
    dataset, indices, predictions = open_run(run_folder).predict_test_split()
    return dataset.inputs[indices[0], ..., 0], predictions[0]


@pytest.mark.slow
def test_a_network_loads_without_this_package(run_folder, sample):
    """Every part of it is one of Keras's own, none registered by somebody else."""
    image, expected = sample
    with zipfile.ZipFile(run_folder / "model.keras") as file:
        config = file.read("config.json").decode()
    assert set(re.findall(r'"module": (\W?\w+)', config)) == {'"keras'}
    network = keras.saving.load_model(run_folder / "model.keras")
    found = network.predict(image[None, ..., None], verbose=0)
    np.testing.assert_allclose(found[0, ..., 0], expected, atol=1e-5)


@pytest.mark.slow
def test_a_picture_is_refocused_as_in_the_evaluation(run_folder, sample, tmp_path):
    """From a picture of 16 bits, three times as large in both directions."""
    image, expected = sample
    write_image(tmp_path / "card.png", to_levels(np.kron(image, np.ones((3, 3))), 16))
    result = run("predict", tmp_path / "card.png", "--model", run_folder, "--out", tmp_path / "out")
    out = tmp_path / "out" / "card"
    stack, slopes = read_focal_stack(out / "refocused.tif")
    np.testing.assert_allclose(stack, expected, atol=1e-3)
    assert list(slopes) == open_run(run_folder).slopes
    for k, name in enumerate(["refocused_1_+10mm.png", "refocused_2_-10mm.png"]):
        np.testing.assert_allclose(imread(out / name) / 255, stack[k], atol=0.003)
    record = json.loads((out / "prediction.json").read_text())
    assert record["notes"] == []
    assert f"card.png: refocused in {record['ms']:.0f} ms" in result.output


def test_light_fields_are_seen_as_in_training(run_folder, rng, tmp_path):
    """Views, raw lenslet image and photograph, or central view, are the same input."""
    light_field = LightField(rng.uniform(size=(3, 3, 120, 192)).astype(np.float32))
    np.savez(tmp_path / "views.npz", views=light_field.views, weights=np.eye(3))
    write_light_field(light_field, tmp_path / "raw.png", 16)
    write_light_field(light_field, tmp_path / "folder", 16)
    np.save(tmp_path / "raw.npy", light_field.photograph)
    np.save(tmp_path / "central.npy", light_field.views[1, 1])
    for kind in ("raw", "central"):
        encoding = InputEncoding(kind)
        expected = encoding.encode(light_field, SIZE)[..., 0]
        for name in ("views.npz", "raw.png", "folder", f"{kind}.npy"):
            found = read_input(tmp_path / name, SIZE, encoding)
            np.testing.assert_allclose(found.image, expected, atol=2e-5)
            assert found.notes == []
    missing = light_field.views * np.eye(3, dtype=np.float32)[..., None, None]
    np.savez(tmp_path / "missing.npz", views=missing, weights=np.eye(3))
    with pytest.raises(InputError, match="missing.npz: a view .* is missing, or black"):
        read_input(tmp_path / "missing.npz", SIZE)


def test_colours_become_luminance(tmp_path):
    picture = np.zeros((*SIZE, 3), np.uint8)
    picture[:, :20, 0], picture[:, 20:40, 1], picture[:, 40:, 2] = 255, 255, 255
    write_image(tmp_path / "colours.png", picture)
    found = read_input(tmp_path / "colours.png", SIZE).image
    np.testing.assert_allclose(found[0, [0, 30, 60]], [0.2126, 0.7152, 0.0722], atol=2e-4)
    imsave(tmp_path / "photo.png", picture, check_contrast=False)
    assert "gamma-coded" in read_input(tmp_path / "photo.png", SIZE).notes[0]
    np.save(tmp_path / "four.npy", np.zeros((9, 9, *SIZE, 4), np.float32))
    with pytest.raises(InputError, match="four.npy must be grey or have 3 channels, got 4"):
        read_input(tmp_path / "four.npy", SIZE)


@pytest.mark.parametrize("height", [33, 50, 91])
def test_other_sizes_are_interpolated_and_that_is_said(height, tmp_path):
    """A ramp stays the same ramp, seen at the middles of other pixels."""
    width = round(height * 1.6)
    ramp = (np.arange(width) + 0.5) / width * np.ones((height, 1))
    write_image(tmp_path / "ramp.png", to_levels(ramp, 16))
    found = read_input(tmp_path / "ramp.png", SIZE)
    expected = (np.arange(64) + 0.5) / 64
    np.testing.assert_allclose(found.image[20, 4:-4], expected[4:-4], atol=1e-3)
    assert found.notes == [f"{height} x {width} is not a multiple of 40 x 64: interpolated"]


def test_values_beyond_0_and_1_are_cut_off_and_that_is_said(tmp_path):
    picture = np.tile(np.float32([-0.5, 0.5, 3.0, 1.0]), (40, 16))
    write_image(tmp_path / "bright.tif", picture)
    found = read_input(tmp_path / "bright.tif", SIZE)
    np.testing.assert_array_equal(found.image[:, :4], np.tile([0, 0.5, 1, 1], (40, 1)))
    assert found.notes == ["values from -0.5 to 3: cut off below 0 and above 1"]


def test_pictures_that_cannot_be_used_are_one_sentence(run_folder, tmp_path):
    write_image(tmp_path / "square.png", np.zeros((80, 80), np.uint8))
    holed = np.zeros(SIZE, np.float32)
    holed[3, 4] = np.nan
    write_image(tmp_path / "holed.tif", holed)
    (tmp_path / "text.png").write_text("no picture")
    (tmp_path / "other").mkdir()
    shutil.copy(tmp_path / "square.png", tmp_path / "other")
    for names, message in (
        (["square.png"], "square.png has 80 x 80 pixels, 1 times .*; crop it to 1.6 times"),
        (["holed.tif"], "holed.tif: A light field must be finite, got 1 NaN"),
        (["text.png"], "text.png cannot be read"),
        (["none.png"], "none.png: no such file"),
        (["square.png", "other/square.png"], "square.png and another image would both go"),
    ):
        paths = [tmp_path / name for name in names]
        with pytest.raises(InputError, match=message) as caught:
            run("predict", *paths, "--model", run_folder, "--out", tmp_path / "out")
        assert len(str(caught.value).splitlines()) == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_run_stands_alone(run_folder, sample, tmp_path, monkeypatch):
    """From another working folder, moved, and without its data set it predicts the same."""
    picture, prediction = sample
    write_image(tmp_path / "picture.tif", picture)
    shutil.copytree(run_folder, tmp_path / "moved", ignore=shutil.ignore_patterns("checkpoint*"))
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    run("predict", "../picture.tif", "--model", "../moved", "--out", "out")
    stack, slopes = read_focal_stack("out/picture/refocused.tif")
    np.testing.assert_allclose(stack, prediction, atol=1e-5)
    moved = open_run(tmp_path / "moved")
    assert moved.config.camera.views == 3
    assert list(slopes) == moved.slopes
    assert moved.objects == ["square", "circle"]
    with pytest.raises(InputError, match="There is no data set at .*shapes.zarr"):
        open_run(tmp_path / "moved").predict_test_split()  # scores, and nothing else, need it


def test_scores_of_another_data_set_are_refused(run_folder, tmp_path):
    shutil.copytree(run_folder, tmp_path / "run", ignore=shutil.ignore_patterns("checkpoint*"))
    record = json.loads((run_folder / "run.json").read_text())
    record["dataset"]["slopes"] = [0.5, -0.5]
    changed = record | {"data": str(run_folder.parent / "shapes.zarr")}
    write_json(tmp_path / "run" / "run.json", changed)
    with pytest.raises(InputError, match="shapes.zarr is not the data set that .*run was trained"):
        open_run(tmp_path / "run").predict_test_split()
