"""Base of all refocusing systems: a light field in, refocused images out.

A system states which views it uses, which slopes it accepts and how large an image must be, and
refuses other input in one sentence. It may be a network or a formula.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from lf_flame.errors import InputError
from lf_flame.refocus._arguments import (
    Views,
    as_block,
    as_slopes,
    as_views,
    refuse_uncounted,
)

ViewIndices = Sequence[tuple[int, int]]
"""Row and column of each selected view."""

PIXELS_AT_ONCE = 1 << 18
"""Maximum number of pixels in a batch: sixteen images of 90 x 180, or one photograph."""


class RefocusingSystem(ABC):
    """A method that turns a light field into refocused images.

    Attributes
    ----------
    name : str
        Name in tables.
    smallest : int
        Side of the smallest image that it accepts: its receptive field, for a network, because in
        a smaller image every pixel would depend on the border.
    parameters : int
        Number of the network's parameters; 0 for a formula.
    """

    name: str
    smallest: int = 1
    parameters: int = 0

    @abstractmethod
    def view_indices(self, rows: int, columns: int) -> ViewIndices:
        """Row and column of each view that the system uses, of rows x columns views.

        An InputError says that required views are missing.
        """

    def slope_range(self, rows: int, columns: int) -> tuple[float, float]:
        """Lowest and highest slope that it accepts, in pixels of its images per view step."""
        return -np.inf, np.inf

    def refocus(
        self, views: Views, slopes: ArrayLike, block: tuple[int, int] = (1, 1)
    ) -> np.ndarray:
        """Refocus a light field.

        Parameters
        ----------
        views : LightField or array_like, shape (v, u, t, s) or (v, u, t, s, channels)
            Grey or 3 channels, from 0 to 1. A system made for colour receives grey as three equal
            channels; one made for grey processes one channel after the other.
        slopes : float or sequence of float
            Slopes in lenslets per view step, positive = behind the focal plane.
        block : (int, int), optional
            Number of lenslets averaged into one pixel of the images, along (t, s).

        Returns
        -------
        ndarray of float32, shape (n, t / block, s / block) or with a last axis of channels
            Refocused images from 0 to 1.

        Raises
        ------
        InputError
            If views are missing or integers, a slope is outside the range of the system's training,
            the block does not divide the image, or the image is too small.
        """
        slopes = as_slopes(slopes)
        self.check(views, slopes, block)
        return np.clip(self._refocus(as_views(views), slopes, block), 0, 1)

    def check(self, views: Views, slopes: ArrayLike = (), block: tuple[int, int] = (1, 1)) -> None:
        """Refuse input that `refocus` would refuse; slopes may be empty."""
        light_field, views = views, as_views(views)
        if views.dtype.kind != "f":
            raise InputError(
                f"{self.name} takes values from 0 to 1, got whole numbers ({views.dtype}): divide "
                f"them by the largest."
            )
        self._check(views.shape, np.asarray(slopes, float), block)
        refuse_uncounted(light_field, self.view_indices(*views.shape[:2]), self.name)

    @abstractmethod
    def _refocus(self, views: np.ndarray, slopes: np.ndarray, block) -> np.ndarray:
        """Refocus checked input."""

    def _check(self, shape: tuple[int, ...], slopes: np.ndarray, block: tuple[int, int]) -> None:
        as_block(block, shape[2:4])
        self.view_indices(*shape[:2])
        if shape[4:] not in ((), (3,)):
            raise InputError(
                f"{self.name} takes grey light fields and those of 3 channels, got {shape[4]}."
            )
        low, high = self.slope_range(*shape[:2])
        for slope in slopes / block[0]:
            if not low <= slope <= high:
                raise InputError(
                    f"{self.name} does slopes from {low:.3g} to {high:.3g} pixels per view step of "
                    f"{shape[0]} x {shape[1]} views, got {slope:.3g}."
                )
        height, width = (n // m for n, m in zip(shape[2:4], block, strict=True))
        if min(height, width) < self.smallest:
            raise InputError(
                f"{self.name} needs images of {self.smallest} pixels or more along each side, got "
                f"{height} x {width}."
            )


class NetworkSystem(RefocusingSystem):
    """A refocusing system with a network.

    Parameters
    ----------
    model : keras.Model
        Network from images (n, h, w, channels) of any size to images (n, h, w, channels).
    name : str, optional
        Name in tables. Default: that of the class.

    Attributes
    ----------
    colours : int
        Number of an image's channels that the network processes together, 1 or 3.
    multiple : int
        Number of which the sides of its images must be multiples.
    """

    colours: int = 1
    multiple: int = 1

    def __init__(self, model, name: str | None = None):
        self.model, self.name = model, name or self.name
        self.parameters = model.count_params()

    @abstractmethod
    def show(self, views: np.ndarray, slopes: np.ndarray, block) -> np.ndarray:
        """Prepare the network's input, float32 (m, h, w, channels).

        Views have shape (v, u, t, s), or (v, u, t, s, 3) for a network of 3 colours; slopes and
        block are those of `refocus`.
        """

    def truth(self, stack: np.ndarray) -> np.ndarray:
        """Arrange refocused images (n, h, w) as the network's output, (m, h, w, c)."""
        return stack[..., None]

    def slopes_to_learn(self, slopes: np.ndarray, block: tuple[int, int]) -> np.ndarray:
        """Choose the slopes to learn from a light field, given proposed ones."""
        return slopes

    def _refocus(self, views: np.ndarray, slopes: np.ndarray, block) -> np.ndarray:
        if views.ndim == 4 or self.colours > 1:
            return self._draw(views, slopes, block)
        channels = [self._draw(views[..., c], slopes, block) for c in range(views.shape[4])]
        return np.stack(channels, axis=-1)

    def _draw(self, views: np.ndarray, slopes: np.ndarray, block) -> np.ndarray:
        """Refocus a light field that the network can process directly."""
        return self.predict(self.show(views, slopes, block))[..., 0]

    def predict(self, shown: np.ndarray) -> np.ndarray:
        """Run the network on images (m, h, w, channels), in batches that fit into memory.

        If the sides are no multiples of `multiple`, edges are repeated, and cut off again.
        """
        height, width = shown.shape[1:3]
        beyond = -height % self.multiple, -width % self.multiple
        if any(beyond):
            sides = ((0, 0), (0, beyond[0]), (0, beyond[1]), (0, 0))
            shown = np.pad(shown, sides, mode="edge")
        some = max(PIXELS_AT_ONCE // (shown.shape[1] * shown.shape[2]), 1)
        starts = range(0, len(shown), some)
        drawn = [self.model.predict_on_batch(shown[k : k + some]) for k in starts]
        return np.concatenate(drawn)[:, :height, :width]
