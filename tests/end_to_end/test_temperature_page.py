"""The page from a raw image to a temperature, done as it says, in an empty folder."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
import tifffile
from programs import run_here

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "from_raw_image_to_temperature.md").read_text(encoding="utf-8")

KELVIN = (1750.0, 1850.0, 1800.0)


@pytest.mark.slow
def test_the_page_ends_in_the_temperatures_that_it_began_with(tmp_path):
    pytest.importorskip("pyproximal")
    (tmp_path / "data_gen").symlink_to(ROOT / "data_gen")
    blocks = re.findall(r"^```sh\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
    commands = [shlex.split(line) for block in blocks for line in block.splitlines()]
    assert len(commands) == 7
    for program, *arguments in commands:
        assert program == "lf-flame"
        done = run_here(*arguments, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        assert "Warning" not in done.stderr
    found = tifffile.imread(tmp_path / "temperature" / "green" / "temperature.tif")
    sigma = tifffile.imread(tmp_path / "temperature" / "green" / "temperature_sigma.tif")
    emission = tifffile.imread(tmp_path / "reconstructed" / "red" / "emission.tif")
    for plane, kelvin in enumerate(KELVIN):
        bright = emission[plane] > 0.2 * emission[plane].max()
        inside = found[plane][bright]
        assert np.isfinite(inside).all()
        assert abs(inside.mean() - kelvin) < 5
        assert inside.std() < 15
        # Both colours err alike where the prior does, which bars that take them apart do not know.
        error = np.sqrt(np.mean((inside - kelvin) ** 2))
        assert error < sigma[plane][bright].mean() < 4 * error
    for name in ("axial", "radial"):
        assert "low_95" in (tmp_path / "profiles" / "red" / f"{name}.csv").read_text()
