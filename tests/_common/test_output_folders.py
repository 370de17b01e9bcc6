"""A folder and its record change together; what is the user's stays."""

import fcntl
import json
import os
from pathlib import Path

import pytest

from lf_flame._common.atomic_files import write_text
from lf_flame._common.checksums import file_sha256, sealed
from lf_flame._common.output_folders import output_folder, verify_outputs
from lf_flame.errors import InputError

RECORD = "work.json"


def fill(folder, error=None, adds=False, **files):
    with output_folder(folder, RECORD, adds=adds) as out:
        for name, text in files.items():
            write_text(out.path(f"{name}.txt"), text)
        if error:
            raise error
    return out


def contents(folder):
    return {path.name: path.read_text() for path in folder.iterdir() if path.name != RECORD}


def test_the_record_names_each_file_by_its_hash(tmp_path):
    out = fill(tmp_path / "new", a="1", b="2")
    record = json.loads((tmp_path / "new" / RECORD).read_text())
    for name in ("a.txt", "b.txt"):
        assert record["files"][name] == file_sha256(tmp_path / "new" / name)
    assert record["files"] == out.files
    assert verify_outputs(tmp_path / "new", RECORD) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["new"]


def test_a_second_call_replaces_what_the_first_wrote_and_leaves_the_rest(tmp_path, caplog):
    fill(tmp_path, a="1", b="1")
    (tmp_path / "mine.txt").write_text("mine")
    assert not caplog.messages
    with caplog.at_level("INFO"):
        fill(tmp_path, b="2", c="2")
    assert len(caplog.messages) == 1
    assert caplog.messages[0].endswith("this one does not: a.txt.")
    assert contents(tmp_path) == {"b.txt": "2", "c.txt": "2", "mine.txt": "mine"}


def test_what_is_added_leaves_what_is_there(tmp_path):
    """But for what the user has changed, which is the user's from then on."""
    fill(tmp_path, adds=True, a="1", b="1", c="1")
    (tmp_path / "c.txt").write_text("mine now")
    fill(tmp_path, adds=True, b="2")
    assert contents(tmp_path) == {"a.txt": "1", "b.txt": "2", "c.txt": "mine now"}
    record = json.loads((tmp_path / RECORD).read_text())
    assert [call["files"] for call in record["earlier"]] == [["a.txt"]]
    assert verify_outputs(tmp_path, RECORD) == 2
    with pytest.raises(InputError, match="c.txt is there, and work.json does not say"):
        fill(tmp_path, adds=True, c="3")
    fill(tmp_path, adds=True, a="4")
    record = json.loads((tmp_path / RECORD).read_text())
    assert [call["files"] for call in record["earlier"]] == [["b.txt"]]


@pytest.mark.parametrize("earlier", [5, [5], [{}], [{"files": 5}], [{"files": [5]}]])
def test_a_damaged_list_of_earlier_calls_is_one_sentence(tmp_path, earlier):
    fill(tmp_path, adds=True, a="1")
    record = json.loads((tmp_path / RECORD).read_text())
    (tmp_path / RECORD).write_text(json.dumps(record | {"earlier": earlier}))
    with pytest.raises(InputError, match=RECORD):
        fill(tmp_path, adds=True, b="1")
    assert contents(tmp_path) == {"a.txt": "1"}


@pytest.mark.parametrize("error", [InputError("wrong"), OSError(28, "disk full")])
def test_a_call_that_fails_changes_nothing(tmp_path, error):
    fill(tmp_path, a="1")
    record = (tmp_path / RECORD).read_text()
    with pytest.raises(type(error)):
        fill(tmp_path, a="2", b="2", error=error)
    assert contents(tmp_path) == {"a.txt": "1"}
    assert (tmp_path / RECORD).read_text() == record


@pytest.mark.parametrize("moved", [0, 1, 2])
@pytest.mark.parametrize("before", [False, True])
def test_what_was_cut_off_between_two_moves_is_moved_by_the_next_call(
    tmp_path, monkeypatch, moved, before
):
    """Whatever cuts it off: nothing runs behind it that could mend anything."""
    folder, moves = tmp_path / "out", []
    if before:
        fill(folder, a="0", b="0")
    replace = Path.replace

    def cut_off(path, target):
        if path.parent.suffix == ".moving":
            moves.append(path.name)
            if len(moves) > moved:
                raise KeyboardInterrupt
        return replace(path, target)

    with monkeypatch.context() as patched:
        patched.setattr(Path, "replace", cut_off)
        with pytest.raises(KeyboardInterrupt):
            fill(folder, a="1", b="1")
    assert moves == ["a.txt", "b.txt", RECORD][: moved + 1]
    fill(folder, a="1", c="1")
    assert contents(folder) == {"a.txt": "1", "c.txt": "1"}
    assert verify_outputs(folder, RECORD) == 2
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_what_another_process_moves_is_left_to_it(tmp_path):
    moving = tmp_path / f".outputs.{'0' * 16}.moving"
    fill(tmp_path / "other", a="theirs")
    (tmp_path / "other").rename(moving)
    descriptor = os.open(moving, os.O_RDONLY)
    fcntl.flock(descriptor, fcntl.LOCK_EX)
    fill(tmp_path, a="1")
    assert moving.exists()
    os.close(descriptor)
    fill(tmp_path, a="1")
    assert not moving.exists()


def test_a_file_that_no_record_names_is_not_replaced(tmp_path):
    (tmp_path / "a.txt").write_text("mine")
    with pytest.raises(InputError, match="a.txt is there, and work.json does not say"):
        fill(tmp_path, a="1")
    assert contents(tmp_path) == {"a.txt": "mine"}
    fill(tmp_path, b="1")
    with pytest.raises(InputError, match="a.txt is there"):
        fill(tmp_path, a="2", b="2")
    assert contents(tmp_path) == {"a.txt": "mine", "b.txt": "1"}


@pytest.mark.parametrize("adds", [False, True])
def test_a_file_that_was_edited_is_not_replaced(tmp_path, adds):
    fill(tmp_path, a="1", b="2", adds=adds)
    (tmp_path / "a.txt").write_text("notes on it")
    with pytest.raises(InputError, match=r"a\.txt has changed since this program wrote it; move"):
        fill(tmp_path, b="3", a="4", adds=adds)
    assert contents(tmp_path) == {"a.txt": "notes on it", "b.txt": "2"}
    (tmp_path / "a.txt").unlink()
    record = (tmp_path / RECORD).read_text()
    (tmp_path / RECORD).write_text(record.replace("versions", "version"))
    with pytest.raises(InputError, match=r"is there, and is no whole record"):
        fill(tmp_path, b="3", a="4", adds=adds)
    (tmp_path / RECORD).write_text(record)
    fill(tmp_path, b="3", a="4", adds=adds)
    assert contents(tmp_path) == {"a.txt": "4", "b.txt": "3"}


def test_a_record_of_a_users_own_is_not_replaced(tmp_path):
    (tmp_path / RECORD).write_text('{"mine": 1}')
    with pytest.raises(InputError, match="work.json is there, and is no whole record"):
        fill(tmp_path, a="1")
    assert json.loads((tmp_path / RECORD).read_text()) == {"mine": 1}


def test_only_what_is_still_as_it_was_written_is_removed(tmp_path):
    fill(tmp_path, a="1", b="1")
    (tmp_path / "a.txt").write_text("mine now")
    fill(tmp_path, c="2")
    assert contents(tmp_path) == {"a.txt": "mine now", "c.txt": "2"}


@pytest.mark.parametrize("absolute", [False, True])
def test_a_record_never_names_a_file_outside_to_be_removed(tmp_path, absolute):
    """The names lead to a file of the user's, with its right hash."""
    thesis, out = tmp_path / "thesis.txt", tmp_path / "out"
    thesis.write_text("mine")
    fill(out, a="1")
    record = json.loads((out / RECORD).read_text())
    (out / "link.txt").symlink_to(thesis)
    for name in (str(thesis) if absolute else "../thesis.txt", "link.txt", "", "..", "."):
        record["files"][name] = file_sha256(thesis)
    (out / RECORD).write_text(json.dumps(sealed(record)))
    fill(out, b="1")
    assert thesis.read_text() == "mine"
    assert (out / "link.txt").is_symlink()


@pytest.mark.parametrize("files", [["a.txt", "b.txt"], None])
def test_records_of_older_versions_are_taken_as_they_are(tmp_path, files):
    """They name their files without hashes, or not at all."""
    fill(tmp_path, a="1", b="1")
    record = json.loads((tmp_path / RECORD).read_text())
    record["files"] = files
    del record["record_sha256"]
    if files is None:
        del record["files"]
    (tmp_path / RECORD).write_text(json.dumps(record))
    with pytest.raises(InputError, match="has no hashes"):
        verify_outputs(tmp_path, RECORD)
    fill(tmp_path, a="2")
    assert contents(tmp_path) == {"a.txt": "2", "b.txt": "1"}


def test_a_file_that_changed_is_named(tmp_path):
    fill(tmp_path, a="1", b="1")
    (tmp_path / "b.txt").write_text("2")
    with pytest.raises(InputError, match="b.txt is not the file"):
        verify_outputs(tmp_path, RECORD)
    (tmp_path / "b.txt").unlink()
    with pytest.raises(InputError, match="b.txt is missing"):
        verify_outputs(tmp_path, RECORD)


MADE_UP = f".outputs.{'0123456789abcdef'}.moving"


@pytest.mark.parametrize("record", ["none", "ours", "other content", "other names", "no JSON"])
@pytest.mark.parametrize("earlier", [False, True])
def test_a_made_up_leftover_replaces_nothing(tmp_path, record, earlier):
    """Whatever record lies in it, the file of the user's is in none of the folder's own."""
    out = tmp_path / "out"
    if earlier:
        fill(out, b="1")
    fill(tmp_path / "made", **{"thesis": "theirs"} if record != "other names" else {"x": "1"})
    made = tmp_path / "made"
    if record == "none":
        (made / RECORD).unlink()
    elif record == "no JSON":
        (made / RECORD).write_text("{")
    if record != "ours":
        (made / "thesis.txt").write_text("another")
    out.mkdir(exist_ok=True)
    made.rename(out / MADE_UP)
    (out / "thesis.txt").write_text("mine")
    fill(out, b="2")
    assert (out / "thesis.txt").read_text() == "mine"
    assert (out / "b.txt").read_text() == "2"
    assert verify_outputs(out, RECORD) == 1


def test_a_leftover_that_holds_a_link_or_no_record_adds_nothing(tmp_path):
    (tmp_path / "secret.txt").write_text("secret")
    for number, name in enumerate(("link", "alone")):
        fill(tmp_path / name, a="secret")
        left = tmp_path / "out" / f".outputs.{number:016x}.moving"
        left.parent.mkdir(exist_ok=True)
        (tmp_path / name).rename(left)
        (left / (RECORD if name == "alone" else "a.txt")).unlink()
        if name == "link":
            (left / "a.txt").symlink_to(tmp_path / "secret.txt")
    fill(tmp_path / "out", b="1")
    assert not (tmp_path / "out" / "a.txt").exists()
    assert (tmp_path / "secret.txt").read_text() == "secret"


def test_a_full_disk_names_the_file(tmp_path):
    def fail(name, inside):
        with output_folder(tmp_path / "out", RECORD) as out:
            path = out.path(name)
            place = str(path) if inside else None
            raise OSError(28, "No space left on device", place)

    for name, inside in (("a.tif", False), ("b.csv", True)):
        with pytest.raises(OSError, match="No space left") as raised:
            fail(name, inside)
        assert raised.value.filename == str(tmp_path / "out" / name)
    assert list(tmp_path.iterdir()) == []
