"""What reading and writing light fields refuses, each in one sentence that names the file."""

import io
import struct
import tarfile
from functools import cache, partial
from pathlib import Path

import lytro_files as lytro
import numpy as np
import pytest
from focused_pictures import Camera
from micro_images import nearest_lenslet
from scipy.io import savemat
from scipy.ndimage import gaussian_filter
from sentences import each, refusals
from skimage.io import imsave
from tifffile import imwrite

from lf_flame import InputError, LightField, read_light_field
from lf_flame.formats import (
    LensletGrid,
    decode_raw,
    estimate_grid,
    read_focal_stack,
    read_raw,
    scan_view_folder,
    write_focal_stack,
    write_light_field,
)
from lf_flame.formats.focused.lenslets import read_raytrix
from lf_flame.formats.focused.views import FocusedPlan
from lf_flame.formats.images import write_image
from lf_flame.formats.lytro.picture import read_lytro
from lf_flame.formats.lytro.white import find_white
from lf_flame.formats.raw.lenslet_grid import grid_from_pitch
from lf_flame.refocus import all_in_focus
from lf_flame.systems import ShiftAndSum
from lf_flame.systems.formulas import square_of_views

RNG = np.random.default_rng(1)
NAN, INF = np.nan, np.inf


def levels(*shape, dtype=np.uint8):
    return RNG.integers(0, np.iinfo(dtype).max, shape, dtype, endpoint=True)


def put(path, content):
    """Write bytes, a text, an array or several arrays, as the name of the file says."""
    path.parent.mkdir(exist_ok=True, parents=True)
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif isinstance(content, str):
        path.write_text(content)
    elif path.suffix == ".npz":
        np.savez(path, **content)
    elif path.suffix == ".mat":
        savemat(path, content, format="4")
    elif path.suffix == ".npy":
        np.save(path, content)
    elif path.suffix == ".tif":
        imwrite(path, content)
    else:
        imsave(path, content, check_contrast=False)


def of(files, name=".", read=read_light_field, **options):
    """Call that writes files into the working folder and reads one of them, or the folder."""

    def call():
        for file, content in files.items():
            put(Path(file), content)
        return read(Path(name), **options)

    return call


def one(name, content, read=read_light_field, **options):
    return of({name: content}, name, read, **options)


def cut(name, content, end):
    """Call that reads the beginning of a file."""

    def call():
        put(Path(name), content)
        Path(name).write_bytes(Path(name).read_bytes()[:end])
        return read_light_field(name)

    return call


def square(side=2, form="{}_{}.png", shape=(3, 4), dtype=np.uint8):
    """Views with names that count rows and columns."""
    return {form.format(*at): levels(*shape, dtype=dtype) for at in np.ndindex(side, side)}


RUN = {f"{n}.png": levels(3, 4) for n in range(9)}
HOLE = {name: view for name, view in square(3).items() if name != "1_1.png"}
FIELD = np.ones((2, 2, 3, 4))
FOLDERS = [
    *((of(RUN, grid=grid), "grid must be rows x columns") for grid in ("0x9", (3,))),
    (of(RUN, grid="2x4"), "do not count 8 positions from 1"),
    (of(square(3), grid="1x9"), "do not count 1 positions from 0"),
    (of(RUN, "0.png", grid="1x1"), "grid does not apply to 0.png, which is read as a lenslet imag"),
    *((of(square(), order=order), "order must be one of row,col; ") for order in ("row", "")),
    (of({}, read=scan_view_folder), r"one set of images \(.png, .* got none"),
    (of(RUN, names="view*.png"), r"are like view\*.png and differ only in numbers"),
    (partial(scan_view_folder, "nowhere"), "is not a folder"),
    (of({**square(), **square(form="d{}_{}.png")}), "must contain one set .*--names '#?.*png'"),
    (of(dict.fromkeys(["1_1.png", "01_01.png", "1_01.png"], RUN["0.png"])), "do not number a grid"),
    (of({**square(), "0_0.png": b"no picture"}), "0_0.png cannot be read"),
    (of({**square(3), "1_1.png": levels(3, 5)}), r"1_1.png has shape \(3, 5\), 0_0.png \(3, 4\)"),
    (of(square(2, "{}_{}.tif", (6, 7, 5))), r"0_0.tif must have 1 or 3 .*\(6, 7, 5\)"),
    (of(square(2, "{}_{}.tif", dtype=np.int32)), "0_0.tif .* unsigned .* or floats, got int32"),
    (of(square(), white="0_0.png"), "white does not apply to ., which is read as a folder of vie"),
    (lambda: all_in_focus(of(HOLE)(), [-1.0, 0.0, 1.0]), "slope map, .* needs the view in row 1"),
    (lambda: ShiftAndSum("nine", square_of_views).refocus(of(HOLE)(), 0.5), "the view in row 1"),
    (one("a.png", levels(60, 90), mosaic="7x3"), "7 x 3 views needs sides .* has 60 x 90 pixels"),
    (one("a.png", levels(60, 90), mosaic="8"), "mosaic must be rows x columns of .* got '8'"),
    (one("a.png", levels(60, 90), mosaic="3x3", grid="3x3"), "grid does not apply to a.png, .* mo"),
    (one("a.png", levels(60, 90), views=3, bayer="rggb"), "bayer does not .*, as there is neither"),
    (one("a.npy", FIELD, mosaic="3x3"), "mosaic does not apply to a.npy, which is read as an arra"),
]

VIEWS = RNG.uniform(size=(2, 2, 3, 3))
PICKLED = np.array([{"a": 1}], object)
STACK = RNG.uniform(size=(7, 10, 12)).astype(np.float32)
LENSLETS = levels(28, 42)
FILES = [
    ("pickled.npy", PICKLED, {}, "pickled.npy cannot be read"),
    ("pickled.npz", {"views": PICKLED}, {}, "pickled.npz cannot be read"),
    ("text.npy", "no array", {}, "cannot be read"),
    ("empty.npy", b"", {}, "cannot be read"),
    ("text.npz", "no archive", {}, "cannot be read"),
    ("two.npz", {"a": VIEWS, "b": VIEWS}, {}, r"numbers named views, got a \(2, 2, 3, 3\), b"),
    ("none.npz", {}, {}, "got none"),
    ("complex.npy", VIEWS + 1j, {}, "or floats, got complex128"),
    ("long.npy", VIEWS.astype(int), {}, "8 or 16 bits, or floats, got int64"),
    ("line.npy", VIEWS.ravel(), {}, r"got shape \(36,\)"),
    ("nan.npy", VIEWS * NAN, {}, "must be finite, got 36 NaN"),
    ("a.npz", {"views": VIEWS, "weights": np.ones((2, 3))}, {}, "weights must"),
    ("a.npz", {"views": VIEWS, "valid": np.ones((2, 2, 3, 4))}, {}, "valid must"),
    ("a.npy", FIELD, {"grid": "3x2"}, "grid of 3 x 2 views does not fit a.npy, of 2 x 2"),
    ("a.npy", np.ones((40, 50, 6, 7, 9)), {}, "unlikely to be vutsc: state its .* --axes`"),
    ("a.npy", FIELD, {"axes": "vutsc"}, "axes must be one letter for each axis of .*, got "),
    ("a.npy", FIELD, {"axes": "xyzw"}, "axes must be one letter for each axis of .*, got "),
    ("a.png", LENSLETS, {}, r"28 x 42 .*\(2, 7, 14\), got None; to decode a raw image"),
    ("a.png", LENSLETS, {"views": 15}, r"28 x 42 pixels \(2, 7, 14\), got 15"),
    ("a.png", levels(9, 8), {"views": 3}, r"\(only 1 does\), got 3"),
    ("a.png", b"no picture", {"views": 2}, "a.png cannot be read"),
    ("a.xyz", b"", {}, "a.xyz is not a light field: it must be a folder of views"),
    ("a.mat", b"anything", {}, r"a\.mat cannot be read: .* not a MATLAB file of version 5 or 7"),
    (
        "a.mat",
        {"LF": np.ones((3, 4))},
        {},
        r"a\.mat cannot be read: .* not a MATLAB file of version 5 or 7",
    ),
    ("seven.tif", STACK, {}, "seven.tif contains 7 views .* form no square: .* --grid ROWSxCO"),
    ("text.tif", "no picture", {}, "text.tif"),
]
ARRAYS = [
    *((one(name, content, **options), said) for name, content, options, said in FILES),
    (cut("cut.npz", {"a": VIEWS}, 300), "cut.npz cannot be read"),
    (cut("cut.npy", VIEWS, -8), "cut.npy cannot be read"),
    (cut("cut.tif", STACK, 200), "cut.tif"),
    (partial(read_light_field, "nowhere.npy"), "no such file"),
    (partial(read_light_field, "nowhere"), "no such file or folder"),
    (one("b.tif", levels(2, 2, 5, 6, dtype=np.uint16), read_focal_stack), "images along one axis"),
]


def reads_a_focal_stack():
    write_focal_stack(STACK[:4], [0, 1, 2, 3], "focal.tif")
    read_light_field("focal.tif")


@cache
def white(layout="hexagonal", pitch=12.2):
    """Round micro-images, 300 x 320 pixels."""
    y, x = np.mgrid[:300, :320].astype(float)
    *_, down, along = nearest_lenslet(y - 30, x - 20, pitch, hexagonal=layout == "hexagonal")
    return np.clip(0.45 * pitch - np.hypot(down, along) + 0.5, 0, 1)


def of_no_grid():
    """Images that show no array of lenslets."""
    y, x = np.mgrid[:300, :300]
    noise = np.random.default_rng(2).uniform(size=y.shape)
    return [0 * noise, noise, x + y, np.sin(x / 2) + noise, gaussian_filter(noise, 4)]


FLAT, EVEN, SIX = np.ones((50, 50)), np.ones((30, 30)), LensletGrid(2.5, 2.5, 6)
RAW = [
    *((lambda k=k: estimate_grid(of_no_grid()[k]), "No regular array of micr") for k in range(5)),
    (lambda: estimate_grid(white(), pitch=30), "every 12 pixels, not every 30"),
    (lambda: estimate_grid(white(), layout="rectangular"), "must be hexagonal, .* 'rectangular'"),
    (lambda: estimate_grid(white()[:30, :60]), "No regular array of micro-images"),
    *each(
        estimate_grid,
        ((FLAT[:1, :1],), "No regular array of micro-images"),
        ((FLAT[0],), r"shape \(50,\)"),
        ((FLAT * NAN,), "must be finite, got 2500"),
    ),
    *each(
        grid_from_pitch,
        (((90, 100), 0.5), "pitch must be at least 1 pixel, got 0.5"),
        (((90, 100), NAN), "pitch must be at least 1 pixel, got nan"),
        (((90, 100), 10, "square"), "layout must be rectangular or hexagonal, got 'square'"),
    ),
    (partial(LensletGrid, 3, 4, 10, 1.0), "rotation must lie within pi/4"),
    (partial(LensletGrid(0, 0, 40).block, (30, 300)), "No micro-image"),
    *each(
        decode_raw,
        ((EVEN[0], SIX), r"raw lenslet image must be grey or coloured, .* shape \(30,\)"),
        ((EVEN * 1j, SIX), "type complex128"),
        ((EVEN * INF, SIX), "raw lenslet image must be finite, got 900"),
        ((EVEN, SIX, None, EVEN[1:]), "white image must have the shape"),
        ((EVEN, SIX, None, EVEN * NAN), "white lenslet image must be finite"),
        ((EVEN, SIX, None, 0 * EVEN), "must be bright in the centre"),
        ((EVEN[:4], SIX), "No micro-image of 6 x 6 pixels lies entirely"),
        ((EVEN, SIX, 0), "1 to twice the pitch of 6, got 0"),
        ((EVEN, SIX, 13), "1 to twice the pitch of 6, got 13"),
        ((EVEN, SIX, 2.5), "1 to twice the pitch of 6, got 2.5"),
        ((FLAT[:, :16], LensletGrid(7.5, 30, 10, 0, "hexagonal")), "at least two whole lenslets"),
    ),
    (
        of({"a.tif": EVEN, "b.tif": FLAT}, "a.tif", read_raw, lenslets="b.tif"),
        "The lenslet image must have the shape",
    ),
    (partial(decode_raw, EVEN, SIX, bayer="rgbg"), "one of rggb, bggr, grbg, gbrg, got 'rgbg'"),
    (partial(decode_raw, np.ones((30, 30, 3)), SIX, bayer="rggb"), r"one chan.*\(30, 30, 3\)"),
    (partial(decode_raw, EVEN[1:], SIX, bayer="rggb"), "even numbers of rows and col"),
]


def picture(facts=None):
    """A picture of an Illum, 6 x 8 pixels."""
    facts = facts or lytro.metadata("ILLUM", (6, 8))
    mosaic = np.random.default_rng(3).integers(0, 1024, (6, 8), np.uint16)
    return lytro.container("ILLUM", facts, lytro.pack(mosaic, 10))


def changed(path, value):
    """Metadata of an Illum with another value."""
    facts = lytro.metadata("ILLUM", (6, 8))
    *names, last = path.split("/")
    inner = facts
    for name in names:
        inner = inner[name]
    inner[last] = value
    return facts


def frame(**names):
    return {"frames": [{"frame": names}]}


WHOLE = picture()
FACTS = lytro.json_bytes(lytro.metadata("ILLUM", (6, 8)))
OWN, ODD = lytro.name_of(FACTS), lytro.name_of(b"\0\1")
CONTAINERS = [
    (WHOLE[:200] + b"\xfe" + WHOLE[201:], "damaged or truncated: at byte 16 there is no"),
    (b"\x89PNG" + WHOLE[4:], "not a container of a Lytro camera"),
    (b"", "not a container of a Lytro camera"),
    (WHOLE[:16], "no table of contents"),
    (WHOLE[:-40], "damaged or truncated: at byte"),
    (WHOLE[: WHOLE.index(b"\x89LFM")], "no table of contents"),
    (WHOLE[:24] + struct.pack(">Q", 2**63) + WHOLE[32:], "damaged or truncated: at byte 16 "),
    (WHOLE[:24] + struct.pack(">Q", len(WHOLE)) + WHOLE[32:], "damaged or truncated: at byte 16 "),
    (WHOLE[:16] + b"\0" + WHOLE[16:], "damaged or truncated: at byte 16 "),
    (WHOLE[:32] + b"md5-" + WHOLE[36:], "damaged or truncated: at byte 16 "),
]
TABLES = [
    ((b"[" * 100_000,), "recursion limit"),
    ((b"\xff\xfe{}",), "not a JSON file"),
    ((b"[1, 2]",), "must contain names and values"),
    ((b"{" + b" " * (1 << 22) + b"}",), "4,194,306 bytes, more than the 4,194,304 allowed"),
    (({},), "contains no raw image"),
    (({"frames": {"frame": 1}},), "contains no raw image"),
    (({"frames": [7]},), "contains no raw image"),
    ((frame(metadataRef=["a"]),), "contains no raw image"),
    ((frame(metadataRef="sha1-0"),), "contains no raw image"),
    ((frame(metadataRef=OWN, imageRef=OWN), FACTS), "must have 60 bytes"),
    ((frame(metadataRef=ODD, imageRef=ODD), b"\0\1"), "is not a JSON file"),
]
METADATA = [
    ("image/height", 7.5e9, "image/height must be a number from 2 to 65536"),
    ("image/height", "6", "image/height must be a number from 2 to 65536, got None"),
    ("image/width", 7, "even numbers of rows and columns"),
    ("image/pixelPacking/bitsPerPixel", 14, "10 bits little or 12 bits big"),
    ("image/pixelPacking/endianness", "big", "10 bits little or 12 bits big"),
    ("image/pixelFormat/rightShift", 2, "shifted by 2"),
    ("image/pixelFormat/white/r", 64, "white levels must be above black"),
    ("image/pixelFormat/black/gb", -1, "must be a number from 0 to 65535"),
    ("image/mosaic/tile", "r,gr:b,gb", "must be a Bayer mosaic"),
    ("image/mosaic/upperLeftPixel", "x", "must be a Bayer mosaic"),
]


def linked(kind):
    """An archive with a link, or a device, in place of the pixels."""
    file = io.BytesIO()
    with tarfile.open(fileobj=file, mode="w") as archive:
        member = tarfile.TarInfo("MOD_0001.RAW")
        member.type, member.linkname = kind, "/etc/passwd"
        archive.addfile(member)
        member = tarfile.TarInfo("MOD_0001.TXT")
        member.size = len(TEXT)
        archive.addfile(member, io.BytesIO(TEXT))
    return file.getvalue()


def of_negative_size(whole):
    """An archive whose first member has a negative size, base 256."""
    minus = bytearray(whole)
    minus[124:136] = b"\xff" * 10 + b"\xfe\x00"
    minus[148:156] = b" " * 8
    minus[148:156] = f"{sum(minus[:512]):06o}\0 ".encode()
    return bytes(minus)


def pair(text, packed):
    return lytro.tar_of({"MOD_0001.TXT": text, "MOD_0001.RAW": packed})


def found_in(archive, facts=None):
    """Call that looks for the white image of a picture in an archive."""
    return of(
        {"caldata.tar": archive, "a.lfp": picture(facts)},
        "a.lfp",
        lambda path: find_white(read_lytro(path), Path("caldata.tar")),
    )


TEXT, PACKED = lytro.white_pair(
    "ILLUM", lytro.metadata("ILLUM", (6, 8), -300, 320), np.full((6, 8), 800)
)
UNKNOWN = lytro.metadata("ILLUM", (6, 8), zoom=None)
OTHERS = lytro.tar_of(lytro.white_set(RNG, serial="B0000000000")[0])
WHITES = [
    (found_in(linked(tarfile.SYMTYPE)), "images found: 0"),
    (found_in(linked(tarfile.LNKTYPE)), "images found: 0"),
    (found_in(linked(tarfile.CHRTYPE)), "images found: 0"),
    (found_in(pair(bytes((1 << 22) + 1), PACKED)), "4,194,305 bytes, more than the 4,194,304 all"),
    (found_in(pair(TEXT, bytes(1 << 20))), "must have 60 bytes"),
    (found_in(pair(b"{", PACKED)), "not a JSON file"),
    (found_in(pair(b"[" * 9999, PACKED)), "recursion limit"),
    (found_in(of_negative_size(pair(TEXT, PACKED))), "invalid offset|images found: 0"),
    (found_in(pair(TEXT, PACKED)[:700]), "damaged|images found: 0"),
    (found_in(b"\x1f\x8b\x08" + bytes(600)), "damaged"),
    (found_in(b"no archive" * 100), "damaged"),
    (found_in(b""), "damaged"),
    (found_in(lytro.tar_of({})), "caldata.tar contains no white image .*; images found: 0"),
    (found_in(OTHERS), "images found: 4 of camera B0000000000; too dark: 0"),
    (found_in(OTHERS, UNKNOWN), "does not say which white image fits it"),
]
LYTRO = [
    *((one("a.lfr", data, read_lytro), said) for data, said in CONTAINERS),
    *((one("a.lfr", lytro.table_only(*table), read_lytro), said) for table, said in TABLES),
    *(
        (one("a.lfp", picture(changed(path, value)), read_lytro), rf"a\.lfp: .*{said}")
        for path, value, said in METADATA
    ),
    (one("a.lfr", WHOLE), "No regular array of micro-images"),
    (one("a.lfr", WHOLE, order="row,col"), "order does not apply to a.lfr"),
    (one("a.lfr", WHOLE, grid="3x3"), "grid does not apply to a.lfr"),
    (one("a.lfr", WHOLE, axes="vuts"), "axes does not apply to a.lfr, .* Lytro camera"),
    (one("a.raw", PACKED, read_lytro), "without a description: .* beside it as a.json"),
    (
        of({"a.raw": PACKED[:-1], "a.json": FACTS}, "a.raw", read_lytro),
        "must have 60 bytes, 6 x 8 pixels of 10 bits .* got 59",
    ),
    *WHITES,
]

GOOD = Camera().xml()
CALIBRATIONS = [
    ("", "cannot be read as XML: no element found"),
    ("<scene/>", "not a calibration of a Raytrix camera"),
    ("<RayCalibData/>", "must state offset/x as a number, got 'nothing'"),
    (GOOD.replace("0.012<", "much<"), "must state rotation as a number, got 'much'"),
    (GOOD.replace(">23.3<", ">nan<"), "must state diameter as a number, got 'nan'"),
    (GOOD.replace(">23.3<", ">3<"), "at least 6 pixels wide .* got 1 of 3"),
    (GOOD.replace(">23.3<", ">900<"), "Fewer than 3 x 3 micro-images of 900 pixels"),
    (GOOD.replace("<x>1.0", "<x>0.0"), "no or three kinds of lenslets .* got 2"),
    (GOOD.replace("<max>4<", "<max>1<"), "must increase from above 0, got 2.8 to 1"),
    (GOOD.replace(">1.0<", ">12<"), "within their border, got -0.7 of 23.3"),
    (
        '<!DOCTYPE RayCalibData [<!ENTITY a "1">]>' + GOOD.partition("?>")[2].replace("1", "&a;"),
        "calibration.xml cannot be read: it declares a document type or entities",
    ),
    ("<RayCalibData>" + "<a>" * 9000, "cannot be read as XML"),
    (GOOD + " " * 70000, "bytes, more than the 65,536 allowed"),
    (GOOD.replace("?>", "?>\0"), "cannot be read as XML"),
]


@cache
def focused_white():
    return Camera().white()


def array_of(path):
    return read_raytrix(path, (320, 350)).array


def plan(shape=(320, 350), **options):
    """Call that makes the plan of a calibrated camera."""

    def read(path):
        made = {name: value() if callable(value) else value for name, value in options.items()}
        return FocusedPlan(read_raytrix(path, shape), **made)

    return one("calibration.xml", GOOD, read)


FOCUSED = [
    *((one("calibration.xml", text, array_of), said) for text, said in CALIBRATIONS),
    (plan(virtual_depth=1.0), "must be from 1.5 to 11.65, half the pixels under a lenslet"),
    (plan(virtual_depth=NAN), "must be from 1.5 to 11.65"),
    (plan(views=0), "1 to twice the pitch of 23.3"),
    (plan(shape=(90, 90)), "too small for views"),
    (plan(white=lambda: focused_white()[:-1]), "white image must have the shape"),
    (plan(white=lambda: 0 * focused_white()), "bright in the centre of its micro-images"),
    (plan(bayer="rgby"), "bayer must be one of"),
    (lambda: plan()().decode(focused_white()), "No virtual depth was found"),
    (lambda: plan()().decode(focused_white()[1:]), "raw image must have the shape"),
]


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


test_it_is_refused_in_a_sentence = refusals(
    [
        *FOLDERS,
        *ARRAYS,
        (reads_a_focal_stack, "focal.tif is a stack of refocused images"),
        *RAW,
        *LYTRO,
        *FOCUSED,
    ]
)


SMALL = VIEWS.astype(np.float32)
UNWRITTEN = [
    (
        partial(write_image, Path("a.jpg"), levels(3, 3)),
        "written as .png, .tif or .tiff, got .*a.j",
    ),
    (partial(write_light_field, LightField(SMALL[:1]), "a.png"), r"N x N views, got 1 x"),
    (partial(write_light_field, LightField(SMALL + 2), "out"), "values from 0 to 1, got .* to 2"),
    (partial(write_light_field, LightField(SMALL), "out", bits=12), "bits must be 8 or 16, got 12"),
    (partial(write_light_field, LightField(np.stack([SMALL] * 2, -1)), "out"), "3 channels, got 2"),
    *each(
        write_focal_stack,
        ((np.ones((3, 4, 5)), [0, 1], "a.tif"), "one image for each slope, in up to 4 channels"),
        ((np.ones((4, 5)), [0], "a.tif"), "one image for each slope, in up to 4 channels"),
        ((np.ones((1, 4, 5, 5)), [0], "a.tif"), "one image for each slope, in up to 4 channels"),
        ((np.ones((0, 4, 5)), [], "a.tif"), "one image for each slope, in up to 4 channels"),
    ),
]


@pytest.mark.parametrize(("call", "said"), UNWRITTEN, ids=[said[:30] for _, said in UNWRITTEN])
def test_what_cannot_be_written_leaves_nothing(call, said, tmp_path):
    with pytest.raises(InputError, match=said):
        call()
    assert list(tmp_path.iterdir()) == []


def test_a_folder_with_foreign_files_is_left_alone(tmp_path):
    put(Path("full/mine.txt"), "kept")
    with pytest.raises(InputError, match="new or empty folder"):
        write_light_field(LightField(SMALL), tmp_path / "full")
    assert Path("full/mine.txt").read_text() == "kept"
