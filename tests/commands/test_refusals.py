"""What the commands refuse: each in one sentence, with nothing written."""

import json
import shlex
from dataclasses import asdict
from pathlib import Path

import click
import lytro_files
import numpy as np
import pytest
import tifffile
from builders import camera_toml
from checkerboards import Bench
from PIL import Image

from lf_flame import PAPER_CAMERA, InputError, LightField, write_light_field
from lf_flame.calibration import CameraLaw
from lf_flame.commands.cli import commands
from lf_flame.flame_video.frames import FrameReader, find_frames
from lf_flame.formats import write_movie
from lf_flame.tomography import ColourCalibration, SpectralResponses

SHAPE = (5, 5, 48, 60)
DEPTHS_MM = (-25, -8, 6, 25)
PLANES = np.ones((2, 6, 8), np.float32)
SECTION = np.ones((12, 8), np.float32)
LAW = CameraLaw(
    slope_at_infinity=2.0, slope_mm=-800.0, centre_mm=-400.0, scale=0.002,
    depth_range_mm=(-37.5, 37.5), views=5, lenslets=SHAPE[2:],
)  # fmt: skip
COLOURS = ColourCalibration(
    SpectralResponses.single((480.0, 640.0), ("blue", "red")), [3.0, 2.0], [0, 0], (1500, 1900)
)
RESPONSES = (
    "wavelength_nm,blue,red\n478,0,0\n479,0,0\n480,1,0\n481,0,0\n639,0,0\n640,0,1\n641,0,0\n"
)
BROKEN_PLANES = {
    "low": ("draws.tif", PLANES[:, :3]), "double": ("emission.tif", np.stack([PLANES] * 2)),
    "one": ("draws.tif", PLANES[:1]), "row": ("emission.tif", PLANES[0, 0]),
    "float64": ("emission.tif", PLANES.astype(np.float64)),
    "nan": ("draws.tif", PLANES * np.float32(np.nan)),
    "correction": ("correction.tif", PLANES * np.float32(np.nan)),
    "ones": ("emission.tif", b"II*\0\x08\0\0\0" + 300 * b"\xff"), "text": ("draws.tif", b"none"),
    "cell": ("emission.json", {"cell_mm": [1.0]}),
    "zero": ("emission.json", {"cell_mm": [1, 0]}),
    "none": ("emission.json", {"cell_mm": [], "depths_mm": []}),
    "far": ("emission.json", {"cell_mm": [1.0, 1e308]}),
    "moved": ("emission.json", {"depths_mm": [4.0, -3.0]}), "alone": ("draws.tif", None),
}  # fmt: skip


def write_planes(folder, name="", content=None):
    """A folder of `lf-flame reconstruct`, one file of it or values of its record changed."""
    folder.mkdir()
    record = {"geometry": "planes", "depths_mm": [4.0, -2.0], "cell_mm": [1.0, 0.5]}
    files = {"emission.tif": PLANES, "draws.tif": np.stack([PLANES] * 4)}
    if name == "emission.json":
        record |= content
    elif name:
        files[name] = content
    if name and content is None:
        files.pop(name, None)
    write_folder(folder, "emission.json", record, files)


def write_section(folder, emission=SECTION, sigma=SECTION, **facts):
    """A folder of `lf-flame abel`."""
    folder.mkdir()
    record = {
        "geometry": "section",
        "axis_mm": 0.25,
        "axis_depth_mm": -3.0,
        "radius_mm": 4.0,
        "burner_mm": -12.5,
    }
    files = {"emission.tif": emission} | ({} if sigma is None else {"sigma.tif": sigma})
    write_folder(folder, "emission.json", record | {"step_mm": 0.5, "notes": []} | facts, files)


def write_folder(folder, name, record, files):
    (folder / name).write_text(json.dumps(record))
    for path, content in ((folder / name, content) for name, content in files.items()):
        path.write_bytes(content) if isinstance(content, bytes) else tifffile.imwrite(path, content)


def write_cameras():
    for name, text in {
        "camera.toml": camera_toml(5, SHAPE[2:]),
        "nine.toml": camera_toml(9, SHAPE[2:]),
        "law.toml": LAW.to_toml(),
        "colours.toml": COLOURS.to_toml(),
        "gain.toml": COLOURS.to_toml().replace("gains", "gain"),
        "responses.csv": RESPONSES,
        "three.csv": "wavelength_nm,a,b,c\n500,1,1,1\n600,1,1,1\n",
        "leaky.csv": RESPONSES.replace("639,0,0", "482,0,0\n638,0,0\n639,0,0")
        .replace("640,0", "640,2"),
        "other.xml": "<scene/>",
        "text.txt": "text",
    }.items():  # fmt: skip
        Path(name).write_text(text)
    Path("paper.json").write_text(json.dumps({"camera": asdict(PAPER_CAMERA)}))


def write_light_fields():
    """A spot of light in each view, a video of it, boards, and a furnace in two colours."""
    down, across = (np.linspace(-3, 3, count) for count in SHAPE[2:])
    spot = np.exp(-(down[:, None] ** 2) - across**2)
    views = np.broadcast_to(spot, SHAPE).astype(np.float32)
    for name, array in {
        "ball": views, "small": views[:, :, :8, :8], "bright": 1.5 * views, "grey": views[:3, :3],
        "narrow": views[..., :4], "four": views[:4, :4], "two": views[:2],
    }.items():  # fmt: skip
        np.save(f"{name}.npy", array)
    write_light_field(LightField(views), "views")
    Path("still").mkdir()
    for number in range(16):
        Path("still", f"{number}.npy").symlink_to("../ball.npy")
    bench = Bench(views=3, lenslets=(36, 44))
    for depth in DEPTHS_MM:
        write_light_field(bench.picture(depth + 410.0, 5.0, fine=4), f"b{depth}.npz")
    for kelvin in (1500, 1700, 1900):
        signal = COLOURS.gains * COLOURS.responses.black_body(kelvin)
        np.savez(f"f{kelvin}.npz", views=np.broadcast_to(signal, (3, 3, 20, 24, 2)))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Light fields, cameras, results and tables, most of them useless."""
    folder = tmp_path_factory.mktemp("refusals")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        write_cameras()
        write_light_fields()
        write_planes(Path("planes"))
        for name, (file, content) in BROKEN_PLANES.items():
            write_planes(Path(f"planes_{name}"), file, content)
        write_section(Path("green"))
        write_section(Path("red"), top_mm=1.0)
        write_section(Path("aside"), axis_mm=0.3)
        write_section(Path("bare"), sigma=None)
        write_section(Path("low"), SECTION[1:], SECTION[1:])
        write_section(Path("nan"), np.nan * SECTION)
        write_section(Path("cut"), b"II*\0\x08\0\0\0")
        tifffile.imwrite("two.tif", np.zeros((2, 48, 60), np.float32))
        tifffile.imwrite("levels.tif", np.zeros((48, 60), np.uint8))
        Path("broken.tif").write_bytes(b"no picture")
        Path("page.png").write_bytes(b"")
        Image.new("L", (4, 4)).save("picture.png")
        Path("other.tar").write_bytes(lytro_files.tar_of({"a.txt": b"x"}))
        for name in ("empty", "kinds"):
            Path(name).mkdir()
        for name in ("1.npy", "2.npy", "3.png", "notes.txt"):
            Path("kinds", name).touch()
    return folder


def each(command, *cases):
    """Calls of one command, each with other options."""
    return [(f"{command} {words}", said) for words, said in cases]


FLICKER = "flicker still --frames-per-second 50"
NEED = "need each other"
ABEL = "abel ball.npy --camera camera.toml --out out"
HOT = "temperature green {} --wavelengths 550 650 --out out"
RECONSTRUCT = "reconstruct ball.npy --camera camera.toml --out out"
PAGE = "view ball.npy --single-file page.html"
BOARDS = [f"b{depth}.npz@{depth}" for depth in DEPTHS_MM]
FURNACE = "calibrate-colours f1500.npz@1500 f1700.npz@1700 f1900.npz@1900"
RANGE = "holds for depths from -37.5 to 37.5 mm"

REFUSED = [
    *each(
        ABEL,
        ("--radius -1", "--radius must be above 0"),
        ("--radius 1e20", "--radius must be above 0 and at most the camera's focus distance"),
        ("--strength inf", "'inf' is no finite number"),
        ("--axis-depth 1e20", "Depths must lie above -326 mm"),
        ("--block 7", "block must be"),
        ("--burner 50", "burner_mm must be within the field"),
        ("--soot-exponent 1.4", "--soot-exponent goes with --colours"),
        ("--thin", "--thin goes with --colours"),
        ("--colours colours.toml", "a channel for each of the calibration's 2 colours"),
    ),
    ("abel narrow.npy --camera camera.toml", "8 columns of pixels or more, got views of"),
    ("abel ball.npy --camera law.toml --axis-depth 40", RANGE),
    *(
        (f"calibrate {' '.join(words)} --square-mm 5 --out out", said)
        for words, said in (
            (BOARDS[:2], "3 different distances"),
            ([*BOARDS[:3], "--focal-mm", "50"], "--focal-mm goes with --lenslet-mm"),
            ([*BOARDS[:3], "b25.npz@nan"], "its depth in mm"),
            ([*BOARDS[:3], "b25.npz"], "its depth in mm"),
            ([*BOARDS, "--step-mm 10"], "and not both"),
            ([BOARDS[0], "b-8.npz", "--step-mm 9"], "not both"),
            ([*BOARDS[:3], "none.npz@25"], "there is no"),
            ([*BOARDS[:3], "b-25.npz@25"], "which picture"),
        )
    ),
    *each(
        FURNACE,
        ("--responses three.csv", "each of the 3 spectral responses, got 2"),
        ("--responses responses.csv --exposure 2", "once for each of the 3 pictures"),
        ("--responses leaky.csv", "lets too much red"),
    ),
    ("calibrate-colours f1500.npz@1500 --responses responses.csv", "two temperatures or more"),
    ("calibrate-colours f1500.npz", "as f1.tif@1273"),
    (
        "calibrate-colours f1500.npz@1500 f1700.npz@1900 f1900.npz@1700 --responses responses.csv",
        "in the order of the pictures",
    ),
    *each(
        "convert views",
        ("light.xyz", ".png, .tif, .npy, .npz or .zarr, got light.xyz"),
        ("text.txt", "got text.txt"),
    ),
    ("convert bright.npy x.png", "state a factor, as --gain 0.671"),
    ("convert bright.npy y.png --bits 32", "Floats (32 bits) are written as .tif"),
    *each(
        FLICKER,
        ("--slope 1 --depth-mm 3 --camera camera.toml", "either --slope or --depth-mm"),
        ("--depth-mm 3", NEED),
        ("--camera camera.toml", NEED),
        ("--slope nan", "as refocus@0.5, got 'nan'"),
        ("--burner-row 48", "burner_row must lie within"),
        ("--slope 1e308", "shifted by more than the image"),
        ("--out still", "exists; name another folder"),
        ("--camera nine.toml --depth-mm 0", "has 9 x 9 views"),
        ("--level nan", "'nan' is no finite number"),
        ("--pixel-mm nan", "'nan' is no finite number"),
    ),
    ("flicker still", "Say when the frames were taken"),
    *(
        (f"{command} still --frames-per-second {rate}", said)
        for command in ("flicker", "process --steps height --out out.zarr")
        for rate, said in (("nan", "no finite number"), ("1e308", "range"), ("0", "range"))
    ),
    ("flicker still/0.npy still/1.npy --frames-per-second 9", "16 frames at least, got 2 frames"),
    *each(
        "info",
        ("other.tar", "other.tar holds no white images of a Lytro camera"),
        ("other.xml", "no calibration of a Raytrix camera"),
        ("four.npy --camera law.toml", "5 x 5 views"),
    ),
    *(
        (f"profiles planes_{name} --out out", said)
        for name, said in {
            "low": "must hold planes as emission.tif does",
            "double": "must hold planes as emission.tif does",
            "one": "must hold 2 planes of float32",
            "row": "must hold pictures of rows and columns",
            "float64": "must hold 2 planes of float32",
            "nan": "must hold finite numbers",
            "correction": "correction.tif must hold finite numbers",
            "ones": "emission.tif cannot be read",
            "text": "draws.tif cannot be read: it is damaged",
            "cell": "with a number in cell_mm for each of",
            "none": "with a number in cell_mm for each of",
            "zero": "must be lengths from",
            "far": "must be lengths from",
        }.items()
    ),
    ("profiles planes --across 9 --out out", "must lie within"),
    ("profiles empty", "or `lf-flame abel`: there is no emission.json"),
    ("profiles green", "has written its profiles: axial.csv and radial.csv"),
    *each(
        RECONSTRUCT,
        ("", "either --depths FROM TO STEP or --depth-mm"),
        ("--depths 0 4 2 --depth-mm 1", "either --depths"),
        ("--depths 0 4 3", "must divide"),
        ("--depth-mm -326", "main lens"),
        ("--depth-mm 1e9", "beyond which all is as at infinity"),
        ("--depths 1e308 6 6", "at most 200 planes"),
        ("--depths -6 6 1e-320", "at most 200 planes"),
    ),
    *each(
        f"{RECONSTRUCT} --depth-mm 0",
        ("--noise 0", "x>0"),
        ("--strength 0", "x>0"),
        ("--dark small.npy", "must have the light field's shape"),
        ("--noise 1e20", "at most the light field's largest"),
        ("--bootstrap 1000000000", "2 to 10000"),
        ("--seed -1", "range x>=0"),
        ("--optical-thickness thin", "must be a number or a TIFF file"),
        ("--optical-thickness 5", "at most 2 in total, got 5"),
        ("--optical-thickness none.tif", "there is no such file"),
        ("--optical-thickness two.tif", "1 planes of 48 x 60 pixels, got shape"),
        ("--optical-thickness levels.tif", "floating-point numbers, got uint8"),
        ("--optical-thickness broken.tif", "broken.tif cannot be read"),
    ),
    ("reconstruct ball.npy --camera law.toml --depth-mm 40", "where targets stood, got 40 mm"),
    *each(
        "refocus views",
        ("--depth-mm 3", "need the camera"),
        ("--slope 0.5 --f-number 0", "need the camera"),
        ("--slope nan", "finite"),
        ("--slope 1e9", "from -24 to 24, beyond which views"),
        ("--sweep nan 1", "finite"),
        ("--slope 0.5 --sweep 1 1", "two slopes, got 1.0 twice"),
        ("--map -1 1 --interpolation sinc", "linear, nearest, cubic, got 'sinc'"),
        ("--views 5", "--views does not apply to views, which is read as a folder of views"),
        ("--layout hexagonal", "--layout does not apply"),
        ("--pitch 9", "which is read as a folder of views"),
        ("--slope 0.5 --map 1 1", "lower slope first, got 1.0 and 1.0"),
        ("--map=auto --map -1 1", "cannot both be given"),
        ("--slope 1 --gain nan", "no finite number"),
        ("--slope 1 --network empty", "no finished run"),
        ("--depth-mm 9 --camera nine.toml", "has 9 x 9 views, but the light field has 5 x 5"),
        ("--depth-mm 1e9 --camera camera.toml", "Depths must lie above -326 mm"),
        ("--depth-mm -326 --camera camera.toml", "Depths must lie above -326 mm"),
        ("--depth-mm 100 --camera law.toml", RANGE),
        ("--depth-mm 0 --f-number 8 --camera law.toml", "thin-lens camera"),
    ),
    ("refocus views --slope-of nobody", "is not one of"),
    ("refocus ball.npy --region 10 40 10 500", "inside the 48 x 60 lenslets"),
    ("refocus none", "no such file or folder"),
    *each(
        "refocus ball.npy --background",
        ("90 --region 0 40 0 40", "from -24 to 24, beyond which"),
        ("1", "--background needs --region"),
    ),
    *(
        (HOT.format(name), said)
        for name, said in {
            "aside": "--axis-mm 0.25 --axis-depth -3.0 --radius 4.0 --burner -12.5",
            "bare": "make it with --bootstrap 20",
            "low": "must hold the same planes",
            "nan": "must hold finite numbers",
            "cut": "emission.tif cannot be read: it is damaged",
            "empty": "there is no emission.json",
        }.items()
    ),
    *(
        (f"temperature planes planes_{name} --wavelengths 550 650", said)
        for name, said in {
            "moved": "the same planes",
            "alone": "--bootstrap 20",
            "ones": "emission.tif cannot be read",
        }.items()
    ),
    *each(
        "temperature green green",
        ("--wavelengths 5.5e-4 6.5e-4", "must be two in nm, from 100 to 100000"),
        ("--wavelengths 550 650 --soot-exponent 6", "soot_exponent must be from -1 to 5"),
        ("empty --colours colours.toml", "for each of the 2 colours (blue, red)"),
    ),
    *each(
        "temperature empty",
        ("--colours colours.toml --wavelengths 500 600", "either --colours FILE or --wavelengths"),
        ("--colours colours.toml", "holds no folder blue"),
        ("--colours gain.toml", "gain is not a known key (perhaps gains)"),
    ),
    *each(
        PAGE,
        ("--single-file ball.npy", "is read, and cannot be replaced"),
        ("--single-file page.png", "must end in .html"),
        ("--slopes 2 -2", "two slopes, the lower one first"),
        ("--slopes nan 2", "two slopes, the lower one first"),
        ("--slopes -400 400", "two slopes, the lower one first, from -24 to 24"),
        ("--megabytes 0", "is not in the range"),
        ("--megabytes nan", "no finite number"),
        ("--camera paper.json", "The camera has 15 x 15 views"),
        ("--port 700000", "is not in the range"),
    ),
    (lambda: find_frames([Path("kinds")]), "several kinds (2 x .npy, 1 x .png)"),
    (lambda: find_frames([Path("ball.npy"), Path("9.npy")]), "no such file"),
    (lambda: find_frames([Path("ball.npy"), Path("ball.npy")]), "more than once"),
    (lambda: find_frames([Path("empty")]), "holds no frames"),
    (
        lambda: FrameReader(Path("ball.npy"), {"bayer": "rggb"}).shape,
        "--bayer does not apply to",
    ),
    (
        lambda: FrameReader(Path("ball.npy"), {"pitch": 9.0, "order": "col,row"}).shape,
        "--pitch does not apply",
    ),
    (lambda: write_movie(Path("sweep.avi"), PLANES), "written as .gif, got sweep.avi"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("call", "said"), REFUSED, ids=[f"{k}-{said[:30]}" for k, (_, said) in enumerate(REFUSED)]
)
def test_it_is_refused_in_a_sentence_and_nothing_is_written(folder, monkeypatch, call, said):
    monkeypatch.chdir(folder)
    before = {path: path.lstat().st_mtime_ns for path in Path().rglob("*")}
    with pytest.raises((InputError, click.UsageError)) as caught:
        commands.main(shlex.split(call), standalone_mode=False) if isinstance(call, str) else call()
    assert said in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1
    assert {path: path.lstat().st_mtime_ns for path in Path().rglob("*")} == before


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("refocus wide.npy --aperture 0.5", "--aperture does not apply to a network"),
        ("refocus wide.npy --interpolation sinc", "--interpolation does not apply to a network"),
        ("refocus wide.npy --map -1 1", "--map does not apply to a network"),
        ("refocus small.npy", "needs images of 17 pixels"),
        ("refocus wide.npy --region 0 30 0 30", "needs the network of `train-system volumetric`"),
        ("refocus wide.npy --region 0 30 0 30 --slope 1", "makes no other pictures"),
    ],
)
def test_what_a_network_cannot_do_is_refused(system_runs, tmp_path, monkeypatch, words, said):
    monkeypatch.chdir(tmp_path)
    for name, rows in (("wide", 30), ("small", 16)):
        np.save(f"{name}.npy", np.random.default_rng(1).uniform(size=(9, 9, rows, 30)))
    network = ["--network", str(system_runs / "refocusnet")]
    with pytest.raises(InputError, match=said):
        commands.main([*shlex.split(words), *network], standalone_mode=False)
    assert len(list(tmp_path.iterdir())) == 2
