"""Cameras with focused lenslets: calibration files, virtual depth, views."""

import shutil
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from focused_pictures import Camera, Waves

from lf_flame import InputError, read_light_field
from lf_flame.commands.cli import commands
from lf_flame.flame_video.frames import FrameReader
from lf_flame.formats import LensletGrid
from lf_flame.formats.focused.lenslets import FocusedLenslets, find_virtual_depth, read_raytrix
from lf_flame.formats.focused.views import FocusedPlan, mean_fall_off
from lf_flame.formats.images import write_image

BLURRED = (0.0, 2.0, 4.0)
"""Radii in pixels by which the three kinds blur a micro-image."""


@pytest.fixture
def lenslets_of(tmp_path):
    def read(camera, **changes):
        path = tmp_path / "calibration.xml"
        path.write_text(camera.xml(**changes))
        return read_raytrix(path, camera.shape)

    return read


@pytest.mark.parametrize(("columns", "second"), [(False, 1), (True, 1), (False, -1)])
def test_the_lenslets_of_a_calibration_are_where_it_says_and_of_its_kinds(
    lenslets_of, columns, second
):
    camera = Camera(columns=columns)
    lenslets = lenslets_of(camera, second=second)
    at = lenslets.array[0][:, None] - (np.array(camera.shape) - 1) / 2
    centres, kinds = camera.nearest(*np.moveaxis(at, 2, 0))
    kinds = kinds[:, 0] * second % 3
    assert np.abs(np.moveaxis(at, 2, 0) - centres).max() < 1e-6
    for depth, sharp in ((2.0, [0]), (2.9, [0, 1]), (3.9, [1, 2]), (20.0, [2])):
        np.testing.assert_array_equal(
            lenslets.in_focus(np.full(len(at), depth)), np.isin(kinds, sharp)
        )
    assert len(at) > 200
    assert lenslets.radius == pytest.approx(camera.pitch / 2 - 1)


def alike(camera):
    """Lenslets of a camera, without kinds."""
    middle = (np.array(camera.shape) - 1) / 2
    grid = LensletGrid(
        middle[1] + camera.offset[0],
        middle[0] - camera.offset[1],
        camera.pitch,
        -camera.rotation - (np.pi / 6 if camera.columns else 0),
        "hexagonal" if camera.hexagonal else "rectangular",
    )
    return FocusedLenslets(grid, camera.shape)


def found_in(raw, lenslets):
    """Virtual depth of each lenslet that lies whole in a picture."""
    image, centres = raw[..., None].astype(np.float32), lenslets.array[0]
    image = image / mean_fall_off(image, centres, lenslets.radius)
    return find_virtual_depth(image, lenslets), centres[:, 1] - raw.shape[1] / 2


@pytest.mark.slow
@pytest.mark.parametrize(
    ("depth", "camera"),
    [
        (2.3, Camera()),
        (3.1, Camera(blur=BLURRED)),
        (4.4, Camera(blur=BLURRED[::-1], columns=True)),
        (7.5, Camera(lens=3000.0, rotation=-0.02)),
        (-4.0, Camera(hexagonal=False)),
    ],
)
def test_the_virtual_depth_of_a_plane_is_found(depth, camera):
    lenslets = alike(camera)
    rng = np.random.default_rng(1)
    raw = camera.record(depth, Waves((5 * abs(depth), 16 * abs(depth))))
    found, _ = found_in(raw + rng.normal(0, 0.005, raw.shape), lenslets)
    known = found[np.isfinite(found)]
    truth = camera.apparent(depth)
    assert len(known) > 0.9 * len(found)
    assert np.median(known) == pytest.approx(truth, rel=0.005)
    assert np.mean(np.abs(known / truth - 1) < 0.01) > 0.5
    assert np.mean(np.abs(known / truth - 1) < 0.03) > 0.95


@pytest.mark.slow
def test_where_there_is_no_texture_the_virtual_depth_is_unknown(lenslets_of):
    camera = Camera()
    lenslets = lenslets_of(camera)
    rng = np.random.default_rng(1)
    raw = camera.record(3.1, Waves())
    left = np.arange(raw.shape[1]) < raw.shape[1] / 2
    raw = np.where(left, camera.white() / 2, raw) + rng.normal(0, 0.005, raw.shape)
    found, x = found_in(raw, lenslets)
    assert np.isfinite(found[x > camera.pitch]).mean() > 0.9
    assert np.isfinite(found[x < -camera.pitch]).mean() < 0.02
    # Noise and nothing finer than a micro-image: single matches are accidents.
    raw = camera.record(3.1, Waves((60, 300))) + rng.normal(0, 0.05, raw.shape)
    assert np.isfinite(found_in(raw, lenslets)[0]).mean() < 0.02


def scale_and_shift(image, light, y, x):
    """Scale about the middle, and shift, by which a picture differs from the truth; correlation."""
    step = 1e-3
    turns = [
        (light(y * (1 + step), x * (1 + step)) - light(y * (1 - step), x * (1 - step))) / 2 / step,
        (light(y + step, x) - light(y - step, x)) / 2 / step,
        (light(y, x + step) - light(y, x - step)) / 2 / step,
        np.ones_like(y),
        light(y, x),
    ]
    design = np.stack([one.ravel() for one in turns], axis=1)
    change, *_ = np.linalg.lstsq(design, image.ravel())
    correlation = np.corrcoef(image.ravel(), light(y, x).ravel())[0, 1]
    return change[:3] / change[4], correlation


@pytest.mark.slow
@pytest.mark.parametrize(
    ("depth", "stated", "blur"),
    [
        (2.4, None, (0, 0, 0)),
        (3.3, None, BLURRED[::-1]),
        (5.0, None, (3.0, 1.5, 0)),
        (4.4, 1, (0, 0, 0)),
    ],
)
def test_views_show_the_picture_in_its_place_and_scale(lenslets_of, depth, stated, blur):
    """A place of a view is one of the raw picture, or by the slope and the view beside it."""
    camera = Camera(blur=blur)
    truth = camera.apparent(depth)
    texture = Waves((7 * depth, 20 * depth))
    raw = camera.record(depth, texture)
    plan = FocusedPlan(
        lenslets_of(camera), virtual_depth=truth if stated else None, white=camera.white()
    )
    views = plan.decode(raw).views
    assert views.shape[:2] == (5, 5)
    assert plan.reference == (truth if stated else 3.0)
    slope = (plan.reference - truth) * plan.spacing / plan.step
    middle = (np.array(camera.shape) - 1) / 2
    t, s = np.indices(views.shape[2:])
    for v, u in ((2, 2), (0, 2), (4, 1)):
        # An image moves by the slope from view to view, so that a pixel shows what is behind it.
        y = plan.first[0] + plan.step * (t - slope * (v - 2)) - middle[0]
        x = plan.first[1] + plan.step * (s - slope * (u - 2)) - middle[1]
        k = camera.scale(depth)
        (scale, *shift), correlation = scale_and_shift(
            views[v, u], lambda y, x, k=k: texture.at(k * y, k * x), y, x
        )
        assert correlation > 0.99
        assert abs(scale) < 0.001
        assert np.abs(shift).max() < 0.05 * plan.step


@pytest.mark.slow
def test_a_picture_before_the_lenslets_stands_as_one_behind_them(lenslets_of):
    """At a negative virtual depth, each micro-image is upside down."""
    camera = Camera(hexagonal=False)
    texture = Waves((25, 70))
    plan = FocusedPlan(alike(camera))
    view = plan.decode(camera.record(-3.4, texture)).views[2, 2]
    assert plan.reference == -3.0
    t, s = np.indices(view.shape)
    y, x = (plan.first[k] + 3 * n - (camera.shape[k] - 1) / 2 for k, n in enumerate((t, s)))
    k = camera.scale(-3.4)
    (scale, *shift), correlation = scale_and_shift(
        view, lambda y, x: texture.at(k * y, k * x), y, x
    )
    assert correlation > 0.99
    assert abs(scale) < 0.001
    assert np.abs(shift).max() < 0.15


@pytest.mark.slow
def test_a_step_in_depth_keeps_both_sides(lenslets_of):
    camera = Camera(shape=(320, 520))
    raw = camera.record(lambda y, x: np.where(x < 0, 2.4, 3.6), Waves((18, 50)))
    found, x = found_in(raw, lenslets_of(camera))
    for depth, side in ((2.4, x < -2 * camera.pitch), (3.6, x > 2 * camera.pitch)):
        assert np.nanmedian(found[side]) == pytest.approx(camera.apparent(depth), rel=0.01)


@pytest.fixture(scope="module")
def raw_levels():
    raw = Camera(blur=BLURRED[::-1]).record(4.4, Waves((30, 90)))
    return np.rint(40000 * raw).astype(np.uint16)


@pytest.fixture
def call(raw_levels, tmp_path, monkeypatch):
    """Call of the program on files of a camera in the working folder."""
    monkeypatch.chdir(tmp_path)
    for name in ("raw.png", "other.png"):
        write_image(name, raw_levels)
    Path("camera.xml").write_text(Camera().xml())
    return lambda *words: CliRunner().invoke(commands, words)


@pytest.mark.slow
def test_frames_of_a_video_are_read_by_one_plan(call, raw_levels, caplog):
    options = {"focused": Path("camera.xml"), "views": 3}
    levels = raw_levels.copy()
    levels[50:54, 60:64] = 65535
    write_image("raw.png", levels)
    shutil.copy("raw.png", "later.png")
    first, later = map(FrameReader(Path("raw.png"), options), [Path("raw.png"), Path("later.png")])
    assert first.views.shape[:2] == (3, 3)
    np.testing.assert_array_equal(first.views, later.views)
    assert caplog.text.count("16 pixels (0.00014 of all) are saturated: views are too dark") == 1


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--virtual-depth", "4"], "--virtual-depth does not apply to raw.png"),
        (["--focused", "camera.xml", "--pitch", "9"], "--pitch does not apply to raw.png"),
        (["--focused", "camera.xml", "--order", "row,col"], "--order does not apply to raw.png"),
        (["--focused", "camera.xml", "--virtual-depth", "nan"], "must be from 1.5 to 11.65"),
        (["--focused", "other.png", "--white", "camera.xml"], "camera.xml cannot be read"),
        (["--focused", "."], "cannot be read"),
        (["--focused", "camera.xml", "--dark", "other.png"], "No virtual depth was found"),
    ],
)
def test_options_that_do_not_fit_focused_lenslets_are_refused(call, words, message):
    result = call("convert", "raw.png", "out.npy", *words)
    assert isinstance(result.exception, InputError)
    assert message in str(result.exception)
    assert not Path("out.npy").exists()


@pytest.mark.slow
@pytest.mark.parametrize("columns", [False, True])
def test_a_white_image_takes_the_place_of_a_calibration(columns, tmp_path):
    camera = Camera(shape=(250, 430), offset=(1.3, 2.2), columns=columns)
    raw, white = camera.record(3.1, Waves()), camera.white()
    for name, image in (("raw", raw), ("white", white)):
        write_image(tmp_path / f"{name}.png", np.rint(40000 * image).astype(np.uint16))
    (tmp_path / "camera.xml").write_text(camera.xml())
    source, white = tmp_path / "raw.png", tmp_path / "white.png"
    by_white = read_light_field(source, 3, focused=white)
    by_xml = read_light_field(source, 3, focused=tmp_path / "camera.xml", white=white)
    assert by_white.views.shape == by_xml.views.shape
    inner = np.s_[:, :, 3:-3, 3:-3]
    np.testing.assert_allclose(by_white.views[inner], by_xml.views[inner], atol=0.03)


@pytest.mark.slow
def test_each_colour_of_a_mosaic_gives_its_own_views(lenslets_of):
    camera = Camera()
    levels = np.array([0.5, 1.0, 0.7])
    raw = camera.record(3.1, Waves((25, 60)))
    mosaic = raw.copy()
    for place, colour in enumerate("grbg"):
        mosaic[place // 2 :: 2, place % 2 :: 2] *= levels["rgb".index(colour)]
    lenslets = lenslets_of(camera)
    grey, coloured = (
        FocusedPlan(lenslets, virtual_depth=3.1, bayer=bayer, views=3).decode(image)
        for image, bayer in ((raw, None), (mosaic, "grbg"))
    )
    ratio = coloured.views / grey.views[..., None]
    np.testing.assert_allclose(ratio.mean(axis=(0, 1, 2, 3)), levels, rtol=0.01)
    assert ratio.std(axis=(0, 1, 2, 3)).max() < 0.05


@cache
def levels_of(camera):
    return np.rint(40000 * camera.record(3.1, Waves())).astype(np.uint16)


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    [{"diameter": 23.7}, {"x": 11.0}, {"y": 5.0}, {"rotation": 0.04},
     {"rotation": np.pi / 2 + 0.04}],
)  # fmt: skip
def test_a_calibration_of_other_lenslets_is_refused(tmp_path, changes):
    camera = Camera(columns=changes.get("rotation", 0) > 1)
    write_image(tmp_path / "raw.png", levels_of(camera))
    (tmp_path / "camera.xml").write_text(camera.xml(**changes))
    with pytest.raises(InputError, match=r"are displaced from them by .* pixels or more"):
        read_light_field(tmp_path / "raw.png", focused=tmp_path / "camera.xml")
