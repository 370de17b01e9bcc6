"""Planes that the program makes for a page: of what is too large, by a network, or exactly."""

import http.client
import shlex
import time
from contextlib import contextmanager
from threading import Thread

import numpy as np
import pytest
from click.testing import CliRunner

from lf_flame import InputError, LightField
from lf_flame.commands.cli import commands
from lf_flame.formats.images import read_image
from lf_flame.refocus import aperture_weights, refocus, shift_and_sum
from lf_flame.systems.formulas import ShiftAndSum
from lf_flame.systems.training import load_system
from lf_flame.viewer.exhibit import Exhibit
from lf_flame.viewer.page import single_page
from lf_flame.viewer.planes import PlaneMaker, parse_plane
from lf_flame.viewer.server import ViewerServer

SHAPES = [(9, 9, 14, 23), (3, 6, 12, 10, 3)]

APERTURES = [
    {"shape": "square", "width": 1.0},
    {"shape": "round", "width": 0.8},
    {"shape": "round", "width": 1.3, "ring": 0.5, "centre": [0.4, -0.5]},
    {"shape": "square", "width": 0.61, "centre": [-0.5, 0.25]},
    {"shape": "square", "width": 1.0, "ring": 0.45},
]


@contextmanager
def serving(exhibit):
    """Serve an exhibit."""
    with ViewerServer(exhibit) as server:
        thread = Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        try:
            yield server
        finally:
            server.shutdown()
            thread.join()


@pytest.fixture
def opened(tab):
    """Open an exhibit whose planes the program makes, as a served page."""
    running = []

    def open_exhibit(exhibit, **more):
        running.append(serving(exhibit))
        tab.open(running[-1].__enter__().url, **more)
        # A suite that is green on another renderer proves nothing.
        assert tab.page.evaluate("() => lfViewer.renderer.name") == "the program"
        assert tab.page.evaluate("() => lfViewer.codes") is None
        assert not [url for url in tab.requests if "/views/" in url]
        return tab

    yield open_exhibit
    for server in running:
        server.__exit__(None, None, None)


def planes_asked(tab):
    return [url for url in tab.requests if "/plane?" in url]


def levels_of(image, white=1.0):
    """What a canvas should show of radiance."""
    levels = np.rint(255 * np.clip(image / white, 0, 1))
    return levels if levels.ndim == 3 else levels[..., None]


@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_planes_are_those_of_the_engine(opened, make_exhibit, rng, shape):
    exhibit = make_exhibit(shape, bits=16, most_bytes=np.prod(shape) - 1)
    tab = opened(exhibit)
    for aperture in APERTURES:
        slope = float(rng.uniform(-2, 2))
        aperture = {"ring": 0, "centre": [0, 0], **aperture}
        tab.set(**aperture, slope=slope)
        weights = aperture_weights(shape[:2], **aperture)
        image = shift_and_sum(exhibit.light_field.views, [slope], weights=weights)[0]
        np.testing.assert_allclose(tab.read(image.shape), image, atol=1e-5)
        assert np.abs(tab.canvas() - levels_of(image)).max() <= 1
    assert len(planes_asked(tab)) == 1 + len(APERTURES)


def test_planes_hold_the_views_that_count(opened, make_exhibit, rng):
    exhibit = make_exhibit((5, 4, 33, 40), bits=16, interpolation="cubic")
    own = rng.uniform(0.2, 1, (5, 4))
    own[0] = 0
    views = exhibit.light_field.views
    object.__setattr__(exhibit, "light_field", LightField(views, weights=own))
    tab = opened(exhibit)
    tab.set(slope=0.71, shape="round", width=0.9)
    weights = own.astype(np.float32) * aperture_weights((5, 4), 0.9)
    image = refocus(views, [0.71], interpolation="cubic", weights=weights)[0]
    np.testing.assert_allclose(tab.read(image.shape), image, atol=1e-5)
    assert np.abs(tab.canvas() - levels_of(image)).max() <= 1


def test_a_page_that_can_hold_the_views_sums_them_itself(tab, make_exhibit):
    shape = SHAPES[0]
    with serving(make_exhibit(shape, most_bytes=np.prod(shape))) as server:
        tab.open(server.url, "javascript")
        assert tab.page.evaluate("() => lfViewer.renderer.name") == "JavaScript"
        assert not planes_asked(tab)


@pytest.mark.parametrize("interpolation", ["nearest", "sinc"])
def test_any_interpolation_is_shown(opened, make_exhibit, interpolation):
    exhibit = make_exhibit((4, 5, 20, 26, 3), bits=16, interpolation=interpolation)
    tab = opened(exhibit)
    assert interpolation in tab.page.locator("header p").inner_text()
    tab.set(slope=0.71, shape="round", width=0.9)
    weights = aperture_weights((4, 5), 0.9)
    image = refocus(exhibit.light_field, [0.71], interpolation=interpolation, weights=weights)[0]
    np.testing.assert_allclose(tab.read(image.shape), image, atol=1e-5)
    assert np.abs(tab.canvas() - levels_of(image)).max() <= 1
    linear = shift_and_sum(exhibit.light_field, [0.71], weights=weights)[0]
    assert np.abs(image - linear).max() > 1e-3


def copied(tab, name):
    """What a button copies."""
    tab.page.get_by_role("button", name=name).click()
    return tab.page.locator("code").inner_text()


def assert_copies_give_the_picture(tab, folder):
    """The command and the Python lines, run, draw what the canvas shows."""
    words = shlex.split(copied(tab, "Copy command"))
    out = folder / "copied"
    result = CliRunner().invoke(commands, [*words[1:], "--out", str(out)])
    assert result.exit_code == 0, result.output
    (picture,) = out.glob("refocused_*.png")
    shown = read_image(picture)
    shown = shown if shown.ndim == 3 else shown[..., None]
    assert np.abs(255 * shown - tab.canvas()).max() <= 1
    names = {}
    exec(copied(tab, "Copy Python"), names)
    return words, names["image"]


@pytest.mark.parametrize(
    ("options", "state", "words"),
    [
        ({"most_bytes": 1}, {"slope": -1.3, "shape": "round", "width": 0.7, "ring": 0.2,
                             "centre": [0.5, -1]}, []),
        ({"interpolation": "sinc"}, {"slope": 0.45, "gain": 1.6, "gamma": 2.2},
         ["--interpolation=sinc"]),
        ({"interpolation": "cubic"}, {"slope": -0.7, "width": 0.6}, ["--interpolation=cubic"]),
    ],
)  # fmt: skip
def test_the_copied_command_gives_the_picture_shown(
    opened, make_exhibit, tmp_path, options, state, words
):
    exhibit = make_exhibit((5, 5, 16, 20, 3), **options)
    source = tmp_path / "it's a $(field).npy"
    np.save(source, exhibit.coded.codes if "most_bytes" not in options else
            np.rint(255 * exhibit.light_field.views).astype(np.uint8))  # fmt: skip
    object.__setattr__(exhibit, "source", str(source))
    tab = opened(exhibit)
    tab.set(**state)
    used, image = assert_copies_give_the_picture(tab, tmp_path)
    assert set(words) <= set(used)
    assert np.abs(255 * image.clip(0, 1) - tab.canvas()).max() <= 1


@pytest.mark.slow
def test_a_network_shows_what_the_command_makes(opened, system_runs, tmp_path, rng):
    brightness = 3.7  # networks take values from 0 to 1
    run = tmp_path / "it's a run"
    run.symlink_to(system_runs / "refocusnet")
    network = load_system(run)
    views = (brightness * rng.uniform(size=(9, 9, 40, 52))).astype(np.float32)
    views[4, 4, 0, 0] = brightness
    source = tmp_path / "views.npy"
    np.save(source, views)
    exhibit = Exhibit(LightField(views), "Noise", (-1.0, 1.0), 0.0, source=str(source),
                      network=network, network_source=str(run), with_map=False)  # fmt: skip
    tab = opened(exhibit, address="#width=0.3&shape=round")
    assert tab.page.evaluate("() => [lfViewer.state.width, lfViewer.state.shape]") == [1, "square"]
    tab.set(slope=0.42)
    image = brightness * network.refocus(views / np.float32(brightness), [0.42])[0]
    np.testing.assert_allclose(tab.read(image.shape), image, atol=1e-5 * brightness)
    assert np.abs(tab.canvas() - levels_of(image, brightness)).max() <= 1
    assert np.abs(image - shift_and_sum(views, [0.42])[0]).max() > 0.05
    words, again = assert_copies_give_the_picture(tab, tmp_path)
    assert f"--network={run}" in words
    np.testing.assert_allclose(again, image, atol=1e-5 * brightness)
    for name in ("Width", "Covered middle", "Left and right"):
        assert tab.page.get_by_role("slider", name=name).is_disabled()
    assert "network has an aperture" in tab.page.locator("fieldset p").inner_text()


def test_what_a_network_finds_is_cut_to_its_slopes(rng):
    from lf_flame.viewer.exhibit import choose_slopes

    class Narrow(ShiftAndSum):
        def slope_range(self, rows, columns):
            return -0.25, 0.5

    light_field = LightField(rng.uniform(size=(3, 3, 40, 40)))
    chosen = choose_slopes(light_field, None, Narrow())
    assert -0.25 <= chosen.low < chosen.slope < chosen.high <= 0.5
    with pytest.raises(InputError, match="does slopes from -0.25 to 0.5"):
        Exhibit(light_field, "Noise", (-0.3, 0.5), 0.0, network=Narrow())
    with pytest.raises(InputError, match="does not apply to a network"):
        Exhibit(light_field, "Noise", (-0.2, 0.5), 0.0, network=Narrow(), interpolation="sinc")


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"interpolation": "sinc"}, "Interpolation 'sinc' needs the program"),
        ({"network": ShiftAndSum()}, "A network needs the program"),
        ({"most_bytes": 100}, "A page holds 100 pixels at most, but this light field has 648"),
    ],
)
def test_one_file_says_what_it_cannot_hold(make_exhibit, options, words):
    with pytest.raises(InputError, match=words):
        single_page(make_exhibit((3, 3, 8, 9), **options), 10**8)


def ask(server, path):
    """Status and text of an answer."""
    connection = http.client.HTTPConnection(server.address)
    connection.putrequest("GET", path)  # which takes any letters in a path, as they are
    connection.endheaders()
    answer = connection.getresponse()
    body = answer.read()
    connection.close()
    return answer.status, body


GOOD = {"slope": "0.5", "shape": "round", "width": "0.9", "ring": "0", "v": "0", "u": "1",
        "block": "1"}  # fmt: skip


def query(**changes):
    values = {**GOOD, **changes}
    return "&".join(f"{name}={x}" for name, x in values.items() if x is not None)


HOSTILE = [
    *(query(**{name: value}) for name in ("slope", "width", "v", "block")
      for value in ("nan", "inf", "-inf", "1e400", "", "0x1", "1_0", "%31", "+1", "1e9", "%D9%A3")),
    *(query(**{name: None}) for name in GOOD),
    *(query(shape=shape) for shape in ("star", "", "<script>", "round&shape=round")),
    query(slope="2.01"), query(width="0"), query(width="1.5"), query(shape="square", width="1.01"),
    query(ring="0.9"), query(ring="-0.1"), query(v="2.5"), query(u="-2.1"), query(block="2"),
    query(block="1.5"), query(block="-1"), query(more="1"), query(slope="0." + "1" * 400), "", "?",
    query() + "&", query().replace("&", ";"), query() + "&slope=0.5", "x" * 5000,
    query(width="0.01", v="2", u="2", ring="0.1"),
]  # fmt: skip


@pytest.fixture
def server(make_exhibit):
    with serving(make_exhibit((5, 5, 30, 40), most_bytes=1)) as server:
        yield server


PLACES = ("row=30&column=0", "row=-1&column=0", "row=0", "row=a&column=1", "row=1.5&column=2",
          "row=0&column=40")  # fmt: skip


@pytest.mark.parametrize(
    "asked",
    [*(f"plane?{one}" for one in HOSTILE), *(f"slices?{one}" for one in PLACES)],
    ids=lambda text: text[:60],
)
def test_senseless_questions_are_one_sentence(server, asked, capfd):
    status, body = ask(server, f"/{server.token}/{asked}")
    assert status == 400, body
    assert body.decode().endswith(".")
    assert "\n" not in body.decode()
    assert len(body) < 300
    assert capfd.readouterr().err == ""


def test_only_planes_are_given_where_the_program_makes_them(server):
    status, body = ask(server, f"/{server.token}/plane?{query()}")
    assert (status, len(body)) == (200, 4 * 30 * 40)
    for path in (f"lane?{query()}", "views/0", f"plane/?{query()}"):
        assert ask(server, f"/{server.token}/{path}")[0] == 404


def test_numbers_as_browsers_write_them_are_read():
    found = parse_plane(query(slope="-1.2345678901234567e-7", v="-0.5", u="0"))
    assert (found.slope, found.v, found.u) == (-1.2345678901234567e-07, -0.5, 0.0)


def test_a_network_has_its_own_aperture(make_exhibit):
    whole = {"shape": "square", "width": "1", "v": "0", "u": "0"}
    with serving(make_exhibit((5, 5, 30, 40), network=ShiftAndSum())) as server:
        assert ask(server, f"/{server.token}/plane?{query(**whole)}")[0] == 200
        for name, other in (("shape", "round"), ("width", "0.9"), ("v", "1"), ("ring", "0.1")):
            status, body = ask(server, f"/{server.token}/plane?{query(**whole | {name: other})}")
            assert (status, body) == (400, b"A network has its own aperture.")


@pytest.mark.parametrize("digit", ["٣", "Ù£", " 1", "1\n"])
def test_only_plain_digits_are_numbers(digit):
    with pytest.raises(InputError, match="slope must be a plain number"):
        parse_plane(query(slope=digit))


class Slow:
    """Planes that take a while; counts how many are made at once."""

    def __init__(self, monkeypatch, seconds):
        self.now = self.most = self.count = 0
        make = PlaneMaker.make

        def slowly(maker, query):
            self.now, self.count = self.now + 1, self.count + 1
            self.most = max(self.most, self.now)
            time.sleep(seconds)
            self.now -= 1
            return make(maker, query)

        monkeypatch.setattr(PlaneMaker, "make", slowly)


@pytest.mark.slow
def test_dragging_does_not_pile_up_requests(opened, make_exhibit, monkeypatch):
    exhibit = make_exhibit((3, 3, 40, 50), most_bytes=1)
    tab = opened(exhibit)
    slow = Slow(monkeypatch, 0.15)
    tab.page.evaluate(
        """async () => {
          for (let k = 1; k <= 60; k++) {
            lfViewer.set({ slope: k / 100 }, { dragging: true });
            await new Promise((done) => setTimeout(done, 10));
          }
        }"""
    )
    tab.settle()
    assert slow.most == 1
    assert 2 <= slow.count <= 10  # 60 were asked for, within about a second
    image = shift_and_sum(exhibit.light_field, [0.6])[0]
    assert "slope=0.6&" in planes_asked(tab)[-1]
    tab.set(slope=0.6)  # let go
    np.testing.assert_allclose(tab.read(image.shape), image, atol=1e-5)


@pytest.mark.parametrize(
    "network", [None, pytest.param(ShiftAndSum(), marks=pytest.mark.slow, id="network")]
)
def test_slow_planes_are_coarse_while_dragging(opened, make_exhibit, monkeypatch, network):
    exhibit = make_exhibit((3, 3, 131, 150), most_bytes=1, network=network)
    assert exhibit.planes.coarse == 4
    Slow(monkeypatch, 0.12)
    tab = opened(exhibit)
    tab.page.evaluate("() => lfViewer.set({ slope: 1.2 }, { dragging: true })")
    tab.settle()
    views = exhibit.light_field.views[:, :, :128, :148]
    views = views.reshape(3, 3, 32, 4, 37, 4).mean(axis=(3, 5))
    image = shift_and_sum(views, [1.2 / 4])[0]
    np.testing.assert_allclose(tab.read(image.shape), image, atol=1e-5)
    tab.set(slope=1.2)
    whole = shift_and_sum(exhibit.light_field, [1.2])[0]
    np.testing.assert_allclose(tab.read(whole.shape), whole, atol=1e-5)
    assert tab.canvas().shape == (131, 150, 3)


@pytest.mark.slow
def test_fast_planes_are_whole_while_dragging(opened, make_exhibit):
    exhibit = make_exhibit((3, 3, 131, 150), most_bytes=1)
    tab = opened(exhibit)
    tab.page.evaluate("() => { lfViewer.renderer.took = 20; }")  # whatever the first one took
    tab.page.evaluate("() => lfViewer.set({ slope: 1.2 }, { dragging: true })")
    tab.settle()
    assert tab.canvas().shape == (131, 150, 3)
    assert planes_asked(tab)[-1].endswith("block=1")


def test_small_images_are_never_coarse(make_exhibit):
    assert make_exhibit((3, 3, 60, 500), most_bytes=1).planes.coarse == 1
    assert make_exhibit((3, 3, 100, 500), most_bytes=1).planes.coarse == 3


def busy(tab):
    return tab.page.locator(".lf-picture").get_attribute("aria-busy")


@pytest.mark.slow
def test_waiting_is_said_after_a_moment(opened, make_exhibit, monkeypatch):
    tab = opened(make_exhibit((3, 3, 8, 9), most_bytes=1))
    Slow(monkeypatch, 1.5)
    tab.page.evaluate("() => lfViewer.set({ slope: 1 })")
    tab.page.wait_for_timeout(150)
    assert busy(tab) != "true"
    tab.page.wait_for_timeout(700)
    assert busy(tab) == "true"
    tab.settle()
    assert busy(tab) == "false"


def test_what_goes_wrong_is_said_in_the_page(opened, make_exhibit, monkeypatch):
    exhibit = make_exhibit((3, 3, 8, 9), most_bytes=1)
    tab = opened(exhibit)
    status = tab.page.get_by_role("status")

    def refuse(*_):
        raise InputError("There is no room for <b>this</b> picture.")

    with monkeypatch.context() as patch:
        patch.setattr(PlaneMaker, "make", refuse)
        tab.set(slope=1)
        assert status.inner_text() == "There is no room for <b>this</b> picture."
    tab.set(slope=0.5)
    assert status.inner_text() == ""
    tab.page.context.set_offline(True)
    tab.set(slope=-1)
    assert "does not answer; it may have ended." in status.inner_text()
    tab.complaints.clear()  # the browser's own, of both answers


def test_gain_and_gamma_ask_for_nothing(opened, make_exhibit):
    tab = opened(make_exhibit((3, 3, 8, 9), most_bytes=1))
    tab.set(slope=0.7)
    before = len(tab.requests)
    shown = tab.canvas()
    tab.set(gain=1.7)
    assert len(tab.requests) == before
    assert tab.canvas().mean() > 1.1 * shown.mean()


def test_slices_come_from_the_program(opened, make_exhibit):
    exhibit = make_exhibit((4, 5, 10, 12), most_bytes=1)
    tab = opened(exhibit)
    tab.page.evaluate("() => lfViewer.slicesAt(3, 7)")
    tab.settle()
    views = np.rint(255 * exhibit.light_field.views)
    for name, expected in ((".lf-row", views[1, :, 3, :]), (".lf-column", views[:, 2, :, 7])):
        assert np.abs(tab.canvas(name)[..., 0] - expected).max() <= 1


@pytest.mark.slow
def test_the_map_and_the_state_in_the_address_work_as_ever(opened, make_exhibit):
    exhibit = make_exhibit((5, 5, 30, 40), most_bytes=1, with_map=True)
    tab = opened(exhibit, address="#slope=-0.85&shape=round&width=0.7&overlay=slope&gain=1.5")
    state = tab.page.evaluate("() => lfViewer.state")
    assert (state["slope"], state["width"], state["overlay"]) == (-0.85, 0.7, "slope")
    weights = aperture_weights((5, 5), 0.7)
    image = 1.5 * shift_and_sum(exhibit.light_field, [-0.85], weights=weights)[0]
    assert np.abs(tab.canvas() - levels_of(image)).max() <= 1


def test_the_middle_view_stands_until_the_first_plane(tab, make_exhibit, monkeypatch):
    exhibit = make_exhibit((4, 4, 10, 12, 3), most_bytes=1)
    Slow(monkeypatch, 1.0)
    with serving(exhibit) as server:
        tab.page.goto(server.url)
        tab.page.wait_for_function("() => globalThis.lfViewer?.renderer.values")
        view = tab.read((10, 12, 3))
        np.testing.assert_allclose(view, exhibit.light_field.views[1, 1], atol=1e-6)
        tab.settle()
    image = shift_and_sum(exhibit.light_field, [0.0])[0]
    np.testing.assert_allclose(tab.read(image.shape), image, atol=1e-5)
