"""Origin of a result: command, versions, revision and machine, for its record."""

import os
import platform
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

    The revision is None outside a git checkout, and ends with "+" if tracked programs or settings
    differ from it.
    """
    return {
        "command": " ".join([_program(), *sys.argv[1:]]),
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "git_revision": _git_revision(),
        "versions": {"python": platform.python_version(), **_versions()},
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


def _versions() -> dict[str, str]:
    found = {}
    for name in PACKAGES:
        with suppress(metadata.PackageNotFoundError):
            found[name] = metadata.version(name)
    return found


def _git_revision() -> str | None:
    def git(*args: str) -> str:
        here = Path(__file__).parent
        return subprocess.run(
            ["git", *args], cwd=here, capture_output=True, text=True, check=True
        ).stdout.strip()

    try:
        git("ls-files", "--error-unmatch", Path(__file__).name)  # fails in another's checkout
        # Only programs and settings affect results.
        paths = (":(top,glob)**/*.py", ":(top,glob)**/*.toml")
        # Without a lock, which a kill would leave in the user's repository.
        status = ("--no-optional-locks", "status")
        changed = git(*status, "--porcelain", "--untracked-files=no", "--", *paths)
        return git("rev-parse", "--short=12", "HEAD") + ("+" if changed else "")
    except (OSError, subprocess.CalledProcessError):
        return None
