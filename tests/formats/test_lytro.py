"""Pictures of Lytro cameras: containers, packed pixels, metadata and white images."""

import json

import lytro_files as own
import numpy as np
import pytest

from lf_flame import InputError
from lf_flame.formats.lytro.picture import read_lytro
from lf_flame.formats.lytro.white import find_white

MODELS = ("F01", "ILLUM")


def levels(rng, model, shape=(6, 8), low=0):
    return rng.integers(low, own.SIDES[model][4] + 1, shape, np.uint16)


def written(folder, model, mosaic, facts=None, name="a.lfp", **options):
    facts = facts or own.metadata(model, mosaic.shape)
    path = folder / name
    path.write_bytes(own.container(model, facts, own.pack(mosaic, own.SIDES[model][0]), **options))
    return path


@pytest.mark.parametrize("model", MODELS)
def test_every_level_comes_out_of_a_container(tmp_path, rng, model):
    mosaic, white = levels(rng, model), levels(rng, model)
    packed = own.pack(white, own.SIDES[model][0])
    picture = read_lytro(written(tmp_path, model, mosaic, name="a.LFR", white=packed))
    assert picture.mosaic.dtype == np.uint16
    np.testing.assert_array_equal(picture.mosaic, mosaic)
    np.testing.assert_array_equal(picture.white_image.mosaic, white)
    black, full = own.SIDES[model][3:]
    expected = (mosaic.astype(float) - black) / (full - black)
    np.testing.assert_allclose(picture.radiance, expected, atol=2e-7)


@pytest.mark.parametrize("model", MODELS)
def test_any_bytes_are_unpacked_as_by_imageio(tmp_path, rng, monkeypatch, model):
    lytro = pytest.importorskip("imageio.plugins.lytro")
    bits, shape = own.SIDES[model][0], (6, 40)
    monkeypatch.setattr(lytro, f"LYTRO_{model}_IMAGE_SIZE", shape)  # it takes whole frames alone
    packed = rng.bytes(shape[0] * shape[1] * bits // 8)
    (tmp_path / "a.raw").write_bytes(packed)
    (tmp_path / "a.json").write_text(json.dumps(own.metadata(model, shape)))
    reader = lytro.LytroF01RawFormat if model == "F01" else lytro.LytroIllumRawFormat
    theirs = reader.rearrange_bits(np.frombuffer(packed, np.uint8).astype(np.uint16))
    mosaic = read_lytro(tmp_path / "a.raw").mosaic
    np.testing.assert_array_equal(mosaic, np.rint(theirs * (2**bits - 1)))


@pytest.mark.parametrize("model", MODELS)
def test_metadata_of_both_cameras(tmp_path, rng, model):
    path = written(tmp_path, model, levels(rng, model))
    facts = read_lytro(path).metadata
    assert (facts.shape, facts.model, facts.serial) == ((6, 8), model, "B5143909630")
    assert facts.bayer == {"F01": "bggr", "ILLUM": "grbg"}[model]
    assert (facts.zoom_step, facts.focus_step) == (-297, 309)


@pytest.mark.parametrize("first", ["r", "gr", "gb", "b"])
def test_patterns_and_levels_begin_at_the_upper_left_pixel(tmp_path, rng, first):
    facts = own.metadata("ILLUM", (6, 8))
    facts["image"]["mosaic"]["upperLeftPixel"] = first
    facts["image"]["pixelFormat"]["black"] = {"r": 10, "gr": 20, "gb": 30, "b": 40}
    facts = read_lytro(written(tmp_path, "ILLUM", levels(rng, "ILLUM"), facts)).metadata
    names = {"r": "r gr gb b", "gr": "gr r b gb", "gb": "gb b r gr", "b": "b gb gr r"}[
        first
    ].split()
    assert facts.bayer == "".join(name[0] for name in names)
    expected = [{"r": 10, "gr": 20, "gb": 30, "b": 40}[name] for name in names]
    np.testing.assert_array_equal(facts.black.ravel(), expected)


def test_a_raw_file_is_read_with_the_metadata_beside_it(tmp_path, rng):
    mosaic = levels(rng, "F01")
    text, packed = own.white_pair("F01", own.metadata("F01", (6, 8)), mosaic, "A102")
    (tmp_path / "MOD_0007.RAW").write_bytes(packed)
    (tmp_path / "MOD_0007.TXT").write_bytes(text)
    picture = read_lytro(tmp_path / "MOD_0007.RAW")
    np.testing.assert_array_equal(picture.mosaic, mosaic)
    assert picture.metadata.serial == "A102"
    (tmp_path / "b.raw").write_bytes(packed)
    text = json.dumps(own.metadata("F01", (6, 8)))
    (tmp_path / "b.json").write_text(text, encoding="utf-8-sig")
    np.testing.assert_array_equal(read_lytro(tmp_path / "b.raw").mosaic, mosaic)


def test_empty_sections_and_zeros_at_the_end_do_no_harm(tmp_path, rng):
    mosaic = levels(rng, "F01")
    whole = written(tmp_path, "F01", mosaic).read_bytes()
    short = b"\x89LFC\r\n\x1a\n" + bytes(8)
    for data in (
        whole[:16] + short + whole[16:],
        whole + own.section(b"LFC", b""),
        whole + bytes(64),
    ):
        (tmp_path / "a.lfp").write_bytes(data)
        np.testing.assert_array_equal(read_lytro(tmp_path / "a.lfp").mosaic, mosaic)


@pytest.mark.parametrize("packed", [False, True])
def test_the_white_image_is_chosen_by_serial_zoom_and_focus(tmp_path, rng, packed):
    """The nearest zoom step counts first: -300 beside -297, not -280 with the very focus step."""
    files, mosaics = own.white_set(rng)
    others, _ = own.white_set(rng, serial="B0000000000")
    files = {name.replace("_0", "_1"): data for name, data in files.items()} | others
    where = tmp_path / "caldata.tar"
    if packed:  # names that lead nowhere, as nothing is unpacked
        members = {f"../../{name}": data for name, data in files.items()}
        where.write_bytes(own.tar_of({**members, "/tmp/MOD_9999.TXT": b"{}", "../evil": b"x"}))
    else:
        where.mkdir()
        for name, data in files.items():
            (where / name).write_bytes(data)
    before = sorted(tmp_path.rglob("*"))
    picture = read_lytro(written(tmp_path, "ILLUM", levels(rng, "ILLUM")))
    np.testing.assert_array_equal(find_white(picture, where).mosaic, mosaics[1])
    closer = own.metadata("ILLUM", (6, 8), zoom=-285, focus=100)
    picture = read_lytro(written(tmp_path, "ILLUM", levels(rng, "ILLUM"), closer))
    np.testing.assert_array_equal(find_white(picture, where).mosaic, mosaics[2])
    assert sorted(tmp_path.rglob("*")) == sorted([tmp_path / "a.lfp", *before])


def test_dark_white_images_are_left_out(tmp_path, rng):
    picture = read_lytro(written(tmp_path, "F01", levels(rng, "F01")))
    for k, level in ((0, 499), (2, 501)):
        facts = own.metadata("F01", (6, 8), focus=309 + k)
        pair = own.white_pair("F01", facts, np.full((6, 8), level))
        for ending, data in zip(("TXT", "RAW"), pair, strict=True):
            (tmp_path / f"MOD_{k:04d}.{ending}").write_bytes(data)
    assert np.all(find_white(picture, tmp_path).mosaic == 501)
    facts = own.metadata("F01", (6, 8), zoom=None)
    text, packed = own.white_pair("F01", facts, np.full((6, 8), 502))
    (tmp_path / "MOD_0003.TXT").write_bytes(text)
    (tmp_path / "MOD_0003.RAW").write_bytes(packed)
    assert np.all(find_white(picture, tmp_path).mosaic == 501)
    (tmp_path / "MOD_0002.TXT").unlink()
    assert np.all(find_white(picture, tmp_path).mosaic == 502)  # the only one left
    (tmp_path / "MOD_0003.TXT").unlink()
    with pytest.raises(InputError, match=r"of camera B5143909630; images found: 1 .* too dark: 1"):
        find_white(picture, tmp_path)
