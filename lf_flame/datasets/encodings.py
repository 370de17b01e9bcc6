"""Encodings of a light field as the input image of a network.

The paper's input is the raw lenslet image, resized. Area averaging makes that a photograph without
angular information; picking single pixels, as resizing without averaging does, makes it a central
view (deviation 5). The other encodings keep parallax, in channels or side by side, and use the same
frozen backbone.
"""

from dataclasses import dataclass
from itertools import product
from typing import Literal

import numpy as np

from lf_flame._common.config import strict
from lf_flame.errors import InputError
from lf_flame.lightfield import LightField
from lf_flame.projection import Projector

CHANNELS = 3
"""Number of channels of the images for which the backbone was made."""

SMALLEST = 32
"""Smallest number of pixels along each side of an input that the backbone accepts."""


@strict
@dataclass(frozen=True)
class InputEncoding:
    """Encoding of a light field as the network's input.

    Parameters
    ----------
    kind : {"raw", "central", "views", "grid"}
        Kind of the encoding. "raw": the raw lenslet image resized by area averaging, in one
        channel. "central": the central view at the central lenslet of each pixel, in one channel.
        With odd numbers of views and of lenslets in a pixel this is the raw image resized without
        averaging, by nearest neighbours or bilinear interpolation, bit for bit. "views": three
        views of the central row, leftmost, central and rightmost, in three channels. "grid": views
        from all over the main lens side by side, in one channel.
    grid : int
        Number of views of a "grid" along each axis.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame import LightField
    >>> from lf_flame.datasets import InputEncoding
    >>> light_field = LightField(np.ones((5, 5, 24, 48)))
    >>> InputEncoding().encode(light_field, (12, 24)).shape
    (12, 24, 1)
    """

    kind: Literal["raw", "central", "views", "grid"] = "raw"
    grid: int = 3

    def __post_init__(self):
        if self.grid < 1:
            raise InputError(f"grid must be at least 1 view along each axis, got {self.grid}.")

    @property
    def views_per_side(self) -> int:
        """Smallest number of views along an axis that a camera must have."""
        return {"views": CHANNELS, "grid": self.grid}.get(self.kind, 1)

    def shape(self, output: tuple[int, int]) -> tuple[int, int, int]:
        """Height, width and channels of the input of a network with outputs of this size."""
        height, width = output
        if self.kind == "grid":
            return self.grid * height, self.grid * width, 1
        return height, width, CHANNELS if self.kind == "views" else 1

    def view_mesh(self, rows: int, columns: int) -> tuple[np.ndarray, np.ndarray]:
        """Open mesh of the views to use, of rows x columns: indexes ``views[v, u]``."""
        if self.kind == "raw":
            v, u = np.ix_(range(rows), range(columns))
        else:
            down = self.grid if self.kind == "grid" else 1
            v, u = np.ix_(spread(rows, down), spread(columns, self.views_per_side))
        return v, u

    def view_indices(self, rows: int, columns: int) -> list[tuple[int, int]]:
        """List row and column of each view to use, of rows x columns."""
        down, across = self.view_mesh(rows, columns)
        return list(product(down.ravel().tolist(), across.ravel().tolist()))

    def encode(self, light_field: LightField, output: tuple[int, int]) -> np.ndarray:
        """Encode a light field for a network with outputs of this size.

        Parameters
        ----------
        light_field : LightField
            Grey light field; its lenslets must be a multiple of the image.
        output : (int, int)
            Height and width of the network's outputs.

        Returns
        -------
        ndarray of float32, shape ``self.shape(output)``
            Network input from 0 to 1.
        """
        views = light_field.views
        if self.kind == "raw":
            # A pixel is a mean over whole micro-images, also over views that have weight 0.
            return area_average(views.mean(axis=(0, 1), dtype=np.float64), output)[..., None]
        return self._arrange(views[self.view_mesh(*views.shape[:2])], output)

    def project(self, projector: Projector, output: tuple[int, int]) -> np.ndarray:
        """Encode a scene as `encode` would encode its light field, without forming it.

        Parameters
        ----------
        projector : Projector
            Scene and camera.
        output : (int, int)
            Height and width of the network's outputs.

        Returns
        -------
        ndarray of float32, shape ``self.shape(output)``
            Network input from 0 to 1.
        """
        camera = projector.camera
        block = block_of(camera.lenslets, output)
        if self.kind == "raw":
            return np.clip(projector.refocus(0.0, block=block)[0], 0, 1)[..., None]
        down, across = self.view_mesh(camera.views, camera.views)
        indices = self.view_indices(camera.views, camera.views)
        views = projector.align_views(0.0, indices, (1, 1) if self.kind == "central" else block)[0]
        return self._arrange(views.reshape(down.size, across.size, *views.shape[1:]), output)

    def _arrange(self, views: np.ndarray, size: tuple[int, int]) -> np.ndarray:
        """Resize views [v, u, t, s], and arrange them in channels or side by side."""
        if self.kind == "central":
            down, across = block_of(views.shape[2:], size)
            views = views[..., (down - 1) // 2 :: down, (across - 1) // 2 :: across]
        tiles = area_average(views, size)
        if self.kind == "views":
            return np.moveaxis(tiles[0], 0, -1)
        return np.block([list(row) for row in tiles])[..., None]


def block_of(lenslets: tuple[int, int], size: tuple[int, int]) -> tuple[int, int]:
    """Count the lenslets in a pixel of an image of this size, along (t, s)."""
    down, across = (n // m for n, m in zip(lenslets, size, strict=True))
    return down, across


def spread(count: int, chosen: int) -> list[int]:
    """Spread `chosen` indices evenly over `count`, ends included; a single one is central."""
    if chosen == 1:
        return [(count - 1) // 2]
    return np.round(np.linspace(0, count - 1, chosen)).astype(int).tolist()


def area_average(images: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Average areas so that the last two axes have `size`, and clip to [0, 1] like a sensor."""
    from skimage.transform import downscale_local_mean  # takes a while to import

    factors = (1,) * (images.ndim - 2) + block_of(images.shape[-2:], size)
    averaged = downscale_local_mean(images, factors) if max(factors) > 1 else images
    return np.clip(averaged, 0, 1).astype(np.float32)
