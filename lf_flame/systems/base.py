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
from lf_flame.refocus import align_views
from lf_flame.refocus._arguments import Views, as_block, as_slopes, as_views, refuse_excluded

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
    by_weights : bool
        Whether it leaves out views of weight 0; otherwise it refuses them.
    """

    name: str
    smallest: int = 1
    parameters: int = 0
    by_weights: bool = False

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
        return np.clip(self._refocus(views, slopes, block), 0, 1)

    def check(self, views: Views, slopes: ArrayLike = (), block: tuple[int, int] = (1, 1)) -> None:
        """Refuse input that `refocus` would refuse; slopes may be empty."""
        light_field, views = views, as_views(views)
        if views.dtype.kind != "f":
            raise InputError(
                f"{self.name} takes values from 0 to 1, got whole numbers ({views.dtype}): divide "
                f"them by the largest."
            )
        self._check(views.shape, np.asarray(slopes, float), block)
        if not self.by_weights:
            refuse_excluded(light_field, self.view_indices(*views.shape[:2]), self.name)

    @abstractmethod
    def _refocus(self, views: Views, slopes: np.ndarray, block) -> np.ndarray:
        """Refocus checked input; a light field has its weights and unknown pixels."""

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
                    f"{self.name} takes slopes from {low:.3g} to {high:.3g} pixels per view step "
                    f"of {shape[0]} x {shape[1]} views, got {slope:.3g}."
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

    Attributes
    ----------
    colours : int
        Number of an image's channels that the network processes together, 1 or 3.
    multiple : int
        Number of which the sides of its images must be multiples.
    """

    colours: int = 1
    multiple: int = 1

    def __init__(self, model):
        self.model, self.parameters = model, model.count_params()

    def prepare_input(self, views: np.ndarray, slopes: np.ndarray, block) -> np.ndarray:
        """Prepare the network's input, float32 (m, h, w, channels): here the aligned views.

        Views have shape (v, u, t, s), or (v, u, t, s, 3) for a network of 3 colours; slopes and
        block are those of `refocus`.
        """
        indices = self.view_indices(*views.shape[:2])
        return np.moveaxis(align_views(views, slopes, indices, block=block), 1, -1)

    def prepare_target(self, stack: np.ndarray) -> np.ndarray:
        """Arrange refocused images (n, h, w) like the network's output, (m, h, w, channels)."""
        return stack[..., None]

    def training_slopes(self, slopes: np.ndarray, block: tuple[int, int]) -> np.ndarray:
        """Choose the slopes to train at with a sample, given its own."""
        return slopes

    def _refocus(self, views: Views, slopes: np.ndarray, block) -> np.ndarray:
        views = as_views(views)
        if views.ndim == 4 or self.colours > 1:
            return self._apply(views, slopes, block)
        channels = [self._apply(views[..., c], slopes, block) for c in range(views.shape[4])]
        return np.stack(channels, axis=-1)

    def _apply(self, views: np.ndarray, slopes: np.ndarray, block) -> np.ndarray:
        """Refocus a light field with as many channels as the network processes together."""
        return self.predict(self.prepare_input(views, slopes, block))[..., 0]

    def predict(self, inputs: np.ndarray) -> np.ndarray:
        """Run the network on images (m, h, w, channels), in batches that fit into memory.

        If the sides are not multiples of `multiple`, edges are repeated, and cut off again.
        """
        height, width = inputs.shape[1:3]
        beyond = -height % self.multiple, -width % self.multiple
        if any(beyond):
            sides = ((0, 0), (0, beyond[0]), (0, beyond[1]), (0, 0))
            inputs = np.pad(inputs, sides, mode="edge")
        size = max(PIXELS_AT_ONCE // (inputs.shape[1] * inputs.shape[2]), 1)
        batches = [inputs[k : k + size] for k in range(0, len(inputs), size)]
        outputs = np.concatenate([self.model.predict_on_batch(batch) for batch in batches])
        return outputs[:, :height, :width]
