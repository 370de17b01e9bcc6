"""A saved network is looked into before Keras sees it."""

import os
import subprocess
import sys

import pytest

from lf_flame.learning.keras_loading import CLASSES, load_model
from lf_flame.systems.training import NETWORKS

START = "from lf_flame.commands import program; import click\n@click.command()\ndef x():\n"


@pytest.mark.slow
@pytest.mark.parametrize("name", NETWORKS)
def test_networks_of_this_package_are_made_of_known_classes(name, tmp_path):
    model = NETWORKS[name].build(3)
    model.save(tmp_path / "model.keras")
    assert load_model(tmp_path / "model.keras").count_params() == model.count_params()


def test_no_known_class_brings_code_along():
    assert not {x for x in CLASSES if "lambda" in x.lower() or "function" in x} - {"Functional"}
    assert not CLASSES & {"TorchModuleWrapper", "TFSMLayer", "JaxLayer", "StringLookup",
                          "TextVectorization", "Hashing", "__typespec__"}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("KERAS_BACKEND", "bogus", "does not start with the backend bogus: "),
        ("KERAS_MAX_EPOCHS", "1", "is configured with max_epochs 1, but networks of this"),
    ],
)
def test_a_keras_that_would_not_do_is_one_sentence(name, value, said):
    code = START + (
        "    from lf_flame.learning.keras_loading import load_keras\n    load_keras()\n"
        "program.run(x, 'x')"
    )
    known = os.environ | {name: value}
    ended = subprocess.run([sys.executable, "-c", code], env=known, capture_output=True, text=True)
    assert ended.returncode == 2
    first, last = ended.stderr.splitlines()
    assert first == "Starting Keras ..."
    assert last.startswith(f"x: Keras {said}")
