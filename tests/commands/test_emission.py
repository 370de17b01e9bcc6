"""lf-flame reconstruct and abel: from a light field to a folder of emission."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
import tifffile
from builders import camera_toml
from programs import run

from lf_flame import PAPER_CAMERA, Layer, Scene, render
from lf_flame.scenes.flames import flame_texture

CAMERA = camera_toml(5, (48, 60))
LENS = replace(PAPER_CAMERA, views=5, lenslets=(48, 60))
ACROSS, DEPTH, WIDTH, PEAK = -0.6, 3.0, 0.9, 0.5


def noisy(layers, sigma):
    views = render(Scene(layers), LENS, tolerance=1e-6).views
    noise = np.random.default_rng(0).standard_normal(views.shape, dtype=np.float32)
    return views + np.float32(sigma * views.max()) * noise


@pytest.fixture(scope="module")
def flames():
    """Views of two flames, of 1 and 0.5 in brightness, at 6 and -4 mm."""
    texture = flame_texture(4.0, 0.4, cell_mm=0.05)
    both = ((6.0, 1.0, -1.0), (-4.0, 0.5, 1.2))
    return noisy(
        [Layer(bright * texture, depth, (4.0, 2.56), (0.0, x)) for depth, bright, x in both], 0.01
    )


@pytest.fixture(scope="module")
def ball():
    """Views of a ball of light, exp(-(r / WIDTH)^2), as thin layers."""
    at = np.linspace(-3, 3, 121)
    disc = np.exp(-((at[:, None] ** 2 + at**2) / WIDTH**2))
    depths = np.arange(-2.5, 2.5, 0.1) + 0.05
    parts = [PEAK * 0.1 * np.exp(-((z / WIDTH) ** 2)) * disc for z in depths]
    return noisy(
        [Layer(part, DEPTH + z, (6.05, 6.05), (0.0, ACROSS))
         for part, z in zip(parts, depths, strict=True)], 0.01,
    )  # fmt: skip


@pytest.fixture
def call(tmp_path, monkeypatch):
    """Run a command on views in the working folder, and give what it says."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "camera.toml").write_text(CAMERA)

    def call(command, views, *words):
        np.save("flame.npy", views)
        done = run(command, "flame.npy", "--camera", "camera.toml", *words, "--out", "found")
        assert done.exit_code == 0, done.output
        return done.output

    return call


@pytest.mark.slow
def test_emission_is_found_at_each_depth(call, flames, tmp_path, drawn):
    call("reconstruct", flames, "--depth-mm", 6, "--depth-mm", -4, "--bootstrap", 2)
    out = tmp_path / "found"
    emission = tifffile.imread(out / "emission.tif")
    assert emission.shape == tifffile.imread(out / "sigma.tif").shape == (2, 48, 60)
    assert emission.max(axis=(1, 2)) == pytest.approx([1.0, 0.5], rel=0.1)
    rows = list(csv.DictReader((out / "depth.csv").read_text().splitlines()))
    lights = [float(row["light_radiance_mm2"]) for row in rows]
    wanted = flame_texture(4.0, 0.4, cell_mm=0.05).mean() * 4.0 * 2.56
    assert lights == pytest.approx([wanted, wanted / 2], rel=0.05)
    assert all(float(row["standard_deviation"]) > 0 for row in rows)
    record = json.loads((out / "emission.json").read_text())
    assert record["noise"] == pytest.approx(0.01 * flames.max(), rel=0.1)
    assert record["depths_mm"] == [6, -4]
    assert {"slices.png", "depth.png", "trust.png"} <= set(record["files"])


@pytest.mark.slow
def test_a_ball_is_found_with_its_axis(call, ball, tmp_path, drawn):
    call("abel", ball, "--bootstrap", 3)
    record = json.loads((tmp_path / "found" / "emission.json").read_text())
    assert record["axis_mm"] == pytest.approx(ACROSS, abs=0.03)
    assert record["axis_depth_mm"] == pytest.approx(DEPTH, abs=0.2)
    with (tmp_path / "found" / "radial.csv").open() as file:
        rows = [{name: float(x) for name, x in row.items()} for row in csv.DictReader(file)]
    truth = [
        PEAK * np.exp(-(row["height_mm"] ** 2 + row["radius_mm"] ** 2) / WIDTH**2) for row in rows
    ]
    found = [row["emission_per_mm"] for row in rows]
    assert np.abs(np.subtract(found, truth)).max() < 0.06 * PEAK
    assert all(row["standard_deviation"] >= 0 for row in rows)
    with (tmp_path / "found" / "axial.csv").open() as file:
        axis = [float(row["emission_per_mm"]) for row in csv.DictReader(file)]
    assert axis == [row["emission_per_mm"] for row in rows if row["radius_mm"] == 0]
    assert (tmp_path / "found" / "section.png").read_bytes().startswith(b"\x89PNG")
    # At a stated depth the central view sees axis and radius at the same pixels.
    said = call("abel", ball, "--axis-depth", 40, "--central", "--bootstrap", 0, "--overwrite")
    away = json.loads((tmp_path / "found" / "emission.json").read_text())
    scale = LENS.field_mm(40.0)[1] / LENS.field_mm(record["axis_depth_mm"])[1]
    for name in ("axis_mm", "radius_mm"):
        assert away[name] == pytest.approx(record[name] * scale, rel=1e-6)
    assert "was stated at a depth of 40.00 mm" in said
    assert "mm across, the light field shows" not in said
