"""What all refocusing systems have in common: a light field in, refocused images out.

A system says which views it looks at, which slopes it can do and how large an image must be, and
refuses in one sentence what it cannot do. Behind it may stand a network or a formula.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np

from lf_flame.errors import InputError
from lf_flame.refocus._arguments import as_slopes, as_views

Places = Sequence[tuple[int, int]]


class RefocusingSystem(ABC):
    """A way from a light field to refocused images.

    Attributes
    ----------
    name : str
        What tables call it.
    smallest : int
        Side of the smallest image that it takes: its receptive field, for a network.
    parameters : int
        Trained numbers; 0 for a formula.
    """

    name: str
    smallest: int = 1
    parameters: int = 0

    @abstractmethod
    def chosen(self, rows: int, columns: int) -> Places:
        """Row and column of each view that the system looks at, of rows x columns views.

        Raises
        ------
        InputError
            If views that it needs are missing.
        """

    def slope_range(self, rows: int, columns: int) -> tuple[float, float]:
        """Lowest and highest slope that it can do, in pixels of its images per view step."""
        return -np.inf, np.inf

    def refocus(self, views, slopes, block: tuple[int, int] = (1, 1)) -> np.ndarray:
        """Refocus a light field.

        Parameters
        ----------
        views : LightField or array_like, shape (v, u, t, s) or (v, u, t, s, channels)
            Grey or 3 channels, from 0 to 1. A system made for colour sees grey as three equal
            channels, and one made for grey works on one channel after the other.
        slopes : float or sequence of float
            In lenslets per view step, positive = behind the focal plane.
        block : (int, int), optional
            Lenslets that are averaged into one pixel of the images, along (t, s).

        Returns
        -------
        ndarray of float32, shape (n, t / block, s / block) or with a last axis of channels
            From 0 to 1.

        Raises
        ------
        InputError
            If views are missing, a slope is beyond what the system was trained for, or the image
            is smaller than it can take.
        """
        views, slopes = as_views(views), as_slopes(slopes)
        self._check(views.shape, slopes, block)
        return np.clip(self._refocus(views, slopes, block), 0, 1)

    @abstractmethod
    def _refocus(self, views: np.ndarray, slopes: np.ndarray, block) -> np.ndarray:
        """Refocus what has been checked."""

    def _check(self, shape: tuple[int, ...], slopes: np.ndarray, block: tuple[int, int]) -> None:
        self.chosen(*shape[:2])
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
