"""A saved network is looked into before Keras sees it."""

import json
import os
import shutil
import subprocess
import sys
import zipfile

import keras
import pytest
from keras import layers
from sentences import sentence_of

from lf_flame import InputError
from lf_flame._common.memory import LIMIT
from lf_flame.learning.keras_loading import CLASSES, load_model
from lf_flame.systems.training import NETWORKS

START = "from lf_flame.commands import program; import click\n@click.command()\ndef x():\n"


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    path = tmp_path_factory.mktemp("network") / "network.keras"
    seen = keras.Input((8, 8, 1))
    keras.Model(seen, layers.Conv2D(2, 3, padding="same")(seen)).save(path)
    return path


@pytest.fixture
def rewrite(saved, tmp_path):
    """Write the network once more, with other members in its archive."""

    def write(**members):
        path = tmp_path / "other.keras"
        with zipfile.ZipFile(saved) as old, zipfile.ZipFile(path, "w") as new:
            for name in old.namelist():
                content = members.pop(name.partition(".")[0], old.read(name))
                if content is not None:
                    new.writestr(name, content)
            for name, content in members.items():
                new.writestr(name, content)
        return path

    return write


def configured(saved, change):
    with zipfile.ZipFile(saved) as archive:
        config = json.loads(archive.read("config.json"))
    change(config)
    return json.dumps(config)


@pytest.mark.slow
@pytest.mark.parametrize("name", NETWORKS)
def test_networks_of_this_package_are_made_of_known_classes(name, tmp_path):
    model = NETWORKS[name].model(3)
    model.save(tmp_path / "model.keras")
    assert load_model(tmp_path / "model.keras").count_params() == model.count_params()


def test_no_known_class_brings_code_along():
    assert not {x for x in CLASSES if "lambda" in x.lower() or "function" in x} - {"Functional"}
    assert not CLASSES & {"TorchModuleWrapper", "TFSMLayer", "JaxLayer", "StringLookup",
                          "TextVectorization", "Hashing", "__typespec__"}  # fmt: skip


def put_lambda(config):
    config["config"]["layers"][1] |= {"class_name": "Lambda", "module": "keras.layers"}


def put_function(config):
    inner = config["config"]["layers"][1]["config"]
    inner["activation"] = {"class_name": "function", "config": "exec", "module": "builtins"}


def put_module(config):
    config["config"]["layers"][1]["module"] = "os"


def put_registered(config):
    config["config"]["layers"][1]["registered_name"] = "mine>Conv2D"


def put_deep(config):
    config["config"]["layers"][1]["build_config"] = {"x": [{"class_name": "__lambda__"}]}


def put_typed(config):
    config["config"]["layers"][1]["class_name"] = ["Conv2D"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (put_lambda, "hold no keras.layers.Lambda, and code that comes with a file is not run"),
        (put_function, "hold no builtins.function"),
        (put_module, "hold no os.Conv2D"),
        (put_registered, "hold no keras.layers.Conv2D"),
        (put_deep, "hold no None.__lambda__"),
        (put_typed, r"hold no keras.layers.\['Conv2D'\]"),
    ],
)
def test_other_classes_are_refused_before_keras_reads_on(
    saved, rewrite, monkeypatch, change, words
):
    path = rewrite(config=configured(saved, change))
    monkeypatch.setattr(keras.saving, "load_model", lambda *args, **kwargs: pytest.fail("read"))
    with pytest.raises(InputError, match=rf"other\.keras is not loaded: .*{words}"):
        load_model(path)


@pytest.mark.parametrize(
    ("members", "words"),
    [
        ({"config": b"{"}, r"config\.json is not a JSON file"),
        ({"config": b"[" * 10_000}, r"config\.json cannot be read: .* deeper than 64"),
        ({"config": b"\xff"}, r"config\.json is not a JSON file"),
        ({"config": b"[]"}, r"other\.keras cannot be read: it is damaged"),
        ({"config": b"{}"}, r"other\.keras cannot be read: it is damaged"),
        ({"config": b" " * (17 << 20)}, r"config\.json is larger than 16 MB"),
        ({"config": None}, r"must hold config\.json, metadata\.json, model\.weights\.h5"),
        ({"model": b"no weights"}, r"other\.keras cannot be read: it is damaged"),
        ({"../../x": b""}, "and nothing else"),
    ],
)
def test_other_archives_are_one_sentence(rewrite, members, words):
    with pytest.raises(InputError, match=words) as caught:
        load_model(rewrite(**members))
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 1000


def test_what_the_archive_would_need_is_known_before(saved, monkeypatch):
    monkeypatch.setenv(LIMIT, str(0.5 * saved.stat().st_size / 1e9))
    with pytest.raises(InputError, match=r"network\.keras would need .* GB"):
        load_model(saved)


def test_a_damaged_network_is_one_sentence(saved, tmp_path, rng):
    whole = saved.read_bytes()
    path, refused = tmp_path / "network.keras", 0
    for trial in range(60):
        content = bytearray(whole)
        for place in rng.integers(len(content), size=1 + trial % 5):
            content[place] ^= 1 << rng.integers(8)
        path.write_bytes(content[: rng.integers(len(content))] if trial % 3 == 0 else content)
        told = sentence_of(load_model, path)
        refused += bool(told)
        assert not told or (str(path) in told and "\n" not in told)
    assert refused > 40  # bits that say when a file was written, and the like, may be any


@pytest.mark.slow
@pytest.mark.parametrize("backend", ["bogus", "none,"])
def test_a_backend_that_there_is_none_of_is_one_sentence(backend):
    code = START + (
        "    from lf_flame.learning.keras_loading import load_keras\n    load_keras()\n"
        "program.run(x, 'x')"
    )
    known = os.environ | {"KERAS_BACKEND": backend}
    ended = subprocess.run([sys.executable, "-c", code], env=known, capture_output=True, text=True)
    assert ended.returncode == 2
    assert ended.stderr.startswith(f"x: Keras does not start, by the backend {backend}: ")
    assert len(ended.stderr.splitlines()) == 1


def test_a_pipe_is_not_waited_for(tmp_path, saved):
    os.mkfifo(tmp_path / "a.keras")
    with pytest.raises(InputError, match="is a pipe"):
        load_model(tmp_path / "a.keras")
    shutil.copy(saved, tmp_path / "b.keras")
    load_model(tmp_path / "b.keras")
