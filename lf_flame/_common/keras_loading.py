"""Loading Keras, without the pages that TensorFlow writes as it starts, and what it has saved."""

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING
from zipfile import is_zipfile

from lf_flame.errors import InputError

if TYPE_CHECKING:
    import keras


def load_keras() -> None:
    """Import Keras and start its backend's devices, with standard error shut meanwhile.

    To be called before anything else imports Keras.
    """
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "2")
    sys.stderr.flush()
    kept = os.dup(2)
    with Path(os.devnull).open("w") as nowhere:  # below Python: the library writes there directly
        os.dup2(nowhere.fileno(), 2)
        try:
            import keras

            keras.ops.zeros(1)  # starts the backend's devices
        finally:
            os.dup2(kept, 2)
            os.close(kept)


def load_model(path: Path) -> "keras.Model":
    """Load a saved network for prediction; code that may come with it is not run.

    Raises
    ------
    InputError
        If the file is no Keras file, is damaged, or needs code of others.
    """
    import keras

    if not is_zipfile(path):
        raise InputError(f"{path} is not a Keras file, or is cut short.")
    try:
        return keras.saving.load_model(path, compile=False, safe_mode=True)
    except MemoryError:
        raise
    except Exception as error:  # Keras, h5py and zipfile raise many kinds for a wrong file
        reason = str(error).strip().partition("\n")[0].partition(". ")[0]
        raise InputError(
            f"{path} cannot be loaded: it is damaged, or needs code other than Keras's own, which "
            f"is not run ({reason})."
        ) from None
