"""Image files are decoded to the levels that they hold, and nothing else happens."""

import os
import stat
import tracemalloc
import zlib
from contextlib import nullcontext, suppress

import imagecodecs
import numpy as np
import pytest
import tifffile
from PIL import EpsImagePlugin, Image

from lf_flame import InputError
from lf_flame._common.images import read_pixels, read_shape
from lf_flame._common.input_files import LIMIT
from lf_flame.formats import read_focal_stack
from lf_flame.formats.images import is_stack, read_image
from lf_flame.formats.reading import read_light_field
from lf_flame.scenes.scene_files import read_scene

EPS = b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 8 8\n%%EndComments\n%%EOF\n"


@pytest.fixture
def ghostscript(tmp_path, monkeypatch):
    """A program in Ghostscript's place that leaves a mark when it is started."""
    program, mark = tmp_path / "bin" / "gs", tmp_path / "started"
    program.parent.mkdir()
    program.write_text(f"#!/bin/sh\ntouch {mark}\nexit 1\n")
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", f"{program.parent}:/usr/bin:/bin")
    monkeypatch.setattr(EpsImagePlugin, "gs_binary", None)
    return mark


def test_a_picture_starts_no_program(tmp_path, ghostscript):
    """PostScript under the name of a picture, wherever pictures are read."""
    folder = tmp_path / "views"
    folder.mkdir()
    for view in range(4):
        (folder / f"view_{view}.png").write_bytes(EPS)
    picture = folder / "view_0.png"
    scene = tmp_path / "scene.toml"
    scene.write_text(
        '[[layers]]\nimage = "views/view_0.png"\ndepth_mm = 1.0\nsize_mm = [1.0, 1.0]\n'
    )
    for read, path in ((read_pixels, picture), (read_image, picture), (read_scene, scene),
                       (read_light_field, folder)):  # fmt: skip
        with pytest.raises(InputError, match=r"view_0\.png cannot be read"):
            read(path)
    assert not ghostscript.exists()


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".bmp", ".webp", ".ppm", ".tif"])
def test_pictures_of_the_usual_formats_are_read(tmp_path, rng, suffix):
    levels = rng.integers(0, 256, (9, 7, 3)).astype(np.uint8)
    Image.fromarray(levels).save(
        tmp_path / f"a{suffix}", **{"lossless": True} if "w" in suffix else {}
    )
    found = read_pixels(tmp_path / f"a{suffix}")
    assert found.shape == levels.shape
    if suffix != ".jpg":
        np.testing.assert_array_equal(found, levels)


def test_a_palette_keeps_its_transparency(tmp_path):
    image = Image.new("P", (2, 1))
    image.putpalette([255, 0, 0, 0, 255, 0])
    image.putdata([0, 1])
    image.save(tmp_path / "a.png", transparency=1)
    found = read_pixels(tmp_path / "a.png")
    np.testing.assert_array_equal(found, [[[255, 0, 0, 255], [0, 255, 0, 0]]])


@pytest.mark.parametrize(
    ("axes", "form"),
    [("XY", {"metadata": {}}), ("CYX", {"metadata": {}}), ("YXC", {"metadata": {}}),
     ("CYX", {"imagej": True}), ("CYX", {"ome": True}), ("CXY", {"metadata": {}})],
)  # fmt: skip
def test_axes_are_read_as_a_file_declares_them(tmp_path, rng, axes, form):
    levels = rng.integers(0, 256, (9, 7, 3)[: len(axes)]).astype(np.uint8)
    stored = np.einsum(f"{'YXC'[: len(axes)]}->{axes}", levels)
    form = {**form, "metadata": {"axes": axes}}
    tifffile.imwrite(tmp_path / "a.tif", stored, photometric="minisblack", **form)
    np.testing.assert_array_equal(read_image(tmp_path / "a.tif"), levels / np.float32(255))


@pytest.mark.parametrize(
    ("axes", "count"), [("QYX", 3), ("ZYX", 3), ("ZYX", 4), ("TYX", 3), ("CYX", 2), ("CYX", 4)]
)
def test_pages_and_other_channels_are_no_colours(tmp_path, rng, axes, count):
    levels = rng.integers(0, 256, (count, 9, 7)).astype(np.uint8)
    for form in ({"imagej": axes != "QYX", "metadata": {"axes": axes}}, {}):
        tifffile.imwrite(tmp_path / "a.tif", levels, photometric="minisblack", **form)
        with pytest.raises(InputError, match=r"a\.tif must have 1 or 3 channels, got an array of"):
            read_image(tmp_path / "a.tif")


@pytest.mark.parametrize(
    ("kind", "highest"), [("P2", 1023), ("P3", 255), ("P5", 1023), ("P5", 65535), ("P6", 255)]
)
def test_netpbm_keeps_all_levels(tmp_path, rng, highest, kind):
    shape = (5, 7, 3) if kind in ("P3", "P6") else (5, 7)
    levels = rng.integers(0, highest + 1, shape)
    head = f"{kind} # made here\n7 5\n{highest}\n".encode()
    if kind in ("P2", "P3"):
        data = b"# more 9\n" + b" ".join(str(n).encode() for n in levels.ravel())
    else:
        data = levels.astype(">u2" if highest > 255 else "u1").tobytes()
    (tmp_path / "a.ppm").write_bytes(head + data)
    rounding = 0.51 / 65535 if highest == 1023 else 4e-8
    found = read_image(tmp_path / "a.ppm")
    np.testing.assert_allclose(found, levels / highest, atol=rounding, rtol=0)
    (tmp_path / "a.ppm").write_bytes(head + data[: len(data) // 2])
    with pytest.raises(InputError, match=r"a\.ppm cannot be read: it is damaged"):
        read_image(tmp_path / "a.ppm")


PACKINGS = {
    "lzw": imagecodecs.lzw_encode, "zlib": zlib.compress, "zstd": imagecodecs.zstd_encode,
    "packbits": imagecodecs.packbits_encode,
}  # fmt: skip


@pytest.mark.parametrize("order", "<>")
def test_levels_of_12_bits_are_fractions_of_the_highest(tmp_path, rng, order):
    levels = rng.integers(0, 2**12, (9, 8), np.uint16)
    bits = "".join(f"{level:012b}" for level in levels.ravel())
    packed = int(bits, 2).to_bytes(len(bits) // 8)
    form = {"shape": (9, 8), "dtype": "u2", "bitspersample": 12, "rowsperstrip": 9}
    tifffile.imwrite(tmp_path / "a.tif", iter([packed]), byteorder=order, **form)
    np.testing.assert_array_equal(read_pixels(tmp_path / "a.tif"), levels / np.float32(4095))


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize(("packing", "predictor"), [("lzw", None), ("lzw", 3), ("zlib", 3)])
def test_floats_are_read_in_either_byte_order(tmp_path, rng, order, packing, predictor):
    values = rng.uniform(size=(9, 8)).astype(np.float32)
    form = {"byteorder": order, "compression": packing, "predictor": predictor}
    tifffile.imwrite(tmp_path / "a.tif", values, **form)
    np.testing.assert_array_equal(read_image(tmp_path / "a.tif"), values)


PICTURE, THUMBNAIL = np.arange(63, dtype=np.uint16).reshape(7, 9), np.full((2, 3), 7, np.uint16)


@pytest.mark.parametrize(
    ("pages", "inside"),
    [
        ([(THUMBNAIL, 1), (PICTURE, 0)], 0),
        ([(PICTURE, 0), (THUMBNAIL, 1)], 0),
        ([(THUMBNAIL, 1), (PICTURE, 0)], 1),  # as in DNG
        ([(PICTURE, 0), (PICTURE[::2, ::2], 1)], 1),  # a pyramid
    ],
)
def test_the_picture_is_the_page_in_full_resolution(tmp_path, pages, inside):
    with tifffile.TiffWriter(tmp_path / "a.tif") as file:
        for number, (page, kind) in enumerate(pages):
            inner = inside if number == 0 and inside else None
            file.write(page, subfiletype=kind, subifds=inner, metadata=None)
    np.testing.assert_array_equal(read_pixels(tmp_path / "a.tif"), PICTURE)
    assert read_shape(tmp_path / "a.tif") == (7, 9, 1)
    assert not is_stack(tmp_path / "a.tif")


@pytest.mark.parametrize("thumbnail", [False, True])
@pytest.mark.parametrize("kind", [0, 2])
def test_pages_of_one_form_are_a_stack_with_a_thumbnail_or_without(tmp_path, thumbnail, kind):
    pages = np.stack([PICTURE + k for k in range(4)])
    with tifffile.TiffWriter(tmp_path / "a.tif") as file:
        if thumbnail:
            file.write(THUMBNAIL, subfiletype=1, metadata=None)
        for page in pages:
            file.write(page, subfiletype=kind, metadata=None)
    assert is_stack(tmp_path / "a.tif")
    stack, _ = read_focal_stack(tmp_path / "a.tif")
    np.testing.assert_array_equal(stack, pages / np.float32(65535))


@pytest.mark.parametrize("suffix", [".png", ".tif"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_pictures_are_turned_as_they_are_to_be_seen(tmp_path, rng, orientation, suffix):
    """By the words of TIFF 6.0: where the first row and the first column are to be seen."""
    levels = rng.integers(0, 256, (5, 7)).astype(np.uint8)
    rows, columns = [
        ("top", "left"), ("top", "right"), ("bottom", "right"), ("bottom", "left"),
        ("left", "top"), ("right", "top"), ("right", "bottom"), ("left", "bottom"),
    ][orientation - 1]  # fmt: skip
    seen = levels if rows in ("top", "bottom") else levels.T
    seen = seen[::-1] if "bottom" in (rows, columns) else seen
    seen = seen[:, ::-1] if "right" in (rows, columns) else seen
    path = tmp_path / f"a{suffix}"
    if suffix == ".tif":
        tifffile.imwrite(path, levels, extratags=[(274, "H", 1, orientation, True)])
    else:
        exif = Image.Exif()
        exif[274] = orientation
        Image.fromarray(levels).save(path, exif=exif)
    np.testing.assert_array_equal(read_pixels(path), seen)


@pytest.mark.parametrize("samples", [2, 4])
def test_samples_of_which_the_file_says_nothing_are_refused(tmp_path, samples):
    """With the tag of the transparency they are read, and without it not."""
    pixels = np.full((9, 8, samples), 100, np.uint8)
    tifffile.imwrite(
        tmp_path / "a.tif", pixels, photometric="rgb" if samples == 4 else "minisblack",
        planarconfig="contig", extrasamples=["unassalpha"],
    )  # fmt: skip
    assert read_image(tmp_path / "a.tif").shape == ((9, 8, 3) if samples == 4 else (9, 8))
    whole = bytearray((tmp_path / "a.tif").read_bytes())
    at = whole.index((338).to_bytes(2, "little") + (3).to_bytes(2, "little"))
    whole[at : at + 2] = (40000).to_bytes(2, "little")  # a tag that nobody knows
    (tmp_path / "a.tif").write_bytes(whole)
    with pytest.raises(InputError, match=rf"a\.tif has {samples} samples per pixel"):
        read_image(tmp_path / "a.tif")


def tiff(pixels, **form):
    return lambda path: tifffile.imwrite(path, np.asarray(pixels), **form)


def pages(*some):
    def write(path):
        with tifffile.TiffWriter(path) as file:
            for page, kind, *packing in some:
                file.write(page, subfiletype=kind, metadata=None, compression=(*packing, None)[0])

    return write


def samples(count, photometric, extra=None):
    return tiff(
        np.ones((9, 8, count), np.uint8), photometric=photometric, planarconfig="contig",
        extrasamples=extra,
    )  # fmt: skip


REFUSED = {
    "inks.tif": (samples(4, "separated"), "does not store grey or RGB light .* but SEPARATED"),
    "lab.tif": (lambda path: Image.new("LAB", (8, 8)).save(path), "but CIELAB"),
    "white.tif": (tiff(np.ones((4, 5), "u1"), photometric="miniswhite"), "but MINISWHITE"),
    "four.tif": (samples(4, "minisblack"), "has 4 samples per pixel"),
    "two.tif": (samples(2, "minisblack"), "has 2 samples per pixel"),
    "unsaid.tif": (samples(4, "rgb", ["unspecified"]), "has 4 samples per pixel"),
    "multiplied.tif": (samples(4, "rgb", ["assocalpha"]), "has 4 samples per pixel"),
    "deep.tif": (tiff(np.ones((4, 5), np.uint32)), "or floats, got uint32"),
    "larger.tif": (pages((THUMBNAIL, 0), (PICTURE, 0)), "one picture in full .* got .2, 3. of u"),
    "other.tif": (pages((PICTURE, 0), (PICTURE.astype("f4"), 0)), "or several of one form, stored"),
    "mixed.tif": (pages((PICTURE, 0), (PICTURE, 0, "zlib")), "of one form, stored alike, got"),
    "reduced.tif": (pages((THUMBNAIL, 1), (PICTURE, 1)), "one picture in full .* got none"),
    "lzma.tif": (tiff(np.ones((9, 8), np.uint8), compression="lzma"), r"34925 \(LZMA\)"),
    "jpeg.tif": (tiff(np.ones((9, 8), np.uint8), compression="jpeg"), r"compression 7 \(JPEG\)"),
    "large.png": (lambda path: Image.new("L", (3000, 3000)).save(path), "would need 0.081 GB"),
    "deep.ppm": (lambda path: path.write_bytes(b"P6 1 1 65535 abcdef"), "has colours of 16 bits"),
    "inks.jpg": (lambda path: Image.new("CMYK", (8, 8)).save(path), "stores ink"),
    "empty.tif": (lambda path: path.write_bytes(b""), "cannot be read: it is damaged"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_pictures_that_cannot_be_used_are_refused(tmp_path, monkeypatch, name):
    write, words = REFUSED[name]
    write(tmp_path / name)
    monkeypatch.setenv(LIMIT, "0.05")
    with pytest.raises(InputError, match=rf"{name}.*{words}") as refused:
        read_image(tmp_path / name)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("packing", PACKINGS)
def test_a_strip_unpacks_to_no_more_than_its_declared_size(tmp_path, packing):
    """200,000 bytes where the picture has 72, or too few, are refused or cut to the picture."""
    pack, form = PACKINGS[packing], {"shape": (9, 8), "dtype": "u1", "rowsperstrip": 9}
    whole = bytes(range(72))
    for strip, pixels, refused in (
        (pack(whole), whole, nullcontext()),
        (pack(whole)[:-20], whole, suppress(InputError)),
        (pack(bytes(200_000)), bytes(72), suppress(InputError)),
    ):
        tifffile.imwrite(tmp_path / "a.tif", iter([strip]), compression=packing, **form)
        tracemalloc.start()
        with refused:
            assert read_pixels(tmp_path / "a.tif").tobytes() == pixels
        assert tracemalloc.get_traced_memory()[1] < 4e5
        tracemalloc.stop()


def test_the_checksums_of_a_png_are_checked(tmp_path, rng):
    Image.fromarray(rng.integers(0, 256, (9, 7)).astype(np.uint8)).save(tmp_path / "a.png")
    whole = bytearray((tmp_path / "a.png").read_bytes())
    start = whole.find(b"IDAT")
    whole[start + 4 + int.from_bytes(whole[start - 4 : start])] ^= 1
    (tmp_path / "a.png").write_bytes(whole)
    with pytest.raises(InputError, match=r"a\.png cannot be read: it is damaged"):
        read_image(tmp_path / "a.png")


@pytest.mark.parametrize("other", ["../secret.tif", "../pipe.tif"])
@pytest.mark.parametrize("read", [read_image, read_light_field, read_pixels])
def test_files_that_a_picture_names_are_not_opened(tmp_path, other, read):
    tifffile.imwrite(tmp_path / "secret.tif", np.full((4, 5), 200, np.uint8))
    os.mkfifo(tmp_path / "pipe.tif")
    (tmp_path / "in").mkdir()
    data = "".join(
        f'<TiffData IFD="0" FirstZ="{k}" PlaneCount="1"><UUID FileName="{name}">urn:{k}</UUID>'
        f"</TiffData>"
        for k, name in enumerate(("a.ome.tif", other))
    )
    told = (
        '<OME xmlns="http://www.openmicroscopy.org/Schemas/OME/2016-06"><Image ID="Image:0">'
        '<Pixels ID="Pixels:0" DimensionOrder="XYZCT" Type="uint8" SizeX="5" SizeY="4" SizeZ="2" '
        f'SizeC="1" SizeT="1"><Channel ID="Channel:0:0" SamplesPerPixel="1"/>{data}</Pixels>'
        "</Image></OME>"
    )
    path = tmp_path / "in" / "a.ome.tif"
    tifffile.imwrite(path, np.zeros((4, 5), np.uint8), description=told, metadata=None)
    with pytest.raises(InputError, match="refers to other files"):
        read(path)
