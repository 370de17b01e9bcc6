"""Operators of a grid of depth planes, which all fits on that grid share."""

from dataclasses import dataclass
from functools import cached_property

from lf_flame.tomography.cell_detail import SmoothStack
from lf_flame.tomography.frequency_gram import FrequencyGram
from lf_flame.tomography.frustum_grid import FrustumGrid
from lf_flame.tomography.projection_operator import ProjectionOperator


@dataclass(frozen=True, eq=False)
class Operators:
    """Operators of a grid, which do not depend on the light field; made when they are needed."""

    grid: FrustumGrid

    @cached_property
    def projection(self) -> ProjectionOperator:
        """Light field of cells."""
        return ProjectionOperator(self.grid)

    @cached_property
    def gram(self) -> FrequencyGram:
        """Its Gram matrix by frequency."""
        return FrequencyGram(self.grid)

    @cached_property
    def smooth(self) -> SmoothStack:
        """Filtered focal stack of smooth functions through cells."""
        return SmoothStack(self.projection)
