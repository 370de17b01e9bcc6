"""Height, width and contour of flames whose shape is known in closed form."""

import numpy as np
import pytest

from lf_flame.flame_video import measure_flame, row_error

SHAPE = (60, 80)


def gaussian(row=32.3, column=41.6, sigma_row=7.1, sigma_column=4.3, shape=SHAPE):
    rows, columns = np.indices(shape)
    exponent = ((rows - row) / sigma_row) ** 2 + ((columns - column) / sigma_column) ** 2
    return np.exp(-exponent / 2)


def half_axis(sigma, level, image):
    """Half axis of the ellipse at a share of the brightest pixel, a little below the true peak."""
    return sigma * np.sqrt(-2 * np.log(level * image.max()))


@pytest.mark.parametrize(("level", "chord"), [(0.2, 0.01), (0.5, 0.01), (0.8, 0.015)])
def test_a_gaussian_has_an_ellipse_for_its_contour(level, chord):
    """But for chords in place of arcs, the more so the smaller the ellipse."""
    image = gaussian()
    found = measure_flame(image, level=level)
    down, across = (half_axis(sigma, level, image) for sigma in (7.1, 4.3))
    assert found.tip_row == pytest.approx(32.3 - down, abs=4 * chord)
    assert found.height == pytest.approx(59.5 - (32.3 - down), abs=4 * chord)
    assert found.width == pytest.approx(2 * across, abs=0.06)
    assert found.area == pytest.approx(np.pi * down * across, rel=0.025)
    rows, columns = (found.contour - (32.3, 41.6)).T
    assert np.hypot(rows / down, columns / across) == pytest.approx(1, abs=chord)
    assert (found.contour[0] == found.contour[-1]).all()
    # The mean of a Gaussian above a level is (1 - level) / ln(1 / level) of its peak.
    assert found.brightness == pytest.approx((1 - level) / np.log(1 / level), rel=0.03)
    assert found.doubts == ()


def test_lengths_are_in_the_pixels_unit_and_count_from_the_burner():
    image = gaussian()
    pixels, mm = measure_flame(image), measure_flame(9 * image, pixel_mm=0.25, burner_row=50.0)
    assert mm.height == pytest.approx(0.25 * (pixels.height - 9.5))
    assert mm.width == pytest.approx(0.25 * pixels.width)
    assert mm.area == pytest.approx(0.0625 * pixels.area)
    assert mm.tip_row == pytest.approx(pixels.tip_row)
    assert mm.contour == pytest.approx(pixels.contour)
    assert mm.brightness == pytest.approx(9 * pixels.brightness)


@pytest.mark.parametrize("level", [0.1, 0.2, 0.5, 0.7])
def test_the_swing_of_a_tip_that_crosses_a_row_is_bounded(level):
    """By the first harmonic of its error, the tip's place being that of the step itself."""
    parts = (np.arange(32) + 0.5) / 32
    columns = np.ones(9)
    errors = [
        measure_flame(np.clip(5 + part - np.arange(15), 0, 1)[::-1, None] * columns, level=level)
        .height - part for part in parts
    ]  # fmt: skip
    swing = 2 * abs(np.mean(np.array(errors) * np.exp(2j * np.pi * parts)))
    assert 0.8 * row_error(level) < swing < row_error(level)


@pytest.mark.slow
def test_noise_alone_has_no_flame_and_a_weak_flame_is_one():
    rng = np.random.default_rng(2)
    for _ in range(4):
        noise = rng.standard_normal((270, 540))
        # As refocusing leaves it: neighbours alike.
        blurred = (noise[:, 1:] + noise[:, :-1]) / 2
        assert measure_flame(noise).doubts == ("dark",)
        assert measure_flame(blurred[::2]).doubts == ("dark",)
        for cut in (np.abs(noise), np.maximum(noise, 0)):  # as some cameras do
            assert np.isnan(measure_flame(cut).height)
    assert measure_flame(gaussian() + 0.05 * rng.standard_normal(SHAPE)).height > 0
    for dark in (-gaussian(), gaussian() - 2):
        assert measure_flame(dark).doubts == ("dark",)


@pytest.mark.parametrize(("black", "is_told"), [(0.0, False), (0.025, False), (0.04, True)])
@pytest.mark.parametrize("place", [{}, {"row": 1.0}, {"column": 0.0}, {"row": 60.0}])
def test_a_black_level_is_told_wherever_the_flame_is(black, is_told, place):
    """Also where it reaches the top, a side or the burner; noise and a wall are none."""
    noise = 0.001 * np.random.default_rng(4).standard_normal(SHAPE)
    found = measure_flame(3 * (gaussian(**place) + black + noise))
    assert ("bright_dark" in found.doubts) == is_told


@pytest.mark.parametrize("brightness", [1.5, 4.0, 200.0])
@pytest.mark.parametrize("place", [(5, 60), (32, 41), (40, 41), (13, 70)])
def test_a_hot_pixel_changes_nothing(brightness, place):
    """Brighter than the flame, apart from it, or within."""
    clean = measure_flame(gaussian())
    image = gaussian()
    image[place] = brightness
    found = measure_flame(image)
    assert found.tip_row == pytest.approx(clean.tip_row, abs=0.2)
    assert found.width == pytest.approx(clean.width, abs=0.2)
    assert found.brightness == pytest.approx(clean.brightness, rel=0.05)
    assert found.doubts == ()


def test_a_hollow_flame_has_one_outer_contour():
    rows, columns = np.indices(SHAPE)
    radius = np.hypot(rows - 30.2, columns - 40.4)
    found = measure_flame(np.exp(-(((radius - 14) / 3) ** 2)))
    outer = 14 + 3 * np.sqrt(np.log(2))
    assert found.tip_row == pytest.approx(30.2 - outer, abs=0.05)
    assert found.width == pytest.approx(2 * outer, abs=0.1)
    assert found.area == pytest.approx(np.pi * outer**2, rel=0.01)


@pytest.mark.parametrize(
    ("row", "column", "is_cut"),
    [(2.0, 40.0, True), (30.0, 1.0, True), (30.0, 78.0, True), (57.0, 40.0, False)],
)
def test_a_flame_that_leaves_the_picture_is_told(row, column, is_cut):
    """But at the lower edge, where the burner is."""
    found = measure_flame(gaussian(row=row, column=column))
    assert ("cut" in found.doubts) == is_cut
    assert (found.contour[0] == found.contour[-1]).all()
    low, high = found.contour.min(axis=0), found.contour.max(axis=0)
    assert (low >= -0.5).all()
    assert (high <= np.array(SHAPE) - 0.5).all()
    reached = [
        row == 2 and low[0] == -0.5, column == 1 and low[1] == -0.5,
        column == 78 and high[1] == 79.5, row == 57 and high[0] == 59.5,
    ]  # fmt: skip
    assert any(reached)


def test_a_saturated_picture_is_told():
    """Also after sums whose last digits differ; a few bright pixels are no ceiling."""
    image = np.minimum(gaussian(), 0.8)
    rounded = image * (1 + 1e-7 * np.random.default_rng(0).standard_normal(SHAPE))
    for one in (image, rounded):
        found = measure_flame(one)
        assert found.doubts == ("ceiling",)
        assert found.area > 1.2 * measure_flame(gaussian()).area
    assert measure_flame(np.minimum(gaussian(), 0.97)).doubts == ()
    assert measure_flame(np.round(255 * gaussian()).astype(np.uint8)).doubts == ()


def test_the_flame_is_the_largest_bright_region_and_others_are_told():
    """A smaller one, though brighter, and a spark are left out."""
    upper, lower = gaussian(row=14.0, sigma_row=3.0), gaussian(row=46.0, sigma_row=5.0)
    alone = measure_flame(lower)
    found = measure_flame(0.9 * upper + lower)
    assert found.tip_row == pytest.approx(alone.tip_row, abs=1e-3)
    assert found.area == pytest.approx(alone.area, rel=1e-3)
    assert found.doubts == ("apart",)
    assert measure_flame(0.4 * upper + lower).doubts == ()  # below the level
    spark = lower.copy()
    spark[4:7, 60:63] = 1.1
    higher = np.log(1 / 0.55) / np.log(1 / 0.5)  # the spark's level, half of its 1.1
    assert measure_flame(spark).area == pytest.approx(alone.area * higher, rel=0.02)
