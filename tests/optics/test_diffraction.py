import numpy as np
import pytest
from scipy import ndimage, special

from lf_flame.optics.diffraction import blur_cells, blur_lines, blur_views, share_leaving_square


def square_by_frequency(spread, n):
    """Weights 0 to n - 1 from the transfer function of the square aperture, sample 1."""
    x, weight = special.roots_legendre(1500)
    nu = (1 + x) / 2 / spread
    seen = (1 - nu * spread) * np.sinc(nu) ** 2 * weight / spread
    return seen @ np.cos(2 * np.pi * nu[:, None] * np.arange(n))


def round_by_frequency(spread, n):
    """Weights (0 to n - 1)^2 from the transfer function of the round aperture, sample 1."""
    x, weight = special.roots_legendre(300)
    phi = (1 + x) * np.pi / 4
    q = np.cos(phi)
    transfer = 2 / np.pi * (np.arccos(q) - q * np.sqrt(1 - q**2))
    radial = 4 * (weight * np.pi / 4) ** 2 * np.sin(phi) * q / spread**2 * transfer
    y, x = (np.outer(q, f(phi)).ravel() / spread for f in (np.sin, np.cos))
    waves = [
        np.cos(2 * np.pi * nu[:, None] * np.arange(n)) * np.sinc(nu)[:, None] ** 2 for nu in (y, x)
    ]
    angular = np.outer(radial / weight, weight).ravel()
    return (waves[0] * angular[:, None]).T @ waves[1]


@pytest.mark.parametrize("spread", [0.05, 0.1, 0.3, 1.0, 7.0])
@pytest.mark.parametrize("round_aperture", [False, True])
def test_a_cell_is_blurred_by_the_transfer_function(spread, round_aperture):
    """A lone cell among dark ones, against weights from the transfer function by quadrature."""
    place = ((-6, 7), (-4, 9))
    cell = np.ones((1, 1))
    found = blur_cells(cell, spread, (1.0, 1.0), round_aperture, place, (1500, 1500))
    if round_aperture:
        quadrant = round_by_frequency(spread, 9)
    else:
        quadrant = np.multiply.outer(*[square_by_frequency(spread, 9)] * 2)
    rows, columns = (np.abs(np.arange(*ends)) for ends in place)
    expected = quadrant[np.ix_(rows, columns)]
    # Airy patterns far smaller than cells are taken along each axis by itself: of what leaves a
    # lone cell that is up to a seventh too much.
    separate = round_aperture and spread < 0.06
    allowed = (1 - quadrant[0, 0]) / 7 if separate else 2e-6 * (1 + spread)
    np.testing.assert_allclose(found, expected, atol=allowed)


@pytest.mark.parametrize("round_aperture", [False, True])
def test_cells_need_not_be_square(rng, round_aperture):
    """Cells of 1 x 2, against the same light on cells of 1 x 1."""
    cells = rng.random((5, 3))
    seen = ((-2, 9), (-1, 5))
    found = blur_cells(cells, 1.3, (1.0, 2.0), round_aperture, seen, (500, 250))
    even = np.repeat(cells, 2, axis=1)
    fine = blur_cells(even, 1.3, (1.0, 1.0), round_aperture, ((-2, 9), (-2, 10)), (500, 500))
    np.testing.assert_allclose(found, fine.reshape(11, 6, 2).mean(axis=2), atol=2e-6)


@pytest.mark.parametrize("spread", [0.05, 1.0, 7.0])
def test_lines_go_on_beyond_their_border(rng, spread):
    image = rng.random((6, 7))
    weights = square_by_frequency(spread, 40 if spread < 1 else 400)
    kernel = np.concatenate([weights[:0:-1], weights])
    expected = ndimage.convolve1d(image, kernel, 0, mode="nearest")
    found = blur_lines(image, spread, 1.0)
    np.testing.assert_allclose(found, expected, atol=3e-4 * spread + 2e-4)
    np.testing.assert_allclose(blur_lines(image, 0, 1.0), image, atol=1e-12)


@pytest.mark.parametrize("spread", [1e-5, 0.05, 0.3, 2.0])
def test_share_that_leaves_a_square(spread):
    """For a round aperture it may be a seventh too much."""
    limit = spread / np.pi**2 * (np.log(2 * np.pi / spread) + 1 + np.euler_gamma)
    one = limit if spread < 1e-3 else 1 - square_by_frequency(spread, 1)[0]
    square = share_leaving_square(2 * spread, 2.0, False)
    assert square == pytest.approx(1 - (1 - one) ** 2, rel=1e-5)
    if spread > 1e-3:
        round_ = 1 - round_by_frequency(spread, 1)[0, 0]
        assert round_ < share_leaving_square(spread, 1.0, True) < 8 / 7 * round_
    assert share_leaving_square(0.0, 1.0, True) == share_leaving_square(5e-324, 1.0, True) == 0


@pytest.mark.parametrize("round_aperture", [False, True])
def test_views_are_blurred_one_by_one(round_aperture):
    """A lone pixel against weights by quadrature; light beyond 32 pixels is not followed."""
    views = np.zeros((2, 1, 41, 43), np.float32)
    views[1, 0, 20, 21] = 1e6
    found = blur_views(views, 0.06, 0.2, round_aperture)
    assert not found[0].any()
    assert found.min() >= 0
    if round_aperture:
        quadrant = round_by_frequency(0.3, 9)
    else:
        quadrant = np.multiply.outer(*[square_by_frequency(0.3, 9)] * 2)
    np.testing.assert_allclose(found[1, 0, 20:29, 21:30], 1e6 * quadrant, rtol=1e-3, atol=5)
    np.testing.assert_allclose(found[1, 0, 20:11:-1, 21:12:-1], 1e6 * quadrant, rtol=1e-3, atol=5)


def test_uniform_views_stay_uniform():
    for level in (0.0, 0.1, 1e30, -3.0):
        views = np.full((1, 1, 21, 33), level, np.float32)
        np.testing.assert_array_equal(blur_views(views, 0.4, 1.0, True), views)
    views = np.arange(6, dtype=np.float32).reshape(1, 1, 2, 3)
    np.testing.assert_allclose(blur_views(views, 0.0, 1.0, False), views, atol=1e-6)
