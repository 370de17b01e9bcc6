"""Flames against what their documentation says, read off the textures by their moments.

Of a row ``b exp(-q^2) (1 + c (q^2 + 1/2))`` with ``q = x / b``, Gaussian moments give the light
``pi b^2 (1 + c)``, with the projection's own sqrt(pi), and the variance
``b^2 (1/2 + c) / (1 + c)``.
"""

import numpy as np
import pytest

from lf_flame import InputError
from lf_flame.datasets.templates import FlameObject, FlameTemplate
from lf_flame.scenes.flames import HALF_WIDTH, WAVES, draw_wrinkles, flame_texture

HEIGHT, RADIUS = 20.0, 2.4
FINE = 0.02
"""Cells in mm, so that sums over a row are its integrals."""

ROWS = round(HEIGHT / FINE)
H = 1 - (np.arange(ROWS) + 0.5) / ROWS
HOLLOW = 3 * (1 - H)


def moments(flame, radius=RADIUS):
    """Light, middle and standard deviation of each row, in mm."""
    columns = flame.shape[1]
    width = 2 * HALF_WIDTH * radius
    x = ((np.arange(columns) + 0.5) / columns - 0.5) * width
    light = flame.sum(axis=1) * width / columns
    middle = flame @ x * width / columns / light
    square = flame @ x**2 * width / columns / light - middle**2
    return light, middle, np.sqrt(square)


def radius_of(spread):
    """Radius b from the standard deviation of a row."""
    return spread * np.sqrt((1 + HOLLOW) / (0.5 + HOLLOW))


def documented_radius():
    return RADIUS * np.sqrt(1 - H) * (0.6 + 1.2 * H)


def documented_waves(wave):
    """Sum of the cosine and sine waves of one wrinkle over the height."""
    return sum(
        cosine * np.cos(2 * np.pi * k * H) + sine * np.sin(2 * np.pi * k * H)
        for k, (cosine, sine) in enumerate(wave, 1)
    )


def test_the_radius_has_its_profile():
    """0.6 of the nominal one at the burner, 0 at the tip, most in between."""
    flame = flame_texture(HEIGHT, RADIUS, cell_mm=FINE)
    assert flame.max() == 1
    assert flame.min() >= 0
    _, middle, spread = moments(flame)
    np.testing.assert_allclose(middle, 0, atol=1e-9)
    radius = radius_of(spread)
    wide = radius > 10 * FINE  # at the very tip a row is narrower than its cells
    np.testing.assert_allclose(radius[wide], documented_radius()[wide], rtol=1e-4)
    assert radius[-1] / RADIUS == pytest.approx(0.6, abs=0.002)
    assert H[radius.argmax()] == pytest.approx(0.5, abs=0.01)  # where sqrt(1-h) (1 + 2h) is most


def test_the_glow_sets_in_above_the_burner():
    """A row shines as ``ignition b^2 (1 + c)``; ignition rises from 0.15 to 1 over 0.15 of h."""
    light, _, spread = moments(flame_texture(HEIGHT, RADIUS, cell_mm=FINE))
    wide = spread > 10 * FINE
    ignition = (light / (documented_radius() ** 2 * (1 + HOLLOW)))[wide]
    ignition /= ignition[np.abs(H[wide] - 0.6).argmin()]
    expected = 1 - 0.85 * np.exp(-((H[wide] / 0.15) ** 2))
    np.testing.assert_allclose(ignition, expected, rtol=1e-4)
    assert ignition[-1] == pytest.approx(0.15, abs=1e-3)


def test_the_energy_of_the_waves_falls_as_the_wave_number_to_minus_five_thirds(rng):
    waves = np.array([draw_wrinkles(rng) for _ in range(10_000)])
    energy = (waves**2).mean(axis=(0, 1, 3))
    # 40,000 squares of normal numbers for each: a standard error of 0.7 %
    expected = np.arange(1, WAVES + 1.0) ** (-5 / 3)
    np.testing.assert_allclose(energy / energy[0], expected / expected[0], rtol=0.03)
    np.testing.assert_allclose(energy, expected / expected.sum(), rtol=0.03)


def test_the_axis_sways_by_the_waves_times_the_height():
    wrinkles = draw_wrinkles(np.random.default_rng(4))
    sway_mm = 0.3
    _, middle, _ = moments(flame_texture(HEIGHT, RADIUS, wrinkles, sway_mm, cell_mm=FINE))
    wide = documented_radius() > 10 * FINE
    expected = sway_mm * H * documented_waves(wrinkles[0])
    np.testing.assert_allclose(middle[wide], expected[wide], atol=2e-4)
    assert np.abs(expected).max() > 0.1


def test_the_radius_swells_by_the_waves_times_the_height():
    wrinkles = draw_wrinkles(np.random.default_rng(5))
    swelling = 0.08
    flame = flame_texture(HEIGHT, RADIUS, wrinkles, swelling=swelling, cell_mm=FINE)
    _, middle, spread = moments(flame)
    np.testing.assert_allclose(middle, 0, atol=1e-9)
    ratio = radius_of(spread) / documented_radius()
    wide = documented_radius() > 10 * FINE
    expected = np.exp(swelling * H * documented_waves(wrinkles[1]))
    np.testing.assert_allclose(ratio[wide], expected[wide], rtol=1e-3)
    assert np.abs(np.log(expected)).max() > 0.05


@pytest.mark.parametrize("radius", [1.2, 2.4])
def test_a_template_sways_by_a_share_of_the_radius(radius):
    """Root-mean-square over flames at the tip, where all waves count in full."""
    flame = FlameObject("flame", 0.0, (0.0, 0.0), HEIGHT, 0.0, radius)
    drawn = {"sway": 0.06, "swelling": 0.0} | {"position_mm": 0.0, "brightness": (1.0, 1.0)}
    template = FlameTemplate([flame], **drawn)
    sways = []
    for seed in range(300):
        scene, _ = template.draw(np.random.default_rng(seed))
        texture = scene.layers[0].texture
        rows = len(texture)
        row = round(0.1 * rows)
        _, middle, _ = moments(texture[row : row + 1], radius)
        sways.append(middle[0] / (1 - (row + 0.5) / rows))
    # 300 normal numbers: a standard error of 4 %
    assert np.sqrt(np.mean(np.square(sways))) == pytest.approx(0.06 * radius, rel=0.15)


def test_a_flame_that_flickers_down_to_nothing_is_refused():
    """A sine of this standard deviation swings by sqrt(2) of it, here by the whole height."""
    with pytest.raises(InputError, match="height_mm above the amplitude of its flicker"):
        FlameObject("flame", 0.0, (0.0, 0.0), 2**0.5, 1.0, RADIUS)
    assert FlameObject("flame", 0.0, (0.0, 0.0), 1.42, 1.0, RADIUS).height_mm == 1.42
