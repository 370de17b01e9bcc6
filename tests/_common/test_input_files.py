"""Only regular files are opened, and texts are bounded before they are parsed."""

import os
import socket
import tomllib

import pytest

from lf_flame import InputError
from lf_flame._common.input_files import (
    check_regular,
    parse_json,
    read_record,
    read_text,
    read_toml,
    readable,
)


def test_what_is_no_regular_file_is_refused_and_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    with socket.socket(socket.AF_UNIX) as bound:
        bound.bind(str(tmp_path / "socket"))
        for name, words in (
            ("pipe", "is a device, a pipe or a socket"),
            ("socket", "is a device, a pipe or a socket"),
            ("", "is a folder"),
            ("/dev/zero", "is a device, a pipe"),
            ("none", "no such file"),
            ("loop", "symbolic links"),
            ("a\0b", "no file has such a name"),
            ("n" * 300, "name too long"),
        ):
            with pytest.raises(InputError, match=f"cannot be read: .*(?i:{words})"):
                check_regular(tmp_path / name)
            for read in (read_text, read_toml, read_record):
                with pytest.raises(InputError):
                    read(tmp_path / name)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[" * 100_000, "is not a JSON file: recursion limit exceeded"),
        ("{} {", "is not a JSON file"),
        ("", "is not a JSON file"),
        ("[]", "must contain names and values"),
        ('{"a": NaN}', "is not a JSON file: expected value at line 1"),
        ('{"a": -Infinity}', "is not a JSON file: invalid number"),
        ('{"a": "\\u0000"}', "contains a null byte"),
        ('{"\\ud800": 1}', "is not a JSON file"),
        (f'{{"a": {2**63}}}', "beyond 64 bits"),
        ('{"a": ' + "9" * 5000 + "}", "is not a JSON file: number out of range"),
        ('{"a": "\0"}', "is not a JSON file"),
    ],
)
def test_odd_records_are_one_sentence(tmp_path, text, words):
    (tmp_path / "record.json").write_text(text)
    with pytest.raises(InputError, match=rf"record\.json.*{words}") as caught:
        read_record(tmp_path / "record.json")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a = " + "[" * 2000 + "]" * 2000, "is not a TOML file: maximum recursion depth"),
        ("a = " + "{b = " * 2000 + "1" + "}" * 2000, "is not a TOML file: maximum recursion depth"),
        ("a = 1\na = 2", "is not a TOML file"),
        ('a = "\\u0000"', "contains a null byte"),
        ("a = 99999999999999999999", "beyond 64 bits"),
        ("a = 2000-13-41", "is not a TOML file"),
    ],
)
def test_odd_configurations_are_one_sentence(tmp_path, text, words):
    (tmp_path / "a.toml").write_text(text)
    with pytest.raises(InputError, match=rf"a\.toml.*{words}"):
        read_toml(tmp_path / "a.toml")


def test_what_is_no_text_is_refused(tmp_path):
    (tmp_path / "a.toml").write_bytes(b"a = '\xff'")
    with pytest.raises(InputError, match="is not text in UTF-8 .invalid start byte at 5.; save it"):
        read_toml(tmp_path / "a.toml")


def test_a_byte_order_mark_is_no_part_of_the_text(tmp_path):
    (tmp_path / "a.toml").write_bytes(b"\xef\xbb\xbfa = 1")
    assert read_toml(tmp_path / "a.toml") == {"a": 1}


def test_the_usual_is_read_as_it_stands(tmp_path):
    text = """
    title = "It's [fine]. {And} \\"so\\" is this"  # don't [count
    # .........................................................................
    names.of."some.thing" = [0.1, 0.25,1e3, -2.5]
    long = '''
    ]]] [[[ "
    '''
    [[layers]]
    size_mm = [1.0, 2.0]
    """
    (tmp_path / "a.toml").write_text(text)
    assert read_toml(tmp_path / "a.toml") == tomllib.loads(text)
    deep = "[" * 60 + "]" * 60
    assert parse_json(f'{{"a": {deep}, "b": [1.5e-3, null, "x[y\\"]"]}}', "here")["b"][0] == 0.0015


def test_a_readers_errors_name_the_file_and_our_sentences_pass(tmp_path):
    path = tmp_path / "a.dat"
    path.write_bytes(b"")
    words = r"a\.dat cannot be read: it is damaged.*\(EOFError\)"
    with pytest.raises(InputError, match=words), readable(path):
        raise EOFError
    with pytest.raises(InputError, match="said already"), readable(path):
        raise InputError("said already")
