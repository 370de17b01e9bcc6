"""Options for reading a light field, and the class that holds them.

As in `lf_flame.commands.cli`, heavy modules are imported inside.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import cloup

from lf_flame._common import progress
from lf_flame._common.printable import printable
from lf_flame.commands.options import PATH, UsablePath, tell
from lf_flame.errors import InputError

if TYPE_CHECKING:
    from lf_flame.formats.reading import Found
    from lf_flame.lightfield import LightField
    from lf_flame.optics.lens import Lens

EXISTING = UsablePath(exists=True, path_type=Path)

READING = cloup.option_group(
    "How the light field is read (other options: `lf-flame convert`)",
    cloup.option(
        "--white",
        type=EXISTING,
        help="White image (flat field), to decode a raw lenslet image; for a Lytro picture also a "
        "folder of white images, or caldata-SERIAL.tar.",
    ),
    cloup.option(
        "--lenslets",
        type=EXISTING,
        help="Image that shows the lenslets' centres, as bright spots (closed aperture); it does "
        "not correct the brightness.",
    ),
    cloup.option(
        "--dark",
        type=PATH,
        help="Dark image, in the format of SOURCE; subtracted from SOURCE and from --white.",
    ),
    cloup.option(
        "--bayer",
        type=click.Choice(["rggb", "bggr", "grbg", "gbrg"], case_sensitive=False),
        help="Colours of the upper left 2 x 2 pixels of a raw image of a colour sensor.",
    ),
    cloup.option("--pitch", type=float, help="Micro-image pitch of a raw image, in pixels."),
    cloup.option(
        "--views",
        type=int,
        help="Number of pixels under a lenslet along each axis, in a lenslet image or raw image "
        "(default: by the camera).",
    ),
    cloup.option(
        "--layout",
        type=click.Choice(["rectangular", "hexagonal"]),
        help="Layout of the lenslets of a raw image (default: found in the white image).",
    ),
    cloup.option(
        "--grid",
        help="Rows x columns of views in a folder, as 9x9; numbers in names are places in it, and "
        "missing views get weight 0 (default: by the names, or a square).",
    ),
    cloup.option(
        "--order",
        help="Order in which names count views (default: found by the parallax): row,col is row by "
        "row from the top left; -row from the bottom, -col from the right.",
    ),
    cloup.option("--names", help="Pattern of the views' names in a folder, as 'input_Cam*.png'."),
)
"""Options for reading a light field that every such command has."""

RARE = cloup.option_group(
    "For files of other kinds",
    cloup.option(
        "--mosaic", help="Rows x columns of views side by side in one picture SOURCE, as 8x8."
    ),
    cloup.option("--axes", help="Meaning of the axes of an array, as vuts, tsvu or ntsc."),
    cloup.option("--array", help="Name of the array, if SOURCE (.npz, .h5, .mat) holds several."),
    cloup.option("--first", type=int, help="Number of the first view of --grid, if not 0 or 1."),
    cloup.option(
        "--focused",
        type=EXISTING,
        help="Calibration (.xml) of a Raytrix camera, or white image of another camera, whose "
        "lenslets are focused.",
    ),
    cloup.option(
        "--virtual-depth",
        type=float,
        help="Virtual depth at which focused lenslets are put together (default: found for each).",
    ),
)
"""Options for reading that `lf-flame convert` alone has."""


def refuse_options(what: str, **options: Any) -> None:
    """Refuse options that are given, by their names."""
    for name, value in options.items():
        if value is not None:
            raise InputError(f"--{name.replace('_', '-')} does not apply to {what}.")


@dataclass(frozen=True)
class Reading:
    """Options of `READING` and `RARE`, which are those of `lf_flame.read_light_field`."""

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
    first: int | None = None
    focused: Path | None = None
    virtual_depth: float | None = None

    @property
    def stated(self) -> dict[str, Any]:
        """Options that were given."""
        options = {name: getattr(self, name) for name in self.__dataclass_fields__}
        return {name: value for name, value in options.items() if value is not None}

    def given(self) -> dict[str, Any]:
        """Give the options that were given, paths as text."""
        return {name: str(x) if isinstance(x, Path) else x for name, x in self.stated.items()}

    @property
    def is_raw(self) -> bool:
        """Whether the source is said to be a raw image."""
        return not {"white", "lenslets", "pitch", "focused"}.isdisjoint(self.stated)

    @property
    def files(self) -> tuple[Path, ...]:
        """Files that are read beside the source."""
        return tuple(value for value in self.stated.values() if isinstance(value, Path))

    def for_camera(self, source: Path, lens: "Lens | None") -> "Reading":
        """Take the number of views from a camera, if the source is a raw or a lenslet image.

        Raises
        ------
        InputError
            If the camera's views do not fill the micro-images, as those of a decoded raw image do.
        """
        from lf_flame.commands.lens_facts import check_gaps
        from lf_flame.formats.reading import takes
        from lf_flame.optics.camera import PlenopticCamera

        simulated = (source.parent / "simulation.json").is_file()  # by this very camera
        if isinstance(lens, PlenopticCamera) and (
            self.is_raw or (self.views is None and not simulated)
        ):
            check_gaps(lens, self.is_raw)
        if lens is None or self.views is not None or not takes(source, "views", **self.stated):
            return self
        return replace(self, views=lens.views)

    def find(self, source: Path) -> "Found":
        """Read a light field of any kind, and print what was found."""
        from lf_flame.formats.reading import find_light_field

        with progress.stage(f"Reading {printable(source)}"):
            found = find_light_field(source, **self.stated)
        for line in found.notes:
            tell(printable(line))
        return found

    def read(self, source: Path) -> "LightField":
        """Read a light field of any kind, and print what was found and what is doubtful."""
        from lf_flame.formats.coding import notes_on_values
        from lf_flame.formats.reading import note_on_order

        found = self.find(source)
        light_field = found.light_field
        v, u, t, s = light_field.views.shape[:4]
        tell(f"{v} x {u} views of {t} x {s} pixels")
        as_stored = found.order is None and self.order is None
        doubt = note_on_order(light_field, source) if as_stored else ""
        kept = (light_field.uncounted, light_field.unknown, doubt)
        for note in (*kept, *notes_on_values(light_field, source)):
            if note:
                tell(note)
        return light_field

    def read_of_camera(self, source: Path, lens: "Lens | None") -> "tuple[LightField, Lens | None]":
        """Read a light field and give its camera the light field's own size.

        Pitch and number of views of the camera must be the light field's; how many lenslets there
        are, its pixels say.
        """
        from lf_flame.commands.lens_facts import note_on_pixels

        light_field = self.for_camera(source, lens).read(source)
        if lens is None:
            return light_field, None
        for note in note_on_pixels(lens, light_field.shape):
            tell(note)
        return light_field, lens.for_light_field(light_field.shape)
