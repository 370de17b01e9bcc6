"""Flames traced ray by ray, and the report on rivals."""

import numpy as np
import pytest
from scipy.integrate import quad

from experiments.emission.truth import Lens, Sheet, cells, record
from experiments.paths import EXPERIMENTS, REFERENCE
from experiments.tomography import flame_rays as rays
from experiments.tomography.rivals import CASES, METHODS, body

LENS = Lens(lenslets=(rays.LENSLETS, rays.LENSLETS))


def test_sheets_are_those_of_other_rays():
    """Few rays to a pixel against the mean over it, in a camera with another pitch too."""
    depths = (6.0, 2.0, -2.0, -6.0)
    flame, places = rays.sheets(depths, 0.05), (-1.15, 1.15, -0.25, 0.65)
    wanted = [Sheet(z, (0.05, x), (1.5, 0.7)) for z, x in zip(depths, places, strict=True)]
    assert np.abs(flame.record() - record(LENS, wanted)).max() < 2e-4
    other = record(Lens(lenslets=LENS.lenslets, pitch=1.005 * 0.112), wanted)
    assert np.abs(flame.record(1.005 * rays.PITCH_MM) - other).max() < 2e-4
    truth = [cells(LENS, one) for one in wanted]
    assert np.abs(flame.truth(depths) - truth).max() < 1e-3


def test_slabs_add_up_to_the_line_of_sight():
    """The elliptic flame's truth on nine planes, summed, is its closed integral along depth."""
    planes = np.arange(-4.0, 4.5)
    whole = rays.elliptic().truth(planes).sum(axis=0)
    assert whole.max() == pytest.approx(1.6 * np.sqrt(np.pi), rel=0.02)
    assert rays.hollow().truth(planes)[4, 30, 30] < 4e-3


def test_the_printed_profile_is_the_printed_one():
    """Emission and projection at m / 30, as table I prints them."""
    printed = {0: (1.1875, 0.75), 5: (1.1876, 0.9352), 9: (1.0719, 0.9873), 18: (0.4713, 0.5499)}
    for m, (seen, glow) in printed.items():
        assert rays.cremers_profile(m / 30) == pytest.approx(glow, abs=6e-5)
        edge, kink = np.sqrt(1 - (m / 30) ** 2), np.sqrt(max(0.0625 - (m / 30) ** 2, 0))
        along = quad(
            lambda z, m=m: rays.cremers_profile(np.hypot(m / 30, z)), 0, edge, points=[kink]
        )
        assert 2 * along[0] == pytest.approx(seen, abs=6e-5)


def test_the_report_has_a_column_for_each_method_and_names_what_is_left_out():
    rows = [
        {
            "flame": CASES[0].name, "noise": 0.01, "method": name, "error": 0.1 + k, "best": 0.05,
            "light": 0.0, "iterations": 7, "seconds": 1.0, "said": "edge", "wanted": "",
        }
        for k, name in enumerate(METHODS)
    ]  # fmt: skip
    printed = [{"method": "Frie, as printed", "rms": 0.001, "worst": 0.002, "differs": "points"}]
    text = body({"rows": rows, "printed": printed})
    line = next(one for one in text[2].splitlines() if "on the planes" in one)
    found = [cell.strip() for cell in line.split("|")[3:-1]]
    assert found == [f"{0.1 + k:.3f}" for k in range(len(METHODS))]
    assert "ChinaXiv 201711.00595" in text[-1]


def test_the_page_has_the_records_table():
    record = (REFERENCE / "tomography/rivals.md").read_text()
    table = record.split("## Error\n\n")[1].split("\n\n")[0]
    assert table in (EXPERIMENTS.parent / "docs/emission_methods.md").read_text()
