"""The campaign against the commands: its judgement, and some cases of each part."""

import json
import random
import time

import campaign
import pytest
from campaigning import damages, kills, known, malformed, pairs, places
from campaigning.commands import WRITING
from campaigning.contents import contents, differences
from campaigning.mutation import as_toml, changed
from campaigning.processes import Process
from campaigning.verdicts import Outcome, fault

SENTENCE = "lf-flame: none.png cannot be read: there is no such file.\n"


@pytest.mark.parametrize(
    ("status", "err", "expected"),
    [
        (0, "", ""),
        (2, SENTENCE, ""),
        (2, "reading: 10%|## | 1/9\rreading: 100%|###| 9/9\n" + SENTENCE, ""),
        (2, "Usage: lf-flame [OPTIONS]\n\nError: No such option: --x\n", ""),
        (2, "", "0 sentences"),
        (2, SENTENCE * 2, "2 sentences"),
        (2, "lf-flame: " + "x" * 1001 + "\n", "a sentence of 1011 bytes"),
        (2, "WARNING\n" * 1000 + SENTENCE, "bytes beside the sentence"),
        (1, "Traceback (most recent call last):\nKeyError: 'a'\n", "traceback: KeyError: 'a'"),
        (0, "Traceback (most recent call last):\nKeyError: 'a'\n", "traceback"),
        (1, "odd", "status 1: odd"),
        (130, SENTENCE, "status 130"),
        (-11, "", "ended by SIGSEGV"),
        (None, "", "did not end within 7 s"),
    ],
)
def test_ends_that_are_wrong_are_told_from_those_that_are_not(status, err, expected):
    found = fault(Outcome(status, "", err, 7.0))
    assert expected in found
    assert bool(found) == bool(expected)


def test_contents_are_compared_without_dates(tmp_path):
    for name, date, slope in (("a", 1, 2.0), ("b", 2, 2.0), ("c", 1, 3.0)):
        folder = tmp_path / name
        folder.mkdir()
        (folder / "record.json").write_text(json.dumps({"date": date, "slope": slope}))
        (folder / "table.csv").write_text(f"slope,seconds\n{slope},{date}\n")
        (folder / "picture.png").write_bytes(b"\x89PNG")
    a, b, c = (contents(tmp_path / name) for name in "abc")
    assert differences(a, b) == ""
    assert differences(a, c) == "another content: record.json, table.csv"
    (tmp_path / "a" / "cut.keras").write_bytes(b"PK")
    assert differences(contents(tmp_path / "a"), b) == "left over: cut.keras"
    (tmp_path / "a" / "cut.keras").unlink()
    (tmp_path / "b" / ".picture.part").touch()
    (tmp_path / "b" / "picture.png").unlink()
    assert differences(contents(tmp_path / "b"), a) == (
        "left over: .picture.part; missing: picture.png"
    )


def test_what_a_killed_process_leaves_behind_is_found(tmp_path, monkeypatch):
    """A child that outlives its parent, in a session of its own."""
    (tmp_path / "parent.py").write_text(
        "import subprocess, sys, time\n"
        "subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(60)'],"
        " start_new_session=True)\n"
        "open('started', 'w').close()\ntime.sleep(60)\n"
    )
    process = Process(["parent"], tmp_path, environment={"PYTHONPATH": str(tmp_path)})
    while not (tmp_path / "started").exists():
        time.sleep(0.01)
    process.kill()
    process.wait()
    try:
        assert process.survivors(0.5) == 1
    finally:
        process.end()
    assert process.survivors(5.0) == 0


def test_a_disk_is_full_for_a_process(tmp_path):
    (tmp_path / "writer.py").write_text(
        "with open('out', 'wb') as file:\n    file.write(bytes(5000))\n"
    )
    process = Process(["writer"], tmp_path, 1000, {"PYTHONPATH": str(tmp_path)})
    assert "File too large" in process.wait().err
    assert (tmp_path / "out").stat().st_size == 1000


@pytest.mark.parametrize(("place", "outside"), [("<module>", True), ("run", False)])
def test_an_interruption_counts_where_the_program_runs(place, outside):
    line = f'  File "lf_flame/commands/program.py", line 9, in {place}'
    err = f"Traceback (most recent call last):\n{line}\nKeyboardInterrupt\n"
    assert kills._is_outside(Outcome(1, "", err, 1.0)) == outside


@pytest.mark.parametrize(
    ("there", "done", "wrong"),
    [
        ({"b", "record"}, [0, 1], ""),
        ({"a", "record"}, [0], ""),
        ({"record"}, [0, 1], "missing: a"),
        ({"record"}, [1], "missing: b"),
        (set(), [], ""),
    ],
)
def test_a_later_call_may_remove_what_an_earlier_one_wrote(there, done, wrong):
    alone = [{"a": "1", "record": "0"}, {"b": "1", "record": "0"}]
    found = {name: "0" if name == "record" else "1" for name in there}
    assert pairs._mixed(found, alone, done) == wrong


@pytest.mark.slow
@pytest.mark.parametrize("part", [kills, pairs, damages, malformed, known, places])
def test_cases_are_the_same_in_every_run(part):
    """So that one can be repeated by its number."""
    found = part.cases(1, quick=False)
    assert [case.number for case in found] == list(range(len(found)))
    assert [case.what for case in found] == [case.what for case in part.cases(1, quick=False)]
    quick = {case.number: case for case in part.cases(1, quick=True)}
    assert 0 < len(quick) < len(found)
    assert all(found[number] == case for number, case in quick.items())


def test_as_much_is_tried_as_is_said():
    assert len(kills.cases(1, quick=False)) == 280
    assert {case.command for case in kills.cases(1, quick=False)} == set(WRITING)
    assert min(command.kills for command in WRITING) >= 10
    assert len(damages.cases(1, quick=False)) >= 500
    assert len(malformed.cases(1, quick=False)) >= 2000


def test_configurations_are_changed_by_their_schema():
    schema = malformed.schema_of("scene")
    values = {"layers": [{"depth_mm": 1.0, "size_mm": [1.0, 1.0], "shape": "circle"}]}
    new = [as_toml(changed(values, random.Random(seed), schema)) for seed in range(300)]
    assert len(set(new)) > 200
    for word in ("optical_thickness", "nan", "inf", "1e+308", "[]"):  # one of the optional keys
        assert any(word in text for text in new), word


def test_a_record_goes_on_and_tells_what_is_wrong(tmp_path, monkeypatch, capsys):
    tried = []

    def try_out(cases, keys, jobs, record, learning):
        tried.extend(cases)
        with record.open("a") as file:
            for case, key in zip(cases, keys, strict=True):
                wrong = "traceback: KeyError" if case.number == 1 else ""
                row = {
                    "key": key, "part": case.part, "number": case.number, "command": case.name,
                    "what": case.what, "right": not wrong, "wrong": wrong, "seconds": 1.0,
                }  # fmt: skip
                file.write(json.dumps(row) + "\n")

    monkeypatch.setattr(campaign, "run", try_out)
    arguments = ["--part", "places", "--out", str(tmp_path)]
    for _ in range(2):
        with pytest.raises(SystemExit) as end:
            campaign.main(arguments)
        assert end.value.code == 1
    assert len(tried) == len(places.cases(1, quick=False))  # the second time all is known
    text = (tmp_path / "campaign.md").read_text()
    assert f"{len(tried)} cases of {len(tried)}, **1 wrong**" in text
    assert "- `places:1` simulate: a link to a file. **traceback: KeyError**" in text
    assert text in capsys.readouterr().out


@pytest.mark.slow
def test_a_quick_campaign_finds_nothing_wrong(tmp_path):
    """Some cases of each part, without TensorFlow: some minutes."""
    with pytest.raises(SystemExit) as end:
        campaign.main(["--quick", "--out", str(tmp_path)])
    assert end.value.code == 0, (tmp_path / "campaign.md").read_text()
