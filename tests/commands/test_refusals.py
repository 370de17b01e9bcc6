"""What the commands refuse themselves: each in one sentence, with nothing written."""

import shlex
from pathlib import Path

import click
import numpy as np
import pytest
import tifffile
from builders import RESPONSES, camera_toml, write_folder, write_section
from checkerboards import Bench

from lf_flame import InputError, LightField, write_light_field
from lf_flame.calibration import CameraLaw
from lf_flame.commands.cli import commands
from lf_flame.flame_video.frames import FrameReader, find_frames
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
BROKEN_PLANES = {
    "low": ("draws.tif", PLANES[:, :3]),
    "row": ("emission.tif", PLANES[0, 0]),
    "float64": ("emission.tif", PLANES.astype(np.float64)),
    "nan": ("sigma.tif", PLANES * np.float32(np.nan)),
    "text": ("draws.tif", b"none"),
    "none": ("emission.json", {"cell_mm": [], "depths_mm": []}),
    "far": ("emission.json", {"cell_mm": [1.0, 1e308]}),
    "moved": ("emission.json", {"depths_mm": [4.0, -3.0]}),
    "alone": ("draws.tif", None),
}


def write_planes(folder, name="", content=None):
    """A folder of `lf-flame reconstruct`, one file of it or values of its record changed."""
    record = {"geometry": "planes", "depths_mm": [4.0, -2.0], "cell_mm": [1.0, 0.5]}
    files = {"emission.tif": PLANES, "draws.tif": np.stack([PLANES] * 4)}
    if name == "emission.json":
        record |= content
    elif name:
        files[name] = content
    write_folder(folder, record, files)


def write_light_fields():
    """A spot of light in each view, a video of it, boards, and a furnace in two colours."""
    down, across = (np.linspace(-3, 3, count) for count in SHAPE[2:])
    spot = np.exp(-(down[:, None] ** 2) - across**2)
    views = np.broadcast_to(spot, SHAPE).astype(np.float32)
    for name, array in {"ball": views, "bright": 1.5 * views, "two": views[:2]}.items():
        np.save(f"{name}.npy", array)
    write_light_field(LightField(views), "views")
    Path("still").mkdir()
    for number in range(16):
        Path("still", f"{number}.npy").symlink_to("../ball.npy")
    bench = Bench(views=3, lenslets=(36, 44))
    for depth in DEPTHS_MM:
        write_light_field(bench.picture(depth + 410.0, 5.0, fine=4), f"b{depth}.npz")
    for kelvin in (1500, 1700):
        signal = COLOURS.gains * COLOURS.responses.black_body(kelvin)
        np.savez(f"f{kelvin}.npz", views=np.broadcast_to(signal, (3, 3, 20, 24, 2)))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Light fields, cameras, results and tables, most of them useless."""
    folder = tmp_path_factory.mktemp("refusals")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for name, text in {
            "camera.toml": camera_toml(5, SHAPE[2:]),
            "nine.toml": camera_toml(9, SHAPE[2:]),
            "law.toml": LAW.to_toml(),
            "colours.toml": COLOURS.to_toml(),
            "responses.csv": RESPONSES,
        }.items():
            Path(name).write_text(text)
        write_light_fields()
        write_planes(Path("planes"))
        for name, (file, content) in BROKEN_PLANES.items():
            write_planes(Path(f"planes_{name}"), file, content)
        write_section(Path("green"), SECTION, SECTION)
        write_section(Path("aside"), SECTION, SECTION, axis_mm=0.3)
        write_section(Path("bare"), SECTION)
        tifffile.imwrite("two.tif", np.zeros((2, 48, 60), np.float32))
        tifffile.imwrite("levels.tif", np.zeros((48, 60), np.uint8))
        Path("page.png").write_bytes(b"")
        for name in ("empty", "kinds"):
            Path(name).mkdir()
        for name in ("1.npy", "2.npy", "3.png", "notes.txt"):
            Path("kinds", name).touch()
    return folder


def each(command, *cases):
    """Calls of one command, each with other options."""
    return [(f"{command} {words}", said) for words, said in cases]


BOARDS = " ".join(f"b{depth}.npz@{depth}" for depth in DEPTHS_MM[:3])
FURNACE = "calibrate-colours f1500.npz@1500 f1700.npz@1700"

REFUSED = [
    *each(
        "abel ball.npy --camera camera.toml --out out",
        ("--radius 1e20", "--radius must be above 0 and at most the camera's focus distance"),
        ("--strength inf", "'inf' is not a finite number"),
        ("--soot-exponent 1.4", "--soot-exponent needs --colours"),
        ("--thin", "--thin needs --colours"),
    ),
    *each(
        "calibrate --square-mm 5 --out out",
        ("b-25.npz@-25 b-8.npz@-8", "3 or more different distances"),
        (f"{BOARDS} --focal-mm 50", "--hexagonal and --focal-mm need --lenslet-mm"),
        (f"{BOARDS} b25.npz@nan", "its depth in mm"),
        (f"{BOARDS} b25.npz", "its depth in mm"),
        (f"{BOARDS} --step-mm 10", "and not both"),
        (f"{BOARDS} none.npz@25", "there is no"),
        (f"{BOARDS} b-25.npz@25", "which picture"),
    ),
    (f"{FURNACE} --responses responses.csv --exposure 2", "once for each of the 2 pictures"),
    ("convert bright.npy x.png", "state a factor, such as --gain 0.671"),
    ("convert ball.npy x.npz --bits 16", "--bits does not apply to x.npz"),
    *each(
        "flicker still --frames-per-second 50",
        ("--slope 1 --depth-mm 3 --camera camera.toml", "either --slope or --depth-mm"),
        ("--depth-mm 3", "need each other"),
        ("--camera camera.toml", "need each other"),
        ("--out still", "exists; name another folder"),
        ("--out still/out", "cannot be in the frames' own folder, got still/out"),
        ("--camera nine.toml --depth-mm 0", "contains 5 x 5 views, but --views (or else the cam"),
    ),
    ("flicker still", "State when the frames were taken"),
    ("flicker still --frames-per-second nan", "not a finite number"),
    ("flicker still/0.npy still/1.npy --frames-per-second 9", "at least 16 frames, got 2 frames"),
    ("info none.npy", "no such file or folder"),
    ("info ball.npy --camera nine.toml", "9 x 9 views"),
    *(
        (f"profiles planes_{name} --out out", said)
        for name, said in {
            "low": "must contain planes as emission.tif does",
            "row": "must have pictures of rows and columns",
            "float64": "must contain 2 planes of float32",
            "nan": "sigma.tif must contain finite numbers",
            "text": "draws.tif cannot be read: it is damaged",
            "none": "with a number in cell_mm for each of",
            "far": "cell_mm #2: input should be less than or equal to",
        }.items()
    ),
    *each(
        "process ball.npy --out out.zarr --steps refocus@0.5",
        ("--depths 0 4 2", "--depths needs the step emission"),
        ("--depth-mm 1", "--depth-mm needs the step emission"),
        ("--noise 0.1", "--noise needs the step emission"),
        ("--level 0.3", "--level needs the step height"),
    ),
    ("profiles empty", "abel`, which contains emission.json: there is none"),
    ("profiles green", "has written its profiles: axial.csv and radial.csv"),
    *each(
        "reconstruct ball.npy --camera camera.toml --out out",
        ("", "either --depths FROM TO STEP or --depth-mm"),
        ("--depths 0 4 2 --depth-mm 1", "either --depths"),
        ("--depth-mm 0 --seed -1", "range x>=0"),
        ("--depth-mm 0 --colours colours.toml --optical-thickness 1", "which finds it"),
        ("--depth-mm 0 --optical-thickness thin", "must be a number or a TIFF file"),
        ("--depth-mm 0 --optical-thickness none.tif", "No such file"),
        ("--depth-mm 0 --optical-thickness two.tif", "1 planes or their 48 x 60 pixels, got shape"),
        ("--depth-mm 0 --optical-thickness levels.tif", "floating-point numbers, got uint8"),
    ),
    ("reconstruct ball.npy --camera law.toml --depth-mm 40", "depths of its targets, got 40 mm"),
    *each(
        "refocus views",
        ("--depth-mm 3", "need the camera"),
        ("--slope 0.5 --f-number 0", "need the camera"),
        ("--slope 1e9", "from -24 to 24, beyond which views"),
        ("--sweep nan 1", "finite"),
        ("--slope 0.5 --sweep 1 1", "two slopes, got 1.0 twice"),
        ("--map -1 1 --interpolation sinc", "sinc does not apply to --map"),
        ("--views 5", "--views does not apply to views, which is read as a folder of views"),
        ("--slope 0.5 --map 1 1", "lower slope first, got 1.0 and 1.0"),
        ("--map=auto --map -1 1", "cannot both be given"),
        ("--slope 1 --network empty", "no finished run"),
        ("--depth-mm 9 --camera nine.toml", "has 9 x 9 views, but the light field has 5 x 5"),
        ("--depth-mm 100 --camera law.toml", "is valid from -37.5 to 37.5 mm"),
        ("--depth-mm 0 --f-number 8 --camera law.toml", "thin-lens camera"),
        ("--slope-of nobody", "is not one of"),
        ("--background 1", "--background needs --region"),
        ("--background 90 --region 0 40 0 40", "from -24 to 24, beyond which"),
        ("--region 10 40 10 500", "inside the 48 x 60 lenslets"),
    ),
    ("refocus none", "no such file or folder"),
    ("refocus ball.npy --white ball.npy", "cannot be decoded by itself"),
    *each(
        "temperature",
        (
            "green aside --wavelengths 550 650",
            "--axis-mm 0.25 --axis-depth -3.0 --radius 4.0 --burner -12.5",
        ),
        ("green bare --wavelengths 550 650", "make it with --bootstrap 20"),
        ("planes planes_moved --wavelengths 550 650", "the same planes"),
        ("planes planes_alone --wavelengths 550 650", "--bootstrap 20"),
        ("green green empty --colours colours.toml", "for each of the 2 colours (blue, red)"),
        ("empty --colours colours.toml --wavelengths 5 6", "either --colours FILE or --wavelength"),
        ("empty --colours colours.toml", "contains no folder blue"),
    ),
    *each(
        "view ball.npy",
        ("--single-file ball.npy", "is an input, and cannot be replaced"),
        ("--single-file page.png", "must end in .html"),
        ("--single-file page.html --slopes 2 -2", "two slopes, the lower one first"),
        ("--single-file page.html --camera nine.toml", "contains 5 x 5 views, but --views"),
        ("--single-file page.html --views 3", "or else the camera) states 3"),
    ),
    ("flicker kinds --lenslets kinds/3.png --frames-per-second 9", "got 2 x .npy, 1 x .png"),
    *each(
        "process --steps decode --out x.zarr",
        ("kinds --lenslets kinds/3.png", "got 2 x .npy, 1 x .png"),
        ("ball.npy two.tif --white two.tif", "two.tif is the white or the dark image"),
    ),
    (lambda: find_frames([Path("kinds")]), "got 2 x .npy, 1 x .png"),
    (lambda: find_frames([Path("ball.npy"), Path("9.npy")]), "no such file"),
    (lambda: find_frames([Path("empty")]), "got none"),
    (lambda: FrameReader(Path("ball.npy"), {"bayer": "rggb"}).shape, "--bayer does not apply to"),
]


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
