"""`lf-flame verify`: what changed since it was written is found and named."""

import shutil

import pytest
from click.testing import CliRunner
from tiny_data import DATA

from lf_flame import InputError
from lf_flame._common.atomic_files import write_text
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
    assert str(result.exception) == "1 of the results is damaged."


def test_results_of_several_commands_in_one_folder_are_all_looked_at(results):
    with output_folder(results / "refocus", "simulation.json") as out:
        write_text(out.path("b.txt"), "simulated")
    shutil.copytree(results / "prediction", results / "refocus" / "picture")
    assert run(results / "refocus")[1] == ["whole"] * 3
    (results / "refocus" / "b.txt").write_text("other")
    (results / "refocus" / "picture" / "a.txt").write_text("other")
    assert run(results / "refocus")[1] == ["whole", "DAMAGED", "DAMAGED"]


def test_a_sample_that_changed_is_noticed(results):
    chunk = next((results / "data" / "shapes.zarr" / "input").rglob("c/0/*/*/*"))
    chunk.write_bytes(chunk.read_bytes()[::-1])
    result, marks = run(results / "data" / "shapes.zarr", results / "refocus")
    assert marks == ["DAMAGED", "whole"]
    assert isinstance(result.exception, InputError)


def test_what_holds_no_result_is_one_sentence(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    (tmp_path / "config.json").write_text("{}")  # of some other program
    for path in (tmp_path, tmp_path / "notes.txt"):
        assert "holds nothing whose hash is known" in str(run(path)[0].exception)
