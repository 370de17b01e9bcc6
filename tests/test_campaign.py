"""The campaign against the commands: its table is complete, and its judgement is right."""

import json
import random
import signal
import time

import pytest
from campaigning import processes
from campaigning.contents import contents, differences, is_recorded
from campaigning.inputs import DAMAGES, damage, with_value
from campaigning.processes import Outcome, Process, fault
from campaigning.table import CALLS, UNTRIED, WRITING, registered

SENTENCE = "lf-flame: none.png cannot be read: there is no such file.\n"


def test_every_registered_command_is_in_the_table():
    tried = {call.command for call in CALLS}
    assert tried <= registered().keys()
    assert registered().keys() - tried <= UNTRIED.keys()


def test_every_parameter_that_names_an_output_does_so_in_some_call():
    for name in {call.command for call in CALLS}:
        lines = [" ".join(call.words) for call in CALLS if call.command == name]
        for parameter in registered()[name].params:
            if parameter.name in WRITING and parameter.type.name != "name":
                option = parameter.opts[-1] if parameter.param_type_name == "option" else ""
                assert any(f"{option} out" in line for line in lines), (name, option)


@pytest.mark.parametrize(
    ("status", "err", "expected"),
    [
        (0, "", ""),
        (2, SENTENCE, ""),
        (2, "reading: 10%|## | 1/9\rreading: 100%|###| 9/9\n" + SENTENCE, ""),
        (2, "Usage: lf-flame [OPTIONS]\n\nError: No such option: --x\n", ""),
        (2, "", "not one sentence"),
        (2, SENTENCE * 2, "not one sentence"),
        (2, "lf-flame: " + "x" * 1001 + "\n", "not one sentence"),
        (1, "Traceback (most recent call last):\nKeyError: 'a'\n", "KeyError: 'a'"),
        (0, "Traceback (most recent call last):\nKeyError: 'a'\n", "traceback"),
        (1, "odd", "status 1: odd"),
        (130, SENTENCE, "status 130"),
        (-11, "", "status -11"),
        (None, "", "did not end in time"),
    ],
)
def test_ends_that_are_wrong_are_told_from_those_that_are_not(status, err, expected):
    found = fault(Outcome(status, "", err))
    assert expected in found
    assert bool(found) == bool(expected)


def test_contents_are_compared_without_dates(tmp_path):
    for name, date, slope in (("a", 1, 2.0), ("b", 2, 2.0), ("c", 1, 3.0)):
        (tmp_path / name).mkdir()
        record = {"date": date, "slope": slope, "files": {"table.csv": "0"}}
        (tmp_path / name / "record.json").write_text(json.dumps(record))
        (tmp_path / name / "table.csv").write_text(f"slope,seconds\n{slope},{date}\n")
    a, b, c = (contents(tmp_path / name) for name in "abc")
    assert differences(a, b) == ""
    assert differences(a, c) == "another content: record.json, table.csv"
    assert is_recorded(tmp_path / "a" / "table.csv")
    (tmp_path / "a" / "table.csv").rename(tmp_path / "a" / ".table.part")
    assert differences(contents(tmp_path / "a"), b) == "left over: .table.part; missing: table.csv"
    assert not is_recorded(tmp_path / "a" / ".table.part")


def test_helpers_that_outlive_their_program_are_found(tmp_path, monkeypatch):
    monkeypatch.setattr(processes, "LOADED", [])
    (tmp_path / "parent.py").write_text(
        "import subprocess, sys, time\n"
        "subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(60)'])\n"
        "open('started', 'w').close()\ntime.sleep(60)\n"
    )
    with Process(["parent"], tmp_path) as process:
        while not (tmp_path / "started").exists():
            time.sleep(0.01)
        process.send(signal.SIGKILL)
        process.wait()
        assert process.leaves_helpers(0.2)
    assert not process.leaves_helpers()


def test_a_disk_is_full_for_a_process(tmp_path, monkeypatch):
    monkeypatch.setattr(processes, "LOADED", [])
    (tmp_path / "writer.py").write_text(
        "with open('out', 'wb') as file:\n    file.write(bytes(5000))\n"
    )
    with Process(["writer"], tmp_path, largest_file=1000) as process:
        assert "File too large" in process.wait().err
    assert (tmp_path / "out").stat().st_size == 1000


@pytest.mark.parametrize("how", DAMAGES)
def test_files_are_damaged_in_every_way(tmp_path, how):
    text, path = b'slope = 2.5\nname = "a"\n', tmp_path / "record.toml"
    path.write_bytes(text)
    damage(path, how, random.Random(1))
    assert not path.is_file() or path.is_symlink() or path.read_bytes() != text


def test_every_parameter_is_given_another_value():
    asked = next(call for call in CALLS if call.command == "simulate")
    for parameter in registered()["simulate"].params:
        words = with_value(asked, parameter, random.Random(1))
        assert words != asked.words, parameter.name
        assert words[:2] == asked.words[:2]
