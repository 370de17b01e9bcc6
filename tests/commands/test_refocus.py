"""The program `lf-flame refocus`: from files of anybody's light field to pictures."""

import json
import re
from dataclasses import asdict, replace

import numpy as np
import pytest
from PIL import Image
from programs import run_or_raise
from scipy.ndimage import shift
from skimage.data import camera as camera_picture
from skimage.io import imread

from lf_flame import PAPER_CAMERA, InputError, Layer, LightField, Scene, render
from lf_flame._common.atomic_files import exclusive
from lf_flame.commands import refocus_output
from lf_flame.formats import read_focal_stack, read_light_field, write_light_field
from lf_flame.formats.images import write_image
from lf_flame.refocus import all_in_focus, refocus, refocus_surface, round_aperture, shift_and_sum
from lf_flame.scenes.dead_leaves import DeadLeaves
from lf_flame.systems.training import load_system

DEPTH = 3.0


@pytest.fixture(scope="module")
def camera():
    return replace(PAPER_CAMERA, views=5, lenslets=(40, 48))


@pytest.fixture(scope="module")
def light_field(camera):
    texture = np.random.default_rng(1).uniform(size=(12, 14))
    rendered = render(Scene([Layer(0.9 * texture, DEPTH, (3.0, 4.0))]), camera)
    return LightField(np.rint(rendered.views * 65535) / np.float32(65535))


@pytest.fixture
def folder(light_field, tmp_path):
    write_light_field(light_field, tmp_path / "views")
    return tmp_path / "views"


def run(*args, command="refocus"):
    return run_or_raise(command, *args)


def depth_of(slope):
    """Depth of a slope by the thin-lens equation: views look through the lens 1/5 of it apart."""
    i0 = 150 * 326 / (326 - 150)
    view_step = i0 * (0.112 * (1 + 0.4 / i0) / 5) / 0.4
    image = i0 / (1 + slope * 0.112 / view_step)
    return 1 / (1 / 150 - 1 / image) - 326


def written_camera(camera, folder, **changes):
    path = folder / "camera.json"
    path.write_text(json.dumps({"camera": asdict(replace(camera, **changes))}))
    return path


def test_slopes_and_depths(folder, light_field, camera, tmp_path):
    record = {"camera": {name: getattr(camera, name) for name in (
        "main_lens_focal_mm", "focus_distance_mm", "lenslet_focal_mm", "lenslet_pitch_mm",
        "views", "lenslets")}}  # fmt: skip
    (tmp_path / "simulation.json").write_text(json.dumps(record))
    result = run(folder, "--slope", -0.5, "--depth-mm", DEPTH, "--camera",
                 tmp_path / "simulation.json", "--out", tmp_path / "out")  # fmt: skip
    assert "5 x 5 views of 40 x 48 pixels" in result.output
    stack, slopes = read_focal_stack(tmp_path / "out" / "focal_stack.tif")
    np.testing.assert_allclose(slopes, [-0.5, camera.depth_to_slope(DEPTH)])
    np.testing.assert_array_equal(stack, shift_and_sum(light_field, slopes))
    shown = imread(tmp_path / "out" / f"refocused_2_slope{slopes[1]:+.3f}_+3mm.png")
    assert shown.shape == (13 * 40, 13 * 48)  # 600 pixels wide or more
    np.testing.assert_allclose(shown[::13, 6::13] / 255, stack[1], atol=0.003)
    written = json.loads((tmp_path / "out" / "refocus.json").read_text())
    assert written["slopes"] == list(slopes)
    assert written["depths_mm"] == pytest.approx([depth_of(-0.5), DEPTH])
    assert written["views"] == [5, 5]


def test_by_default_it_is_refocused_where_it_is_sharpest(folder, camera, tmp_path, drawn):
    result = run(folder, "--out", tmp_path / "out")
    written = json.loads((tmp_path / "out" / "refocus.json").read_text())
    assert written["slopes"][0] == pytest.approx(camera.depth_to_slope(DEPTH), abs=0.02)
    assert "sharpest at slope" in result.output
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"slope_search.png", "focal_stack.tif", "refocus.json"} < names


def test_apertures_interpolations_and_numbers_of_other_programs(folder, light_field, tmp_path):
    """plenpy's number for our slope 0.5 with 5 views is -0.4."""
    run(folder, "--slope", -0.4, "--slope-of", "plenpy", "--interpolation", "sinc", "--aperture",
        0.6, "--ring", 0.2, "--out", tmp_path / "out")  # fmt: skip
    weights = round_aperture((5, 5), 0.6) - round_aperture((5, 5), 0.2)
    expected = refocus(light_field, [0.5], interpolation="sinc", weights=weights)
    stack, _ = read_focal_stack(tmp_path / "out" / "focal_stack.tif")
    np.testing.assert_allclose(stack, expected, atol=1e-6)


@pytest.mark.slow
def test_sweep_and_map(folder, light_field, camera, tmp_path, drawn):
    result = run(folder, "--sweep", -1, 1.5, "--map", -1, 2, "--out", tmp_path / "out")
    assert "No slope is certain" not in result.output
    with Image.open(tmp_path / "out" / "sweep.gif") as movie:
        assert movie.n_frames == 80
        assert movie.size == (13 * 48, 13 * 40)
        for frame, slope in ((0, -1), (40, 1.5), (79, -0.9375)):  # there and back, in 40 steps
            movie.seek(frame)
            levels = np.asarray(movie.convert("L"))[::13, ::13] / 255
            np.testing.assert_allclose(levels, shift_and_sum(light_field, slope), atol=0.003)
    slopes = imread(tmp_path / "out" / "slope_map.tif")
    assert np.median(slopes[14:26, 16:32]) == pytest.approx(camera.depth_to_slope(DEPTH), abs=0.05)
    found = all_in_focus(light_field, np.linspace(-1, 2, 33))
    files = {"all_in_focus": "all_in_focus", "slope_map": "slope", "slope_confidence": "confidence"}
    for name, part in files.items():
        written = imread(tmp_path / "out" / f"{name}.tif")
        np.testing.assert_allclose(written, getattr(found, part), rtol=1e-6, atol=1e-6)


def test_one_channel_is_grey_and_two_are_refused(light_field, tmp_path):
    """A text beside the views is no array to choose."""
    np.savez(tmp_path / "one.npz", data=light_field.views[..., None], camera="a name")
    run(tmp_path / "one.npz", "--slope", 0.5, "--sweep", 0, 1, "--out", tmp_path / "out")
    stack, _ = read_focal_stack(tmp_path / "out" / "focal_stack.tif")
    np.testing.assert_allclose(stack, shift_and_sum(light_field, [0.5]), atol=1e-6)
    np.save(tmp_path / "two.npy", np.stack([light_field.views] * 2, axis=-1))
    with pytest.raises(InputError, match="1 or 3 channels; this light field has 2"):
        run(tmp_path / "two.npy", "--slope", 0.5, "--out", tmp_path / "out2")


def test_bright_and_dim_light_fields_are_shown(light_field, tmp_path):
    """A view that does not count may be brighter by far."""
    weights = np.ones((5, 5))
    weights[0, 0] = 0
    for brightness in (1e-3, 50.0):
        views = light_field.views * np.float32(brightness)
        views[0, 0, 3, 4] = 1e3 * brightness
        write_light_field(LightField(views, weights=weights), tmp_path / "views.npz")
        words = ("--slope", 0.5, "--gain", 2, "--gamma", 2.2, "--overwrite")
        run(tmp_path / "views.npz", *words, "--out", tmp_path / "out")
        assert imread(tmp_path / "out" / "refocused_1_slope+0.500.png").max() > 120
        written = json.loads((tmp_path / "out" / "refocus.json").read_text())
        white = written["radiance_of_white_in_png"]
        assert white == pytest.approx(light_field.views[weights > 0].max() * brightness / 2)
        assert written["gamma"] == 2.2
    # Here the used views fit into levels, and the other is clipped.
    write_light_field(LightField(light_field.views + 9 * (weights == 0)[..., None, None],
                                 weights=weights), tmp_path / "views.npz")  # fmt: skip
    run(tmp_path / "views.npz", tmp_path / "lenslets.png", command="convert")
    stored = imread(tmp_path / "lenslets.png") / 65535
    np.testing.assert_allclose(stored[2::5, 2::5], light_field.views[2, 2], atol=1e-5)
    assert stored[0::5, 0::5].min() == 1


@pytest.fixture
def leaves(tmp_path):
    """Leaves at two depths, up to three times as bright as a camera's white."""
    rng = np.random.default_rng(8)
    left, right = (
        DeadLeaves(slopes=(slope, slope)).draw((9, 9), (60, 120), rng).views
        for slope in (0.8, -0.6)
    )
    views = 3 * np.concatenate([left[..., :60], right[..., 60:]], axis=-1)
    np.save(tmp_path / "leaves.npy", views)
    return tmp_path / "leaves.npy"


@pytest.mark.slow
def test_two_sharp_slopes_are_named(leaves, tmp_path):
    said = run(leaves, "--out", tmp_path / "out").output
    peaks = re.search(r"several slopes are sharp \((.*), (.*)\)", said).groups()
    assert [float(peak) for peak in peaks] == pytest.approx([-0.6, 0.8], abs=0.03)


@pytest.mark.slow
def test_a_trained_network_refocuses(leaves, system_runs, tmp_path, monkeypatch):
    """It takes values from 0 to 1: brighter light fields are dimmed for it."""
    network = system_runs / "refocusnet"
    monkeypatch.setattr(refocus_output, "SWEEP_FRAMES", 8)
    run(leaves, "--slope", 0.25, "--sweep", 0, 1, "--network", network, "--out", tmp_path / "out")
    stack, _ = read_focal_stack(tmp_path / "out" / "focal_stack.tif")
    views = np.load(leaves)
    expected = views.max() * load_system(network).refocus(views / views.max(), 0.25)
    np.testing.assert_allclose(stack, expected, rtol=1e-5, atol=1e-5)
    assert np.abs(stack - shift_and_sum(views, 0.25)).max() > 0.1
    written = json.loads((tmp_path / "out" / "refocus.json").read_text())
    assert written["network"] == "RefocusNet"


@pytest.mark.parametrize("how", ["dense", "network"])
def test_regions_come_into_focus(leaves, system_runs, tmp_path, how, drawn):
    aperture = ["--aperture", 0.9, "--interpolation", "cubic"]
    options = ["--network", system_runs / "volumetric"] if how == "network" else aperture
    regions = ["--region", 16, 44, 10, 50, "--region", 16, 44, 70, 110]
    shown = run(leaves, *regions, *options, "--out", tmp_path / "out").stdout
    assert "region 16 44 10 50: slope +0.8" in shown
    assert "region 16 44 70 110: slope -0." in shown
    written = json.loads((tmp_path / "out" / "refocus.json").read_text())
    slopes = [region["slope"] for region in written["regions"]]
    assert all(0.5 < region["confidence"] <= 1 for region in written["regions"])
    assert slopes == pytest.approx([0.8, -0.6], abs=0.11)
    assert set(written["files"]) == {"regions.tif", "regions.png", "regions_slope.tif",
                                     "regions_slope.png"}  # fmt: skip
    views, image = np.load(leaves), imread(tmp_path / "out" / "regions.tif")
    surface = imread(tmp_path / "out" / "regions_slope.tif")
    assert surface[0, 60] == pytest.approx(slopes[1] - 2, abs=0.1)  # 8 pixels for nine views
    error = np.abs(image - views[4, 4])[16:44, 10:50].mean()
    if how == "network":  # which has learnt next to nothing
        assert np.isfinite(image).all()
    else:
        assert error < 0.1 < np.abs(image - views[4, 4])[:3].mean()
        weights = round_aperture((9, 9), 0.9)
        expected = refocus_surface(views, surface, interpolation="cubic", weights=weights)
        np.testing.assert_allclose(image, expected, atol=1e-4)
        assert written["views_used"] == "those in the aperture"


@pytest.mark.slow
def test_calls_for_other_slopes_get_other_folders_by_default(folder, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for words in ([], ["--slope", 0.5, "--slope", -1], ["--sweep", 0, 1], ["--map", "auto"]):
        said = run(folder, *words).output
    assert "written to refocused/views_map" in said
    names = ["views", "views_map", "views_slope+0.5-1", "views_sweep+0+1"]
    assert sorted(path.name for path in (tmp_path / "refocused").iterdir()) == names
    with pytest.raises(InputError, match="refocused/views exists; .* replace it with --overwrite"):
        run(folder)
    run(folder, "--gain", 2, "--overwrite")
    record = json.loads((tmp_path / "refocused" / "views" / "refocus.json").read_text())
    assert record["source"] == "../../views"
    with pytest.raises(InputError, match="views exists"):
        run(folder, "--out", folder)
    with pytest.raises(InputError, match="views is not replaced, as it is not a result"):
        run(folder, "--out", folder, "--overwrite")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("auto",), r"0% of the image has a clear slope up to \d.*No slope.*--map FROM TO"),
        ((-1, 1), r"No slope is certain: .*\(--map auto finds a range\)"),
        ((0, 0.5), "The range must be wider than 1, .* got 0.5; --map auto finds a range"),
    ],
)
def test_a_map_in_which_nothing_is_certain_advises_what_was_not_asked(tmp_path, words, said):
    np.save(tmp_path / "bare.npy", np.full((3, 3, 24, 30), 0.5, np.float32))
    result = run(tmp_path / "bare.npy", "--map", *words, "--out", tmp_path / "out")
    assert re.search(f"(?s){said}", result.output)


def test_two_calls_do_not_convert_to_one_file_at_once(folder, tmp_path):
    with exclusive(tmp_path / "a.npy"), pytest.raises(InputError, match="by another process"):
        run(folder, tmp_path / "a.npy", command="convert")
    assert [path.name for path in tmp_path.iterdir()] == ["views"]


def test_what_is_read_is_not_converted_over(folder, tmp_path):
    run(folder, tmp_path / "x.tif", command="convert")
    before = (tmp_path / "x.tif").read_bytes()
    (tmp_path / "link.tif").symlink_to("x.tif")
    for target in (tmp_path / "x.tif", tmp_path / "views" / ".." / "x.tif", tmp_path / "link.tif"):
        with pytest.raises(InputError, match="is an input, and cannot be replaced"):
            run(tmp_path / "x.tif", target, "--views", 5, command="convert")
    assert (tmp_path / "x.tif").read_bytes() == before
    for target, more in ((tmp_path / "x.tif", ["--white", tmp_path / "x.tif"]),
                         (folder / "view_00_00.png", [])):  # fmt: skip
        with pytest.raises(InputError, match="is an input, and cannot be replaced"):
            run(folder, target, *more, command="convert")
    for _ in range(2):  # an array in a folder of views is none of them
        run(folder, folder / "views.npz", command="convert")


def test_names_of_views_forge_no_line_and_steer_no_terminal(folder, tmp_path, capsys):
    """The folder, its views, and the folder for the pictures that is named after it."""
    odd = folder.rename(tmp_path / "odd\nfocal_stack.tif is in")
    for path in list(odd.iterdir()):
        path.rename(odd / f"\x1b[31m\u202e\r{path.name}")
    run(odd, "--slope", 0.5, "--out", tmp_path / "out\x1b[2J")
    said = capsys.readouterr()
    for text in (said.out, said.err):
        assert all(letter.isprintable() or letter == "\n" for letter in text)
        assert "\nfocal_stack.tif is in" not in text


@pytest.mark.slow
def test_with_a_camera_all_is_in_mm_too(folder, camera, tmp_path, drawn):
    known = ["--camera", written_camera(camera, tmp_path)]
    result = run(
        folder, *known, "--search", "--map", -1, 2, "--sweep", -1, 2, "--out", tmp_path / "o"
    )
    written = json.loads((tmp_path / "o" / "refocus.json").read_text())
    (slope,), (depth,) = written["slopes"], written["depths_mm"]
    assert depth == pytest.approx(depth_of(slope), rel=1e-9)
    assert depth == pytest.approx(DEPTH, abs=0.2)
    assert (tmp_path / "o" / f"refocused_1_slope{slope:+.3f}_{depth:+.4g}mm.png").exists()
    assert f"sharpest at slope {slope:+.3f} ({depth:+.4g} mm)" in result.output
    ends = [depth_of(-1), depth_of(2)]
    searched = f"slope map, searched from -1.000 ({ends[0]:+.4g} mm) to +2.000 ({ends[1]:+.4g}"
    assert searched in result.output
    assert written["slope_map_mm"] == written["sweep_mm"] == pytest.approx(ends)
    slopes, depths = (imread(tmp_path / "o" / f"{name}_map.tif") for name in ("slope", "depth"))
    np.testing.assert_allclose(depths, depth_of(slopes.astype(float)), rtol=1e-4, atol=1e-4)
    run(folder, "--slope", 0, "--out", tmp_path / "plain")
    plain = json.loads((tmp_path / "plain" / "refocus.json").read_text())
    assert "depths_mm" not in plain


def test_the_count_of_views_follows_from_the_camera(light_field, camera, tmp_path):
    write_light_field(light_field, tmp_path / "raw.tif")
    known = ["--camera", written_camera(camera, tmp_path)]
    for source in (["raw.tif"], ["raw.tif", "--pitch", 5]):
        words = [tmp_path / source[0], *source[1:], *known, "--slope", 0]
        result = run(*words, "--out", tmp_path / f"out{len(source)}")
        assert "5 x 5 views of 40 x 48" in result.output
    assert "rotation and the position of the array were not searched for" in result.output


def devignetted(folder, rng):
    """A raw image, its white and its dark one, of 12 bits: (raw - dark) / (white - dark)."""
    y, x = np.indices((140, 140))
    spot = np.hypot((y - 4.5) % 10 - 5 + 0.5, (x - 4.5) % 10 - 5 + 0.5) < 4.5
    white = 64 + 3000 * np.where(spot, 1, 0.1) * (1 - ((y - 70) ** 2 + (x - 70) ** 2) / 25_000)
    raw = 64 + (white - 64) * rng.uniform(0.0, 1.3, (14, 14)).repeat(10, 0).repeat(10, 1)
    for name, image in (("raw", raw), ("white", white), ("dark", np.full_like(raw, 64))):
        noise = rng.normal(0, 12, raw.shape)
        write_image(folder / f"{name}.tif", np.rint(image + noise).astype(np.uint16))
        write_image(folder / f"{name}.png", np.rint(8 * (image + noise)).astype(np.uint16))


def test_a_camera_s_pixels_narrower_than_the_steps_of_decoded_views_are_refused(
    camera, tmp_path, rng
):
    """10 sensor pixels under a lenslet, of which 9 are stated as views."""
    devignetted(tmp_path, rng)
    filling = camera.micro_image_pitch_mm / 9
    facts = {"views": 9, "lenslets": (14, 14)}
    words = ["--white", tmp_path / "white.tif", "--dark", tmp_path / "dark.tif", "--depth-mm", 1]
    file = written_camera(camera, tmp_path, **facts, pixel_pitch_mm=0.9 * filling)
    with pytest.raises(InputError, match=f"Leave pixel_pitch_mm out .* is {filling:.6g} mm"):
        run(tmp_path / "raw.tif", *words, "--camera", file, "--out", tmp_path / "out")
    np.save(tmp_path / "views.npy", rng.uniform(size=(9, 9, 14, 14)).astype(np.float32))
    said = run(tmp_path / "views.npy", *words[-2:], "--camera", file, "--out", tmp_path / "stored")
    assert "wrong by about 11.1%: leave pixel_pitch_mm out" in said.output
    file = written_camera(camera, tmp_path, **facts, pixel_pitch_mm=0.995 * filling)
    run(tmp_path / "raw.tif", *words, "--camera", file, "--out", tmp_path / "out")


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["tif", "png"])
def test_devignetted_raw_images_are_converted_whatever_their_values(kind, tmp_path, rng):
    devignetted(tmp_path, rng)
    raw, *others = (tmp_path / f"{name}.{kind}" for name in ("raw", "white", "dark"))
    if kind == "tif":  # 12 bits in words of 16: brighter, as they are in floats
        for path in (raw, *others):
            write_image(path, imread(path).astype(np.float32) / 2500)
    words = ["--white", others[0], "--dark", others[1]]
    run(raw, tmp_path / "exact.npy", *words, command="convert")
    exact = read_light_field(tmp_path / "exact.npy").views
    for target in ("views", "lenslets.tif"):
        run(raw, tmp_path / target, *words, command="convert")
        options = {} if target == "views" else {"views": len(exact)}
        read = read_light_field(tmp_path / target, order="row,col", **options).views
        np.testing.assert_array_equal(read, exact)
    assert exact.min() < 0
    for target, bits in (("lenslets.png", 16), ("eight.tif", 8), ("eight", 8)):
        call = [raw, tmp_path / target, *words, "--bits", bits]
        with pytest.raises(InputError, match=f"in levels of {bits} bits, .* state a factor"):
            run(*call, command="convert")
        run(*call, "--gain", 0.5, command="convert")
        options = {} if target == "eight" else {"views": len(exact)}
        read = read_light_field(tmp_path / target, order="row,col", **options).views
        step = 1 / (2**bits - 1)
        np.testing.assert_allclose(read, (exact / 2).clip(0, 1), atol=0.51 * step)


@pytest.mark.parametrize(
    ("stored", "order"),
    [("vuts", ""), ("uvts", "col,row"), ("vust", "col,row"), ("backwards", "-row,col")],
)
def test_an_array_whose_views_move_otherwise_is_told(tmp_path, stored, order):
    """A photograph that moves by -0.6 pixels a view both ways, in arrays of several orders."""
    picture = camera_picture()[:96, :128] / 255
    moved = [[shift(picture, (-0.6 * v, -0.6 * u)) for u in range(5)] for v in range(3)]
    views = np.array(moved, np.float32)
    axes = {"uvts": (1, 0, 2, 3), "vust": (0, 1, 3, 2)}.get(stored, range(4))
    views = views[::-1] if stored == "backwards" else views.transpose(*axes)
    np.save(tmp_path / "a.npy", views)
    args = [tmp_path / "a.npy", "--slope", 0, "--overwrite", "--out", tmp_path / "o"]
    recorded = lambda: json.loads((tmp_path / "o" / "refocus.json").read_text())  # noqa: E731
    said = run(*args).output
    assert ("do not move" in said) == bool(order)
    assert f"they are stored as {order}" in said or not order
    assert recorded()["order_of_views"] == "row,col, as stored"
    again = run(*args, f"--order={order or 'row,col'}").output
    assert "do not move" not in again
    assert f"order {recorded()['order_of_views']}" in again
    assert recorded()["order_of_views"] == f"{order or 'row,col'}, as stated"
    assert "refocused" in again
