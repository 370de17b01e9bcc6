"""Which image files are likely to be gamma-coded, by files of Pillow and hand-made chunks."""

import struct
import zlib

import numpy as np
import pytest
from PIL import Image, ImageCms
from tifffile import imwrite

from lf_flame import LightField
from lf_flame.formats import write_light_field
from lf_flame.formats.images import CODED, note_on_coding
from lf_flame.formats.reading import find_light_field


def chunk(kind, data):
    whole = kind + data
    return struct.pack(">I", len(data)) + whole + struct.pack(">I", zlib.crc32(whole))


def write_png(path, bits, *chunks):
    """A grey PNG of 2 x 2 pixels, by its specification."""
    header = struct.pack(">IIBBBBB", 2, 2, bits, 0, 0, 0, 0)
    lines = zlib.compress(2 * (b"\0" + bytes(2 * bits // 8)))
    parts = [chunk(b"IHDR", header), *chunks, chunk(b"IDAT", lines), chunk(b"IEND", b"")]
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(parts))


def png(bits, *chunks):
    return lambda path: write_png(path, bits, *chunks)


def gamma(value):
    return chunk(b"gAMA", struct.pack(">I", value))


PROFILE = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
GREY = np.arange(12).reshape(3, 4)


def by_tifffile(dtype="u1", **form):
    return lambda path: imwrite(path, GREY.astype(dtype), **form)


def by_pillow(**form):
    return lambda path: Image.fromarray(GREY.astype(np.uint8)).save(path, **form)


@pytest.mark.parametrize(
    ("name", "write", "kind"),
    [
        ("a.png", png(8), "a PNG file of 8 bits."),
        ("a.png", png(16), None),
        ("a.png", png(8, gamma(100000)), None),
        ("a.png", png(16, gamma(45455)), "a PNG file of 16 bits."),
        ("a.png", png(16, chunk(b"sRGB", b"\0")), "a PNG file of 16 bits."),
        ("a.tif", by_tifffile(), "a TIFF file of 8 bits"),
        ("a.tif", by_tifffile("u2"), None),
        ("a.tif", by_tifffile("f4"), None),
        ("a.tif", by_tifffile("u2", iccprofile=PROFILE), "a TIFF file of 16 bits with a colour"),
        ("a.tif", by_tifffile("f4", iccprofile=PROFILE), "a TIFF file of 32 bits with a colour"),
        ("a.tif", by_pillow(icc_profile=PROFILE), "a TIFF file of 8 bits with a colour profile"),
        ("a.png", by_pillow(icc_profile=PROFILE), "a PNG file of 8 bits with a colour profile"),
        ("a.jpg", by_pillow(icc_profile=PROFILE), "a JPEG file"),
        ("a.JPG", lambda path: by_pillow()(path), "a JPEG file"),
        ("a.webp", by_pillow(), "a WEBP file"),
        ("a.bmp", by_pillow(), "a BMP file"),
        ("a.pgm", by_pillow(), "a PPM file of 8 bits"),
        ("a.pgm", lambda path: path.write_bytes(b"P5 1 1 1023 ab"), None),
        ("a.pgm", lambda path: path.write_bytes(b"P5 1 1 65535 ab"), None),
        ("a.npy", lambda path: np.save(path, GREY.astype(np.uint8)), None),
    ],
)
def test_images_are_coded_by_depth_profile_or_what_they_say(tmp_path, name, write, kind):
    write(tmp_path / name)
    note = note_on_coding(tmp_path / name)
    assert bool(note) == (kind is not None)
    if kind:
        assert f"{name} is {kind}" in note
        assert note.endswith(CODED)


def test_own_images_say_that_they_are_linear(tmp_path):
    field = LightField(np.full((2, 2, 3, 3), 0.5, np.float32))
    for linear in (True, False):
        for suffix in ("", ".png", ".npz"):
            path = tmp_path / f"{linear}{suffix}"
            write_light_field(field, path, 8, linear=linear)
            found = find_light_field(path, views=2 if suffix == ".png" else None)
            assert bool(found.coded) != linear
            assert found.light_field.views[0, 0, 0, 0] == pytest.approx(0.5, abs=0.002)
