"""One writer at a time, and no lock outlives its process."""

import subprocess
import sys
import threading

import pytest
from filelock import FileLock

from lf_flame._common.locks import exclusive
from lf_flame.errors import InputError

HOLDER = """
import sys, time
from lf_flame._common.locks import exclusive
with exclusive(sys.argv[1]):
    print("held", flush=True)
    time.sleep(60)
"""


@pytest.fixture
def holder(tmp_path):
    command = [sys.executable, "-c", HOLDER, str(tmp_path / "out")]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout.readline() == "held\n"
    yield process
    process.kill()
    process.communicate()


def test_a_second_writer_is_refused_until_the_first_is_dead(tmp_path, holder):
    with (
        pytest.raises(InputError, match="out is being written by another process"),
        exclusive(tmp_path / "out"),
    ):
        pass
    (tmp_path / "link").symlink_to("out")
    with pytest.raises(InputError, match="another process"), exclusive(tmp_path / "link"):
        pass
    holder.kill()
    holder.wait()
    with exclusive(tmp_path / "out"):
        assert (tmp_path / ".out.lock").exists()
    assert [path.name for path in tmp_path.iterdir()] == ["link"]


def test_other_outputs_are_free(tmp_path, holder):
    with exclusive(tmp_path / "out2"), exclusive(tmp_path / "sub" / "out"):
        pass
    assert not (tmp_path / "sub").exists()  # made for the lock alone


def test_never_two_at_once(tmp_path):
    """Locks are removed while others wait for them: still nobody comes in beside another."""
    inside, most, turns = [], [], []

    def work():
        for _ in range(30):
            with exclusive(tmp_path / "out", wait_s=60):
                inside.append(1)
                most.append(len(inside))
                inside.pop()
                turns.append(1)

    threads = [threading.Thread(target=work) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert max(most) == 1
    assert len(turns) == 120


def test_who_comes_in_during_a_release_keeps_the_lock(tmp_path, monkeypatch):
    """The file is gone by then, and the next holder's new one must not go with the old lock."""
    file, release, second = (
        tmp_path / ".out.lock",
        FileLock.release,
        FileLock(tmp_path / ".out.lock"),
    )

    def come_in_before(lock, *args, **options):
        monkeypatch.undo()
        second.acquire(timeout=0)
        release(lock, *args, **options)

    with exclusive(tmp_path / "out"):
        monkeypatch.setattr(FileLock, "release", come_in_before)
    assert file.exists()
    with pytest.raises(InputError, match="another process"), exclusive(tmp_path / "out"):
        pass
    second.release()


def test_the_root_folder_is_no_output():
    with pytest.raises(InputError, match="/ is the root of all folders"), exclusive("/"):
        pass
