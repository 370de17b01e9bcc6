"""Sentences of the documentation whose numbers come from records.

What a document says stands in the document; where its numbers come from, in a TOML file of
`experiments/texts/sources`:

    document = "docs/studies.md"

    [[sentences]]
    says = "At twice that it reaches {twice:.1f} dB"
    twice = { record = "results/studies/variation_flames.csv", row = { ... }, column = "psnr_db" }

    [[stated]]
    says = "the 40.75 dB that the paper prints"
    because = "the mean of Table II"

A sentence is found by its words, wherever lines end in it; only its numbers are ever changed.
`stated` numbers are those that nobody measured, with the reason. A whole table comes from a
committed report, behind a comment: ``<!-- table of results/hard_cases/hard_cases.md -->``.
"""

import re
import tomllib
from dataclasses import dataclass
from pathlib import Path
from string import Formatter
from typing import Any

from experiments.paths import EXPERIMENTS
from experiments.texts.records import look_up
from lf_flame.errors import InputError

SOURCES = EXPERIMENTS / "texts" / "sources"

NUMBER = r"[-+]?\d[\d,]*(?:\.\d+)?(?:e[-+]?\d+)?"

UNITS = (
    r"(?:dB|ms|s|min|minutes?|seconds?|hours?|h|GB|MB|kB|%|per\ cent|times|Mray/s|Mpixel/s|GB/s)"
)

TABLE = re.compile(r"(?<=<!-- table of )(?P<record>\S+)(?P<middle> -->\n)(?P<table>(?:\|.*\n)*)")
"""Where a document shows the table of a committed report, by its path below `experiments`."""

MEASURED = re.compile(rf"(?<![\w.,-])(?:{NUMBER}\s(?:to\s{NUMBER}\s)?{UNITS}(?!\w)|\d+\.\d+(?!\w))")
"""What looks measured: a number with a unit of time, level, memory or share, or with decimals."""

UNREAD = re.compile(r"^```.*?^```|`[^`\n]*`|\]\([^)\n]*\)", re.DOTALL | re.MULTILINE)
"""Code, and where links lead."""


@dataclass(frozen=True)
class Sentence:
    """Words with numbers in their midst.

    Attributes
    ----------
    says : str
        Fields in braces stand for numbers and say how each is written, as in ``str.format``.
    numbers : dict of str to dict
        The source of each field, see `experiments.texts.records.look_up`.
    """

    says: str
    numbers: dict[str, Any]

    def find(self, text: str) -> re.Match:
        """Find where a text says so.

        Raises
        ------
        InputError
            If it says so nowhere, or more than once.
        """
        found = list(re.finditer(self._pattern(), text))
        if len(found) != 1:
            raise InputError(
                f"This stands in the text {len(found)} times, not once: {self.says!r}."
            )
        return found[0]

    def _pattern(self) -> str:
        parts = []
        for words, name, form, _ in Formatter().parse(self.says):
            parts.append(r"\s+".join(map(re.escape, re.split(r"\s+", words))))
            if name is not None:
                parts.append(f"(?P<{name}>{NUMBER}{'%' * form.endswith('%')})")
        return "".join(parts)

    def written(self, folder: Path = EXPERIMENTS) -> dict[str, str]:
        """Write each number as the sentence wants it, from its record."""
        fields = [(name, form) for _, name, form, _ in Formatter().parse(self.says) if name]
        return {name: format(look_up(self.numbers[name], folder), form) for name, form in fields}


@dataclass(frozen=True)
class Document:
    """A text, and where its numbers come from.

    Attributes
    ----------
    path : str
        Below the checkout.
    sentences : tuple of Sentence
    stated : tuple of Sentence
        Without fields: what nobody measured.
    """

    path: str
    sentences: tuple[Sentence, ...]
    stated: tuple[Sentence, ...]

    def filled(self, text: str, folder: Path = EXPERIMENTS) -> str:
        """Put the records' numbers into a text."""
        changes = []
        for sentence in self.sentences:
            found = sentence.find(text)
            changes += [
                (*found.span(name), number) for name, number in sentence.written(folder).items()
            ]
        changes += [
            (*found.span("table"), _table(folder / found["record"]))
            for found in TABLE.finditer(text)
        ]
        for start, end, number in sorted(changes, reverse=True):
            text = text[:start] + number + text[end:]
        return text

    def unsourced(self, text: str) -> list[str]:
        """List what looks measured and is in no sentence, with the words around it."""
        known = [one.find(text).span() for one in (*self.sentences, *self.stated)]
        known += [found.span() for found in (*UNREAD.finditer(text), *TABLE.finditer(text))]
        return [
            " ".join(text[max(found.start() - 40, 0) : found.end() + 10].split())
            for found in MEASURED.finditer(text)
            if not any(start <= found.start() and found.end() <= end for start, end in known)
        ]


def _table(path: Path) -> str:
    lines = path.read_text(encoding="utf-8").splitlines(keepends=True)
    return "".join(line for line in lines if line.startswith("|"))


def read_documents(folder: Path = SOURCES) -> list[Document]:
    """Read where the numbers of all documents come from."""
    return [_read_document(path) for path in sorted(folder.glob("*.toml"))]


def _read_document(path: Path) -> Document:
    content = tomllib.loads(path.read_text(encoding="utf-8"))
    sentences = [
        Sentence(entry["says"], {name: x for name, x in entry.items() if name != "says"})
        for entry in content.get("sentences", [])
    ]
    stated = [Sentence(entry["says"], {}) for entry in content.get("stated", [])]
    return Document(content["document"], tuple(sentences), tuple(stated))
