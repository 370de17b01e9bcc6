"""`lf-flame report`: one file from what a folder holds, and from nothing else."""

import base64
import io
import json
import re
from pathlib import Path

import numpy as np
import pytest
from builders import DATA
from click.testing import CliRunner
from PIL import Image

from lf_flame import InputError
from lf_flame._common.atomic_files import write_text
from lf_flame._common.output_folders import output_folder
from lf_flame.commands import cli
from lf_flame.datasets.config import config_from_json, config_to_json


def run(folder, out):
    return CliRunner().invoke(cli.commands, ["report", str(folder), "--out", str(out)])


@pytest.fixture
def results(tmp_path):
    """A folder as commands write it, with one warning, one table, one curve and one picture."""
    folder = tmp_path / "flame"
    with output_folder(folder, "reconstruct.json") as out:
        write_text(out.path("depth.csv"), "depth_mm,light\n10.0,0.125\n-10.0,4.5\n")
        rows = "".join(f"{epoch},{2.0**-epoch}\n" for epoch in range(20))
        write_text(out.path("history.csv"), f"epoch,loss\n{rows}")
        Image.new("RGB", (8, 4), (255, 0, 0)).save(out.path("slices.png"))
        out.facts |= {"depths_mm": [10.0, -10.0], "warnings": ["<b>Light</b> at the edge."]}
    (folder / "stray.csv").write_text("secret,of\n1,2\n")
    return folder


def test_a_report_holds_what_the_folder_holds_and_is_the_same_again(results, tmp_path):
    assert run(results, tmp_path / "one.html").exception is None
    page = (tmp_path / "one.html").read_text()
    assert "All files are as they were written; 1 warning, below." in page
    assert "<td>0.125</td>" in page
    assert "&lt;b&gt;Light&lt;/b&gt; at the edge." in page  # text from files is text
    assert "Depth planes were at 10, -10 mm from the focal plane." in page
    assert "secret" not in page  # no record lists it
    assert "script" not in page  # not in its policy either
    (data,) = re.findall(r"base64,([\w+/=]+)", page)
    picture = np.asarray(Image.open(io.BytesIO(base64.b64decode(data))))
    assert picture.shape == (4, 8, 3)
    assert (picture == (255, 0, 0)).all()
    points = re.search(r'points="([^"]*)"', page)[1].split()
    at = np.array([point.split(",") for point in points], float)
    np.testing.assert_allclose(at[:, 0], np.linspace(0, 300, 20), atol=0.06)
    np.testing.assert_allclose(at[:, 1], np.linspace(0, 120, 20), atol=0.06)  # logarithms
    run(results, tmp_path / "two.html")
    assert (tmp_path / "two.html").read_bytes() == (tmp_path / "one.html").read_bytes()


def test_damaged_results_are_refused(results, tmp_path):
    (results / "depth.csv").write_text("depth_mm,light\n10.0,9.9\n")
    assert "depth.csv is not the file" in str(run(results, tmp_path / "one.html").exception)
    assert not (tmp_path / "one.html").exists()


def test_names_in_records_and_links_open_nothing(tmp_path):
    (tmp_path / "secret.csv").write_text("a,b\nhidden,1\n")
    folder = tmp_path / "bad"
    folder.mkdir()
    (folder / "link.csv").symlink_to(tmp_path / "secret.csv")
    (folder / "torn.png").write_bytes(b"\x89PNG\r\n\x1a\n nothing")
    (folder / "torn.csv").write_text("a,b\n1\n")
    (folder / "wide.csv").write_text("a,b\n1," + 200_000 * "x" + "\n")
    (folder / "far.csv").write_text("a,b\n" + "".join(f"{k},{k}e307\n" for k in range(1, 20)))
    (folder / "other.json").write_text('{"files": 3, "recipe": {"batch_size": 1e999}}')
    files = [
        "../secret.csv",
        "link.csv",
        "torn.png",
        "torn.csv",
        "wide.csv",
        "far.csv",
        3,
        "\u202e",
    ]
    record = {"files": files, "table": [{"a": 1}, {"b": [2]}], "warnings": [{}], "title": ["x"]}
    (folder / "any.json").write_text(json.dumps(record))
    (folder / "broken.json").write_text("{")
    assert run(folder, tmp_path / "one.html").exception is None
    page = (tmp_path / "one.html").read_text()
    assert "hidden" not in page
    for name in ("torn.png", "torn.csv", "wide.csv", "broken.json", "other.json"):
        assert f"{name} is not shown" in page


@pytest.mark.parametrize("slopes", [[], ["x"], [float("nan")], [1e9], None])
def test_a_light_field_whose_record_makes_no_sense_is_not_shown(tmp_path, slopes):
    folder = tmp_path / "simulated"
    with output_folder(folder, "simulation.json") as out:
        np.savez(out.path("light_field.npz"), views=np.zeros((3, 3, 4, 5), np.float32))
        out.facts["slopes"] = slopes
    assert run(folder, tmp_path / "one.html").exception is None
    page = (tmp_path / "one.html").read_text()
    assert "The viewer is not shown: " in page
    assert "script" not in page


def write_scored(folder, config):
    folder.mkdir()
    record = {"dataset": {"config": config, "slopes": [0.5, -0.5]}}
    (folder / "table1.json").write_text(json.dumps(record))


def test_the_report_of_a_network_holds_a_light_field_of_its_data_set(tmp_path):
    config = config_to_json(config_from_json(DATA, "here"))
    write_scored(tmp_path / "scored", config)
    assert run(tmp_path / "scored", tmp_path / "one.html").exception is None
    assert "script" in (tmp_path / "one.html").read_text()
    config["camera"]["lenslets"] = [40_000, 64_000]
    for number, wrong in enumerate((config, {"kind": "shapes"}, {"kind": ["x"]})):
        write_scored(tmp_path / f"{number}", wrong)
        assert run(tmp_path / f"{number}", tmp_path / "one.html").exception is None
        assert "The viewer is not shown: " in (tmp_path / "one.html").read_text()


def test_a_page_of_yours_is_not_replaced_unasked(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("one").mkdir()
    Path("one/any.json").write_text('{"seed": 7}')
    Path("report.html").write_text("my thesis")
    refused = CliRunner().invoke(cli.commands, ["report", "one"])
    assert "is no report: name another" in str(refused.exception)
    assert Path("report.html").read_text() == "my thesis"
    Path("report.html").unlink()
    for _ in range(2):
        assert CliRunner().invoke(cli.commands, ["report", "one"]).exit_code == 0
    assert "seed" in Path("report.html").read_text()


@pytest.mark.slow
def test_pictures_are_reduced_until_they_fit(tmp_path):
    noise = np.random.default_rng(1).integers(0, 256, (900, 1400, 3), dtype=np.uint8)
    Image.fromarray(noise).save(tmp_path / "noise.png", compress_level=1)
    (tmp_path / "any.json").write_text('{"seed": 7}')
    run(tmp_path, tmp_path / "one.html")
    page = (tmp_path / "one.html").read_bytes()
    assert 1e6 < len(page) <= 5_000_000
    assert page.count(b"<img") == 1


@pytest.mark.parametrize("text", ["[", "[1]", ""])
def test_folders_without_records_are_refused(tmp_path, text):
    (tmp_path / "any.json").write_text(text)
    error = run(tmp_path, tmp_path / "one.html").exception
    assert isinstance(error, InputError)
    assert "holds no record" in str(error)
    assert not (tmp_path / "one.html").exists()
