"""Dead leaves: random textured leaves at all depths that occlude one another.

Such images have edges, textures and occlusions of all sizes, like photographs (A. B. Lee, D.
Mumford, J. Huang, "Occlusion models for natural images", International Journal of Computer Vision
41, 2001). A light field of them is cheap: a leaf with slope d moves by d pixels from view to view.
No lens is simulated; each view is that of a pinhole camera.
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
    """Random light fields of dead leaves: textured leaves that occlude one another.

    Parameters
    ----------
    leaves : int
        Number of leaves in a light field.
    smallest, largest : float
        Range of half a leaf's length along each of its axes, in pixels; the density of lengths r
        is r^-3, with which an image looks alike at all scales.
    slopes : (float, float)
        Range of slopes, in pixels per view step, positive = behind the focal plane; uniform.
    contrast : float
        Largest amplitude of a leaf's wave pattern.
    wavelength : (float, float)
        Range of the pattern's wavelength, in pixels; uniform in its logarithm.

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
            Number of views along (v, u), and of pixels along (t, s).
        rng : numpy.random.Generator

        Returns
        -------
        LightField
            Grey light field with values from 0 to 1.
        """
        leaves = self._draw_leaves(image, rng)
        out = np.empty((*views, *image), np.float32)
        _kernels.render_leaves(leaves, rng.uniform(), out)
        return LightField(out)

    def _draw_leaves(self, image: tuple[int, int], rng: np.random.Generator) -> np.ndarray:
        """Draw the parameters of all leaves, nearest first, [leaf, parameter]; see the kernel."""
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
        """Draw lengths between the smallest and the largest, with density r^-3."""
        near, far = self.smallest**-2, self.largest**-2
        return (near - (near - far) * rng.uniform(size=self.leaves)) ** -0.5
