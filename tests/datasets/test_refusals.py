"""What data sets refuse, each in one sentence that names the file."""

import json
import os
import re
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import zarr
from builders import DATA, shapes, toml
from sentences import refusals, sentence_of

from lf_flame import InputError
from lf_flame._common.config import build
from lf_flame._common.memory import LIMIT
from lf_flame.datasets import split_indices
from lf_flame.datasets.config import DatasetConfig, read_config
from lf_flame.datasets.encodings import InputEncoding
from lf_flame.datasets.making import make_dataset
from lf_flame.datasets.store import Dataset

TEXT = toml(DATA)
OBJECTS = shapes(2)["template"]["objects"]


def configured(text):
    """Call that reads a configuration."""

    def call():
        Path("config.toml").write_text(text)
        return read_config(Path("config.toml"))

    return call


def altered(old, new):
    assert old in TEXT, old
    return configured(TEXT.replace(old, new))


def level_opaque():
    """Opaque shapes that all stand at one depth."""
    objects = [{**one, "depth_mm": 10.0} for one in OBJECTS]
    template = {**DATA["template"], "opaque": True, "objects": objects}
    return configured(toml({**DATA, "template": template}))


CAMERA = {**DATA["camera"], "views": 0}
CONFIGURATIONS = [
    (altered("seed = 5", "sed = 5"), "config.toml: sed is not a known key"),
    (altered("seed = 5", ""), "seed is missing"),
    (altered("seed = 5", "seed = -1"), "seed must be 0 or above"),
    (altered('kind = "shapes"', 'kind = "cats"'), "kind: input should be 'shapes' or 'flames'"),
    (altered('kind = "shapes"', 'kind = ["shapes"]'), "kind: input should be 'shapes' or 'flames'"),
    (altered("= 150.0", "= -150.0"), "camera: main_lens_focal_mm must be a positive.*-150"),
    (altered("= 326.0", "= 100.0"), "camera: focus_distance_mm must exceed"),
    (altered("image = [10, 16]", "image = [7, 16]"), "image must divide"),
    (altered("smoke = 2", "smoke = 0"), "samples from 1 to 1000000"),
    (altered("size = 0.1", "size = 1.5"), "size must be below 1"),
    (altered('"square"', '"star"'), "template: objects #1.shape: input should be 'rectangle'"),
    (altered("views = 3", "views = 3.5"), "camera.views: input should be a valid integer"),
    (altered("camera = {", "camera = "), "is not a TOML file"),
    (level_opaque(), r"different depths, got \[10.0, 10.0\] mm"),
    (lambda: configured(TEXT)().sample_count("huge"), "one of smoke, got 'huge'"),
    (
        lambda: configured(toml({**DATA, "input": {"image": [7, 16]}}))(),
        r"image must divide .* got \(7, 16\)",
    ),
    (partial(build, DatasetConfig, {**DATA, "camera": CAMERA}, "here"), "here: camera: .*views"),
    (partial(InputEncoding, "grid", grid=0), "grid must be at least 1 view"),
    (partial(split_indices, 2, (0.7, 0.15, 0.15), seed=1), "2 samples are too few to split"),
]


test_a_mistake_is_told_in_a_sentence = refusals(CONFIGURATIONS)


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def changed(name, *keys, value):
    """Change that puts a value into the metadata, under some keys within each other."""

    def change(path):
        file = path / name / "zarr.json"
        found = inner = json.loads(file.read_text())
        for key in keys[:-1]:
            inner = inner[key]
        inner[keys[-1]] = value
        file.write_text(json.dumps(found))

    return change


def both(*changes):
    return lambda path: [change(path) for change in changes]


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
    """Change one bit of the middle sample of three."""
    content[len(content) // 2] ^= 1


def spoil(content):
    content[-3:] = b"xyz"


ATTRIBUTES = partial(changed, "", "attributes")
TARGETS = "target/c/0/*/*/*"
DAMAGES = [
    (ATTRIBUTES("config", value=3), "a.zarr/zarr.json: config: "),
    (ATTRIBUTES("config", "kind", value=["shapes"]), "kind: "),
    (ATTRIBUTES("config", "template", value=[]), "template: "),
    (ATTRIBUTES("slopes", value=["1.0"]), "slopes #1: input should be a valid number"),
    (ATTRIBUTES("slopes", value=[1.0, 2.0]), "one slope and one name for each object"),
    (ATTRIBUTES(value={}), "a.zarr/zarr.json: config, slopes, objects, rays are missing"),
    (
        changed("", "node_type", value="array"),
        "a.zarr/zarr.json is damaged, or not that of a group",
    ),
    (changed("input", "shape", value=[3, 4, 7, 1]), "chunks of whole samples, up to 4096"),
    (changed("target", "data_type", value="object"), "target/zarr.json is damaged"),
    (changed("target", "codecs", value=[{"name": "pickle"}]), "target/zarr.json is damaged"),
    (changed("complete", "shape", value=[10**15]), "same number of samples, at most 1000000, got 3, 1000"),
    (changed("complete", "chunk_grid", value="all"), "complete/zarr.json is damaged"),
    (changed("complete", "fill_value", value=[1]), "complete/zarr.json is damaged"),
    (
        both(
            changed("target", "shape", value=[3, 2, 10, 16]),
            changed("target", "chunk_grid", "configuration", "chunk_shape", value=[16, 2, 10, 16]),
        ),
        r"target is damaged: a sample must have the shape \(1, 10, 16",
    ),
    (
        replaced("complete/c/0", lambda file: file.symlink_to("/dev/zero")),
        "complete/c/0 cannot be read: .* is a device",
    ),
    (
        replaced("parameters/brightness/c/0/0", os.mkfifo),
        "parameters/brightness/c/0/0 cannot be read: .* is a pipe",
    ),
    (changed("parameters/size_mm", "codecs", value=[{"name": "pickle"}]), "size_mm/zarr.json is d"),
    (damaged(TARGETS, flip), "a.zarr/target is damaged .*; remove the data set"),
    (damaged(TARGETS, lambda x: x.pop()), "a.zarr/target is damaged"),  # without its index
    (lambda path: next(path.glob(TARGETS)).unlink(), "1 of its 1 chunk files are missing"),
    (lambda path: (path / "zarr.json").write_text("{"), r"a\.zarr/zarr\.json is not a JSON file"),
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
    (
        {},
        3,
        damaged("complete/c/0", spoil),
        r"b\.zarr\.part/zarr\.json cannot be read: it is damaged",
    ),
    (
        {},
        3,
        both(
            changed("input", "codecs", value=[]),
            lambda part: (part / "complete" / "zarr.json").unlink(),
        ),
        r"complete/zarr\.json cannot be read: there is no such",
    ),
    (
        {},
        3,
        lambda part: (part / "zarr.json").write_text("{"),
        r"b\.zarr\.part/zarr\.json is not a JSON file",
    ),
]


@pytest.mark.parametrize(("options", "samples", "change", "said"), PARTS)
def test_a_part_that_is_another_or_damaged_is_left(path, options, samples, change, said):
    part = path.rename(path.with_name("b.zarr.part"))
    change(part)
    Path(path.with_name("a.toml")).write_text(toml({**DATA, **options}))
    with pytest.raises(InputError, match=said):
        make_dataset(read_config(path.with_name("a.toml")), samples, path.with_name("b.zarr"))
    assert part.exists()


def test_memory_is_checked_before_samples_are_read(path, monkeypatch):
    dataset = Dataset(path)
    assert dataset.targets.shape == (3, 1, 10, 16)
    monkeypatch.setenv(LIMIT, "1e-7")
    with pytest.raises(InputError, match="a.zarr/input would need"):
        _ = dataset.inputs


def test_a_sample_that_is_not_finite_is_named(path):
    group = zarr.open_group(path, mode="r+")
    group["target"][1, 0, 2, 3] = np.nan
    with pytest.raises(InputError, match="Sample 1 of .*a.zarr/target is missing or not finite"):
        _ = Dataset(path).targets


def read_all(path):
    dataset = Dataset(path)
    assert np.isfinite(dataset.inputs).all() and np.isfinite(dataset.targets).all()  # noqa: PT018
    dataset.parameters("brightness")


ODD = [None, True, 0, -1, 1e300, 2**62, "", "x", "a" * 5000, [], {}, [[]], {"a": 1}, [1, 2], ["a"]]


def put_odd_value(content, rng):
    """Replace some value of metadata."""
    found = inner = json.loads(content)
    while True:
        key = rng.choice(list(inner)) if isinstance(inner, dict) else rng.integers(len(inner))
        if not (isinstance(inner[key], dict | list) and inner[key]) or rng.random() < 0.3:
            break
        inner = inner[key]
    inner[key] = ODD[rng.integers(len(ODD))]
    return json.dumps(found).encode()


def cut(content, rng):
    return content[: rng.integers(len(content))]


def flip_bit(content, rng):
    at = rng.integers(len(content))
    return content[:at] + bytes([content[at] ^ 1 << rng.integers(8)]) + content[at + 1 :]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("files", "damage"), [("zarr.json", put_odd_value), ("*", cut), ("*", flip_bit)]
)
def test_no_damage_makes_a_traceback(path, rng, files, damage):
    found, refused = sorted(file for file in path.rglob(files) if file.is_file()), 0
    for _ in range(60):
        file = found[rng.integers(len(found))]
        before = file.read_bytes()
        file.write_bytes(damage(before, rng))
        told = sentence_of(read_all, path)
        assert not told or re.search("a.zarr", told)
        assert "\n" not in told
        refused += bool(told)
        file.write_bytes(before)
    assert refused > 15
