"""A saved network is looked into before Keras sees it."""

import os
import subprocess
import sys

import pytest
from sentences import sentence_of

from lf_flame.learning.keras_loading import CLASSES, load_model
from lf_flame.systems.training import NETWORKS

START = "from lf_flame.commands import program; import click\n@click.command()\ndef x():\n"


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


def test_a_damaged_network_is_one_sentence(network, tmp_path, rng):
    whole = network.read_bytes()
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
    first, said = ended.stderr.splitlines()
    assert first == "Starting Keras ..."
    assert said.startswith(f"x: Keras does not start with the backend {backend}: ")
