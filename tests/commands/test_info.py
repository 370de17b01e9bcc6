"""What `lf-flame info` says of files, and the previews that it writes."""

from datetime import datetime
from time import time

import lytro_files as own
import numpy as np
import pytest
import tifffile
from builders import camera_toml
from click.testing import CliRunner
from focused_pictures import Camera, Waves

from lf_flame import InputError, LightField
from lf_flame.commands.cli import commands
from lf_flame.formats import write_focal_stack, write_light_field
from lf_flame.formats.images import write_image


@pytest.fixture
def told(tmp_path, monkeypatch):
    """What the command prints about a file in the working folder."""
    monkeypatch.chdir(tmp_path)

    def call(*words):
        result = CliRunner().invoke(commands, ["info", *words])
        if result.exception is not None:
            raise result.exception
        return result.stdout

    return call


def write_picture(path, model="ILLUM", **options):
    mosaic = np.full((8, 12), 300)
    facts = options.pop("facts", own.metadata(model, mosaic.shape))
    packed = own.pack(mosaic, own.SIDES[model][0])
    path.write_bytes(own.container(model, facts, packed, **options))


def test_a_lytro_picture(told, tmp_path):
    write_picture(tmp_path / "my photo.lfr")
    said = told("my photo.lfr")
    for words in (
        "picture of a Lytro camera",
        "ILLUM, serial number B5143909630",
        "12 x 8 pixels of 10 bits, grbg mosaic",
        "missing: a white image of this camera",
        "next: lf-flame refocus 'my photo.lfr' --white caldata-B5143909630.tar",
    ):
        assert words in said
    write_picture(tmp_path / "b.lfp", "F01", white=own.pack(np.full((8, 12), 2000), 12))
    said = told("b.lfp")
    assert "white image   in the file" in said
    assert "missing" not in said
    assert said.endswith("next: lf-flame refocus b.lfp\n")


def test_text_from_a_file_steers_no_terminal(told, tmp_path):
    facts = own.metadata("ILLUM", (8, 12))
    facts["camera"]["model"] = "\x1b[31mred\nnext: rm -r /" + "x" * 5000
    write_picture(tmp_path / "a.lfr", facts=facts, serial="\x1b]0;title\x07 ; rm -r /")
    said = told("a.lfr")
    assert "\x1b" not in said
    assert "\nnext: rm" not in said
    assert max(map(len, said.splitlines())) < 700
    assert "--white 'caldata-?]0;title? ; rm -r /.tar'" in said


def test_white_images(told, tmp_path):
    files = {}
    for k, zoom in enumerate((-700, -300, -300)):
        facts = own.metadata("ILLUM", (8, 12), zoom, 100 + k)
        pair = own.white_pair("ILLUM", facts, np.full((8, 12), 700))
        files |= dict(zip((f"MOD_{k:04d}.TXT", f"MOD_{k:04d}.RAW"), pair, strict=True))
    (tmp_path / "caldata-B5.tar").write_bytes(own.tar_of(files))
    (tmp_path / "sn").mkdir()
    for name, data in files.items():
        (tmp_path / "sn" / name).write_bytes(data)
    for source in ("caldata-B5.tar", "sn"):
        said = told(source)
        assert "images        3" in said
        assert "cameras       B5143909630" in said
        assert f"next: lf-flame refocus PICTURE.lfr --white {source}" in said


@pytest.mark.slow
def test_focused_lenslets_are_not_taken_for_others(told, tmp_path):
    camera = Camera()
    raw = np.rint(40000 * camera.record(3.1, Waves())).astype(np.uint16)
    write_image(tmp_path / "raw.png", raw)
    (tmp_path / "calibration.xml").write_text(camera.xml())
    said = told("raw.png")
    assert "hexagonal lenslets, pitch 23." in said
    assert "`lf-flame convert` reads focused lenslets, such as those of Raytrix" in said
    said = told("calibration.xml")
    assert "calibration.xml: calibration of a Raytrix camera" in said
    assert "pitch 23.300 pixels along rows" in said
    assert "virtual depths of 1 to 3, 2.8 to 4, 3.8 to 100" in said
    assert said.endswith("next: lf-flame convert RAW.png views.npz --focused calibration.xml\n")


def test_other_light_fields(told, tmp_path, rng, monkeypatch):
    monkeypatch.setattr("sys.argv", ["/bin/lf-flame", "convert", "views"])
    light_field = LightField(rng.uniform(size=(3, 3, 20, 30)))
    write_light_field(light_field, tmp_path / "views")
    write_light_field(light_field, tmp_path / "a.npz")
    made_by = told("a.npz").partition("  made by       ")[2].partition("\n")[0]
    assert made_by.rpartition(", ")[0].endswith("convert views")
    assert abs(datetime.fromisoformat(made_by.rpartition(", ")[2]).timestamp() - time()) < 60
    write_focal_stack(rng.uniform(size=(4, 5, 6)), [0, 1, 2, 3], tmp_path / "stack.tif")
    said = told("views")
    assert "3 x 3, of 20 x 30 pixels, grey" in said
    assert "note: order row,col, as the numbers are: the parallax does not show an order" in said
    assert said.endswith("next: lf-flame refocus views\n")
    said = told("a.npz")
    assert "3 x 3, of 20 x 30 pixels, grey" in said
    assert "note: order row,col, as stored" in said
    assert "4, at slopes from 0 to 3" in told("stack.tif")
    write_focal_stack(rng.uniform(size=(1, 5, 6)), [0.5], tmp_path / "one.tif")
    assert "1, at slopes from 0.5 to 0.5" in told("one.tif")
    tifffile.imwrite(tmp_path / "pages.tif", light_field.views, photometric="minisblack")
    assert "3 x 3, of 20 x 30 pixels, grey" in told("pages.tif")


def lenslets(pitch, side):
    y, x = np.indices((side, side)) % pitch - (pitch - 1) / 2
    return np.clip(pitch / 2 - np.hypot(y, x), 0.05, 1)


def test_raw_and_lenslet_images(told, tmp_path, rng):
    light_field = LightField(rng.uniform(size=(5, 5, 20, 30)))
    write_light_field(light_field, tmp_path / "plain.png")
    raw = np.rint(60000 * lenslets(12.3, 200)).astype(np.uint16)
    write_image(tmp_path / "raw.png", raw)
    said = told("raw.png")
    assert "rectangular lenslets, pitch 12.3" in said
    assert "next: lf-flame refocus raw.png --white WHITE.png" in said
    given = ["--white", "raw.png", "--dark", "dark.png", "--bayer", "rggb"]
    write_image(tmp_path / "dark.png", np.full(raw.shape, 500, np.uint16))
    light = (raw + 500).astype(np.uint16)
    light[::2, ::2] //= 3  # red
    light[1::2, 1::2] //= 3  # blue
    write_image(tmp_path / "light.png", light)
    given[1] = "light.png"
    assert told("light.png", *given).endswith(
        f"next: lf-flame refocus light.png {' '.join(given)}\n"
    )
    (tmp_path / "five.toml").write_text(camera_toml(5, (16, 16)))
    assert told("light.png", *given, "--camera", "five.toml").endswith(
        f"{' '.join(given)} --views 5 --camera five.toml\n"
    )
    for option, why in ((given[2:4], "give a white image"), (given[4:], "--bayer does not apply")):
        with pytest.raises(InputError, match=why):
            told("raw.png", *option)
    assert "divides its 100 x 150 pixels (2, 5, 10, 25, 50)" in told("plain.png")
