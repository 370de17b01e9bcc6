"""Figures of commands, drawn only for the tests that look at them."""

import pytest
from PIL import Image

from lf_flame._common import figures
from lf_flame._common.atomic_files import atomic_write


def save_one_pixel(figure, path, dpi=150):
    """Write a picture in place of a figure, whose drawing takes half a second."""
    with atomic_write(path) as aside:
        Image.new("L", (1, 1)).save(aside)


@pytest.fixture
def drawn():
    """For a test of what a command draws."""


@pytest.fixture(autouse=True)
def _figures(request, monkeypatch):
    if "drawn" not in request.fixturenames:
        monkeypatch.setattr(figures, "save", save_one_pixel)
