"""One writer at a time for each output."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from lf_flame._common.atomic_files import made
from lf_flame.errors import InputError


@contextmanager
def exclusive(output: str | Path, wait_s: float = 0.0) -> Iterator[None]:
    """Keep other processes from writing the same output during the block.

    The lock is a file ``.NAME.lock`` beside the output. The system holds it for this process and
    frees it when the process ends for any reason.

    Parameters
    ----------
    output : str or Path
        A file or folder, which need not exist; its parent folder is made.
    wait_s : float, optional
        Longest time to wait for another process, in seconds.

    Raises
    ------
    InputError
        If another process is still writing there, or the output is the root folder.
    """
    path = Path(output).resolve()
    if not path.name:
        raise InputError(f"{output} is the root of all folders; choose another place.")
    file = path.with_name(f".{path.name}.lock")
    lock = FileLock(file, timeout=wait_s)
    with made(path.parent):
        try:
            lock.acquire()
        except Timeout:
            raise InputError(
                f"{output} is being written by another process; wait for it, or choose another "
                f"place."
            ) from None
        try:
            yield
        finally:
            # Removed while held: a process that opened it before finds it gone, and makes another.
            file.unlink(missing_ok=True)
            lock.release()
