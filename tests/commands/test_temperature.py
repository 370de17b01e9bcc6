"""lf-flame temperature on folders of abel, and what it says of its result."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import tifffile
from builders import write_section
from programs import run

from experiments.emission.truth import planck
from lf_flame._common.atomic_files import output_folder
from lf_flame.formats.images import CODED
from lf_flame.tomography import ColourCalibration, SpectralResponses, Temperatures
from lf_flame.tomography.emission import Place
from lf_flame.tomography.soot_output import temperature_warnings, write_temperature

HEIGHTS, RADII = 12, 8


def soot(wavelength_nm, kelvin):
    """Planck's law times wavelength^-1, relative to 650 nm at 1,800 K."""
    return planck(wavelength_nm, kelvin) / planck(650.0, 1800.0) * 650.0 / wavelength_nm


def kelvin_of_nodes():
    return 1700.0 + 20 * np.arange(HEIGHTS)[:, None] - 10 * np.arange(RADII)


@pytest.fixture
def colours(tmp_path):
    """Green and red sections of one flame, and a dark cell."""
    folders = []
    for name, wavelength in (("green", 550.0), ("red", 650.0)):
        emission = soot(wavelength, kelvin_of_nodes())
        emission[0, -1] = 0
        folders.append(write_section(tmp_path / name, emission, 1e-3 * emission + 1e-9))
    return folders


@pytest.mark.slow
def test_sections_of_abel_have_their_temperatures(colours, monkeypatch, drawn):
    monkeypatch.chdir(colours[0])
    out = Path("temperature/green")  # where they go by default
    result = run("temperature", ".", colours[1], "--wavelengths", 550, 650)
    assert result.exit_code == 0, result.output
    known = np.delete(kelvin_of_nodes(), RADII - 1)
    said = f"{known.size} of {HEIGHTS * RADII} cells have a temperature, their median "
    assert f"{said}{np.median(known):.0f} K;" in result.output
    assert "single wavelength" in result.output
    assert "(Bayer), temperatures are off by tens to hundreds of kelvin" in result.output
    # Wien: d(1 / T) = da ln(l2 / l1) / (c2 (1 / l1 - 1 / l2)), at 1,775 K -41 K for da = 0.3.
    told = re.search(
        r"With 1.3 instead .*, temperatures would differ by about (-\d+) K", result.output
    )
    by_wien = 0.3 * np.log(650 / 550) / (1.4388e7 * (1 / 550 - 1 / 650))
    middle = np.median(kelvin_of_nodes())
    assert int(told[1]) == pytest.approx(1 / (1 / middle + by_wien) - middle, abs=1)
    found = tifffile.imread(out / "temperature.tif").reshape(HEIGHTS, RADII)
    truth = kelvin_of_nodes()
    truth[0, -1] = np.nan
    assert found == pytest.approx(truth, abs=0.5, nan_ok=True)
    record = json.loads((out / "temperature.json").read_text())
    assert record["depths_mm"] == [-3.0]
    assert "single wavelength" in record["notes"][0]


@pytest.mark.slow
def test_no_temperature_and_coded_files_are_told(colours, tmp_path, drawn):
    record = json.loads((colours[1] / "emission.json").read_text())
    record["notes"] = [f"flame.jpg is a JPEG file. {CODED}"]
    (colours[1] / "emission.json").write_text(json.dumps(record))
    words = ["--wavelengths", 650, 550, "--out", tmp_path / "out"]
    result = run("temperature", *colours, *words)
    assert result.exit_code == 0, result.output
    assert "0 of 96 cells" in result.output
    assert "No cell has a temperature" in result.output
    assert "order of the folders" in result.output
    assert f"{colours[1]} was made from files" in result.output
    assert "flame.jpg" not in result.output


def test_three_planes_are_three_pages(tmp_path):
    planes, places = np.ones((3, 6, 8)), [Place("", (-4, 4, -3, 3), z) for z in (1.0, 2.0, 3.0)]
    with output_folder(tmp_path / "out", "temperature.json") as folder:
        write_temperature(Temperatures(2e3 * planes, planes), planes, places, folder)
    with tifffile.TiffFile(tmp_path / "out" / "temperature.tif") as file:
        assert len(file.pages) == 3


def warned(*kelvin, calibrated):
    """Whether temperatures are warned of, with a furnace or lamp from 1,400 K on."""
    camera = SpectralResponses(
        ("g", "r"), [500.0, 550.0, 600.0, 650.0], [[0, 1, 0, 0], [0, 0, 1, 0.1]]
    )
    colours = ColourCalibration(camera, [1, 1], [0, 0], (1400.0, calibrated))
    return bool(temperature_warnings(Temperatures(np.array(kelvin), None), colours))


def test_temperatures_of_no_flame_are_warned_of_where_they_are_most():
    assert warned(950, 3050, 2000, calibrated=1700)
    assert not warned(950, 3050, 2000, 2000, np.nan, calibrated=1700)
    assert not warned(950, 3050, 2000, calibrated=3100)
    # Hotter than the furnace, as flames often are.
    assert not warned(1900, 1900, 1600, calibrated=1700)
    assert not warned(np.nan, np.nan, calibrated=1700)
