"""Dead leaves: random textured leaves, one hiding the other, at all depths.

Images so made have the edges, the textures and the occlusions of photographs, in all sizes
(A. B. Lee, D. Mumford, J. Huang, "Occlusion models for natural images", International Journal of
Computer Vision 41, 2001), and cost nothing to make as a light field: a leaf at a slope moves by as
much from view to view. Nothing here knows of lenses; a view is a pinhole's.
"""

from dataclasses import dataclass

import numpy as np

from lf_flame._common.config import strict
from lf_flame.errors import InputError
from lf_flame.lightfield import LightField
from lf_flame.scenes import _kernels


@strict
@dataclass(frozen=True)
class DeadLeaves:
    """What the leaves look like.

    Parameters
    ----------
    leaves : int
        In a light field.
    smallest, largest : float
        Half the length of a leaf along each of its axes, in pixels; lengths r are as frequent as
        r^-3, by which an image looks alike in all sizes.
    slopes : (float, float)
        Range, in pixels per view step, positive = behind the focal plane; uniform.
    contrast : float
        Largest amplitude of a leaf's wave pattern.
    wavelength : (float, float)
        Of the pattern, in pixels, uniform in its logarithm.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.scenes import DeadLeaves
    >>> DeadLeaves().draw((5, 5), (40, 60), np.random.default_rng(1))
    LightField(5 x 5 views of 40 x 60 pixels, grey)
    """

    leaves: int = 100
    smallest: float = 4.0
    largest: float = 60.0
    slopes: tuple[float, float] = (-1.5, 1.5)
    contrast: float = 0.3
    wavelength: tuple[float, float] = (4.0, 40.0)

    def __post_init__(self):
        if self.leaves < 1 or not 0.5 <= self.smallest <= self.largest or self.contrast < 0:
            raise InputError(
                f"Leaves must be 1 or more, lengths rise from 0.5 pixels or more, and contrast be "
                f"0 or above, got {self.leaves}, {self.smallest}, {self.largest}, {self.contrast}."
            )
        if self.slopes[0] > self.slopes[1] or not 2 <= self.wavelength[0] <= self.wavelength[1]:
            raise InputError(
                f"slopes and wavelength must be two rising numbers, wavelength from 2 pixels on, "
                f"got {self.slopes} and {self.wavelength}."
            )

    def draw(
        self, views: tuple[int, int], image: tuple[int, int], rng: np.random.Generator
    ) -> LightField:
        """Draw a light field.

        Parameters
        ----------
        views, image : (int, int)
            Views along (v, u), pixels along (t, s).
        rng : numpy.random.Generator

        Returns
        -------
        LightField
            Grey, from 0 to 1.
        """
        leaves = self._draw_leaves(image, rng)
        out = np.empty((*views, *image), np.float32)
        _kernels.render_leaves(leaves, rng.uniform(), out)
        return LightField(out)

    def _draw_leaves(self, image: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
        """Draw the numbers of all leaves, nearest first, [leaf, number]; see the kernel."""
        n = self.leaves
        angle = rng.uniform(0, 2 * np.pi, n)
        shortest, longest = np.log(self.wavelength)
        period = np.exp(rng.uniform(shortest, longest, n))
        direction = rng.uniform(0, 2 * np.pi, n)
        columns = {
            "y": rng.uniform(0, image[0], n),
            "x": rng.uniform(0, image[1], n),
            "slope": np.sort(rng.uniform(*self.slopes, n)),
            "half_height": self._draw_lengths(rng),
            "half_width": self._draw_lengths(rng),
            "cosine": np.cos(angle),
            "sine": np.sin(angle),
            "squareness": rng.choice([2.0, 8.0], n),
            "brightness": rng.uniform(0, 1, n),
            "contrast": rng.uniform(0, self.contrast, n),
            "wave_y": 2 * np.pi / period * np.cos(direction),
            "wave_x": 2 * np.pi / period * np.sin(direction),
            "phase": rng.uniform(0, 2 * np.pi, n),
        }
        return np.column_stack([columns[name] for name in _kernels.COLUMNS])

    def _draw_lengths(self, rng: np.random.Generator) -> np.ndarray:
        """Lengths between the smallest and the largest, of density r^-3."""
        near, far = self.smallest**-2, self.largest**-2
        return (near - (near - far) * rng.uniform(size=self.leaves)) ** -0.5
