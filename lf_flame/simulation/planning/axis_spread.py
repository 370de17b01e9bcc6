"""What happens to a layer's light along one axis when it spreads: how far it goes, and how much."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

PATCHES = 2
"""Parts of a pixel's width whose rays are told apart."""


@dataclass(frozen=True)
class Box:
    """Widths of the two boxes whose convolution a bundle is, along one axis, in mm.

    Attributes
    ----------
    lenslet, pixel : (float, float)
        Narrowest and widest, 0 or above.
    """

    lenslet: tuple[float, float]
    pixel: tuple[float, float]

    @property
    def half_mm(self) -> float:
        """Half of the bundle's full extent."""
        return (self.lenslet[1] + self.pixel[1]) / 2


@dataclass(frozen=True)
class Pairs:
    """Pairs of rays that replace each ray: one this far to either side.

    Attributes
    ----------
    weights : ndarray, shape (pairs,)
        Shares of the light; they need not sum to 1.
    moves_mm : ndarray, shape (pairs, patches)
        How far the rays of equal parts of the pixel's width move at most, 0 or above.
    widening_mm : ndarray, shape (pairs,)
        How much the pixel's box widens while the rays move.
    """

    weights: np.ndarray
    moves_mm: np.ndarray
    widening_mm: np.ndarray

    @classmethod
    def alike(cls, weights: np.ndarray, moves_mm: np.ndarray) -> "Pairs":
        """Pairs that move all rays of a bundle alike."""
        return cls(weights, moves_mm[:, None], np.zeros_like(moves_mm))

    @property
    def farthest_mm(self) -> np.ndarray:
        """Farthest move of each pair, shape (pairs,)."""
        return self.moves_mm.max(axis=1)


@dataclass(frozen=True)
class Rounding:
    """What the steps between cells add to the change of a texture that rises evenly between them.

    Attributes
    ----------
    any_steps : float
        Share of the largest step near a bundle; or
    even_steps, bends : float
        of the largest step and of the largest second difference, added up.
    """

    any_steps: float
    even_steps: float
    bends: float


@dataclass(frozen=True)
class Shifts:
    """Light that comes from one side: its shares, and from how far.

    Attributes
    ----------
    weights, moves_mm : ndarray, shape (shifts,)
    """

    weights: np.ndarray
    moves_mm: np.ndarray

    @property
    def arise(self) -> bool:
        """Whether any light is shifted at all."""
        return bool(self.weights @ self.moves_mm > 0)


@dataclass(frozen=True)
class Border:
    """What happens to pixels so near the image's border that pairs lose one side.

    Attributes
    ----------
    regions_mm : tuple of (float, float)
        Where the centres of their bundles lie.
    farther, nearer : Shifts
        The sides of each pair; and what is lost beside them.
    """

    regions_mm: tuple[tuple[float, float], ...]
    farther: Shifts
    nearer: Shifts
    lost: Shifts


@dataclass(frozen=True)
class AxisSpread:
    """What happens to a layer's light along one axis.

    Attributes
    ----------
    box : Box
    centres_mm : (float, float)
        First and last centre of the pixels' bundles.
    pairs : Pairs
    rounding : Rounding
    shifts : Shifts, optional
        How far the middle of each pair stands aside.
    border : Border, optional
    """

    box: Box
    centres_mm: tuple[float, float]
    pairs: Pairs
    rounding: Rounding
    shifts: Shifts | None = None
    border: Border | None = None

    @cached_property
    def reach_mm(self) -> float:
        """Farthest that light comes from, on the layer, from a bundle's centre."""
        aside = 0.0 if self.shifts is None else self.shifts.moves_mm.max(initial=0.0)
        farthest = self.pairs.moves_mm.max(initial=0.0) + aside
        if self.border is not None:
            for shifts in (self.border.farther, self.border.nearer, self.border.lost):
                farthest = max(farthest, shifts.moves_mm.max(initial=0.0))
        return self.box.half_mm + float(farthest)
