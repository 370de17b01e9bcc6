"""One writer at a time for each output."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from filelock import FileLock, Timeout

from lf_flame.errors import InputError


@contextmanager
def exclusive(output: str | Path, wait_s: float = 0.0) -> Iterator[None]:
    """Keep other processes from writing the same output during the block.

    The lock is a file ``.NAME.lock`` beside the output, whose parent folders are made, and removed
    if they are empty at the end. The system frees it when the process ends for any reason.
    An output that another process is still writing after `wait_s` seconds is refused.
    """
    path = Path(output).resolve()
    if not path.name:
        raise InputError(f"{output} is the root of all folders; choose another place.")
    made = [folder for folder in path.parents if not folder.exists()]
    path.parent.mkdir(parents=True, exist_ok=True)
    file = path.with_name(f".{path.name}.lock")
    lock = FileLock(file, timeout=wait_s)
    try:
        lock.acquire()
    except Timeout:
        raise InputError(
            f"{output} is being written by another process; wait for it, or choose another place."
        ) from None
    try:
        yield
    finally:
        # Removed while held: a process that opened it before finds it gone, and makes another.
        file.unlink(missing_ok=True)
        lock.release()
        with suppress(OSError):  # one holds something
            for folder in made:
                folder.rmdir()
