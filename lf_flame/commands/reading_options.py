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
    import numpy as np

    from lf_flame.formats import DecodePlan, FocusedPlan, LensletGrid, ViewFolder
    from lf_flame.formats.view_files.parallax_order import FoundOrder
    from lf_flame.lightfield import LightField
    from lf_flame.optics.lens import Lens

READING = cloup.option_group(
    "How the light field is read",
    cloup.option(
        "--views",
        type=int,
        help="Number of pixels under a lenslet along each axis, in a lenslet image or raw image "
        "(default: by the camera).",
    ),
    cloup.option(
        "--order",
        help="Order in which views are counted (default: found by the parallax): row,col is row by "
        "row from the top left; -row from the bottom, -col from the right; snake,row,col runs "
        "every other row back.",
    ),
    cloup.option(
        "--grid",
        help="Rows x columns of views, as 1x9, if their names hold one running number or most are "
        "missing; what is missing gets weight 0.",
    ),
    cloup.option(
        "--mosaic", help="Rows x columns of views side by side in one picture SOURCE, as 8x8."
    ),
    cloup.option("--axes", help="Meaning of the axes of an array, as vuts, tsvu or ntsc."),
    cloup.option("--array", help="Name of the array, if SOURCE (.npz, .h5, .mat) holds several."),
    cloup.option(
        "--white",
        type=UsablePath(exists=True, path_type=Path),
        help="White image (flat field), to decode a raw lenslet image; for a Lytro picture also a "
        "folder of white images, or caldata-SERIAL.tar.",
    ),
    cloup.option(
        "--dark",
        type=PATH,
        help="Dark image, in the format of SOURCE; subtracted from SOURCE and from --white.",
    ),
    cloup.option("--pitch", type=float, help="Micro-image pitch of a raw image, in pixels."),
    cloup.option(
        "--layout",
        type=click.Choice(["rectangular", "hexagonal"]),
        help="Layout of the lenslets of a raw image (default: found in the white image).",
    ),
    cloup.option(
        "--bayer",
        type=click.Choice(["rggb", "bggr", "grbg", "gbrg"], case_sensitive=False),
        help="Colours of the upper left 2 x 2 pixels of a raw image of a colour sensor.",
    ),
    cloup.option(
        "--focused",
        type=UsablePath(exists=True, path_type=Path),
        help="Calibration (.xml) of a Raytrix camera, or white image of another camera, whose "
        "lenslets are focused.",
    ),
    cloup.option(
        "--virtual-depth",
        type=float,
        help="Virtual depth at which focused lenslets are put together (default: found for each).",
    ),
)
"""Options for reading a light field."""


def refuse_options(what: str, **options: Any) -> None:
    """Refuse options that are given, by their names."""
    for name, value in options.items():
        if value is not None:
            raise InputError(f"--{name.replace('_', '-')} does not apply to {what}.")


@dataclass(frozen=True)
class Reading:
    """Options of the group `READING`: how to read a light field."""

    views: int | None = None
    order: str | None = None
    grid: str | None = None
    mosaic: str | None = None
    axes: str | None = None
    array: str | None = None
    white: Path | None = None
    pitch: float | None = None
    layout: str | None = None
    dark: Path | None = None
    bayer: str | None = None
    focused: Path | None = None
    virtual_depth: float | None = None

    def for_camera(self, source: Path, lens: "Lens | None") -> "Reading":
        """Take the number of views from a camera, if the source is a raw or a lenslet image.

        Raises
        ------
        InputError
            If the source is said to have focused lenslets, and the camera's are not; or if the
            camera's views do not fill the micro-images, as those of a decoded raw image do.
        """
        from lf_flame.calibration import CameraLaw
        from lf_flame.commands.lens_facts import check_gaps
        from lf_flame.formats.view_files.sources import is_view_folder
        from lf_flame.optics.camera import PlenopticCamera

        if not (self.focused is None or lens is None or isinstance(lens, CameraLaw)):
            raise InputError(
                "A camera file is one of unfocused lenslets, whose slopes mean other depths than "
                "those of --focused; use a calibration by `lf-flame calibrate`."
            )

        simulated = (source.parent / "simulation.json").is_file()  # by this very camera
        if isinstance(lens, PlenopticCamera) and (
            self.is_raw or (self.views is None and not simulated)
        ):
            check_gaps(lens, self.is_raw)
        stated = self.views is not None or self.mosaic is not None
        if lens is None or stated or is_view_folder(source):
            return self
        return replace(self, views=lens.views)

    def given(self) -> dict[str, Any]:
        """Give the options that were given, paths as text."""
        options = {name: getattr(self, name) for name in self.__dataclass_fields__}
        return {
            name: str(x) if isinstance(x, Path) else x
            for name, x in options.items()
            if x is not None
        }

    @property
    def is_raw(self) -> bool:
        """Whether the source is said to be a raw image."""
        return any(x is not None for x in (self.white, self.pitch, self.focused))

    def plan(self, source: Path) -> "tuple[DecodePlan | FocusedPlan, np.ndarray]":
        """Read a raw image, plan its decoding, and print what was found."""
        from lf_flame.formats.coding import note_on_depth
        from lf_flame.formats.focused.reading import plan_focused
        from lf_flame.formats.lytro.decoding import is_lytro
        from lf_flame.formats.raw.reading import plan_raw

        refuse_options(
            f"the raw image {source}", order=self.order, grid=self.grid, axes=self.axes,
            mosaic=self.mosaic, array=self.array,
        )  # fmt: skip
        plan: DecodePlan | FocusedPlan
        with progress.stage(f"Reading {printable(source)}"):
            if self.focused is None:
                refuse_options(f"{source} without --focused", virtual_depth=self.virtual_depth)
                plan, image = plan_raw(
                    source, self.white, self.pitch, self.layout, self.views,
                    dark=self.dark, bayer=self.bayer,
                )  # fmt: skip
                said = self._describe(plan.grid)
            else:
                refuse_options("--focused", pitch=self.pitch, layout=self.layout)
                plan, image = plan_focused(
                    source, self.focused, virtual_depth=self.virtual_depth, views=self.views,
                    white=self.white, dark=self.dark, bayer=self.bayer,
                )  # fmt: skip
                said = plan.lenslets.describe()
        tell(f"{printable(source)}: {said}")
        note = "" if is_lytro(source) else note_on_depth(image)
        if note:
            tell(note)
        return plan, image

    def scan(self, source: Path) -> "ViewFolder":
        """Find the views of a folder, an archive or a list, and print what was found."""
        from lf_flame import formats

        refuse_options(
            f"the folder {source}", views=self.views, layout=self.layout, axes=self.axes,
            bayer=self.bayer, mosaic=self.mosaic, array=self.array,
            virtual_depth=self.virtual_depth,
        )  # fmt: skip
        folder = formats.scan_view_folder(source, self.order, grid=self.grid)
        tell(folder.describe())
        return folder

    def read_stored(self, source: Path) -> "LightField":
        """Read a light field from any other file."""
        return self._read_ordered(source)[0]

    def _read_ordered(self, source: Path) -> "tuple[LightField, FoundOrder | None]":
        """Read a light field from any other file, and the order of its views if it was found."""
        from lf_flame.formats.reading import Stated, read_ordered

        refuse_options(f"{source} without --white or --pitch", layout=self.layout, bayer=self.bayer)
        refuse_options(f"{source} without --focused", virtual_depth=self.virtual_depth)
        if self.mosaic is not None:
            refuse_options("a mosaic of views", views=self.views)
        stated = Stated(*(getattr(self, name) for name in Stated._fields))
        return read_ordered(source, self.dark, stated)

    def read(self, source: Path) -> "LightField":
        """Read a light field of any kind, and print what was found."""
        from lf_flame.formats.coding import notes_on_values
        from lf_flame.formats.reading import Stated, note_on_order, subtract_dark
        from lf_flame.formats.view_files.sources import is_view_folder

        doubt = ""
        if self.is_raw:
            plan, image = self.plan(source)
            light_field = plan.decode(image)
        elif is_view_folder(source):
            folder = self.scan(source)
            stated = Stated(order=folder.found.order, grid=folder.counted)
            light_field = subtract_dark(folder.read(), self.dark, stated)
        else:
            light_field, found = self._read_ordered(source)
            for line in () if found is None else found.describe():
                tell(line)
            if found is None and self.order is None:
                doubt = note_on_order(light_field, source)
        v, u, t, s = light_field.views.shape[:4]
        tell(f"{v} x {u} views of {t} x {s} pixels")
        kept = (light_field.uncounted, light_field.unknown, doubt)
        for note in (*kept, *notes_on_values(light_field, source)):
            if note:
                tell(note)
        return light_field

    def _describe(self, grid: "LensletGrid") -> str:
        """Describe the lenslets of a raw image, and what was not searched for."""
        said = grid.describe()
        if grid.layout == "hexagonal":
            said += (
                f"; a pixel of the views is as wide as the rows are apart: in a camera file, "
                f"multiply the lenslets' pitch and focal length by "
                f"{grid.row_pitch / grid.pitch:.3f}; a calibration holds as it is"
            )
        if self.white is not None or self.pitch is None:
            return said
        return (
            f"{said}; the pitch is as given. The rotation and the position of the array "
            f"were not searched for: that needs a white image (--white)"
        )

    @property
    def files(self) -> tuple[Path, ...]:
        """Files that are read beside the source."""
        return tuple(path for path in (self.white, self.dark, self.focused) if path is not None)
