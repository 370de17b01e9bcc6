"""The commands that show a light field: view and demo.

As in `lf_flame.commands.cli`, heavy modules are imported inside the commands.
"""

import math
import webbrowser
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING

import click
import cloup

from lf_flame._common.input_files import printable
from lf_flame.commands.options import (
    PATH,
    FiniteRange,
    camera_option,
    command,
    flag,
    open_lens,
    option,
    pick,
    report,
)
from lf_flame.commands.reading_options import READING, Reading
from lf_flame.errors import InputError

if TYPE_CHECKING:
    from lf_flame.viewer.exhibit import Exhibit

SHOWING = cloup.option_group(
    "How it is shown",
    option("--slopes", "Ends of the slider and of the slope map (default: found).", float, nargs=2,
           metavar="FROM TO"),
    flag("--no-map", "Leave out slope map and all-in-focus image."),
    option("--title", "Heading of the page (default: the source's name)."),
    option("--single-file", "Write one HTML file instead of serving a page.", PATH),
    option(
        "--megabytes",
        "Largest size of that file; pictures that do not fit are stored coarser, with a note.",
        FiniteRange(0.3, 1000),
        default=10.0,
        rare=True,
    ),
    option("--port", "Port of the local page; 0: any free one.", click.IntRange(0, 65535),
           default=0, rare=True),
    flag("--no-browser", "Print the page's address; open no browser."),
)  # fmt: skip


@command()
@click.argument("source", type=PATH)
@SHOWING
@camera_option()
@READING
def view(source, slopes, no_map, title, camera, **options) -> None:
    """Look at a light field in the browser: drag its focus, its aperture, its viewpoint.

    SOURCE is read as by `lf-flame refocus`, or is a folder of `lf-flame reconstruct`, whose planes
    the slider moves through. The page is visible on this machine only; Ctrl-C ends it.

    \b
      lf-flame view buddha                             a folder of views
      lf-flame view raw.png --white white.png          any plenoptic camera
      lf-flame view buddha --single-file buddha.html   to be mailed, or put on any site
      lf-flame view reconstructed/flames               emission, plane by plane
    """  # noqa: D301 - click reads the backspace
    from lf_flame.tomography.emission_folder import RECORD
    from lf_flame.viewer.exhibit import Exhibit

    beside = (options[name] for name in ("white", "lenslets", "dark"))
    _check_single_file(options["single_file"], (source, camera, *beside))
    reading = pick(Reading, options)
    if (source / RECORD).is_file() or any(source.glob(f"*/{RECORD}")):  # or one for each colour
        for name, value in (reading.given() | {"slopes": slopes, "camera": camera}).items():
            if value is not None:
                raise InputError(f"--{name} does not apply to planes of `lf-flame reconstruct`.")
        show(emission_exhibit(source, title), **options)
        return
    lens = open_lens(camera)
    reading = reading.for_camera(source, lens)
    light_field, lens = reading.read_of_camera(source, lens)
    light_field = light_field if lens is None else lens.corrected(light_field)
    chosen = _choose_slopes(light_field, slopes, lens)
    exhibit = Exhibit(
        light_field,
        title or source.resolve().name,
        (chosen.low, chosen.high),
        chosen.slope,
        lens,
        str(source),
        reading.given() | ({"camera": str(camera)} if camera else {}),
        with_map=not no_map,
    )
    show(exhibit, **options)


def emission_exhibit(source: Path, title: str | None) -> "Exhibit":
    """Show a folder of `lf-flame reconstruct`, its planes in the order of their depths."""
    import numpy as np

    from lf_flame.lightfield import LightField
    from lf_flame.tomography import EmissionFolder
    from lf_flame.viewer.exhibit import Exhibit

    folder = EmissionFolder(source)
    if folder.is_section:
        raise InputError(f"{source} is a half section of `lf-flame abel`, which has one plane.")
    order = np.argsort(folder.depths_mm)
    depths, emission = np.array(folder.depths_mm)[order], folder.emission[order]
    brightest = depths[np.argmax(emission.sum(axis=(1, 2)))]
    return Exhibit(
        LightField(emission[None]),
        title or f"{source.resolve().name}: emission by depth",
        (depths[0], depths[-1]),
        brightest,
        with_map=False,
        depths_mm=depths.tolist(),
    )


def _check_single_file(single_file: Path | None, read: tuple[Path | None, ...] = ()) -> None:
    """Refuse a page over an input file, or under a name that browsers do not show as a page."""
    if single_file is None:
        return
    if single_file.resolve() in {path.resolve() for path in read if path}:
        raise InputError(f"{single_file} is an input, and cannot be replaced; name another file.")
    if single_file.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"--single-file must end in .html, got {single_file}.")


def _choose_slopes(light_field, slopes: tuple[float, float] | None, camera=None):
    from lf_flame.viewer.exhibit import choose_slopes

    chosen = choose_slopes(light_field, slopes)
    if slopes is None:
        ends = [camera.slope_to_real_depth(end) for end in (chosen.low, chosen.high) if camera]
        known = ends and all(math.isfinite(end) for end in ends)
        depths = f", {ends[0]:+.4g} to {ends[1]:+.4g} mm" if known else ""
        report(f"{chosen.describe()}{depths} (--slopes FROM TO for others)")
    return chosen


def show(
    exhibit: "Exhibit", single_file: Path | None, megabytes: float, port: int, no_browser: bool
) -> None:
    """Write an exhibit as one file, or serve it until Ctrl-C."""
    from lf_flame._common.atomic_files import write_text
    from lf_flame.viewer.page import single_page
    from lf_flame.viewer.server import ViewerServer

    if single_file:
        page, quality = single_page(exhibit, int(megabytes * 1e6))
        write_text(single_file, page)
        click.echo(f"{printable(single_file)} is written, {len(page) / 1e6:.1f} MB: {quality}")
        return
    with ViewerServer(exhibit, port) as server:
        click.echo(f"{server.url}\nCtrl-C ends it.")
        if not no_browser:
            # A text browser ends only when it was answered.
            Thread(target=webbrowser.open, args=(server.url,), daemon=True).start()
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            click.echo("Ended.")


@command()
@SHOWING
@option("--save", "File (.npy) for the light field; copied commands then read it.", PATH)
def demo(slopes, no_map, title, save, **options) -> None:
    """Simulate flames in front of a wall, and look at them: no data is needed.

    Three flames are at 8, 0 and -6 mm from the focal plane, the wall at 15 mm, the burner at
    -10 mm. Drag the focus from one to the other, or click on them.
    """
    from lf_flame.viewer.demo import DEMO_CAMERA, DEPTHS_MM, demo_light_field
    from lf_flame.viewer.exhibit import Exhibit

    _check_single_file(options["single_file"])
    report("simulating a plenoptic camera, 9 x 9 views ...")
    near, far = (DEMO_CAMERA.depth_to_slope(depth) for depth in DEPTHS_MM)
    exhibit = Exhibit(
        demo_light_field(),
        title or "Three flames in front of a wall",
        slopes or (near, far),
        0.0,
        DEMO_CAMERA,
        str(save) if save else None,  # which copied commands read
        with_map=not no_map,
    )
    if save:
        from lf_flame.formats import write_light_field

        write_light_field(exhibit.light_field, save, 16)
        report(f"{printable(save)} is written")
    show(exhibit, **options)
