"""Emission that was found, on planes or in a half section, and the frames of its maps."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import special

from lf_flame.tomography.frustum_grid import FrustumGrid

if TYPE_CHECKING:
    from lf_flame.tomography.data_checks import Check
    from lf_flame.tomography.fit import Explanation

LEVEL = 0.95
"""Confidence level of an error bar."""


def scatter(draws: np.ndarray, found: np.ndarray) -> np.ndarray:
    """Root-mean-square distance of draws from the result along axis 0; it includes their bias."""
    return np.sqrt(np.mean(np.square(draws - found), axis=0))


def bar_times(count: int) -> float:
    """Half-width of a bar of `LEVEL` in standard errors estimated from `count` draws (Student)."""
    return float(special.stdtrit(count, (1 + LEVEL) / 2))


@dataclass(frozen=True, eq=False)
class Emission:
    """Emission on depth planes, or of an axisymmetric flame, with its error bars and warnings.

    Attributes
    ----------
    grid : FrustumGrid or AxisymmetricGrid
        Depth planes and cells, or nodes of the half section.
    emission : ndarray of float32, shape (planes, rows, columns) or (heights, radii)
        On planes: radiance that each depth plane adds along the line of sight, in the unit of the
        light field; rows and columns are the pixels of the central view. In a half section: the
        same per mm; if that unit is a radiance, 4 pi times the emission is power per volume.
        Absorption is corrected if an optical thickness was given.
    correction : ndarray of float32, shape of `emission`
        Part of the emission that was added to the fit to correct the effect of the penalty and of
        emission that is constant over cells, or linear between nodes.
    draws : ndarray of float32, shape (draws, ...)
        Bootstrap draws of the emission: refits with redrawn noise and redrawn prior of the penalty,
        each with a random part of the correction. Their scatter does not include all of the
        uncertainty in depth.
    noise : float
        Standard deviation of a pixel's noise, stated or measured, in the unit of the light field.
    strength : float
        Strength of the regularisation that was used.
    chi_squared : ndarray of float64, shape (v, u)
        Mean squared residual of each view, in units of the noise's variance; NaN of views that are
        not fitted. The residual is that of the emission with its correction.
    checks : tuple of Check
        Measures of disagreement between data and model, with their limits.
    background, background_sigma : float
        Uniform background that was subtracted, and its standard deviation; 0 without.
    fit : Explanation
        Fit of the light that leaves the cells, from which the next frame of a video starts.
    """

    grid: Any
    emission: np.ndarray
    correction: np.ndarray
    draws: np.ndarray
    noise: float
    strength: float
    chi_squared: np.ndarray
    checks: tuple[Check, ...]
    fit: Explanation = field(repr=False)
    background: float = 0.0
    background_sigma: float = 0.0

    @property
    def warnings(self) -> tuple[str, ...]:
        """Sentence of each check whose number is beyond its limit."""
        return tuple(check.sentence for check in self.checks if check.failed)

    @property
    def on_planes(self) -> bool:
        """Whether it is emission on depth planes."""
        return isinstance(self.grid, FrustumGrid)

    @cached_property
    def sigma(self) -> np.ndarray | None:
        """Standard error due to noise, penalty and correction, float32; None without draws.

        It does not include all of the uncertainty in depth: for a flame that is thick in depth, the
        truth is outside many error bars. In a half section it does not include detail that is finer
        than two steps between nodes, and is up to 1.3 times the error of a flame that is smoother
        than the penalty expects.
        """
        if not len(self.draws):
            return None
        if self.on_planes:
            return scatter(self.draws, self.emission)
        return self.draws.std(axis=0, ddof=1)

    @property
    def bar(self) -> np.ndarray | None:
        """Half-width of the 95 % error bar, None without draws; Student's t, as draws are few."""
        if self.sigma is None:
            return None
        return (bar_times(len(self.draws) - (not self.on_planes)) * self.sigma).astype(np.float32)

    @property
    def light(self) -> tuple[np.ndarray, np.ndarray | None]:
        """Light of depth planes, not of a half section: radiance times mm^2; its error or None."""
        areas = np.array([self.grid.cell_mm(depth) ** 2 for depth in self.grid.depths_mm])
        light, draws = (
            one.sum(axis=(-2, -1), dtype=np.float64) * areas for one in (self.emission, self.draws)
        )
        return light, scatter(draws, light) if len(draws) else None


@dataclass(frozen=True)
class Place:
    """Frame of a map: a depth plane, or the section through a flame's axis.

    title : name of the frame
    extent_mm : left, right, lower and upper edge of the map
    depth_mm : depth of the plane, or of the axis
    across : label of the horizontal axis
    mirrored : whether maps are a half section, which begins on the axis; the extent is of the whole
    """

    title: str
    extent_mm: tuple[float, float, float, float]
    depth_mm: float
    across: str = "across (mm)"
    mirrored: bool = False

    def whole(self, planes: np.ndarray) -> np.ndarray:
        """Complete maps: a half section with its mirror image."""
        return np.concatenate([planes[..., :0:-1], planes], -1) if self.mirrored else planes
