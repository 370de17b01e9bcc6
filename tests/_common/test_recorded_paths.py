"""Paths in records lead back through links, which the system follows before it goes up."""

import os

import pytest

from lf_flame._common.output_folders import recorded_path


@pytest.mark.parametrize("out", ["results/o", "results", "deep/er/store/o", "plain/o", "."])
def test_a_recorded_path_leads_back(tmp_path, monkeypatch, out):
    (tmp_path / "deep" / "er" / "store").mkdir(parents=True)
    (tmp_path / "results").symlink_to("deep/er/store")
    (tmp_path / "lf.npy").touch()
    (tmp_path / "link.npy").symlink_to("lf.npy")
    monkeypatch.chdir(tmp_path)
    (tmp_path / out).mkdir(parents=True, exist_ok=True)
    for name in ("lf.npy", "link.npy"):
        recorded = recorded_path(name, out)
        assert not os.path.isabs(recorded)  # noqa: PTH117
        assert (tmp_path / out / recorded).samefile(tmp_path / "lf.npy")
