import numpy as np
import pytest

from lf_flame.learning.decoder import build_decoder
from lf_flame.learning.fast_decoder import training_view


@pytest.mark.parametrize("neck", ["pooled", "positions"])
def test_training_view_is_the_same_function(rng, neck):
    decoder = build_decoder((3, 6, 32), (9, 18), 4, neck=neck, seed=3)
    features = rng.normal(size=(4, 3, 6, 32)).astype(np.float32)
    view = training_view(decoder)
    vectors, stack = view([features, np.zeros((4, 9 * 18 * 4), np.float32)])
    assert vectors.shape == (4, 256)
    np.testing.assert_allclose(np.array(stack), np.array(decoder(features)), atol=1e-6)
    assert [id(w) for w in view.variables] == [id(w) for w in decoder.variables]
