"""Loading Keras without the pages that TensorFlow writes as it starts."""

import os
import sys
from pathlib import Path


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
