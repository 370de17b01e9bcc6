"""Results of the maker's program in a processed Lytro file: refocused images and depth maps."""

import io
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from lf_flame._common.images import PILLOW_ERRORS
from lf_flame._common.input_files import readable
from lf_flame._common.memory import check_memory
from lf_flame.errors import InputError
from lf_flame.formats.lytro.container import LytroContainer, open_container
from lf_flame.formats.nested_values import NestedValues, tables

MOST = 1000
"""Largest number of results that are looked at."""

FLOATS = ("raw", "packedFloat")
"""Packings of a map of float32, least significant byte first."""


@dataclass(frozen=True)
class LytroProduct:
    """One result in a file, of which nothing is decoded yet.

    Attributes
    ----------
    kind : str
        Kind in the maker's words, such as refocusStack, focusStack or depthMap.
    packing : str
        Packing of its images, such as jpeg or h264; empty if there are none.
    images : tuple of (str, float or None)
        Name of the section of each image, empty if it has none of its own, and its focus.
    maps : tuple of (str, str, int, int)
        Kind, name of the section, rows and columns of each map that can be read.
    """

    kind: str
    packing: str
    images: tuple[tuple[str, float | None], ...]
    maps: tuple[tuple[str, str, int, int], ...]

    @property
    def is_read(self) -> bool:
        """Whether `read_lytro_products` reads it, or a part of it."""
        return bool(self.pictures or self.maps)

    @property
    def pictures(self) -> list[tuple[str, float | None]]:
        """Section and focus of each image that can be decoded."""
        return [one for one in self.images if one[0]] if self.packing == "jpeg" else []

    def describe(self) -> str:
        """Describe it in a few words."""
        parts = []
        if self.images:
            parts.append(f"{len(self.images)} images, {self.packing or 'of unknown packing'}")
        parts += [f"{kind} of {rows} x {columns} pixels" for kind, _, rows, columns in self.maps]
        return ", ".join(parts or ["empty"]) + ("" if self.is_read else "; not read")


@dataclass(frozen=True, eq=False)
class LytroProducts:
    """Refocused images and depth of a processed file; None where the file has none.

    Attributes
    ----------
    images : ndarray of uint8, shape (n, rows, columns, 3), or None
        Images in sRGB, as the maker's program rendered them.
    focus : ndarray of float64, shape (n,), or None
        Focus of each image in the maker's unit (lambda), NaN where it is not stated.
    depth, confidence : ndarray of float32, shape (rows, columns), or None
        Focus at which each point is sharp, in the same unit, and how sure that is.
    """

    images: np.ndarray | None
    focus: np.ndarray | None
    depth: np.ndarray | None
    confidence: np.ndarray | None


def read_lytro_products(path: str | Path) -> LytroProducts:
    r"""Read the refocused images and the depth map of a processed file of a Lytro camera.

    Parameters
    ----------
    path : str or Path
        Container (``.lfp``) that the maker's program exported. Images must be JPEG; video (h264) is
        not read.

    Returns
    -------
    LytroProducts
        First stack of images and first depth map of the file.

    Raises
    ------
    InputError
        If the file cannot be read, or holds nothing of the kind.

    Examples
    --------
    >>> import hashlib, json
    >>> from pathlib import Path
    >>> from lf_flame.formats import read_lytro_products
    >>> def section(kind, data):
    ...     name = b"sha1-" + hashlib.sha1(data).hexdigest().encode()
    ...     head = b"\x89" + kind + b"\r\n\x1a\n" + len(data).to_bytes(8, "big")
    ...     return head + name + bytes(35) + data + bytes(-len(data) % 16)
    >>> ref = "sha1-" + hashlib.sha1(bytes(24)).hexdigest()
    >>> depth = {"width": 3, "height": 2, "depthMap": {"imageRef": ref, "representation": "raw"}}
    >>> entry = {"type": "com.lytro.acceleration.depthMap", "vendorContent": depth}
    >>> table = json.dumps({"picture": {"accelerationArray": [entry]}}).encode()
    >>> start = b"\x89LFP\r\n\x1a\n\0\0\0\1\0\0\0\0"
    >>> data = start + section(b"LFM", table) + section(b"LFC", bytes(24))
    >>> _ = Path("picture.lfp").write_bytes(data)
    >>> read_lytro_products("picture.lfp").depth.shape
    (2, 3)
    """
    container = open_container(path)
    products = find_products(container)
    stack = next((one for one in products if one.pictures), None)
    images, focus = (None, None) if stack is None else _read_images(container, stack)
    maps: dict[str, np.ndarray] = {}
    for kind, name, rows, columns in (found for one in products for found in one.maps):
        if kind not in maps:
            maps[kind] = _read_map(container, name, rows, columns)
    if images is None and not maps:
        held = ", ".join(f"{one.kind}: {one.describe()}" for one in products[:5]) or "nothing"
        raise InputError(
            f"{path} must hold refocused images in JPEG or a depth map, got {held[:300]}."
        )
    depth = maps.get("depthMap", maps.get("depthLut"))
    return LytroProducts(images, focus, depth, maps.get("confidenceMap"))


def find_products(container: LytroContainer) -> list[LytroProduct]:
    """List the results of the maker's program in a container, of either camera."""
    table = NestedValues(container.table, container.path)
    entries = tables(table.find("picture/accelerationArray", "accelerations"))
    for holder in tables(table.find("views")) + tables(table.find("frames")):
        entries += tables(holder.get("accelerations"))
    return [_product(entry, container) for entry in entries[:MOST]]


def _product(entry: dict[str, Any], container: LytroContainer) -> LytroProduct:
    """Find the images and maps of one result."""
    whole = NestedValues(entry, container.path)
    content = whole.find("vendorContent")
    inner = NestedValues(content if isinstance(content, dict) else entry, container.path)
    listed = tables(inner.find("imageArray", "perImage", "blockOfImages/metadataArray"))
    images = [NestedValues(one, container.path) for one in listed]
    packing = inner.text("representation", "blockOfImages/representation")
    if images and not packing:
        packing = images[0].text("representation")
    return LytroProduct(
        kind=whole.text("type", "kind").removeprefix("com.lytro.acceleration.")[:60] or "unnamed",
        packing=packing[:60],
        images=tuple(
            (name if name in container else "", one.number("lambda", "focus"))
            for one in images
            for name in [one.text("imageRef")]
        ),
        maps=tuple(_maps(inner, container)),
    )


def _maps(inner: NestedValues, container: LytroContainer):
    """Kind, section, rows and columns of the maps of a result that are whole."""
    for kind in ("depthMap", "depthLut", "confidenceMap"):
        name = inner.text(f"{kind}/imageRef")
        rows, columns = (inner.number(f"{kind}/{side}", side) for side in ("height", "width"))
        if inner.text(f"{kind}/representation") not in FLOATS or name not in container:
            continue
        if rows and columns and rows * columns * 4 == container.sections[name.lower()].length:
            yield kind, name, int(rows), int(columns)


def _read_images(container: LytroContainer, stack: LytroProduct) -> tuple[np.ndarray, np.ndarray]:
    """Decode the images of a stack that are in the file, and their focus."""
    held = stack.pictures
    images: list[np.ndarray] = []
    for name, _ in held:
        with (
            readable(container.path, PILLOW_ERRORS, "holds an image that is no JPEG"),
            Image.open(io.BytesIO(container.read(name)), formats=("JPEG",)) as image,
        ):
            check_memory(3 * prod(image.size) * (len(held) + 2), container.path)
            images.append(np.asarray(image.convert("RGB")))
        if images[-1].shape != images[0].shape:
            raise InputError(
                f"The images of the stack in {container.path} must be of one size, got "
                f"{images[0].shape[:2]} and {images[-1].shape[:2]}."
            )
    return np.stack(images), np.array([focus for _, focus in held], float)


def _read_map(container: LytroContainer, name: str, rows: int, columns: int) -> np.ndarray:
    return np.frombuffer(container.read(name), "<f4").astype(np.float32).reshape(rows, columns)
