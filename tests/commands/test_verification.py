"""`lf-flame verify`: what changed since it was written is found and named."""

import json
import os
import shutil
from pathlib import Path

import pytest
from builders import DATA
from click.testing import CliRunner

from lf_flame import InputError
from lf_flame._common.atomic_files import write_json, write_text
from lf_flame._common.checksums import file_sha256, sealed
from lf_flame._common.output_folders import output_folder
from lf_flame.commands import cli
from lf_flame.datasets.config import config_from_json
from lf_flame.datasets.making import make_dataset


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made")
    make_dataset(config_from_json(DATA, "here"), 2, folder / "data" / "shapes.zarr")
    for record in ("refocus.json", "simulation.json", "prediction.json"):
        with output_folder(folder / record.partition(".")[0], record) as out:
            write_text(out.path("a.txt"), record)
    return folder


@pytest.fixture
def results(made, tmp_path):
    return shutil.copytree(made, tmp_path / "results")


def run(*paths):
    result = CliRunner().invoke(cli.commands, ["verify", *map(str, paths)])
    return result, [line.split()[0] for line in result.output.splitlines()]


def test_all_results_below_a_folder_are_found(results):
    result, marks = run(results)
    assert marks == ["whole"] * 4
    assert result.exception is None
    assert "data set of 2 samples: attributes, images, parameters" in result.output


@pytest.mark.parametrize("name", ["refocus", "simulation", "prediction"])
def test_a_file_that_changed_is_named_and_the_rest_looked_at(results, name):
    (results / name / "a.txt").write_text("other")
    result, marks = run(results)
    assert marks.count("DAMAGED") == 1
    assert marks.count("whole") == 3
    assert f"{name}/a.txt is not the file that {name}.json was written for" in result.output
    assert isinstance(result.exception, InputError)
    assert str(result.exception) == "Of 4 results, 1 is damaged."


def test_results_of_several_commands_in_one_folder_are_all_looked_at(results):
    with output_folder(results / "refocus", "simulation.json") as out:
        write_text(out.path("b.txt"), "simulated")
    shutil.copytree(results / "prediction", results / "refocus" / "picture")
    assert run(results / "refocus")[1] == ["whole"] * 3
    (results / "refocus" / "b.txt").write_text("other")
    (results / "refocus" / "picture" / "a.txt").write_text("other")
    assert run(results / "refocus")[1] == ["whole", "DAMAGED", "DAMAGED"]


@pytest.mark.parametrize("damage", ["none", "table1.csv", "table1.json"])
def test_tables_are_compared_with_their_record(tmp_path, damage):
    """A table's record has the hashes of its files; slopes.json, without any, claims nothing."""
    for name in ("table1.csv", "table1.md", "table1.json", "slopes.csv", "slopes.md"):
        write_text(tmp_path / name, name)
    tables = {name: file_sha256(tmp_path / name) for name in ("table1.csv", "table1.md")}
    write_json(tmp_path / "table1.json", {"versions": {}, "sha256": tables})
    write_json(tmp_path / "slopes.json", {"versions": {}})
    if damage != "none":
        path = tmp_path / damage
        write_text(path, path.read_text()[:-2])
    result, marks = run(tmp_path)
    assert marks[0] == ("whole" if damage == "none" else "DAMAGED")
    assert result.output.count(str(tmp_path)) <= 2
    assert ("2 files, as table1.json says" in result.output) == (damage == "none")


def test_a_sample_that_changed_is_noticed(results):
    chunk = next((results / "data" / "shapes.zarr" / "input").rglob("c/0/*/*/*"))
    chunk.write_bytes(chunk.read_bytes()[::-1])
    result, marks = run(results / "data" / "shapes.zarr", results / "refocus")
    assert marks == ["DAMAGED", "whole"]
    assert isinstance(result.exception, InputError)


def test_what_holds_no_result_is_one_sentence_and_the_rest_is_looked_at(results, tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty" / "notes.txt").write_text("mine")
    (tmp_path / "empty" / "config.json").write_text("{}")  # of some other program
    empty, gone = tmp_path / "empty", tmp_path / "data"
    result, marks = run(empty, empty / "notes.txt", gone, results / "refocus")
    assert marks == ["UNCHECKED"] * 3 + ["whole"]
    assert "holds nothing whose hash is known" in result.output
    assert "there is nothing of that name" in result.output
    assert str(result.exception) == "Of 4 results, 3 are unchecked."


@pytest.mark.parametrize("name", ["x" * 5000, "../a.txt", "a/b"])
def test_a_record_that_names_what_no_file_can_be_is_damaged(results, name):
    path = results / "refocus" / "refocus.json"
    record = json.loads(path.read_text())
    del record["record_sha256"]
    path.write_text(json.dumps(record | {"files": {name: "0" * 64}}))
    result, marks = run(results)
    assert sorted(marks) == ["DAMAGED", "whole", "whole", "whole"]
    assert max(map(len, result.output.splitlines())) < 1000


def test_a_file_that_cannot_be_read_leaves_the_rest_to_be_looked_at(results, monkeypatch):
    """Permissions do not bind an administrator, under whom tests may run."""

    def refuse(path):
        if path.name == "a.txt" and path.parent.name == "refocus":
            raise PermissionError(13, "Permission denied", str(path))
        return file_sha256(path)

    with output_folder(results / "refocus", "refocus.json") as out:
        for name in ("a.txt", "b.txt"):
            write_text(out.path(name), "more")
    monkeypatch.setattr("lf_flame._common.output_folders.file_sha256", refuse)
    result, marks = run(results)
    assert sorted(marks) == ["UNCHECKED", "whole", "whole", "whole"]
    assert "Permission denied" in result.output
    (results / "refocus" / "b.txt").write_text("other")
    assert sorted(run(results)[1]) == ["DAMAGED", "whole", "whole", "whole"]


@pytest.mark.slow
def test_folders_may_nest_deeply(results):
    deep, here = results / "deep", os.getcwd()  # noqa: PTH109
    deep.mkdir()
    os.chdir(deep)
    try:
        for _ in range(1050):  # beyond Python's depth of calls, and below the longest path
            Path("d").mkdir()
            os.chdir("d")
        _, marks = run(results)
        assert marks.count("whole") == 4
    finally:  # nor does whoever removes temporary folders go as deep
        while Path.cwd() != deep:
            os.chdir("..")
            Path("d").rmdir()
        os.chdir(here)


def test_a_place_that_cannot_be_listed_is_said(results, monkeypatch):
    def refuse(path):
        if path.name == "simulation":
            raise PermissionError(13, "Permission denied", str(path))
        return before(path)

    before = Path.iterdir
    monkeypatch.setattr(Path, "iterdir", refuse)
    assert sorted(run(results)[1]) == ["UNCHECKED", "whole", "whole", "whole"]


def test_want_of_memory_is_no_damage(results, monkeypatch):
    monkeypatch.setenv("LF_FLAME_MEMORY_GB", "1e-9")
    result, marks = run(results / "data")
    assert marks == ["UNCHECKED"]
    assert "LF_FLAME_MEMORY_GB" in result.output


@pytest.mark.parametrize("record", ["refocus", "simulation"])
def test_a_flip_in_a_record_itself_is_noticed(results, record):
    path = results / record / f"{record}.json"
    text = path.read_text()
    known = json.loads(text)
    for key in ("date", "machine", "command"):
        value = json.dumps(known[key])
        flipped = value[:-2] + chr(ord(value[-2]) ^ 1) + value[-1]
        path.write_text(text.replace(value, flipped))
        assert run(results / record)[1] == ["DAMAGED"], key
    path.write_text(text)
    assert run(results / record)[1] == ["whole"]


def test_names_forge_no_line_and_steer_no_terminal(results):
    for name in ("a\nwhole     b: 1 files", "\x1b[2J", "\u202ecod", "\rwhole"):
        shutil.copytree(results / "refocus", results / name / "x")
    (results / "a\nwhole     b: 1 files" / "x" / "a.txt").write_text("other")
    result, marks = run(results)
    assert (marks.count("whole"), marks.count("DAMAGED"), len(marks)) == (7, 1, 8)
    assert all(letter.isprintable() or letter == "\n" for letter in result.output)


REQUEST = {"title": "t", "seed": 1, "recipe": {"epochs": 2, "schedule": "constant", "batch": 2}}


@pytest.fixture
def training(tmp_path):
    """Make what a finished run leaves, without training."""
    from lf_flame.learning.checkpoints import FILES, MANIFEST

    folder = tmp_path / "run"
    checkpoint = folder / "checkpoint-000002"
    checkpoint.mkdir(parents=True)
    for name in FILES:
        (checkpoint / name).write_text(name)
    hashes = {name: file_sha256(checkpoint / name) for name in FILES}
    belongs = REQUEST | {"recipe": {"schedule": "constant", "batch": 2}}
    write_json(checkpoint / MANIFEST, {"run": belongs, "sha256": hashes})
    write_json(folder / "config.json", REQUEST)
    write_text(folder / "model.keras", "network")
    record = REQUEST | {"model_sha256": file_sha256(folder / "model.keras"), "train_s": 3.5}
    write_json(folder / "run.json", sealed(record))
    return folder


@pytest.mark.parametrize("finished", [True, False])
def test_what_a_run_was_asked_for_is_held_against_its_other_records(training, finished):
    if not finished:
        (training / "model.keras").unlink()
        (training / "run.json").unlink()
        (training / "checkpoint-000002" / "b").touch()
    config = training / "config.json"
    more = {"recipe": REQUEST["recipe"] | {"epochs": 5}}  # asked for, and not yet trained
    for sound in ({}, more):
        write_json(config, REQUEST | sound)
        assert run(training)[1] == ["whole"], run(training)[0].output
    for other in ("{}", "", "[]", json.dumps(REQUEST | {"seed": 2}), "\0"):
        config.write_text(other)
        assert run(training)[1] == ["DAMAGED"], other


def test_a_flip_in_the_record_of_a_run_is_noticed(training):
    record = training / "run.json"
    assert run(training)[1] == ["whole"]
    record.write_text(record.read_text().replace("3.5", "3.7"))
    assert run(training)[1] == ["DAMAGED"]


def test_a_record_that_may_not_be_read_can_be_sound(results, monkeypatch):
    monkeypatch.setattr(os, "access", lambda path, mode: Path(path).name != "refocus.json")
    result, marks = run(results)
    assert sorted(marks) == ["UNCHECKED", "whole", "whole", "whole"]
    assert "Permission denied" in result.output


def test_a_network_that_is_not_there_is_not_damaged(tmp_path):
    assert run(tmp_path / "net.keras")[1] == ["UNCHECKED"]


def test_a_history_that_changed_is_noticed(training):
    """A kill may leave it an epoch behind, and the next call writes it anew."""
    from lf_flame.learning.checkpoints import MANIFEST

    checkpoint, table = training / "checkpoint-000002", training / "history.csv"
    rows = [{"epoch": 1, "loss": 0.5}, {"epoch": 2, "loss": 0.25}]
    write_json(checkpoint / "history.json", {"epochs": rows})
    manifest = json.loads((checkpoint / MANIFEST).read_text())
    manifest["sha256"]["history.json"] = file_sha256(checkpoint / "history.json")
    write_json(checkpoint / MANIFEST, manifest)
    for text, mark in (
        ("epoch,loss\n1,0.5\n2,0.25\n", "whole"),
        ("epoch,loss\n1,0.5\n", "whole"),
        ("epoch,loss\n1,0.4\n2,0.25\n", "DAMAGED"),
        ("epoch,loss\n1,0.5\n2,0.25\n3,0.1\n", "DAMAGED"),
    ):
        write_text(table, text)
        assert run(training)[1] == [mark], text
