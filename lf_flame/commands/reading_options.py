"""Options for reading a light field, and the class for them.

As in `lf_flame.commands.cli`, heavy modules are imported inside.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import cloup

from lf_flame._common import progress
from lf_flame._common.input_files import printable
from lf_flame.commands.options import EXISTING, PATH, option, report
from lf_flame.errors import InputError

if TYPE_CHECKING:
    from lf_flame.formats.reading import Found
    from lf_flame.lightfield import LightField
    from lf_flame.optics.camera import PlenopticCamera
    from lf_flame.optics.lens import Lens


def _reading_options(rare: bool) -> tuple:
    """Options for reading; `rare` says whether ``--help`` leaves out those of few files."""
    layouts, mosaics = ["rectangular", "hexagonal"], ["rggb", "bggr", "grbg", "gbrg"]
    return (
        option("--white", "White image (flat field) of a raw image.", EXISTING),
        option("--lenslets", "Picture of spots, in place of --white.", EXISTING),
        option("--dark", "Dark image; subtracted from SOURCE and --white.", PATH),
        option(
            "--bayer",
            f"Mosaic of a colour sensor, {' '.join(mosaics)}.",
            click.Choice(mosaics, case_sensitive=False),
            metavar="PATTERN",
        ),
        option("--pitch", "Micro-image pitch of a raw image, in pixels.", float, rare=rare),
        option("--views", "Pixels under a lenslet, or views, each way.", int),
        option("--layout", "Layout of the lenslets (default: found).", click.Choice(layouts),
               rare=rare),
        option("--grid", "Rows x columns of views in a folder, such as 9x9.", rare=rare),
        option("--order", "Meaning of the two numbers in a name, such as row,-col.", rare=rare),
        option("--names", "Pattern of the views' names, such as 'input_Cam*.png'.", rare=rare),
    )  # fmt: skip


READING = cloup.option_group(
    "How SOURCE is read (other files: `lf-flame convert`)", *_reading_options(rare=True)
)
"""Options for reading a light field that every such command has."""

ALL_READING = cloup.option_group(
    "How SOURCE is read",
    *_reading_options(rare=False),
    option("--mosaic", "Rows x columns of views side by side in one picture, such as 8x8."),
    option("--axes", "Meaning of the axes of an array, such as vuts, tsvu or ntsc."),
    option("--array", "Name of the array, if SOURCE contains several.", rare=True),
    option("--focused", "Calibration of a Raytrix camera, or its white image.", EXISTING),
    option("--virtual-depth", "Virtual depth of focused lenslets, else found.", float, rare=True),
)
"""Options of `lf-flame convert`."""


@dataclass(frozen=True)
class Reading:
    """Options of `ALL_READING`, which are those of `lf_flame.read_light_field`.

    Reading fills `coded`, the note that the first picture is gamma-coded, if it is, and `orders`,
    the orders in which the views were stored.
    """

    white: Path | None = None
    lenslets: Path | None = None
    dark: Path | None = None
    bayer: str | None = None
    pitch: float | None = None
    views: int | None = None
    layout: str | None = None
    grid: str | None = None
    order: str | None = None
    names: str | None = None
    mosaic: str | None = None
    axes: str | None = None
    array: str | None = None
    focused: Path | None = None
    virtual_depth: float | None = None
    coded: list[str] = field(default_factory=list, compare=False)
    orders: list[str] = field(default_factory=list, compare=False)

    @property
    def stated(self) -> dict[str, Any]:
        """Options that were given."""
        options = {name: getattr(self, name) for name in self.__dataclass_fields__}
        filled = "coded", "orders"
        return {name: x for name, x in options.items() if x is not None and name not in filled}

    def given(self) -> dict[str, Any]:
        """Options that were given, paths as text."""
        return {name: str(x) if isinstance(x, Path) else x for name, x in self.stated.items()}

    def facts(self) -> dict[str, Any]:
        """Facts of a record: options that were given, orders of the views, and notes."""
        return {
            "reading": self.given(),
            "order_of_views": "; ".join(self.orders),
            "notes": list(self.coded),
        }

    @property
    def is_raw(self) -> bool:
        """Whether the options are those of a raw image."""
        return not {"white", "lenslets", "pitch", "focused"}.isdisjoint(self.stated)

    @property
    def files(self) -> tuple[Path, ...]:
        """Further files that are read."""
        return tuple(value for value in self.stated.values() if isinstance(value, Path))

    def for_camera(self, source: Path, lens: "Lens | None") -> "Reading":
        """Take the number of views from a camera, if the source is a raw or a lenslet image.

        A camera whose views do not fill the micro-images is refused for a raw image, else noted.
        """
        from lf_flame.formats.reading import kind_of
        from lf_flame.optics.camera import PlenopticCamera

        simulated = (source.parent / "simulation.json").is_file()  # by this very camera
        if isinstance(lens, PlenopticCamera) and (
            self.is_raw or (self.views is None and not simulated)
        ):
            _check_gaps(lens, self.is_raw)
        if lens is None or self.views is not None:
            return self
        takes = kind_of(source, self.stated)[2].split()
        return replace(self, views=lens.views) if "views" in takes else self

    def find(self, source: Path) -> "Found":
        """Read a light field of any kind, and print what was found."""
        from lf_flame.formats.reading import find_light_field

        flat = [path.resolve() for path in (self.white, self.dark) if path]  # lenslets may be it
        if source.resolve() in flat:
            raise InputError(f"An image cannot be decoded by itself, got {source} twice.")
        with progress.stage(f"Reading {printable(source)}"):
            found = find_light_field(source, **self.stated)
        for line in found.notes:
            report(printable(line, 600))
        if str(found.order) not in self.orders:
            self.orders.append(str(found.order))
        if found.coded and not self.coded:
            self.coded.append(found.coded)
            report(f"Note: {printable(found.coded, 800)}")
        return found

    def read(self, source: Path) -> "LightField":
        """Read a light field of any kind, and print what was found and what is doubtful."""
        found = self.find(source)
        v, u, t, s = found.light_field.shape[:4]
        report(f"{v} x {u} views of {t} x {s} pixels")
        for note in found.doubts(source):
            report(note)
        return found.light_field

    def read_of_camera(self, source: Path, lens: "Lens | None") -> "tuple[LightField, Lens | None]":
        """Read a light field, by `for_camera`, and give its camera the light field's own size.

        Pitch and number of views of the camera must be the light field's; the number of lenslets
        follows from its pixels.
        """
        light_field = self.read(source)
        if lens is None:
            return light_field, None
        for note in note_on_pixels(lens, light_field.shape):
            report(note)
        return light_field, lens.for_light_field(light_field.shape)


def note_on_pixels(lens: "Lens", shape: tuple[int, ...]) -> list[str]:
    """Note that views (v, u, t, s) have another number of pixels than the camera's, if they do."""
    if tuple(shape[2:4]) == tuple(lens.lenslets):
        return []
    return [
        f"The camera file is for views of {lens.lenslets[0]} x {lens.lenslets[1]} pixels, "
        f"got {shape[2]} x {shape[3]}: mm are right only if the views are cropped, not scaled."
    ]


def _check_gaps(camera: "PlenopticCamera", is_raw: bool) -> None:
    """Compare a camera's step between views with micro-image / views, that of decoded ones."""
    filling = camera.micro_image_pitch_mm / camera.views
    if camera.pixel_mm >= 0.99 * filling:  # the whole of it, but for rounding
        return
    stated = (
        f"the {camera.views} views of a decoded raw image divide the whole micro-image, so one "
        f"step between them is {filling:.6g} mm on the sensor, got {camera.pixel_mm:.6g}."
    )
    if is_raw:
        raise InputError(
            f"Leave pixel_pitch_mm out of the camera file: {stated} (A simulated raw image is read "
            f"by --views.)"
        )
    report(
        f"If these views were decoded with a white image or --pitch, depths in mm are wrong by "
        f"about {filling / camera.pixel_mm - 1:.1%}: leave pixel_pitch_mm out of the camera file; "
        f"{stated}"
    )
