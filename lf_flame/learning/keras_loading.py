"""Loading Keras without TensorFlow's start-up messages, and loading saved networks."""

import os
import sys
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any
from zipfile import ZipFile, is_zipfile

from lf_flame._common import progress
from lf_flame._common.input_files import check_memory, check_regular, parse_json, readable
from lf_flame.errors import InputError

if TYPE_CHECKING:
    import keras


BACKENDS = ("tensorflow", "jax")
"""Backends of Keras on which networks of this package are tested."""


def load_keras() -> None:
    """Import Keras and start its backend's devices, with standard error closed meanwhile.

    Call it before anything else imports Keras. It refuses a backend that does not exist, and what
    `check_keras` refuses.
    """
    progress.report("Starting Keras ...")
    os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "2")
    sys.stderr.flush()
    kept = os.dup(2)
    with Path(os.devnull).open("w") as nowhere:  # below Python: the library writes there directly
        os.dup2(nowhere.fileno(), 2)
        try:
            import keras

            keras.ops.zeros(1)  # starts the backend's devices
        except Exception as error:  # whatever a device or a keras.json makes of it
            if getattr(error, "name", None) in ("keras", "tensorflow"):
                raise  # programs say what to install
            backend = os.environ.get("KERAS_BACKEND", "that of its keras.json")
            reason = (str(error) or type(error).__name__).splitlines()[0].rstrip(".")
            raise InputError(
                f"Keras does not start with the backend {backend}: {reason}."
            ) from None
        finally:
            os.dup2(kept, 2)
            os.close(kept)
    check_keras()


def check_keras() -> None:
    """Refuse a configuration of Keras (``keras.json``, environment) that no network here supports.

    Numbers must have 32 bits, channels come last, and the backend be in `BACKENDS`.
    """
    import keras

    for name, found, allowed in (
        ("backend", keras.config.backend(), BACKENDS),
        ("floatx", keras.config.floatx(), ("float32",)),
        ("image_data_format", keras.config.image_data_format(), ("channels_last",)),
        ("max_epochs", keras.config.max_epochs() or "unlimited", ("unlimited",)),
        ("max_steps_per_epoch", keras.config.max_steps_per_epoch() or "unlimited", ("unlimited",)),
    ):
        if found not in allowed:
            raise InputError(
                f"Keras is configured with {name} {found}, but networks of this package need "
                f"{' or '.join(allowed)}: set it in keras.json, or the environment's KERAS_..."
            )


CLASSES = frozenset(
    (
        "__ellipsis__", "__keras_tensor__", "__numpy__", "__slice__",
        "DTypePolicy", "Functional", "InputLayer",
        "GlorotUniform", "HeNormal", "Ones", "Zeros",
        "Activation", "Average", "BatchNormalization", "Concatenate", "Conv2D", "Conv2DTranspose",
        "Dense", "Dropout", "ELU", "Flatten", "GlobalAveragePooling2D", "LeakyReLU", "MaxPooling2D",
        "Permute", "ReLU", "Rescaling", "Reshape", "ZeroPadding2D",
        "Add", "Clip", "Exp", "Flip", "GetItem", "Mean", "Multiply", "OnesLike", "Subtract",
        "TrueDivide",
    )
)  # fmt: skip
"""Names of Keras classes in networks of this package; a file may name no others.

None of them runs code from the file. Keras's own safe mode alone has let code run more than once
(CVE-2025-1550, -8747, -9905, -9906, -49655, CVE-2026-1462)."""


def load_model(path: Path, shapes: tuple[tuple, tuple] | None = None) -> "keras.Model":
    """Load a saved network for prediction; code in the file is not run.

    Before Keras reads the file, its classes are compared with those of this package's networks.
    `shapes` are the required shapes of input and output, without samples. An InputError refuses a
    file that is not a Keras file, is damaged, needs too much memory, or contains another network.
    """
    import keras

    check_keras()
    check_regular(path)
    if not is_zipfile(path):
        raise InputError(f"{path} is not a Keras file, or is truncated.")
    _check_classes(_read_config(path), path)
    with readable(path), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Keras warns of each layer without weights
        network = keras.saving.load_model(path, compile=False, safe_mode=True)
    found = tuple(network.input_shape[1:]), tuple(network.output_shape[1:])
    if shapes not in (None, found):
        raise InputError(
            f"{path} turns images of shape {found[0]} into {found[1]}, but it should turn "
            f"{shapes[0]} into {shapes[1]}."
        )
    return network


def _read_config(path: Path) -> Any:
    """Read a network's description, if the whole archive fits into memory."""
    with readable(path), ZipFile(path) as archive:
        sizes = {member.filename: member.file_size for member in archive.infolist()}
        if sorted(sizes) != ["config.json", "metadata.json", "model.weights.h5"]:
            raise InputError(
                f"{path} is not a Keras file of this package: it must contain config.json, "
                f"metadata.json, model.weights.h5, and nothing else."
            )
        check_memory(sum(sizes.values()), path)
        if sizes["config.json"] > 1 << 24:  # that of ResNet-50 has 0.2 MB
            raise InputError(f"{path} cannot be read: its config.json is larger than 16 MB.")
        if (damaged := archive.testzip()) is not None:
            raise InputError(
                f"{path} cannot be read: it is damaged, as {damaged} in it does not fit its "
                f"checksum."
            )
        config = archive.read("config.json")
    return parse_json(config.decode("utf-8", "replace"), f"{path}: config.json")


def _check_classes(config: Any, path: Path) -> None:
    """Refuse classes that are not in `CLASSES`, wherever the file names one, except its training.

    Keras does not read the description of the training here.
    """
    if isinstance(config, dict):
        config = {key: value for key, value in config.items() if key != "compile_config"}
    left = [config]
    while left:
        value = left.pop()
        if isinstance(value, dict):
            if "class_name" in value and not _is_known(**value):
                named = f"{value.get('module')}.{value['class_name']}"
                raise InputError(
                    f"{path} is not loaded: networks of this package contain no {named[:80]}, and "
                    f"code that comes with a file is not run."
                )
            left += value.values()
        elif isinstance(value, list):
            left += value


def _is_known(class_name: Any, module: Any = None, registered_name: Any = None, **_: Any) -> bool:
    return (
        isinstance(class_name, str)
        and class_name in CLASSES
        and str(module or "keras").partition(".")[0] == "keras"
        and registered_name in (None, class_name)
    )


def accelerators() -> list[str]:
    """Names of the GPUs or TPUs that Keras uses; none on a processor."""
    import keras

    if keras.backend.backend() == "jax":
        import jax

        return [device.device_kind for device in jax.devices() if device.platform != "cpu"]
    import tensorflow as tf

    return [device.name for device in tf.config.list_physical_devices("GPU")]
