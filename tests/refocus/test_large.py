"""Light fields that are larger than memory, read one row of views at a time."""

import numpy as np
import pytest

from lf_flame import InputError, LightField
from lf_flame.refocus import refocus, refocus_large


class Stored:
    """Views on a disk: only single rows of views can be read, each counted."""

    def __init__(self, views):
        self._views, self.shape, self.reads = views, views.shape, []

    def __getitem__(self, v):
        self.reads.append(v)
        return self._views[int(v)]

    def __array__(self, *_, **__):
        raise MemoryError


@pytest.mark.parametrize("interpolation", ["linear", "nearest", "cubic"])
@pytest.mark.parametrize("kind", [np.uint8, np.float32, np.float64])
def test_rows_add_up_to_the_whole(kind, interpolation, rng):
    views = (255 * rng.uniform(size=(5, 4, 30, 40, 3))).astype(kind)
    weights = rng.uniform(size=(5, 4))
    weights[3] = 0
    slopes = [-1.3, 0.0, 0.77]
    stored = Stored(views)
    options = {"weights": weights, "interpolation": interpolation}
    found = refocus_large(stored, slopes, **options)
    np.testing.assert_allclose(found, refocus(views, slopes, **options), atol=255e-6, rtol=0)
    assert stored.reads == [0, 1, 2, 4]
    assert found.dtype == np.float32
    single = refocus_large(stored, 0.77, **options)
    np.testing.assert_array_equal(single, found[2])


def test_what_cannot_be_refocused_is_refused():
    with pytest.raises(InputError, match=r"got an array of shape \(3, 4, 5\)"):
        refocus_large(np.ones((3, 4, 5)), 0.0)
    with pytest.raises(InputError, match="in memory already"):
        refocus_large(LightField(np.ones((3, 3, 8, 8))), 0.0)
    with pytest.raises(InputError, match="interpolation must be one of linear, nearest, cubic"):
        refocus_large(np.ones((3, 3, 8, 8)), 0.0, interpolation="sinc")
    with pytest.raises(InputError, match="NaN"):
        refocus_large(np.full((3, 3, 8, 8), np.nan), 0.0)
