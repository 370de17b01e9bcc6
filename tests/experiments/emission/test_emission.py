"""Flames traced by own rays, simple methods beside the package's, and the report."""

import json

import numpy as np
import pytest
from scipy.integrate import quad

from experiments.emission import planes, report, rivals, soot, truth
from experiments.emission.truth import Lens, Sheet, Slab, SootFlame
from lf_flame.tomography import reconstruct_soot

LENS = Lens(views=3, lenslets=(24, 30))


def test_rays_and_factors_see_the_same_sheets():
    """Few rays to a pixel against the closed mean over it, and the same on the planes' cells."""
    sheets = [Sheet(6.0, (0.2, -0.5), (0.9, 0.7)), Sheet(-3.0, (0.0, 0.6), (0.8, 0.6), 0.5)]
    slabs = [
        Slab(
            one.depth,
            lambda y, x, one=one: (
                one.peak * np.exp(-(((y - one.middle[0]) / one.width[0]) ** 2))
                * np.exp(-(((x - one.middle[1]) / one.width[1]) ** 2)), 0.0,
            ),
        )
        for one in sheets
    ]  # fmt: skip
    assert np.abs(truth.trace(LENS, slabs, parts=3) - truth.record(LENS, sheets)).max() < 2e-4
    wanted = [truth.cells(LENS, one) for one in sheets]
    assert np.abs(truth.on_planes(LENS, slabs, (6.0, -3.0)) - wanted).max() < 1e-6


def test_light_is_absorbed_on_its_way_and_in_its_own_slab():
    near, far = Slab(-5.0, lambda y, x: (2.0, 0.5)), Slab(5.0, lambda y, x: (3.0, 0.4))
    nearer, through = 2 * (1 - np.exp(-0.5)) / 0.5, np.exp(-0.5)
    wanted = nearer + through * 3 * (1 - np.exp(-0.4)) / 0.4
    assert truth.trace(LENS, [far, near]) == pytest.approx(wanted)
    clear = Slab(5.0, lambda y, x: (3.0, 0.0))  # attenuated, though it absorbs nothing
    assert truth.trace(LENS, [clear, near]) == pytest.approx(nearer + through * 3)


def test_flames_are_what_they_say():
    height, radius = 6.0, 1.0
    sheet = truth.burner_sheet(0.0, height, radius, 3.0, 0.0)
    for y, x in ((-1.0, 0.4), (0.5, 0.0)):
        up = (3.0 - y) / height
        along = quad(lambda z, x=x, up=up: truth.round_glow(up, np.hypot(x, z), radius), -9, 9)[0]
        seen, _ = sheet.light(np.array([[y]]), np.array([[x]]))
        assert seen[0, 0] == pytest.approx(along * (1 - 0.85 * np.exp(-((up / 0.15) ** 2))))
    flame = SootFlame(thickness=0.7, depth_ratio=1.3)
    up = np.linspace(-3.4, 3.4, 101)
    across = [2 * quad(flame.absorption, 0, 4, args=(one,), limit=200)[0] for one in up]
    assert max(across) == pytest.approx(0.7, rel=1e-3)
    total = sum(
        slab.light(np.array([[0.3]]), np.array([[0.0]]))[1] for slab in flame.slabs([500.0])
    )
    wanted = 1.3 * 1.2 * 2 * quad(flame.absorption, 0, 4, args=(-0.3,))[0]
    assert total.item() == pytest.approx(wanted, rel=1e-3)
    # Stefan and Boltzmann's law, over all wavelengths.
    power = quad(lambda nm: float(truth.planck(nm, 1800.0)), 200, 1e5, limit=500)[0]
    assert np.pi * power == pytest.approx(5.670374e-8 * 1800**4, rel=1e-3)


def test_flames_after_tables_are_as_their_tables_say():
    """Single entries, typed from the sources; soot absorbs 7.6 f / wavelength."""
    slot, ethylene = soot.SlotFlame(), soot.EthyleneFlame()
    assert slot.kelvin(5.8, -8.0) == pytest.approx(2012.9)  # 3 mm above the burner
    assert slot.kelvin(-7.0, 8.0) == pytest.approx(2084.3)  # 19 mm
    at = np.array([[-2.0]]), np.array([[3.1]])
    light, tau = zip(*(one.light(*at) for one in slot.slabs([500.0, 600.0])), strict=True)
    assert sum(tau)[0, 0] == pytest.approx([0.12, 0.1])
    seen = truth.planck(np.array([500.0, 600.0]), slot.kelvin(3.1, 2.0).item())
    assert sum(light)[0, 0] == pytest.approx(seen * [0.12, 0.1])
    up = 2.5 * 152 - 342  # the table's fourth height
    ppm, kelvin = (0.2250177 + 0.2325602) / 2, (1527.19824 + 1528.25505) / 2
    assert ethylene.absorption(20.0, up) == pytest.approx(7.6 * ppm * 1e-6 / 600e-6, rel=1e-4)
    assert ethylene.kelvin(20.0, up) == pytest.approx(kelvin, abs=0.06)
    assert ethylene.absorption(85.0, 152 - 342) == ethylene.absorption(101.0, 0.0) == 0


@pytest.mark.slow
def test_one_exposure_is_recorded_and_judged(monkeypatch):
    monkeypatch.setattr(SootFlame, "steps", 16)
    flame = SootFlame(radius=1.1, height=3.2)
    exposure = soot.Exposure(flame, Lens(lenslets=(34, 30)), radius=1.6)
    light_field, calibration = exposure.record(np.random.default_rng(0))
    found = reconstruct_soot(light_field, exposure.grid, calibration, bootstrap=3)
    judged = exposure.judge(found.temperatures)
    assert judged["rms_K"] < 15
    assert judged["rms_K"] ** 2 == pytest.approx(judged["mean_K"] ** 2 + judged["scatter_K"] ** 2)
    assert judged["thickness"] == pytest.approx(1, abs=0.05)
    assert judged["covered"] > 0.7


def test_onion_peeling_inverts_a_projection():
    step, r = 0.02, 0.02 * np.arange(200)
    seen = np.sqrt(np.pi) * np.exp(-(r**2))
    assert rivals.onion_peeling(np.stack([seen, 2 * seen]), step)[1] == pytest.approx(
        2 * np.exp(-(r**2)), abs=2e-3
    )


@pytest.mark.slow
def test_simple_methods_find_a_disc_and_a_square_and_refocused_images_do_not():
    slabs = [Slab(3.0, planes._disc), Slab(-4.0, planes._square)]
    case = planes.traced("disc and square", planes.SMALL, slabs, (3.0, -4.0))
    rows = case.errors((0.1,), 1, np.random.default_rng(0))
    errors = {row["method"]: row["error"] for row in rows}
    assert list(errors) == [planes.OURS, *rivals.PLANES]
    assert errors["reconstruct"] < 0.07
    assert errors["refocused, deconvolved"] < 0.16
    assert errors["SART"] < 0.18
    assert errors["LSQR"] < 0.3
    assert 0.6 < errors["refocused"] < 1.2


def test_a_part_that_is_measured_again_leaves_the_others(tmp_path, monkeypatch):
    rows = [
        {"flame": "disc", "noise": 0.01, "method": name, "error": error}
        for name, error in (("reconstruct", 0.0123), ("SART", 0.4))
    ]
    tables = {"Temperature": lambda rng: [{"flame": "hollow", "rms_K": 1.94}]}
    parts = {"round": report.Part("Round", "", {"Error": lambda rng: rows})}
    monkeypatch.setattr(report, "PARTS", parts | {"soot": report.Part("Soot", "", tables)})
    report.run(tmp_path, ["soot"], 1)
    text = report.run(tmp_path, ["round"], 1).read_text()
    cells = [[one.strip() for one in line.split("|")[1:-1]] for line in text.splitlines()]
    assert ["flame", "noise", "reconstruct", "SART"] in cells
    assert ["disc", "1 %", "0.0123", "0.4000"] in cells
    assert ["hollow", "1.9"] in cells
    assert list(json.loads((tmp_path / "emission.json").read_text())["parts"]) == ["round", "soot"]
