"""What learning refuses, each in one sentence."""

import json
import os
import zipfile
from functools import partial
from pathlib import Path

import keras
import pytest
from builders import RUN

from lf_flame import InputError
from lf_flame._common.config import build
from lf_flame._common.input_files import LIMIT
from lf_flame.datasets.encodings import InputEncoding
from lf_flame.datasets.store import split_indices
from lf_flame.learning.decoder import build_refocus_resnet50
from lf_flame.learning.keras_loading import check_keras, load_model
from lf_flame.learning.prediction import read_input
from lf_flame.learning.run_folders import open_run
from lf_flame.learning.training_config import Recipe

MADE = RUN["dataset"]


def record(record):
    """Open a run whose record is this."""
    Path("model.keras").write_bytes(b"PK\5\6" + bytes(18))  # an empty archive
    Path("run.json").write_text(json.dumps(record))
    return open_run(Path())


def without(name):
    return record({key: value for key, value in RUN.items() if key != name})


def loading_a_device():
    run = record(RUN)
    Path("model.keras").unlink()
    Path("model.keras").symlink_to("/dev/zero")
    run.load_network()


def another_output():
    run = record(RUN)
    Path("model.keras").write_bytes(Path("network.keras").read_bytes())
    run.load_network()


def recipe(**values):
    return partial(build, Recipe, {"epochs": 1} | values, "here")


def decoder(**options):
    return partial(build_refocus_resnet50, (40, 64), **{"backbone_depth": "none"} | options)


def limited_loading():
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(LIMIT, str(0.5 * Path("network.keras").stat().st_size / 1e9))
        load_model("network.keras")


def loading_a_pipe():
    os.mkfifo("a.keras")
    load_model("a.keras")


def loading_changed(change):
    """Load a network whose bytes were changed."""
    Path("other.keras").write_bytes(change(Path("network.keras").read_bytes()))
    load_model("other.keras")


def flip_in_the_middle(content):
    half = len(content) // 2
    return content[:half] + bytes([content[half] ^ 1]) + content[half + 1 :]


def loading(**members):
    """Load a network with other members in its archive."""

    def load():
        left = dict(members)
        with zipfile.ZipFile("network.keras") as old, zipfile.ZipFile("other.keras", "w") as new:
            for name in old.namelist():
                content = left.pop(name.partition(".")[0], old.read(name))
                if content is not None:
                    new.writestr(name, content)
            for name, content in left.items():
                new.writestr(name, content)
        load_model("other.keras")

    return load


def loading_layer(**values):
    """Load a network whose layer is said to be another; Keras may not read it."""

    def load():
        with zipfile.ZipFile("network.keras") as archive:
            config = json.loads(archive.read("config.json"))
        layer = config["config"]["layers"][1]
        layer["config"] |= values.pop("config", {})
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(keras.saving, "load_model", lambda *args, **kw: pytest.fail("read"))
            layer |= values
            loading(config=json.dumps(config))()

    return load


def configured(name, value):
    """Check Keras with another configuration."""

    def check():
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(keras.config, name, lambda: value)
            check_keras()

    return check


FUNCTION = {"class_name": "function", "config": "exec", "module": "builtins"}
LAMBDA = {"class_name": "Lambda", "module": "keras.layers"}
DAMAGED = r"other\.keras cannot be read: it is damaged"
REFUSED = [
    (decoder(backbone_depth="conv6"), "one of conv3, conv4, conv5, none, got 'conv6'"),
    (decoder(dropout=1.0), r"dropout must be in \[0, 1\)"),
    (decoder(dropout_place="attic"), "one of image, vector, none"),
    (recipe(epochs=0), "epochs must be from 1 to 999999, got 0"),
    (recipe(learning_rate=-1.0), "learning_rate must be above 0"),
    (recipe(batch_size=0), "batch_size must be from 1 to 999999, got 0"),
    (recipe(speed=2), "speed is not a known key"),
    (partial(split_indices, 3, (0.8, 0.1, 0.1), 1), "3 samples are too few"),
    *(
        (partial(without, name), rf"run\.json: {name} is missing")
        for name in sorted(set(RUN) - {"dataset", "data"})
    ),
    *(
        (partial(record, RUN | {name: odd}), rf"run\.json: {name}\b")
        for name in sorted(set(RUN) - {"dataset", "data"})
        for odd in ([{"a": {}}], None)
    ),
    *(
        (partial(record, RUN | change), said)
        for change, said in (
            ({"test_indices": []}, "test_indices must be samples"),
            ({"test_indices": [-1]}, "test_indices must be samples"),
            ({"recipe": {"epochs": 2}}, "recipe.batch_size is missing"),
            ({"parts": {}}, "parts contain train and test"),
            ({"split": [0.5, 1e308, 0.1]}, "split must be three fractions"),
            ({"dataset": MADE | {"slopes": [1.0]}}, "as many as the depths"),
            ({"dataset": MADE | {"config": {}}}, "run.json: dataset: "),
            ({"dataset": MADE | {"config": 3}}, "dataset.config: "),
            ({"dataset": 3}, "run.json: dataset: "),
            ({"train_s": "3.5"}, "train_s: input should be a valid number, got '3.5'"),
            ({"system": 3}, "system: input should be a valid string"),
        )
    ),
    (
        partial(record, {"system": "refocusnet", "title": "R", "epochs": 2, "train_s": 1.0}),
        "a run of the system refocusnet; it must be of the paper's network, by `lf",
    ),
    (
        partial(read_input, "picture.png", (40, 64), InputEncoding("views")),
        r"This network takes several views \('views'\)",
    ),
    (another_output, r"into \(8, 8, 2\), but it should turn .* into \(2, 40, 64, 1\)"),
    (loading_a_device, "must be a regular file, but is a device"),
    *(
        (loading_layer(**values), rf"other\.keras is not loaded: .*contain no {said}")
        for values, said in (
            (LAMBDA, "keras.layers.Lambda, and code that comes with a file is not run"),
            ({"config": {"activation": FUNCTION}}, "builtins.function"),
            ({"module": "os"}, "os.Conv2D"),
            ({"registered_name": "mine>Conv2D"}, "keras.layers.Conv2D"),
            ({"build_config": {"x": [{"class_name": "__lambda__"}]}}, "None.__lambda__"),
            ({"class_name": ["Conv2D"]}, r"keras.layers.\['Conv2D'\]"),
        )
    ),
    (loading(config=b"{"), r"config\.json is not a JSON file"),
    (loading(config=b"[" * 10_000), r"config\.json is not a JSON file: recursion limit"),
    (loading(config=b"\xff"), r"config\.json is not a JSON file"),
    (loading(config=b"[]"), DAMAGED),
    (loading(config=b"{}"), DAMAGED),
    (loading(config=b" " * (17 << 20)), r"config\.json is larger than 16 MB"),
    (loading(config=None), r"must contain config\.json, metadata\.json, model\.weights\.h5"),
    (loading(model=b"no weights"), DAMAGED),
    (loading(**{"../../x": b""}), "and nothing else"),
    (
        partial(loading_changed, flip_in_the_middle),
        r"it is damaged, as model\.weights\.h5 in it does not fit",
    ),
    (
        partial(loading_changed, lambda content: content[: len(content) // 2]),
        "is not a Keras file, or is truncated",
    ),
    (limited_loading, r"network\.keras would need .* GB"),
    (loading_a_pipe, "a pipe or a socket"),
    (configured("backend", "torch"), "configured with backend torch, but .* tensorflow or jax"),
    (configured("floatx", "float16"), "configured with floatx float16"),
    (configured("image_data_format", "channels_first"), "image_data_format channels_first"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("call", "said"), REFUSED, ids=[f"{k}-{said[:30]}" for k, (_, said) in enumerate(REFUSED)]
)
def test_it_is_refused_in_a_sentence(network, tmp_path, monkeypatch, call, said):
    monkeypatch.chdir(tmp_path)
    Path("network.keras").symlink_to(network)
    with pytest.raises(InputError, match=said) as caught:
        call()
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 1000
