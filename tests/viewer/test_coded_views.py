"""Views as whole numbers."""

import numpy as np
import pytest

from lf_flame import LightField
from lf_flame.viewer import coded_views
from lf_flame.viewer.coded_views import cut_into_pieces, encode_views, piece_bytes


@pytest.mark.parametrize(("bits", "kind"), [(8, np.uint8), (16, np.uint16)])
@pytest.mark.parametrize("shape", [(3, 4, 5, 6), (3, 4, 5, 6, 3)])
def test_levels_of_image_files_come_back_as_they_were(rng, bits, kind, shape):
    codes = rng.integers(0, 2**bits, shape).astype(kind)
    codes.flat[:2] = 0, 2**bits - 1
    coded = encode_views(LightField(codes / np.float32(2**bits - 1)))
    assert coded.codes.dtype == kind
    np.testing.assert_array_equal(coded.codes.reshape(shape), codes)


@pytest.mark.parametrize(("low", "high"), [(0, 0.02), (-3, 0.5), (0.2, 40), (-1e-3, 1)])
def test_other_radiance_keeps_sixteen_bits(rng, low, high):
    views = rng.uniform(low, high, (3, 3, 20, 20)).astype(np.float32)
    coded = encode_views(LightField(views))
    # White is 1, unless all is darker or something brighter: the codes reach from 0 to white.
    span = max(coded.white, views.max()) - min(views.min(), 0)
    assert np.abs(coded.radiance()[..., 0] - views).max() <= span / 65535 * 0.51


def test_large_light_fields_take_eight_bits(rng, monkeypatch):
    views = rng.uniform(size=(3, 3, 20, 20)).astype(np.float32)
    monkeypatch.setattr(coded_views, "MOST_BYTES", views.size)
    assert encode_views(LightField(views)).codes.dtype == np.uint8


@pytest.mark.parametrize("views", [(1, 1), (2, 2), (5, 4), (9, 9)])
@pytest.mark.parametrize("most", [1, 70, 10**6])
def test_pieces_hold_each_view_once_and_the_middle_first(rng, views, most):
    coded = encode_views(LightField(rng.uniform(size=(*views, 4, 5))))
    pieces = cut_into_pieces(coded, most)
    middle = (views[0] - 1) // 2 * views[1] + (views[1] - 1) // 2
    assert pieces[0] == (middle, 1)
    indices = [first + k for first, count in pieces for k in range(count)]
    assert sorted(indices) == list(range(views[0] * views[1]))
    assert all(count == 1 or count * 4 * 5 * 2 <= most for _, count in pieces)
    flat = coded.codes.reshape(-1, 4, 5, 1)
    for first, count in pieces:
        found = np.frombuffer(piece_bytes(coded, (first, count)), "<u2")
        np.testing.assert_array_equal(found.reshape(-1, 4, 5, 1), flat[first : first + count])
