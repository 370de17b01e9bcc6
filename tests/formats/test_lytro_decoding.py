"""From the file of a Lytro camera to views: slopes, colours, lenslets, white images.

The scene is a plane of colours under round lenslets in a hexagonal array, by geometry of its own:
a pixel sees the plane where the ray through its lenslet's centre meets it.
"""

import logging

import lytro_files as own
import numpy as np
import pytest
from micro_images import nearest_lenslet

from lf_flame import InputError
from lf_flame.formats import read_light_field, read_raw
from lf_flame.refocus import find_sharpest_slope

SHAPE, PITCH, TURN, OFFSET, VIEWS = (300, 330), 14.29, 0.004, (2.4, -3.1), 13
COLOURS = {"r": 0.5, "g": 0.9, "b": 0.35}


def lenslets():
    """For each pixel: centre of its lenslet, and the pixel's distance from it, as x + iy."""
    y, x = np.indices(SHAPE)
    middle = complex((SHAPE[1] - 1) / 2 + OFFSET[0], (SHAPE[0] - 1) / 2 + OFFSET[1])
    z = (x + 1j * y - middle) * np.exp(-1j * TURN)
    *_, down, along = nearest_lenslet(z.imag, z.real, PITCH, np.sqrt(3) / 2 * 1.0003 * PITCH, True)
    away = (along + 1j * down) * np.exp(1j * TURN)
    return x + 1j * y - away, away


def texture(place):
    """Smooth colourless texture from 0.2 to 0.8 with details of three lenslets and more."""
    place = place / PITCH
    waves = (1.9 + 0.3j, 0.4 - 1.7j, 1.2 + 1.3j, -0.9 + 0.5j)
    return 0.5 + 0.075 * sum(
        np.sin((place * wave.conjugate()).real + k) for k, wave in enumerate(waves)
    )


def frames(model, slope):
    """Raw and white image of the camera in levels; a slope in row distances per view."""
    centre, away = lenslets()
    seen = centre - slope * np.sqrt(3) / 2 * 1.0003 * VIEWS * away
    disc = np.clip(0.47 * PITCH - np.abs(away) + 0.5, 0, 1)
    middle = complex(SHAPE[1] / 2, SHAPE[0] / 2)
    fall_off = 1 - 0.2 * np.abs(centre - middle) ** 2 / 220**2
    tile = {"F01": ["bg", "gr"], "ILLUM": ["gr", "bg"]}[model]
    i, j = np.indices(SHAPE) % 2
    colour = np.array([[COLOURS[name] for name in row] for row in tile])[i, j]
    _, _, _, black, white = own.SIDES[model]
    to_levels = lambda light: np.rint(black + (white - black) * light).astype(int)  # noqa: E731
    return to_levels(disc * fall_off * colour * texture(seen)), to_levels(
        0.9 * disc * fall_off * colour
    )


def write_picture(path, model, slope, white=False):
    raw, flat = frames(model, slope)
    bits = own.SIDES[model][0]
    packed = own.pack(flat, bits) if white else None
    path.write_bytes(
        own.container(model, own.metadata(model, SHAPE), own.pack(raw, bits), white=packed)
    )


@pytest.fixture
def said(caplog):
    """What the library tells its user."""
    caplog.set_level(logging.INFO, "lf_flame")
    return lambda: " ".join(record.getMessage() for record in caplog.records)


def measured(light_field, slope):
    green = light_field.views[..., 1]
    weights = light_field.weights
    return find_sharpest_slope(
        green, np.linspace(slope - 0.3, slope + 0.3, 13), weights=weights
    ).slope


@pytest.mark.parametrize(("model", "slope"), [("F01", 0.8), ("ILLUM", -0.6)])
def test_slope_and_colours_with_the_white_image_of_the_file(tmp_path, said, model, slope):
    write_picture(tmp_path / "a.lfr", model, slope, white=True)
    light_field, grid = read_raw(tmp_path / "a.lfr", views=VIEWS)
    assert grid.layout == "hexagonal"
    assert grid.pitch == pytest.approx(PITCH, abs=0.01)
    assert measured(light_field, slope) == pytest.approx(slope, rel=0.015)
    means = light_field.views[5:8, 5:8, 3:-3, 3:-3].mean(axis=(0, 1, 2, 3))
    np.testing.assert_allclose(means / means[1], [5 / 9, 1, 3.5 / 9], rtol=0.02)
    assert "vignetting" not in said()


def test_slope_without_a_white_image(tmp_path, said):
    write_picture(tmp_path / "a.lfp", "ILLUM", 0.8)
    light_field = read_light_field(tmp_path / "a.lfp", VIEWS)
    assert measured(light_field, 0.8) == pytest.approx(0.8, rel=0.015)
    assert "vignetting is not corrected" in said()


@pytest.mark.slow
def test_white_and_dark_images_from_elsewhere(tmp_path, said):
    """A folder of white images, and a dark frame instead of the black level."""
    raw, flat = frames("ILLUM", 0.8)
    packed = own.pack(raw + 30, 10)
    (tmp_path / "a.lfr").write_bytes(own.container("ILLUM", own.metadata("ILLUM", SHAPE), packed))
    for name, mosaic in (("MOD_0003", flat + 30), ("dark", np.full(SHAPE, 94))):
        text, packed = own.white_pair("ILLUM", own.metadata("ILLUM", SHAPE), mosaic)
        (tmp_path / f"{name}.TXT").write_bytes(text)
        (tmp_path / f"{name}.RAW").write_bytes(packed)
    write_picture(tmp_path / "b.lfr", "ILLUM", 0.8, white=True)
    expected, _ = read_raw(tmp_path / "b.lfr", views=VIEWS)
    dark = tmp_path / "dark.RAW"
    for white in (tmp_path, tmp_path / "MOD_0003.RAW"):
        light_field, _ = read_raw(tmp_path / "a.lfr", white, views=VIEWS, dark=dark)
        counted = expected.weights > 0
        found, wanted = (one.views[counted] for one in (light_field, expected))
        # But where a pixel is just lit, which the rounded levels of the white image decide.
        assert np.mean(np.abs(found - wanted) < 6e-4) > 0.999
    assert "White image" in said()
    assert "at zoom step -297 for -297 and focus step 309 for 309" in said()
    with pytest.raises(InputError, match="must be a raw file of the camera"):
        read_raw(tmp_path / "a.lfr", tmp_path, dark=tmp_path / "dark.png")


def test_a_white_image_of_another_camera_is_noted(tmp_path, said):
    write_picture(tmp_path / "a.lfr", "ILLUM", 0.8)
    text, packed = own.white_pair(
        "ILLUM", own.metadata("ILLUM", SHAPE), frames("ILLUM", 0)[1], serial="B2"
    )
    (tmp_path / "w.TXT").write_bytes(text)
    (tmp_path / "w.RAW").write_bytes(packed)
    read_raw(tmp_path / "a.lfr", tmp_path / "w.RAW", views=VIEWS)
    assert "is of camera B2, but the picture of B5143909630" in said()
