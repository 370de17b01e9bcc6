import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from lf_flame import InputError
from lf_flame._common.config import build
from lf_flame.refocus import shift_and_sum
from lf_flame.scenes.dead_leaves import DeadLeaves
from lf_flame.simulation.rendering import render_plan
from lf_flame.systems import training
from lf_flame.systems.formulas import ShiftAndSum, average, every_view, square_of_views
from lf_flame.systems.training import (
    NETWORKS,
    SystemRecipe,
    SystemsConfig,
    TrainingSamples,
    draw_arrays,
    draw_patches,
    load_system,
    make_optimizer,
    read_systems_config,
    train_system,
)

SMOKE = {
    "training_samples": 4, "held_out": 2, "epochs": 2, "steps_per_epoch": 3, "batch_size": 2
}  # fmt: skip


@pytest.fixture(scope="module")
def config(coarse_data):
    values = {
        "seed": 3,
        "checkpoint_s": 0,
        "training_samples": {"data": [str(path) for path in coarse_data], "slopes": 3},
        "presets": {"smoke": SMOKE},
        "systems": {name: {"epochs": 50, "patch": 24} for name in NETWORKS},
    }
    values["systems"]["volumetric"]["optimizer"] = "rmsprop"
    return build(SystemsConfig, values, "test")


def system_of(name, seed=0):
    return NETWORKS[name].system(NETWORKS[name].build(seed))


@pytest.mark.slow
def test_samples_depend_on_seed_and_index_alone(config):
    draw = config.training_samples.draw
    first, again, other = (draw(1, k, every_view) for k in (5, 5, 6))
    np.testing.assert_array_equal(first.views, again.views)
    np.testing.assert_array_equal(first.slopes, again.slopes)
    assert first.views.shape != other.views.shape or np.any(first.views != other.views)
    blocks = {draw(1, k, every_view).block for k in range(8)}
    assert blocks == {(1, 1), (2, 2)}  # leaves and scenes


@pytest.mark.slow
def test_every_object_is_in_focus_in_some_sample(config):
    """Half of a scene's slopes are those of its objects, each object as often as the others."""
    data = config.training_samples.configs[0]
    scenes = TrainingSamples(config.training_samples.data[:1], leaves=0, slopes=4)
    kept, chosen = 0, []
    for k in range(40):
        scene, slopes, _ = scenes._draw_scene(data, np.random.default_rng(k))
        depths = np.array([layer.depth_mm for layer in scene.layers])
        away = np.abs(data.camera.depth_to_slope(depths) - slopes[:2, None])
        np.testing.assert_allclose(away.min(axis=1), 0, atol=1e-9)
        chosen += away.argmin(axis=1).tolist()
        kept += set(depths) == set(data.depths_mm)
    assert np.bincount(chosen, minlength=4).min() >= 12  # of 20 that are expected
    assert 12 <= kept <= 28  # about every other sample keeps the depths of the data set


@pytest.mark.slow
@pytest.mark.parametrize("name", NETWORKS)
def test_inputs_and_targets_are_those_of_the_light_field(config, name, monkeypatch):
    """Computed from the scene without a light field, and by shift-and-sum of the rendered views."""
    scenes, system = replace(config.training_samples, leaves=0), system_of(name)
    made = []

    class Remembered(training.Projector):
        def __init__(self, *arguments):
            super().__init__(*arguments)
            made.append(arguments)

    monkeypatch.setattr(training, "Projector", Remembered)
    arrays = draw_arrays(scenes, system, 1, range(3))
    assert len(made) == 3
    for k, (scene, camera, plan) in enumerate(list(made)):
        sample = scenes.draw(1, k, system.view_indices)
        slopes = system.training_slopes(sample.slopes, sample.block)
        views = render_plan(scene, camera, plan).views
        inputs = system.prepare_input(views, slopes, sample.block)
        targets = system.prepare_target(ShiftAndSum().refocus(views, slopes, sample.block))
        for found, expected in zip(arrays, (inputs, targets), strict=True):
            part = found[k * len(expected) :][: len(expected)]
            np.testing.assert_allclose(part, expected, rtol=0, atol=2e-6)
    shapes = system.model.input_shape, system.model.output_shape
    for found, shape in zip(arrays, shapes, strict=True):
        assert found.shape == (3 if name == "refnet" else 9, 24, 48, shape[3])
        assert found.dtype == np.float32


@pytest.mark.slow
def test_views_that_a_stop_cuts_are_in_no_target_and_no_input(coarse_data, tmp_path):
    path, stop = tmp_path / "round.toml", "views = 9\naperture_diameter_mm = 540.0"
    path.write_text(coarse_data[0].read_text().replace("views = 9", stop))
    scenes = TrainingSamples([str(path)], leaves=0, slopes=2)
    sample = scenes.draw(1, 0, square_of_views)
    stack = shift_and_sum(sample.views, sample.slopes, weights=sample.weights)
    expected = np.clip(average(stack, sample.block), 0, 1)
    np.testing.assert_array_equal(sample.refocus(sample.slopes), expected)
    assert sample.weights.min() == 0
    with pytest.raises(InputError, match="This system needs the view in row 0, column 0"):
        scenes.draw(1, 0, every_view)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["aperturenet", "refnet"])  # commands use runs of the others
def test_training_writes_a_run_that_can_be_used(config, name, tmp_path):
    run = train_system(config, name, "smoke", tmp_path / name).parent
    record = json.loads((run / "run.json").read_text())
    history = pd.read_csv(run / "history.csv")
    assert list(history.epoch) == [1, 2]
    assert record["best_validation_loss"] == pytest.approx(history.val_loss.min(), rel=1e-5)
    system = load_system(run)
    assert record["parameters"] == system.parameters == system.model.count_params()
    views = DeadLeaves().draw((9, 9), (50, 60), np.random.default_rng(1)).views
    assert system.refocus(views, 0.2).shape == (1, 50, 60)
    # The best weights of the run are those in the file.
    held_out = range(1_000_000, 1_000_002)
    arrays = draw_arrays(config.training_samples, system, config.seed, held_out)
    images = system.predict(arrays[0])
    assert np.square(images - arrays[1]).mean() == pytest.approx(history.val_loss.min(), rel=1e-3)


@pytest.mark.slow
def test_a_network_learns_in_the_steps_of_the_recipe(config):
    """Down the cosine, the last step's rate is 0; initial weights depend on the seed."""
    system, again, other = (system_of("refocusnet", seed) for seed in (1, 1, 2))
    first, same, different = (x.model.get_weights()[0] for x in (system, again, other))
    np.testing.assert_array_equal(first, same)
    assert np.any(first != different)
    pair = draw_arrays(config.training_samples, system, 1, range(1))
    recipe = SystemRecipe(epochs=2, steps_per_epoch=12, patch=24, batch_size=2)
    optimizer = make_optimizer(recipe)
    system.model.compile(optimizer, "mean_squared_error")
    start, patches = system.model.evaluate(*pair, verbose=0), draw_patches(*pair, recipe, 1, seed=1)
    options = {"steps_per_epoch": patches.steps, "shuffle": False, "verbose": 0}
    system.model.fit(patches, epochs=2, **options)
    assert int(optimizer.iterations) == 24
    assert float(optimizer.learning_rate) == pytest.approx(0, abs=1e-9)
    assert system.model.evaluate(*pair, verbose=0) < start / 2


def test_patches_have_the_target_of_their_position_and_prefer_contrast(rng):
    """Images whose values say where they are; the right half of each varies, the left is flat."""
    places = np.arange(3 * 20 * 40, dtype=np.float32).reshape(3, 20, 40, 1)
    truth = np.where(np.arange(40)[:, None] < 20, 0.0, places).astype(np.float32)
    recipe = SystemRecipe(epochs=1, steps_per_epoch=50, patch=15, batch_size=4)
    patches = draw_patches(places, truth, recipe, multiple=4, seed=1)
    batches = [patches[k] for k in range(50)]
    inputs, targets = (np.concatenate(x) for x in zip(*batches, strict=True))
    assert inputs.shape == targets.shape == (200, 12, 12, 1)
    columns = inputs[:, 0, 0, 0] % 40
    flat = columns[:, None] + np.arange(12) < 20
    np.testing.assert_array_equal(targets[:, 0, :, 0], np.where(flat, 0, inputs[:, 0, :, 0]))
    # 9 of 29 places are flat, and both of two with a probability of 0.096.
    assert 0.05 < (columns <= 8).mean() < 0.15
    assert {int(x) for x in inputs[:, 0, 0, 0] // 800} == {0, 1, 2}


def test_the_experiment_names_every_network():
    config = read_systems_config("experiments/systems.toml")
    assert set(config.systems) == set(NETWORKS)
    assert config.training_samples.configs[0].image == (90, 180)
    recipe = config.recipe("refnet", "smoke")  # a preset may replace the duration of all
    assert (recipe.epochs, recipe.steps_per_epoch, recipe.training_samples) == (1, 4, 3)
