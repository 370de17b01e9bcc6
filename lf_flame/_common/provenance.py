"""Origin of a result: command, versions, revision and machine, for its record."""

import os
import platform
import shlex
import subprocess
import sys
from contextlib import suppress
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path

PACKAGES = (
    "lf_flame", "numpy", "numba", "scikit-image", "zarr", "keras", "tensorflow", "tensorflow-cpu",
    "jax",
)  # fmt: skip


def environment() -> dict:
    """Describe the running program in JSON values: command, versions, revision, machine.

    The revision is None outside a git checkout, and ends with "+" if tracked files differ from it.
    """
    versions = {"python": platform.python_version()}
    for name in PACKAGES:
        with suppress(metadata.PackageNotFoundError):
            versions[name] = metadata.version(name)
    return {
        "command": f"{_program()} {shlex.join(sys.argv[1:])}".encode(errors="replace").decode(),
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "git_revision": _git_revision(),
        "versions": versions,
        "machine": f"{platform.system()} {platform.machine()}, {cpu_count()} cores",
    }


def cpu_count() -> int:
    """Count the processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _program() -> str:
    """Name of the program as a user calls it: a script, or a module after ``python -m``."""
    spec = getattr(sys.modules.get("__main__"), "__spec__", None)
    if spec is None:
        return Path(sys.argv[0]).name
    return f"python -m {spec.name.removesuffix('.__main__')}"


def _git_revision() -> str | None:
    # It fails in another user's checkout. No lock, which a killed process would leave there.
    own = ("ls-files", "--error-unmatch", Path(__file__).name)
    revision = ("describe", "--always", "--exclude=*", "--abbrev=12", "--dirty=+")
    try:
        for words in (own, revision):
            done = subprocess.run(
                ["git", "--no-optional-locks", *words], cwd=Path(__file__).parent,
                capture_output=True, text=True, check=True,
            )  # fmt: skip
    except (OSError, subprocess.CalledProcessError):
        return None
    return done.stdout.strip()
