"""Long work shows how far it is, quick work and a library show nothing."""

import time

import pytest

from lf_flame._common import progress


@pytest.fixture
def patience(monkeypatch):
    monkeypatch.setattr(progress, "PATIENCE", 0.05)
    progress.show()
    yield
    progress.show(False)


@pytest.mark.slow
def test_a_bar_appears_before_a_long_step_has_ended(patience, capfd):
    for step in progress.steps([1, 2], "tracing", 2):
        time.sleep(0.3)
        assert f"tracing:{50 * (step - 1):4d}%" in capfd.readouterr().err.replace("\r", " ")


def test_what_has_no_steps_is_named_once(patience, caplog):
    with caplog.at_level("INFO"), progress.stage("Looking"):
        time.sleep(0.3)
        assert caplog.messages == ["Looking ..."]


def test_quick_work_and_a_library_show_nothing(patience, capfd, caplog):
    def work(seconds):
        with progress.stage("Looking"):
            assert list(progress.steps([1, 2], "tracing", 2)) == [1, 2]
            time.sleep(seconds)

    with caplog.at_level("INFO"):
        progress.PATIENCE = 0.5
        work(0)
        progress.PATIENCE = 0.05
        progress.show(False)
        work(0.2)
    assert not caplog.messages
    assert capfd.readouterr().err == ""
