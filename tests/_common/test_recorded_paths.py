"""Paths in records lead back through links, which the system follows before it goes up."""

import os

import pytest

from lf_flame._common.recorded_paths import recorded_path, recorded_places


@pytest.fixture
def linked(tmp_path, monkeypatch):
    """Make a working folder with a source, and ``results``, a link to a folder deep below."""
    (tmp_path / "deep" / "er" / "store").mkdir(parents=True)
    (tmp_path / "results").symlink_to("deep/er/store")
    (tmp_path / "lf.npy").touch()
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("out", ["results/o", "results", "deep/er/store/o", "plain/o", "."])
def test_a_recorded_path_leads_back(linked, out):
    recorded = recorded_path("lf.npy", out)
    (linked / out).mkdir(parents=True, exist_ok=True)
    assert not os.path.isabs(recorded)  # noqa: PTH117
    assert (linked / out / recorded).samefile(linked / "lf.npy")
    assert recorded_places(recorded, out)[0] == (linked / "lf.npy").resolve()


def test_what_is_recorded_may_be_a_link_itself(linked):
    (linked / "elsewhere").mkdir()
    (linked / "elsewhere" / "data").touch()
    (linked / "results" / "data").symlink_to(linked / "elsewhere" / "data")
    assert recorded_path("results/data", "results/o") == "../../../../elsewhere/data"


def test_older_records_counted_from_the_folder_as_typed_or_from_the_working_folder(linked):
    """The first through no link, the second as if the link were a folder."""
    source = (linked / "lf.npy").resolve()
    assert source in recorded_places("../../lf.npy", "results/o")
    assert source in recorded_places("../../lf.npy", linked / "results" / "o")
    assert source in recorded_places("lf.npy", "results/o")
    assert source not in recorded_places("../lf.npy", "results/o")
