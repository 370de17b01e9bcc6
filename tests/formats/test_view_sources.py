"""Views in an archive, and side by side in one picture."""

import io
import struct
import tracemalloc
import zipfile

import numpy as np
import pytest
import tifffile
from builders import textured
from PIL import Image

from lf_flame import InputError, read_light_field
from lf_flame._common.memory import LIMIT
from lf_flame.formats import scan_view_folder
from lf_flame.formats.coding import note_on_coding


def drawn(rng, views=(3, 4)):
    """Draw a plane of blurred noise, as levels of 8 bits."""
    return np.rint(255 * textured(rng, 0.7, views, (60, 66))).astype(np.uint8)


def png(view):
    held = io.BytesIO()
    Image.fromarray(view).save(held, "PNG")
    return held.getvalue()


def pack(path, files, compression=zipfile.ZIP_DEFLATED):
    with zipfile.ZipFile(path, "w", compression) as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return path


def numbered(views, form="view_{}_{}.png"):
    return {form.format(*at): png(views[at]) for at in np.ndindex(views.shape[:2])}


@pytest.mark.parametrize("folder", ["", "/abs/", "../../out/", "a/b/c/"])
def test_an_archive_is_read_like_a_folder_and_nothing_is_written(tmp_path, rng, folder):
    views = drawn(rng)
    files = numbered(views[::-1], folder + "view_{}_{}.png")
    files |= {f"__MACOSX/{folder}._{n}_0.png": b"no picture" for n in range(40)}
    files |= {folder + "readme.txt": b"", folder + ".hidden_0_9.png": b""}
    (tmp_path / "in").mkdir()
    path = pack(tmp_path / "in" / "views.zip", files)
    found = scan_view_folder(path)
    assert (found.found.order, found.left_out) == ("-row,col", 2)
    np.testing.assert_array_equal(read_light_field(path).views, views / np.float32(255))
    assert [one.name for one in tmp_path.rglob("*")] == ["in", "views.zip"]


@pytest.mark.parametrize("kind", ["tif", "packed.tif", "ppm", "png", "jpg"])
def test_pictures_of_an_archive_are_decoded_like_files(tmp_path, rng, kind):
    deep = rng.integers(0, 2**16, (2, 2, 8, 9, 3)).astype(np.uint16)
    (tmp_path / "views").mkdir()
    for at in np.ndindex(2, 2):
        path = tmp_path / "views" / f"{at[0]}_{at[1]}.{kind.rpartition('.')[2]}"
        if kind == "ppm":
            path.write_bytes(b"P6 9 8 255\n" + (deep[at] >> 8).astype(np.uint8).tobytes())
        elif kind.endswith("tif"):
            tifffile.imwrite(path, deep[at], photometric="rgb")
        else:
            Image.fromarray((deep[at] >> 8).astype(np.uint8)).save(path)
        if kind == "packed.tif":
            Image.fromarray((deep[at] >> 8).astype(np.uint8)).save(path, compression="tiff_lzw")
    files = {path.name: path.read_bytes() for path in (tmp_path / "views").iterdir()}
    path = pack(tmp_path / "views.zip", files)
    expected = read_light_field(tmp_path / "views").views
    np.testing.assert_array_equal(read_light_field(path).views, expected)
    coded = [bool(note_on_coding(one)) for one in (path, tmp_path / "views")]
    assert coded == [kind != "tif"] * 2


def patched(path, name, field, value):
    """Change a number in the central directory's entry of a file, PKZIP APPNOTE 4.3.12."""
    content = bytearray(path.read_bytes())
    at = content.rindex(b"PK\1\2", 0, content.rindex(name.encode()))
    offset, form = {"flags": (8, "<H"), "method": (10, "<H"), "size": (24, "<I")}[field]
    struct.pack_into(form, content, at + offset, value)
    path.write_bytes(content)


def test_archives_that_cannot_be_trusted_are_refused(tmp_path, rng, monkeypatch):
    files = numbered(drawn(rng, (2, 2)))
    path = pack(tmp_path / "a.zip", files)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"a\.zip cannot be read: it is damaged, or no ZIP arch"):
        read_light_field(path)
    at = whole.index(b"IHDR")
    path.write_bytes(whole[:at] + b"x" + whole[at + 1 :])
    with pytest.raises(InputError, match=r"a\.zip cannot be read: it is damaged"):
        read_light_field(path)
    for field, value, told in (
        ("flags", 1, "view_1_1.png.* is encrypted"),
        ("method", 14, "view_1_1.png in it is packed by method 14; only stored"),
    ):
        path.write_bytes(whole)
        patched(path, "view_1_1.png", field, value)
        with pytest.raises(InputError, match=told):
            read_light_field(path)
    pack(path, {f"{n}_{m}.bmp": bytes(10**6) for n in range(3) for m in range(3)})
    monkeypatch.setenv(LIMIT, "0.008")
    with pytest.raises(InputError, match=r"a\.zip would need 0\.009 GB"):
        read_light_field(path)
    monkeypatch.delenv(LIMIT)
    pack(path, files | {name.replace("view", "depth"): png for name, png in files.items()})
    with pytest.raises(
        InputError, match="several sets of images, 4 of .*depth_#_#.png|4 of .*view_#_#.png"
    ):
        read_light_field(path)


def test_a_bomb_takes_no_more_memory_than_its_size_says(tmp_path):
    """The entry says 1000 bytes, and holds ten million: the archive's reader stops at 1000."""
    path = pack(tmp_path / "a.zip", {"0_0.bmp": bytes(10**7), "0_1.bmp": b""})
    patched(path, "0_0.bmp", "size", 1000)
    tracemalloc.start()
    with pytest.raises(InputError, match=r"a\.zip cannot be read: it is damaged"):
        read_light_field(path)
    assert tracemalloc.get_traced_memory()[1] < 2e6
    tracemalloc.stop()


@pytest.mark.parametrize(
    ("order", "colour"), [("row,col", True), ("-row,col", False), ("col,row", True)]
)
def test_views_side_by_side_are_cut_apart(tmp_path, rng, order, colour):
    views = drawn(rng)
    views = np.stack([views, views // 2, 255 - views], axis=-1) if colour else views
    lines = views[::-1] if "-row" in order else views
    lines = lines.swapaxes(0, 1) if order.startswith("col") else lines
    picture = np.concatenate([np.concatenate(list(line), axis=1) for line in lines])
    Image.fromarray(picture).save(tmp_path / "mosaic.png")
    Image.fromarray(picture // 20).save(tmp_path / "dark.png")
    mosaic = f"{lines.shape[0]}x{lines.shape[1]}"
    expected = views / np.float32(255)
    found = read_light_field(tmp_path / "mosaic.png", mosaic=mosaic)
    np.testing.assert_array_equal(found.views, expected)
    stated = read_light_field(tmp_path / "mosaic.png", order=order, mosaic=mosaic)
    np.testing.assert_array_equal(stated.views, expected)
    less = read_light_field(tmp_path / "mosaic.png", mosaic=mosaic, dark=tmp_path / "dark.png")
    np.testing.assert_allclose(less.views, (views - views // 20) / 255, atol=1e-6)
