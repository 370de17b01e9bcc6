import json
import math
import random
import shutil
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
import zarr

from lf_flame import InputError, Scene, Sensor, plan_effects, render
from lf_flame.datasets.config import read_config
from lf_flame.datasets.encodings import InputEncoding
from lf_flame.datasets.making import LEAST_TOGETHER, make_dataset, shard_size
from lf_flame.datasets.sampling import (
    TARGET_ERROR,
    render_sample,
    search_slopes,
    simulate_sample,
)
from lf_flame.datasets.store import Dataset
from lf_flame.refocus import shift_and_sum
from lf_flame.simulation import rendering

DATA_GEN = Path(__file__).parents[2] / "data_gen"

TINY = """
kind = "shapes"
seed = 3
image = [8, 12]
[samples]
smoke = 5
[camera]
main_lens_focal_mm = 150.0
focus_distance_mm = 326.0
lenslet_focal_mm = 2.0
lenslet_pitch_mm = 0.56
views = 5
lenslets = [24, 36]
[template]
position_mm = 0.4
size = 0.08
brightness = [0.85, 1.0]
[[template.objects]]
shape = "square"
depth_mm = 10.0
size_mm = [6.0, 6.0]
centre_mm = [0.0, -6.0]
[[template.objects]]
shape = "circle"
depth_mm = -10.0
size_mm = [6.0, 6.0]
centre_mm = [0.0, 5.0]
"""


@pytest.fixture
def tiny(tmp_path):
    path = tmp_path / "tiny.toml"
    path.write_text(TINY)
    return read_config(path)


def chunk_bytes(folder):
    """Every file below a data set but its JSON metadata."""
    files = sorted(p for p in folder.rglob("*") if p.is_file() and p.name != "zarr.json")
    return {str(p.relative_to(folder)): p.read_bytes() for p in files}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["shapes", "flames"])
def test_slopes_found_are_the_geometrys(name):
    """As through the paper's camera, with fewer views: pixels as large, and the same aperture."""
    config = read_config(DATA_GEN / f"{name}.toml")
    config = replace(config, camera=replace(config.camera, views=9))
    found = [search.slope for search in search_slopes(config, whole_range=True)]
    np.testing.assert_allclose(found, config.camera.depth_to_slope(config.depths_mm), atol=0.003)
    near = [search.slope for search in search_slopes(config)]
    np.testing.assert_allclose(near, found, atol=5e-5)


def test_each_object_is_searched_where_it_stands(tiny):
    """All lenslets that it lights in the middle view, and a few around them, up to the edges."""
    scene, _ = tiny.draw(None)
    for layer, search in zip(scene.layers, search_slopes(tiny), strict=True):
        lit = render(Scene([layer]), tiny.camera).views[2, 2] > 0
        for axis, length in enumerate(tiny.camera.lenslets):
            places = np.flatnonzero(lit.any(axis=1 - axis))
            first, end = search.region[2 * axis : 2 * axis + 2]
            assert first == 0 or 3 <= places[0] - first <= 9
            assert end == length or 3 <= end - 1 - places[-1] <= 9


def test_network_input_holds_no_angular_information(tiny):
    """It equals the stack refocused at slope 0: DEVIATIONS.md, entry 5."""
    sample = simulate_sample(tiny, [0.0], 0)
    np.testing.assert_allclose(sample["input"][..., 0], sample["target"][0], atol=1e-6)


def test_targets_are_the_stack_at_the_recorded_slopes(tiny, tmp_path):
    make_dataset(tiny, 2, tmp_path / "a.zarr")
    dataset = Dataset(tmp_path / "a.zarr")
    scene, parameters = tiny.template.draw(np.random.default_rng([tiny.seed, 1]))
    stack = shift_and_sum(render(scene, tiny.camera), dataset.attrs["slopes"])
    blocks = stack.reshape(2, 8, 3, 12, 3).mean(axis=(2, 4))
    np.testing.assert_allclose(dataset.targets[1], blocks, atol=1e-6)
    np.testing.assert_array_equal(dataset.parameters("size_mm")[1], parameters["size_mm"])
    assert dataset.config == tiny
    assert set(dataset.attrs["provenance"]) >= {"command", "versions", "git_revision", "wall_s"}


@pytest.mark.slow
def test_bytes_do_not_depend_on_the_number_of_workers(tiny, tmp_path):
    for workers in (1, 2):
        make_dataset(tiny, 5, tmp_path / f"{workers}.zarr", workers)
    assert chunk_bytes(tmp_path / "1.zarr") == chunk_bytes(tmp_path / "2.zarr")


@pytest.mark.parametrize("samples", [1, 16, 200, 1600, 40_000, 1_000_000])
def test_there_are_few_files_and_enough_work_for_all(samples):
    files = math.ceil(samples / shard_size(samples))
    assert 10 * files <= 10_000  # input, target, three parameters or so, complete, simulated
    assert files >= min(64, samples / LEAST_TOGETHER)


def test_samples_lie_in_shards_each_with_its_checksum(tiny, tmp_path):
    make_dataset(tiny, LEAST_TOGETHER + 3, tmp_path / "a.zarr")
    array = zarr.open_group(tmp_path / "a.zarr", mode="r")["target"]
    assert array.shards[0] == LEAST_TOGETHER
    assert array.chunks[0] == 1
    assert "crc32c" in json.dumps(array.metadata.to_dict()["codecs"], default=str)
    files = [path for path in (tmp_path / "a.zarr").rglob("c/*") if path.name.isdigit()]
    assert {path.name for path in files} == {"0", "1"}
    assert len(Dataset(tmp_path / "a.zarr").targets) == LEAST_TOGETHER + 3


@pytest.mark.slow
def test_anybody_may_do_the_work(tiny, tmp_path):
    """An executor of threads, in which each task has one thread of Numba's as elsewhere."""
    make_dataset(tiny, 40, tmp_path / "a.zarr")
    with ThreadPoolExecutor(2) as executor:
        make_dataset(tiny, 40, tmp_path / "b.zarr", executor=executor)
    assert chunk_bytes(tmp_path / "a.zarr") == chunk_bytes(tmp_path / "b.zarr")
    assert Dataset(tmp_path / "b.zarr").attrs["provenance"]["workers"] == "ThreadPoolExecutor"


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["raw", "views", "grid"])
def test_both_ways_to_the_images_agree(tiny, tmp_path, kind):
    """Straight from the scene, and through the light field."""
    config = replace(tiny, input=InputEncoding(kind), shuffled_depths=True)
    with patch.object(rendering, "render_plan", wraps=rendering.render_plan) as rendered:
        make_dataset(config, 3, tmp_path / "short.zarr")
        assert rendered.call_count == 1  # of the mean scene, to find the slopes
        make_dataset(replace(config, route="exact"), 3, tmp_path / "long.zarr")
        assert rendered.call_count == 1 + 1 + 3
    short, long = (Dataset(tmp_path / name) for name in ("short.zarr", "long.zarr"))
    np.testing.assert_allclose(short.inputs, long.inputs, rtol=0, atol=1e-6)
    np.testing.assert_allclose(short.targets, long.targets, rtol=0, atol=1e-6)


@pytest.mark.slow
def test_traced_rays_give_the_images_of_the_exact_route(tiny, tmp_path):
    """As many rays as the mean scene needs are traced for every sample, as the record says."""
    config = replace(tiny, route="rays")
    with patch.object(rendering, "render_plan", wraps=rendering.render_plan) as rendered:
        make_dataset(config, 3, tmp_path / "rays.zarr")
    make_dataset(tiny, 3, tmp_path / "direct.zarr")
    rays, direct = (Dataset(tmp_path / f"{name}.zarr") for name in ("rays", "direct"))
    count = rays.attrs["rays"]
    assert count >= 2
    assert direct.attrs["rays"] is None
    integrators = [(call.args[3], call.args[4]) for call in rendered.call_args_list]
    assert integrators[-3:] == [("rays", count)] * 3
    error = np.square(rays.targets - direct.targets).mean(axis=(2, 3))
    assert 0 < np.sqrt(error.max()) < 3 * TARGET_ERROR
    np.testing.assert_allclose(rays.attrs["slopes"], direct.attrs["slopes"], atol=0.01)


def test_images_that_need_a_light_field_get_one(tiny):
    """Noise is drawn for every pixel of the raw image."""
    noisy = replace(tiny, camera=replace(tiny.camera, sensor=Sensor(100.0)))
    assert "shot_noise" in noisy.plan.not_separable
    sample, light_field = simulate_sample(noisy, [0.3], 1), render_sample(noisy, 1)[0]
    np.testing.assert_array_equal(sample["input"], noisy.encode(light_field))
    blocks = shift_and_sum(light_field, 0.3).reshape(1, 8, 3, 12, 3).mean(axis=(2, 4))
    np.testing.assert_allclose(sample["target"], np.clip(blocks, 0, 1), atol=1e-6)


MAKE = """
import sys
from lf_flame.datasets import make_dataset, read_config
def told(finished, done, total):
    for one in finished:
        print(one, flush=True)
        yield one
make_dataset(read_config(sys.argv[1]), 160, sys.argv[2], progress=told)
"""


@pytest.mark.slow
def test_a_run_that_is_killed_resumes_to_the_same_bytes(tiny, tmp_path):
    rng = random.Random(3)
    command = [sys.executable, "-c", MAKE, str(tmp_path / "tiny.toml"), str(tmp_path / "a.zarr")]
    for _ in range(3):
        process = subprocess.Popen(command, stdout=subprocess.PIPE)
        process.stdout.readline()  # at least one shard is written
        time.sleep(rng.uniform(0, 0.3))
        process.kill()
        process.communicate()
        assert not (tmp_path / "a.zarr").exists()
    for name in ("a.zarr", "b.zarr"):
        make_dataset(tiny, 160, tmp_path / name)
    assert chunk_bytes(tmp_path / "a.zarr") == chunk_bytes(tmp_path / "b.zarr")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.zarr", "b.zarr", "tiny.toml"]


@pytest.mark.slow
def test_a_run_that_was_cut_goes_on_to_the_same_bytes(tiny, tmp_path):
    class Cut(Exception):
        pass

    def cut(finished, done, total):
        for count, index in enumerate(finished):
            if count == 20:
                raise Cut
            yield index

    with pytest.raises(Cut):
        make_dataset(tiny, 40, tmp_path / "a.zarr", progress=cut)
    with pytest.raises(InputError, match="begun, but is not finished"):
        Dataset(tmp_path / "a.zarr")
    redone = []

    def count(finished, done, total):
        redone.append((done, total))
        return finished

    make_dataset(tiny, 40, tmp_path / "a.zarr", progress=count)
    make_dataset(tiny, 40, tmp_path / "b.zarr")
    assert redone[0][0] in (16, 32)
    assert chunk_bytes(tmp_path / "a.zarr") == chunk_bytes(tmp_path / "b.zarr")
    assert not (tmp_path / "a.zarr.part").exists()


def test_a_run_that_was_cut_at_its_very_start_begins_again(tiny, tmp_path):
    left = tmp_path / f".a.zarr.part.{'0' * 16}.part"
    left.mkdir()
    (left / "zarr.json").write_text('{"zarr_format": 3, "node_type": "group", "attributes": {}}')
    make_dataset(tiny, 2, tmp_path / "a.zarr")
    assert len(Dataset(tmp_path / "a.zarr")) == 2
    assert [path.name for path in tmp_path.glob("*a.*")] == ["a.zarr"]


def test_a_folder_that_bears_the_name_of_a_part_is_left_alone(tiny, tmp_path):
    mine = tmp_path / "a.zarr.part" / "thesis.txt"
    mine.parent.mkdir()
    mine.write_text("mine")
    with pytest.raises(InputError, match="a.zarr.part is in the way"):
        make_dataset(tiny, 2, tmp_path / "a.zarr")
    assert mine.read_text() == "mine"
    assert [path.name for path in tmp_path.glob("*a.*")] == ["a.zarr.part"]


def test_a_link_to_nothing_is_refused_before_any_work(tiny, tmp_path):
    (tmp_path / "a.zarr").symlink_to("nowhere")
    with pytest.raises(InputError, match="a.zarr exists; remove it"):
        make_dataset(tiny, 2, tmp_path / "a.zarr")
    assert [path.name for path in tmp_path.glob("*a.zarr*")] == ["a.zarr"]


def test_what_zarr_left_of_a_write_that_was_cut_off_goes(tiny, tmp_path):
    make_dataset(tiny, 2, tmp_path / "a.zarr")
    part = tmp_path / "a.zarr.part"
    shutil.move(tmp_path / "a.zarr", part)
    left = part / "input" / "c" / "0" / "0" / "0" / f"0.{'0' * 32}.partial"
    left.write_bytes(b"half")
    make_dataset(tiny, 2, tmp_path / "a.zarr")
    assert not list((tmp_path / "a.zarr").rglob("*.partial"))


def test_data_sets_of_older_versions_are_read(tiny, tmp_path):
    """Their attributes hold hashes."""
    make_dataset(tiny, 2, tmp_path / "a.zarr")
    hashes = {"sha256": "0", "parameters_sha256": "1", "attributes_sha256": "2"}
    path = tmp_path / "a.zarr" / "zarr.json"
    record = json.loads(path.read_text())
    record["attributes"].update(hashes)
    path.write_text(json.dumps(record))
    assert len(Dataset(tmp_path / "a.zarr").targets) == 2


def test_nothing_finished_is_overwritten(tiny, tmp_path):
    make_dataset(tiny, 2, tmp_path / "a.zarr")
    before = chunk_bytes(tmp_path / "a.zarr")
    with pytest.raises(InputError, match="exists; remove it"):
        make_dataset(tiny, 3, tmp_path / "a.zarr")
    assert chunk_bytes(tmp_path / "a.zarr") == before


@pytest.mark.parametrize(("kind", "shape"), [("views", (8, 12, 3)), ("grid", (24, 36, 1))])
def test_networks_may_be_shown_several_views(tiny, tmp_path, kind, shape):
    config = replace(tiny, input=InputEncoding(kind))
    make_dataset(config, 2, tmp_path / "a.zarr")
    dataset = Dataset(tmp_path / "a.zarr")
    assert dataset.config == config
    assert dataset.inputs.shape == (2, *shape)
    light_field, _ = render_sample(config, 1)
    np.testing.assert_allclose(dataset.inputs[1], config.encode(light_field), atol=1e-6)


def test_shuffled_objects_stand_at_depths_of_others_but_look_the_same(tiny, tmp_path):
    config = replace(tiny, shuffled_depths=True)
    make_dataset(config, 8, tmp_path / "a.zarr")
    dataset = Dataset(tmp_path / "a.zarr")
    depths = dataset.parameters("depth_mm")
    np.testing.assert_array_equal(np.sort(depths), np.tile(np.sort(config.depths_mm), (8, 1)))
    assert len(np.unique(depths, axis=0)) == 2  # both orders of the two objects
    for index in range(8):
        shuffled, fixed = (render_sample(x, index)[0].views[2, 2] for x in (config, tiny))
        np.testing.assert_allclose(shuffled, fixed, atol=0.02)
    np.testing.assert_array_equal(  # what was drawn before the depths stays
        dataset.parameters("size_mm")[1], render_sample(tiny, 1)[1]["size_mm"]
    )


OPAQUE = (
    TINY.replace("brightness = [0.85, 1.0]", "brightness = [0.85, 1.0]\nopaque = true")
    .replace("position_mm = 0.4", "position_mm = 3.0")
    .replace("size = 0.08", "size = 0.3")
    .replace("size_mm = [6.0, 6.0]", "size_mm = [4.0, 4.0]")
    .replace("centre_mm = [0.0, -6.0]", "centre_mm = [0.0, -4.5]")
)
"""Opaque shapes at two depths, that stand before one another in some samples only."""


@pytest.fixture
def opaque(tmp_path):
    path = tmp_path / "opaque.toml"
    path.write_text(OPAQUE)
    config = read_config(path)
    coarse = {"views": 3, "lenslets": (16, 24), "lenslet_pitch_mm": 0.84}
    return replace(config, camera=replace(config.camera, **coarse))


def hides(config, index):
    """Whether a line of sight from the lens meets both shapes' boxes, by similar triangles."""
    scene, _ = config.draw(np.random.default_rng([config.seed, index]))
    boxes = []
    for layer in scene.layers:
        distance = config.camera.focus_distance_mm + layer.depth_mm
        spread = config.camera.aperture_mm / 2 * abs(layer.depth_mm) / 326.0 + 0.5
        middle, half = np.array(layer.centre_mm), np.array(layer.size_mm) / 2
        boxes.append(((middle - half) / distance, (middle + half) / distance, spread / distance))
    (low, high, blur), (other_low, other_high, other_blur) = boxes
    gap = np.max([low - other_high, other_low - high])
    return gap < 0, gap > blur + other_blur


def test_opaque_shapes_overlap_in_some_samples_only(opaque):
    traced = []
    for index in range(8):
        scene, _ = opaque.draw(np.random.default_rng([opaque.seed, index]))
        traced.append(opaque.plan_of(scene).traced)
        overlap, apart = hides(opaque, index)
        assert traced[-1] or not overlap
        assert not (traced[-1] and apart)
    assert set(traced) == {(), ("occlusion",)}


@pytest.mark.slow
def test_effects_are_decided_for_each_sample_of_opaque_shapes(opaque, tmp_path):
    for workers in (1, 2):
        make_dataset(opaque, 8, tmp_path / f"{workers}.zarr", workers)
    dataset = Dataset(tmp_path / "1.zarr")
    assert chunk_bytes(tmp_path / "1.zarr") == chunk_bytes(tmp_path / "2.zarr")
    assert dataset.attrs["simulated"] == Dataset(tmp_path / "2.zarr").attrs["simulated"]
    occluded = []
    for index in range(8):
        scene, _ = opaque.draw(np.random.default_rng([opaque.seed, index]))
        plan = plan_effects(scene, opaque.camera)
        occluded.append("occlusion" in plan.kept)
        assert plan.integrator == "exact"  # polygons, where one hides another
        overlap, apart = hides(opaque, index)
        assert occluded[-1] >= overlap
        assert not (occluded[-1] and apart)
    for index in (occluded.index(False), occluded.index(True)):
        scene, _ = opaque.draw(np.random.default_rng([opaque.seed, index]))
        shown = opaque.encode(render(scene, opaque.camera))
        np.testing.assert_allclose(shown, dataset.inputs[index], atol=1e-6)
    assert 0 < sum(occluded) < 8
    record = dataset.attrs["simulated"]
    assert record["samples"] == 8
    assert record["with"]["occlusion"] == sum(occluded)
    assert record["by_rays"] == 0
    assert record["with"]["defocus"] == 8


def test_glowing_shapes_are_simulated_alike_and_stored_as_before(tiny, tmp_path):
    assert not tiny.planned_by_sample
    make_dataset(tiny, 2, tmp_path / "a.zarr")
    attrs = Dataset(tmp_path / "a.zarr").attrs
    assert "simulated" not in attrs
    assert "opaque" not in attrs["config"]["template"]
    assert tiny.plan_of(tiny.draw(np.random.default_rng(1))[0]) is tiny.plan
