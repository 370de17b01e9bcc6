"""Files of Lytro cameras, written without a line of the package: containers, raw files, archives.

Metadata have the names and the places that those of real pictures have, of an F01 and of an Illum.
"""

import hashlib
import io
import json
import struct
import tarfile

import numpy as np

SIDES = {"F01": (12, "big", "b", 168, 4095), "ILLUM": (10, "little", "gr", 64, 1023)}
"""Bits, byte order, first pixel, black and white level of both cameras."""


def pack(mosaic, bits):
    """Pixels as the camera packs them, by way of single binary digits."""
    digits = mosaic.reshape(-1, 1) >> np.arange(bits - 1, -1, -1) & 1
    if bits == 12:
        return np.packbits(digits).tobytes()
    high, low = digits[:, :8].reshape(-1, 32), digits[:, 8:].reshape(-1, 4, 2)[:, ::-1]
    return np.packbits(np.hstack([high, low.reshape(-1, 8)])).tobytes()


def metadata(model, shape, zoom=-297, focus=309):
    """Metadata of a frame, as far as they are read."""
    bits, endianness, first, black, white = SIDES[model]
    form = {
        "pixelPacking": {"bitsPerPixel": bits, "endianness": endianness},
        "pixelFormat": {
            "rightShift": 0,
            "black": dict.fromkeys(("r", "gr", "gb", "b"), black),
            "white": dict.fromkeys(("r", "gr", "gb", "b"), white),
        },
        "mosaic": {"tile": "r,gr:gb,b", "upperLeftPixel": first},
    }
    old = model == "F01"
    image = {"height": shape[0], "width": shape[1]}
    image |= {"rawDetails": form} if old else form
    return {
        "image": image,
        "camera": {"make": "Lytro, Inc.", "model": model},
        "devices": {"lens": {"zoomStep": zoom, "focusStep": focus}},
    }


def json_bytes(values):
    return json.dumps(values).encode()


def name_of(data):
    return "sha1-" + hashlib.sha1(data).hexdigest()


def section(kind, data, name=None, length=None):
    """A section with its header, up to the next multiple of 16 bytes."""
    head = b"\x89" + kind + b"\r\n\x1a\n" + struct.pack(">II", 0, length or len(data))
    head += (name or name_of(data)).encode() + bytes(35)
    assert len(head) == 96
    return head + data + bytes(-len(data) % 16)


START = b"\x89LFP\r\n\x1a\n" + struct.pack(">II", 1, 0)


def container(model, facts, packed, serial="B5143909630", white=None, more=None):
    """A container with the table of contents first (F01) or last (Illum)."""
    private = json.dumps({"camera": {"serialNumber": serial}}).encode()
    contents = {
        "metadataRef": json.dumps(facts).encode(),
        "privateMetadataRef": private,
        "imageRef": packed,
        **({} if white is None else {"modulationDataRef": white}),
    }
    frame = {"frame": {key: name_of(data) for key, data in contents.items()}}
    if model == "F01":
        table = {"picture": {"frameArray": [frame], **(more or {})}}
    else:
        table = {"frames": [frame], **(more or {})}
    sections = [section(b"LFC", data) for data in contents.values()]
    head = section(b"LFM", json.dumps(table).encode())
    return START + b"".join([head, *sections] if model == "F01" else [*sections, head])


def white_pair(model, facts, mosaic, serial="B5143909630"):
    """Metadata and pixels of a white image of the camera's own set, MOD_*.TXT and MOD_*.RAW."""
    frame = {
        "frame": {
            "privateMetadata": {"camera": {"serialNumber": serial}},
            "metadata": facts,
            "imageRef": "unknown",
        }
    }
    text = json.dumps({"master": {"picture": {"frameArray": [frame]}}})
    return text.encode(), pack(mosaic, SIDES[model][0])


def tar_of(members):
    """An archive of plain files, {name: data}."""
    file = io.BytesIO()
    with tarfile.open(fileobj=file, mode="w") as archive:
        for name, data in members.items():
            member = tarfile.TarInfo(name)
            member.size = len(data)
            archive.addfile(member, io.BytesIO(data))
    return file.getvalue()


def table_only(table, *contents):
    """A container of a table of contents, as values or as bytes, and these sections."""
    text = table if isinstance(table, bytes) else json_bytes(table)
    return START + section(b"LFM", text) + b"".join(section(b"LFC", data) for data in contents)


STEPS = ((-300, 100), (-300, 320), (-280, 309), (-900, 309))
"""Zoom and focus steps of a set of white images."""


def white_set(rng, model="ILLUM", serial="B5143909630"):
    """White images of a camera at these steps, 6 x 8 pixels, and their mosaics."""
    files, mosaics, white = {}, [], SIDES[model][4]
    for k, (zoom, focus) in enumerate(STEPS):
        mosaics.append(rng.integers(white // 2, white + 1, (6, 8), np.uint16))
        pair = white_pair(model, metadata(model, (6, 8), zoom, focus), mosaics[-1], serial)
        files |= dict(zip((f"MOD_{k:04d}.TXT", f"mod_{k:04d}.raw"), pair, strict=True))
    return files, mosaics
