"""Numbers of the documents come from records."""

from pathlib import Path

import pytest

from experiments.texts.records import look_up
from experiments.texts.sentences import Document, Sentence, read_documents
from lf_flame.errors import InputError

ROOT = Path(__file__).parents[3]
DOCUMENTS = read_documents()

CSV = 'name,size,time_s\n"a, b",1,0.25\nc,1,4\n'
JSON = '{"rates": [{"way": "pool", "processes": 2, "rate": 413.4}, {"way": "one", "rate": 218.1}]}'


@pytest.fixture
def records(tmp_path):
    (tmp_path / "some.csv").write_text(CSV)
    (tmp_path / "some.json").write_text(JSON)
    (tmp_path / "some.toml").write_text("[camera]\nlenslets = [270, 540]\n")
    return tmp_path


def in_csv(**row):
    return {"record": "some.csv", "row": row, "column": "time_s"}


@pytest.mark.parametrize("document", DOCUMENTS, ids=[one.path for one in DOCUMENTS])
def test_documents_say_what_the_records_hold(document):
    text = (ROOT / document.path).read_text(encoding="utf-8")
    assert document.filled(text) == text
    assert document.unsourced(text) == []


def test_every_text_for_users_has_its_sources():
    texts = [ROOT / "README.md", *(ROOT / "docs").glob("*.md")]
    measured = [path for path in texts if Document("", (), ()).unsourced(path.read_text())]
    known = [document.path for document in DOCUMENTS]
    assert [
        str(path.relative_to(ROOT)) for path in measured if str(path.relative_to(ROOT)) not in known
    ] == []


@pytest.mark.parametrize(
    ("source", "number"),
    [
        (in_csv(name="a, b"), 0.25),
        (in_csv(name="c", size=1), 4.0),
        ({"record": "some.json", "at": ["rates", {"way": "one"}, "rate"]}, 218.1),
        ({"record": "some.json", "at": ["rates", {"processes": 2}, "rate"]}, 413.4),
        ({"record": "some.toml", "at": ["camera", "lenslets", 1]}, 540),
        ({"mean": [in_csv(name="c"), in_csv(name="a, b")]}, 2.125),
        (
            {"median": [in_csv(name="c"), {"number": 9}, in_csv(name="a, b"), {"number": 8}]},
            6.0,
        ),
        ({"largest": [in_csv(name="c"), in_csv(name="a, b")]}, 4.0),
        ({"smallest": [in_csv(name="c"), in_csv(name="a, b")]}, 0.25),
        (in_csv(name="c") | {"less": in_csv(name="a, b")}, 3.75),
        (in_csv(name="c") | {"over": in_csv(name="a, b"), "times": 100}, 1600),
        (in_csv(name="c") | {"less": in_csv(name="a, b"), "over": in_csv(name="a, b")}, 15),
    ],
)  # fmt: skip
def test_a_source_leads_to_its_number(records, source, number):
    assert look_up(source, records) == pytest.approx(number)


@pytest.mark.parametrize(
    ("source", "told"),
    [
        (in_csv(size=1), "has 2 entries"),
        (in_csv(name="d"), "has 0 entries"),
        ({"record": "some.csv", "row": {"name": "c"}, "column": "name"}, "holds no number"),
        ({"record": "some.csv", "row": {"name": "c"}, "column": "other"}, "holds no number"),
        ({"record": "some.json", "at": ["rates", {"way": "none"}, "rate"]}, "has 0 entries"),
        ({"record": "some.json", "at": ["rates", 5]}, "holds no 5 there"),
    ],
)  # fmt: skip
def test_a_source_that_leads_nowhere_is_named(records, source, told):
    with pytest.raises(InputError, match=told):
        look_up(source, records)


def test_numbers_are_filled_in_wherever_lines_end(records):
    says = Sentence("takes {c:.1f} s, {a:.0%}", {"c": in_csv(name="c"), "a": in_csv(name="a, b")})
    text = "It takes\n3.0 s, 7%. And 2.5 dB, of `1.5` and [x](y-1.5.md) at 12 mm.\n"
    document = Document("", (says,), ())
    assert document.filled(text, records) == text.replace("3.0 s, 7%", "4.0 s, 25%")
    assert document.unsourced(text) == ["It takes 3.0 s, 7%. And 2.5 dB, of `1.5`"]
    assert Document("", (says,), (Sentence("And 2.5 dB", {}),)).unsourced(text) == []


@pytest.mark.parametrize("text", ["It takes 3.0 s.", "takes 3.0 s, 7%, takes 3.0 s, 7%"])
def test_a_sentence_that_is_not_there_once_is_named(text):
    says = Sentence("takes {c:.1f} s, {a:.0%}", {})
    with pytest.raises(InputError, match="stands in the text"):
        says.find(text)


def test_a_table_is_filled_in_whole(records):
    (records / "some.md").write_text("# Some\n\n| a | b |\n|---|---|\n| 1.5 | 2 s |\n\nWords.\n")
    text = "Before.\n\n<!-- table of some.md -->\n| old |\n\nAfter.\n"
    filled = Document("", (), ()).filled(text, records)
    assert filled == text.replace("| old |", "| a | b |\n|---|---|\n| 1.5 | 2 s |")
    assert Document("", (), ()).unsourced(filled) == []
