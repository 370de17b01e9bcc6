"""What data sets refuse, each in one sentence that names the file."""

import json
import os
from functools import partial

import numcodecs
import numpy as np
import pytest
import zarr
from builders import DATA, shapes
from sentences import refusals

from lf_flame import InputError
from lf_flame._common.input_files import LIMIT
from lf_flame.datasets import split_indices
from lf_flame.datasets.config import config_from_json
from lf_flame.datasets.encodings import InputEncoding
from lf_flame.datasets.making import make_dataset
from lf_flame.datasets.store import Dataset
from lf_flame.formats.array_files import ZarrFile


def changed(*keys, value):
    """Call that builds a configuration with another value under some keys within each other."""
    values = inner = json.loads(json.dumps(shapes(2, (10, 16), 3, off_axis_mm=0)))
    for key in keys[:-1]:
        inner = inner[key]
    inner[keys[-1]] = value
    return partial(config_from_json, values, "here")


def level_opaque():
    template = changed("template", "opaque", value=True).args[0]["template"]
    objects = [{**one, "depth_mm": 10.0} for one in template["objects"]]
    return changed("template", value={**template, "objects": objects})()


test_a_mistake_is_one_sentence = refusals([
    (changed("sed", value=5), r"here: sed is not a known key \(perhaps seed"),
    (changed("seed", value=-1), "seed must be 0 or above"),
    (changed("kind", value="cats"), "kind: input should be 'shapes' or 'flames'"),
    (changed("kind", value=["shapes"]), "kind: input should be 'shapes' or 'flames'"),
    (changed("route", value="straight"), "route: input should be 'rays', 'exact' or 'direct'"),
    (changed("camera", "main_lens_focal_mm", value=-150), "here: camera: main_lens.*-150"),
    (changed("image", value=[7, 16]), r"image must divide .* got \(7, 16\)"),
    (changed("input", value={"kind": "grid", "grid": 4}), "4 views along each axis, .* has 3"),
    (changed("samples", "smoke", value=0), "samples from 1 to 1000000"),
    (changed("template", "size", value=1.5), "template: size must be below 1"),
    (changed("template", "brightness", value=[0.9, 0.8]), "two increasing numbers"),
    (changed("template", "objects", 0, "shape", value="star"), "objects #1.shape: input should be"),
    (level_opaque, r"different depths, got \[10.0, 10.0\] mm"),
    (lambda: changed("seed", value=1)().sample_count("huge"), "one of smoke, got 'huge'"),
    (partial(InputEncoding, "grid", grid=0), "grid must be at least 1 view"),
    (partial(split_indices, 2, (0.7, 0.15, 0.15), seed=1), "2 samples are too few to split"),
])  # fmt: skip


def metadata(name, *keys, value):
    """Change that puts a value into the metadata, under some keys within each other."""

    def change(path):
        file = path / name / "zarr.json"
        found = inner = json.loads(file.read_text())
        for key in keys[:-1]:
            inner = inner[key]
        inner[keys[-1]] = value
        file.write_text(json.dumps(found))

    return change


def replaced(name, put):
    """Change that puts something in the place of a file."""

    def change(path):
        (path / name).unlink()
        put(path / name)

    return change


def damaged(name, edit):
    """Change of the bytes of the first file of a name."""

    def change(path):
        file = next(path.glob(name))
        content = bytearray(file.read_bytes())
        edit(content)
        file.write_bytes(content)

    return change


def flip(content):
    content[len(content) // 2] ^= 1


def spoil(content):
    content[-3:] = b"xyz"


TARGETS = "target/c/0/*/*/*"
DAMAGES = [
    (metadata("", "attributes", "config", value=3), "a.zarr/zarr.json: config: "),
    (metadata("", "attributes", "slopes", value=["1.0"]), "slopes #1: input should be a valid num"),
    (metadata("", "attributes", "slopes", value=[1.0, 2.0]), "one slope and one name for each"),
    (metadata("", "attributes", value={}), "a.zarr/zarr.json: config is missing; slopes is"),
    (metadata("", "node_type", value="array"), "a.zarr/zarr.json cannot be read: it is damaged"),
    (
        metadata("input", "shape", value=[3, 4, 7, 1]),
        "array input must have the shape .10, 16, 1., got .4, 7",
    ),
    (metadata("parameters/size_mm", "codecs", value=[{"name": "pickle"}]), "codec: 'pickle'"),
    (metadata("complete", "shape", value=[10**15]), "at most 1000000, got 3, 1000000"),
    (metadata("complete", "shape", value=[4]), "same number of samples, .* got 3, 4"),
    (metadata("", "attributes", "config", "image", value=[5, 8]), "must have the shape .5, 8, 1"),
    (replaced("complete/c/0", lambda file: file.symlink_to("/dev/zero")), "complete/c/0 .* device"),
    (replaced("parameters/brightness/c/0/0", os.mkfifo), "brightness/c/0/0 cannot .* a pipe"),
    (damaged("complete/c/0", spoil), "a.zarr/zarr.json cannot be read: it is damaged"),
    (damaged(TARGETS, flip), "a.zarr/zarr.json cannot .* or its array target is"),
    (damaged(TARGETS, lambda x: x.pop()), "or its array target is"),  # without its index
    (lambda path: next(path.glob(TARGETS)).unlink(), "1 of its 1 chunk files are missing"),
    (lambda path: next(path.glob("input/c/0/*/*/*")).unlink(), "input cannot be read: 1 of its 1"),
    (lambda path: path.rename(path.with_name("b.zarr")), "There is no data set at"),
]


@pytest.mark.parametrize(("change", "said"), DAMAGES, ids=[said for _, said in DAMAGES])
def test_what_is_no_whole_data_set_is_refused(path, change, said):
    change(path)
    with pytest.raises(InputError, match=said):
        _ = Dataset(path).targets


PARTS = [
    ({"route": "exact"}, 3, lambda part: None, "b.zarr.part was begun with another configuration"),
    ({}, 4, lambda part: None, "another configuration or number of samples"),
    ({}, 3, damaged("complete/c/0", spoil), r"b\.zarr\.part/zarr\.json cannot be read"),
    (
        {},
        3,
        replaced("complete/zarr.json", lambda file: None),
        "its array complete must .* got None",
    ),
]


@pytest.mark.parametrize(("options", "samples", "change", "said"), PARTS)
def test_a_part_that_is_another_or_damaged_is_left(path, options, samples, change, said):
    part = path.rename(path.with_name("b.zarr.part"))
    change(part)
    with pytest.raises(InputError, match=said):
        make_dataset(config_from_json({**DATA, **options}, "x"), samples, path.with_name("b.zarr"))
    assert part.exists()


@pytest.mark.parametrize(
    ("read", "said"),
    [(Dataset, "There is no data set"), (ZarrFile, r"not a Zarr folder .* 3: .* no zarr\.json")],
)
def test_a_codec_that_could_run_code_is_refused(tmp_path, read, said):
    codec, kept = numcodecs.Pickle(), {"fill_value": 0, "order": "C", "filters": None}
    facts = {"zarr_format": 2, "shape": [2, 3], "chunks": [2, 3], "dtype": "<f4"}
    facts |= {**kept, "compressor": codec.get_config()}
    (tmp_path / ".zarray").write_text(json.dumps(facts))
    (tmp_path / "0.0").write_bytes(codec.encode(np.ones((2, 3), np.float32)))
    with pytest.raises(InputError, match=said):
        read(tmp_path)


def test_memory_is_checked_before_samples_are_read(path, monkeypatch):
    dataset = Dataset(path)
    assert dataset.targets.shape == (3, 1, 10, 16)
    monkeypatch.setenv(LIMIT, "1e-7")
    with pytest.raises(InputError, match="a.zarr would need"):
        _ = dataset.inputs


def test_a_sample_that_is_not_finite_is_named(path):
    group = zarr.open_group(path, mode="r+")
    group["target"][1, 0, 2, 3] = np.nan
    with pytest.raises(InputError, match="Sample 1 of .*a.zarr/target is missing or not finite"):
        _ = Dataset(path).targets
