"""Running a click program so that whatever goes wrong is one sentence and an exit status."""

import os
import sys

import click

from lf_flame.errors import InputError


def run(commands: click.Group, name: str) -> None:
    """Run a program: bad input ends with status 2, an interruption with 130, never a traceback.

    Parameters
    ----------
    commands : click.Group
    name : str
        What stands before a message.
    """
    leave_cores_to_networks()
    try:
        status = commands.main(prog_name=name, standalone_mode=False)
    except click.exceptions.Abort:
        _fail(
            name, "Stopped. Files that were finished are kept; long work goes on from there.", 130
        )
    except click.ClickException as error:
        error.show()
        sys.exit(2)
    except InputError as error:
        _fail(name, str(error), 2)
    except MemoryError as error:
        _fail(name, f"There is not enough memory for this camera or scene: {error}.", 2)
    except ModuleNotFoundError as error:
        if error.name not in OPTIONAL:
            raise
        _fail(name, f"{OPTIONAL[error.name]} (there is no module {error.name}).", 2)
    except OSError as error:
        place = f" ({error.filename})" if error.filename else ""
        _fail(name, f"{error.strerror or error}{place}. Nothing that was there before is lost.", 2)
    sys.exit(status or 0)


def leave_cores_to_networks() -> None:
    """Let idle threads of Numba sleep at once, unless the environment says otherwise.

    Views are aligned by Numba's threads, then a network runs in its backend's. Those of Numba would
    stay awake for some milliseconds, as is OpenMP's default, and hold the cores that the network
    needs. OpenMP reads the variable as it starts, so this must come before Numba's first loop; a
    library must not do it to its user's process.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")


LEARNING = "This needs what learning needs: pip install 'lf_flame[learn]'"
OPTIONAL = {
    **dict.fromkeys(("keras", "tensorflow", "pandas", "zarr"), LEARNING),
    "jax": "This needs JAX: pip install 'lf_flame[gpu]'",
}
"""Packages that a light installation lacks, and what to do then."""


def _fail(name: str, message: str, status: int) -> None:
    click.echo(f"{name}: {message}", err=True)
    sys.exit(status)
