"""File of ResNet-50's ImageNet weights: from Keras's cache, else downloaded into it.

Keras can download it too, but sets no time limit for its connection, and a limit from outside,
`socket.setdefaulttimeout`, would apply to every connection of the process.
"""

import hashlib
import os
from http.client import HTTPException
from pathlib import Path
from urllib.request import urlopen

from lf_flame._common import progress
from lf_flame._common.atomic_files import atomic_write
from lf_flame.errors import InputError

NAME = "resnet50_weights_tf_dim_ordering_tf_kernels_notop.h5"
ORIGIN = "https://storage.googleapis.com/tensorflow/keras-applications/resnet/"
MD5 = "4d473c1dd8becc155b73f8504c6f6626"
"""MD5 checksum of the file, as in `keras.applications.ResNet50`."""

TIMEOUT_S = 5.0
"""Longest time in seconds to wait for the connection, and for each part of the file."""


class ImagenetUnavailable(InputError):
    """The ImageNet weights are neither in Keras's cache nor can they be downloaded."""


def imagenet_file() -> Path:
    """Find the weights file in Keras's cache, ``~/.keras`` or ``KERAS_HOME``, or download it there.

    ImagenetUnavailable is raised if there is no connection, no data arrive for `TIMEOUT_S`, the
    file received is another one, or it cannot be written.
    """
    path = Path(os.environ.get("KERAS_HOME", "~/.keras")).expanduser() / "models" / NAME
    if path.is_file() and _md5(path) == MD5:
        return path
    try:
        with atomic_write(path) as aside:
            _download(ORIGIN + NAME, aside)
            if _md5(aside) != MD5:
                raise OSError("the download is incomplete or not the file")
    except (OSError, HTTPException) as error:
        raise ImagenetUnavailable(
            f"The ImageNet weights of ResNet-50 could not be downloaded into {path.parent} "
            f"({_reason(error)})."
        ) from None
    return path


def _reason(error: Exception) -> str:
    """Reason of an error on one line, without number and file."""
    inner = getattr(error, "reason", None)
    if isinstance(inner, OSError):  # of the connection, wrapped by urllib
        error = inner
    return " ".join(str(getattr(error, "strerror", None) or error).split())


def _download(url: str, path: Path) -> None:
    with urlopen(url, timeout=TIMEOUT_S) as response, path.open("wb") as file:
        size = int(response.headers.get("Content-Length") or 0) or None
        with progress.bar("ImageNet weights", size, "B", stays=True, unit_scale=True) as bar:
            while part := response.read(1 << 20):
                file.write(part)
                bar.update(len(part))


def _md5(path: Path) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "md5").hexdigest()
