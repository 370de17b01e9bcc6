"""A page in one file: what it holds, and how large it is."""

import json
import os

import numpy as np
import pytest

from lf_flame import InputError, LightField
from lf_flame.viewer import coded_views
from lf_flame.viewer.exhibit import Exhibit
from lf_flame.viewer.page import served_page, single_page


def smooth(shape, rng):
    """Views that JPEG can do something with."""
    ramp = np.linspace(0, 3, shape[3])[:, None] + np.arange(3)
    return np.clip(0.5 + 0.3 * np.sin(ramp) + rng.uniform(-0.05, 0.05, shape), 0, 1)


@pytest.mark.slow
def test_what_does_not_fit_is_carried_coarser_and_said_so(rng):
    exhibit = Exhibit(LightField(smooth((9, 9, 60, 80, 3), rng)), "Smooth", (-2.0, 2.0), 0.0,
                      with_map=False)  # fmt: skip
    whole, quality = single_page(exhibit, 10**8)
    assert quality == "all views, with 16 bits"
    seen = set()
    for part in (0.6, 0.25, 0.12):
        page, quality = single_page(exhibit, int(part * len(whole)))
        assert len(page.encode()) <= part * len(whole)
        assert quality.startswith("preview: views ")
        assert quality in page
        seen.add(quality.partition(",")[0])
    assert len(seen) > 1
    with pytest.raises(InputError, match=r"allow that many \(--megabytes") as refused:
        single_page(exhibit, 100_000)
    needed = float(str(refused.value).partition("--megabytes ")[2].rstrip(")."))
    assert len(single_page(exhibit, int(needed * 1e6))[0].encode()) <= needed * 1e6
    with pytest.raises(InputError):
        single_page(exhibit, int((needed - 0.1) * 1e6))


def test_a_page_holds_nothing_that_json_or_utf8_do_not_know(make_exhibit):
    exhibit = make_exhibit((3, 3, 8, 9))
    object.__setattr__(exhibit, "title", os.fsdecode(b"flamm\xe9"))
    for page in (served_page(exhibit), single_page(exhibit, 10**8)[0]):
        assert b"<h1>flamm?</h1>" in page.encode()
        text = page.partition('id="lf-metadata">')[2].partition("</script>")[0]
        assert json.loads(text, parse_constant=pytest.fail)["levels"] == 255


def test_a_light_field_too_large_for_a_page_is_refused(monkeypatch):
    monkeypatch.setattr(coded_views, "MOST_BYTES", 100)
    with pytest.raises(InputError, match="has room for 100 values .* has 648"):
        Exhibit(LightField(np.ones((3, 3, 8, 9))), "Large", (-1.0, 1.0), 0.0)
