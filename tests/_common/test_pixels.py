"""Image files are decoded, and nothing else happens."""

import stat

import numpy as np
import pytest
import tifffile
from PIL import EpsImagePlugin, Image

from lf_flame import InputError
from lf_flame._common.pixels import read_pixels
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
