"""Image files are decoded, and nothing else happens."""

import os
import stat

import numpy as np
import pytest
import tifffile
from PIL import EpsImagePlugin, Image

from lf_flame import InputError
from lf_flame._common.images import read_pixels
from lf_flame.formats.images import read_image
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
    scene.write_text(f'[[layers]]\nimage = "{picture}"\ndepth_mm = 1.0\nsize_mm = [1.0, 1.0]\n')
    for read, path in ((read_pixels, picture), (read_image, picture), (read_scene, scene),
                       (read_light_field, folder)):  # fmt: skip
        with pytest.raises(InputError, match=r"view_0\.png cannot be read"):
            read(path)
    assert not ghostscript.exists()


def test_the_mark_is_left_where_the_program_is_started(tmp_path, ghostscript):
    (tmp_path / "picture.png").write_bytes(EPS)
    with pytest.raises(Exception), Image.open(tmp_path / "picture.png") as image:  # noqa: B017
        image.load()
    assert ghostscript.exists()


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


@pytest.mark.parametrize("planar", ["contig", "separate"])
def test_channels_come_last_however_they_are_stored(tmp_path, rng, planar):
    levels = rng.integers(0, 256, (9, 7, 3)).astype(np.uint8)
    stored = levels if planar == "contig" else np.moveaxis(levels, -1, 0)
    tifffile.imwrite(tmp_path / "a.tif", stored, photometric="rgb", planarconfig=planar)
    np.testing.assert_array_equal(read_pixels(tmp_path / "a.tif"), levels)


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


@pytest.mark.parametrize("highest", [100, 1023, 4095, 65535])
@pytest.mark.parametrize("kind", ["P2", "P3", "P5", "P6"])
def test_netpbm_keeps_all_levels(tmp_path, rng, highest, kind):
    shape = (5, 7, 3) if kind in ("P3", "P6") else (5, 7)
    levels = rng.integers(0, highest + 1, shape)
    head = f"{kind} # made here\n7 5\n{highest}\n".encode()
    if kind in ("P2", "P3"):
        data = b"# more 9\n" + b" ".join(str(n).encode() for n in levels.ravel())
    else:
        data = levels.astype(">u2" if highest > 255 else "u1").tobytes()
    (tmp_path / "a.ppm").write_bytes(head + data)
    np.testing.assert_allclose(read_image(tmp_path / "a.ppm"), levels / highest, atol=4e-8, rtol=0)
    (tmp_path / "a.ppm").write_bytes(head + data[: len(data) // 2])
    with pytest.raises(InputError, match=r"a\.ppm cannot be read: it is damaged"):
        read_image(tmp_path / "a.ppm")


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_grey_that_counts_from_white_is_turned(tmp_path, rng, dtype):
    top = np.iinfo(dtype).max
    levels = rng.integers(0, top, (9, 7), dtype, endpoint=True)
    tifffile.imwrite(tmp_path / "a.tif", levels, photometric="miniswhite")
    found = np.rint(top * read_image(tmp_path / "a.tif").astype(float))
    np.testing.assert_array_equal(found, top - levels.astype(float))


@pytest.mark.parametrize("compression", ["tiff_lzw", "group3", "group4", "packbits", "jpeg"])
def test_packed_tiff_is_read(tmp_path, rng, compression):
    levels = np.repeat(rng.integers(0, 2, (16, 2)) * 255, 8, axis=1).astype(np.uint8)
    image = Image.fromarray(levels)
    image = image.convert("1") if compression.startswith("group") else image
    image.save(tmp_path / "a.tif", compression=compression)
    np.testing.assert_allclose(read_image(tmp_path / "a.tif"), levels / 255, atol=0.03)


def lzw(data):
    """Pack without packing: each byte as a code of 9 bits, and a new table before it is full."""
    codes = [c for k in range(0, len(data), 200) for c in (256, *data[k : k + 200])] + [257]
    bits = "".join(f"{code:09b}" for code in codes)
    bits += "0" * (-len(bits) % 8)
    return int(bits, 2).to_bytes(len(bits) // 8)


@pytest.mark.parametrize("order", "<>")
def test_deep_colours_in_lzw_keep_all_bits(tmp_path, rng, order):
    levels = rng.integers(0, 2**16, (9, 8, 3)).astype(np.uint16)
    packed = lzw(levels.astype(f"{order}u2").tobytes())
    tifffile.imwrite(
        tmp_path / "a.tif", iter([packed]), shape=levels.shape, dtype="u2", byteorder=order,
        compression="adobe_deflate", photometric="rgb", rowsperstrip=9,
    )  # fmt: skip
    with tifffile.TiffFile(tmp_path / "a.tif", mode="r+b") as file:
        file.pages[0].tags["Compression"].overwrite(5)
    np.testing.assert_array_equal(read_image(tmp_path / "a.tif"), levels / np.float32(65535))


def test_packing_that_only_newer_pythons_know_is_left_to_pillow(tmp_path, rng):
    """Zstandard: tifffile looks for a decoder that Python has from 3.14 on."""
    pack = pytest.importorskip("numcodecs").Zstd().encode
    levels = rng.integers(0, 2**16, (9, 8, 3)).astype(np.uint16)
    tifffile.imwrite(
        tmp_path / "a.tif", iter([pack(levels.tobytes())]), shape=levels.shape, dtype="u2",
        compression="adobe_deflate", photometric="rgb", rowsperstrip=9,
    )  # fmt: skip
    with tifffile.TiffFile(tmp_path / "a.tif", mode="r+b") as file:
        file.pages[0].tags["Compression"].overwrite(50000)
    try:
        found = read_image(tmp_path / "a.tif")
    except InputError as error:  # where Pillow's libtiff was built without it
        assert "packed in a way (compression 50000" in str(error)  # noqa: PT017
        return
    np.testing.assert_array_equal(found, levels / np.float32(65535))


def test_deep_colours_that_pillow_would_round_are_refused(tmp_path, rng):
    """In planes of their own: of these it gives the high byte alone."""
    levels = rng.integers(0, 2**16, (3, 9, 8)).astype(np.uint16)
    tifffile.imwrite(
        tmp_path / "a.tif", iter([lzw(plane.tobytes()) for plane in levels]), shape=levels.shape,
        dtype="u2", compression="adobe_deflate", photometric="rgb", planarconfig="separate",
        rowsperstrip=9,
    )  # fmt: skip
    with tifffile.TiffFile(tmp_path / "a.tif", mode="r+b") as file:
        file.pages[0].tags["Compression"].overwrite(5)
    with pytest.raises(InputError, match=r"packed in a way \(compression 5, 16 bits\)"):
        read_image(tmp_path / "a.tif")


def test_brightness_and_colour_differences_become_rgb(tmp_path, rng):
    """By ITU-R BT.601, as in JFIF; and where several pixels share a colour, a refusal."""
    coded = rng.integers(100, 156, (9, 7, 3)).astype(np.uint8)
    y, cb, cr = np.moveaxis(coded.astype(float), -1, 0) - np.array([0, 128, 128])[:, None, None]
    rgb = np.stack([y + 1.402 * cr, y - 0.344136 * cb - 0.714136 * cr, y + 1.772 * cb], axis=-1)
    Image.fromarray(coded, "YCbCr").save(tmp_path / "a.tif")
    np.testing.assert_allclose(255 * read_image(tmp_path / "a.tif"), rgb, atol=1.01)
    with tifffile.TiffFile(tmp_path / "a.tif", mode="r+b") as file:
        file.pages[0].tags["YCbCrSubSampling"].overwrite((2, 2))
    with pytest.raises(InputError, match="packed in a way"):
        read_image(tmp_path / "a.tif")


@pytest.mark.parametrize("suffix", [".png", ".tif", "lzw.tif", ".jpg", ".webp"])
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
        packed = {
            "lzw.tif": {"compression": "tiff_lzw"}, ".jpg": {"quality": 100},
            ".webp": {"lossless": True},
        }.get(suffix, {})  # fmt: skip
        Image.fromarray(levels).save(path, exif=exif, **packed)
    found = read_pixels(path)
    found = found[..., 1] if found.ndim == 3 else found  # WebP knows no grey
    np.testing.assert_allclose(found.astype(int), seen, atol=3 if suffix == ".jpg" else 0)


@pytest.mark.parametrize(
    ("photometric", "samples", "extra"),
    [("separated", 4, None), ("minisblack", 4, None), ("minisblack", 2, None),
     ("rgb", 4, ["unspecified"]), ("rgb", 4, ["assocalpha"])],
)  # fmt: skip
def test_samples_that_are_no_plain_light_are_refused(tmp_path, photometric, samples, extra):
    tifffile.imwrite(
        tmp_path / "a.tif", np.ones((9, 8, samples), np.uint8), photometric=photometric,
        planarconfig="contig", extrasamples=extra,
    )  # fmt: skip
    with pytest.raises(InputError, match=r"a\.tif (holds no light but|has . samples to a pixel)"):
        read_image(tmp_path / "a.tif")


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
    with pytest.raises(InputError, match=rf"a\.tif has {samples} samples to a pixel"):
        read_image(tmp_path / "a.tif")


@pytest.mark.parametrize("suffix", ["png", "webp"])
def test_films_are_refused(tmp_path, suffix):
    first, *others = (Image.new("RGB", (8, 8), (90 * k, 0, 0)) for k in range(3))
    first.save(tmp_path / f"a.{suffix}", save_all=True, append_images=others)
    with pytest.raises(InputError, match="holds 3 pictures that follow each other"):
        read_image(tmp_path / f"a.{suffix}")


def test_inks_are_refused(tmp_path):
    Image.new("CMYK", (8, 8)).save(tmp_path / "a.jpg")
    with pytest.raises(InputError, match="holds no light but CMYK"):
        read_image(tmp_path / "a.jpg")


def test_a_layer_is_no_complex_picture(tmp_path):
    tifffile.imwrite(tmp_path / "a.tif", np.ones((4, 5), complex))
    (tmp_path / "a.toml").write_text(
        '[[layers]]\nimage = "a.tif"\ndepth_mm = 1.0\nsize_mm = [1.0, 1.0]\n'
    )
    with pytest.raises(InputError, match="or floats, got complex128"):
        read_scene(tmp_path / "a.toml")


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
    with pytest.raises(InputError, match="names other files"):
        read(path)
