"""Views at positions of their own: cameras of an array that stand on no grid."""

import numpy as np
import pytest
from click.testing import CliRunner
from PIL import Image

from lf_flame import InputError, LightField, read_light_field, write_light_field
from lf_flame.commands.cli import commands
from lf_flame.formats import scan_view_folder
from lf_flame.refocus import (
    align_views,
    all_in_focus,
    farthest_slope,
    find_sharpest_slope,
    shift_and_sum,
)
from lf_flame.viewer.exhibit import Exhibit

PLACES = np.random.default_rng(4).uniform(-2, 2, (9, 2)) + [0.3, -0.5]
PLACES -= PLACES.mean(axis=0)
SIZE = (48, 64)


def waves(y, x, seed=0):
    """A smooth texture as a sum of waves, anywhere in the plane."""
    rng = np.random.default_rng(seed)
    total = 0.0
    for _ in range(12):
        down, right, phase = rng.uniform(-0.8, 0.8, 2).tolist() + [rng.uniform(0, 6)]
        total = total + np.cos(down * y + right * x + phase)
    return total


def array_of(slope, seed=0):
    """Each camera sees the texture moved by the slope times its place."""
    y, x = np.indices(SIZE, float)
    slope = np.broadcast_to(slope, SIZE)
    views = [waves(y - slope * down, x - slope * right, seed) for down, right in PLACES]
    return LightField(np.array(views)[:, None], positions=PLACES[:, None] + [5.0, -3.0])


def test_views_are_shifted_by_their_own_positions():
    """Refocused at its slope the array shows the texture as from the middle of the positions."""
    light_field = array_of(1.3)
    image = shift_and_sum(light_field, 1.3, interpolation="cubic")
    inside = (slice(6, -6), slice(6, -6))
    wanted = waves(*np.indices(SIZE, float))
    assert np.abs(image - wanted)[inside].max() < 0.01 * np.ptp(wanted)
    off = shift_and_sum(light_field, -1.3, interpolation="cubic")
    assert np.abs(off - wanted)[inside].max() > 0.1 * np.ptp(wanted)


def test_a_grid_given_as_positions_is_the_grid():
    """Of two columns; and weights choose views."""
    views = np.random.default_rng(1).uniform(size=(3, 2, 20, 24, 3)).astype(np.float32)
    weights = np.array([[1, 2], [0, 1], [1, 1.0]])
    grid = np.stack(np.indices((3, 2)), axis=-1).reshape(6, 1, 2)
    placed = LightField(views.reshape(6, 1, 20, 24, 3), positions=grid)
    options = {"interpolation": "cubic"}
    found = shift_and_sum(placed, [0.7, -1.0], weights=weights.reshape(6, 1), **options)
    wanted = shift_and_sum(views, [0.7, -1.0], weights=weights, **options)
    np.testing.assert_allclose(found, wanted, atol=2e-6)
    assert farthest_slope(placed) == farthest_slope(views)


@pytest.mark.parametrize("slope", [-1.4, 0.0, 0.65])
def test_the_sharpest_slope_is_found(slope):
    assert find_sharpest_slope(array_of(slope)).slope == pytest.approx(slope, abs=0.01)
    region = (10, 40, 12, 50)
    found = find_sharpest_slope(array_of(slope), np.linspace(-2, 2, 21), region=region)
    assert found.slope == pytest.approx(slope, abs=0.01)
    assert found.confidence > 0.5


def test_the_slope_map_shows_both_halves():
    """A wall that recedes in the middle of the image by a slope of one."""
    slopes = np.where(np.arange(SIZE[1]) < 32, -0.6, 0.4)
    found = all_in_focus(array_of(slopes), np.linspace(-1.5, 1.5, 25), window=2.0)
    assert np.median(found.slope[8:-8, 8:22]) == pytest.approx(-0.6, abs=0.05)
    assert np.median(found.slope[8:-8, 42:-8]) == pytest.approx(0.4, abs=0.05)


def test_what_needs_a_grid_refuses_them(tmp_path):
    light_field = array_of(0.5)
    with pytest.raises(InputError, match="views on a grid"):
        align_views(light_field, 0.5, [(0, 0)])
    with pytest.raises(InputError, match="A file needs views on a grid"):
        write_light_field(light_field, tmp_path / "a.npz")
    with pytest.raises(InputError, match="A viewer needs views on a grid"):
        Exhibit(light_field, "title", (-1, 1), 0.5)
    assert "own position" in repr(light_field.grey())


@pytest.mark.parametrize(
    ("positions", "said"),
    [
        (np.zeros((9, 2)), "two numbers for each view"),
        (np.zeros((9, 1, 2)), "not all the same"),
        (np.full((9, 1, 2), np.nan), "finite"),
        ("middle", "must be numbers"),
    ],
)
def test_positions_that_cannot_be_used_are_refused(positions, said):
    with pytest.raises(InputError, match=said):
        LightField(np.ones((9, 1, 4, 4)), positions=positions)
    with pytest.raises(InputError, match="one column"):
        LightField(np.ones((3, 3, 4, 4)), positions=np.ones((3, 3, 2)))


def written(folder, names, slope=1.1):
    """Pictures of the array under other names; the values are scaled to 8 bits."""
    for name, view in zip(names, array_of(slope).views[:, 0], strict=True):
        Image.fromarray(np.uint8(np.rint(8 * view + 128))).save(folder / name)
    return folder


@pytest.mark.parametrize(
    ("name", "order"),
    [("y{0:.3f}_x{1:.3f}.png", None), ("cam {1:.3f} {2:.3f}.png", "col,-row")],
)
def test_positions_are_read_from_names(tmp_path, name, order):
    """In any unit; a step is the usual distance of neighbours."""
    unit = 25.0
    names = [name.format(unit * y, unit * x, -unit * y) for y, x in PLACES]
    folder = written(tmp_path, names)
    found = read_light_field(folder, order=order)
    apart = np.hypot(*(PLACES[:, None] - PLACES).transpose(2, 0, 1)) + 9 * np.eye(9)
    step = np.median(apart.min(axis=0))
    by_name = sorted(range(9), key=lambda k: names[k])
    wanted = (PLACES * unit).round(3)[by_name] / unit / step
    np.testing.assert_allclose(found.positions[:, 0], wanted, atol=5e-4)
    assert find_sharpest_slope(found).slope == pytest.approx(1.1 * step, abs=0.01)
    assert f"a step of {unit * step:.5g}"[:12] in scan_view_folder(folder, order).describe()
    dark = read_light_field(folder, order=order, dark=folder)
    assert not dark.views.any()
    assert dark.positions is not None


def test_positions_are_read_from_a_list_and_even_ones_stay_a_grid(tmp_path):
    folder = written(tmp_path, [f"v{k}.png" for k in range(9)])
    rows = [f"v{k}.png,{y:.4f},{x:.4f}" for k, (y, x) in enumerate(PLACES)]
    (folder / "a.csv").write_text("\n".join(rows))
    found = read_light_field(folder / "a.csv")
    assert find_sharpest_slope(found).confidence > 0.5
    assert found.positions.shape == (9, 1, 2)
    # A full grid of unequal steps is none of equal ones.
    for steps, shape in (((-1.5, 0.0, 2.1), (9, 1)), ((-1.5, 0.0, 1.5), (3, 3))):
        places = [(y, x) for y in steps for x in steps]
        rows = [f"v{k}.png,{y},{x}" for k, (y, x) in enumerate(places)]
        (folder / "a.csv").write_text("\n".join(rows))
        assert read_light_field(folder / "a.csv").views.shape[:2] == shape
    (folder / "a.csv").write_text("v0.png,0.5,0.1\nv1.png,1.7,1.2\nv2.png,0.1,4.1")
    with pytest.raises(InputError, match="snake is for a grid"):
        read_light_field(folder / "a.csv", order="snake")


@pytest.mark.slow
def test_the_program_refocuses_an_array_on_no_grid(tmp_path):
    folder = written(tmp_path, [f"y{y:.3f}_x{x:.3f}.png" for y, x in PLACES])
    words = ["refocus", str(folder), "--search", "--map", "-1", "3", "--out", str(tmp_path / "out")]
    done = CliRunner().invoke(commands, words)
    assert done.exit_code == 0, done.output
    assert "the views stand on no grid: slopes are for a step of" in done.output
    for option in (
        ("--aperture", "0.5"),
        ("--slope", "1", "--slope-of", "hci"),
        ("--map", "auto"),
    ):
        refused = CliRunner().invoke(
            commands, [*words[:2], *option, "--out", str(tmp_path / "other")]
        )
        assert "views on a grid of equal steps" in str(refused.exception)
