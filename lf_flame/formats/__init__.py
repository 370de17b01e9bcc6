"""Reading light fields of other programs and cameras, and writing light fields for them."""

from lf_flame.formats.arrays import read_array
from lf_flame.formats.lenslet_grid import LensletGrid, grid_from_pitch
from lf_flame.formats.lenslet_image import read_lenslet_image, write_lenslet_image
from lf_flame.formats.movie import write_movie
from lf_flame.formats.raw_lenslets import decode_raw
from lf_flame.formats.reading import read_light_field, read_raw
from lf_flame.formats.stacks import read_focal_stack, read_view_stack, write_focal_stack
from lf_flame.formats.view_folder import (
    ViewFolder,
    read_view_folder,
    scan_view_folder,
    write_view_folder,
)
from lf_flame.formats.white_image import estimate_grid
from lf_flame.formats.writing import write_light_field

__all__ = [
    "LensletGrid",
    "ViewFolder",
    "decode_raw",
    "estimate_grid",
    "grid_from_pitch",
    "read_array",
    "read_focal_stack",
    "read_lenslet_image",
    "read_light_field",
    "read_raw",
    "read_view_folder",
    "read_view_stack",
    "scan_view_folder",
    "write_focal_stack",
    "write_lenslet_image",
    "write_light_field",
    "write_movie",
    "write_view_folder",
]
