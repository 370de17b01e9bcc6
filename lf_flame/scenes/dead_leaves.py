"""Dead leaves: random textured leaves at all depths that occlude one another.

Such images have edges, textures and occlusions of all sizes, like photographs (A. B. Lee, D.
Mumford, J. Huang, "Occlusion models for natural images", International Journal of Computer Vision
41, 2001). A light field of them is cheap: a leaf with slope d moves by d pixels from view to view.
No lens is simulated; each view is that of a pinhole camera. One thread computes each pixel in a
fixed order: the bits do not depend on the number of threads.
"""

import math
from collections import namedtuple
from dataclasses import dataclass

import numpy as np
from numba import njit

from lf_flame._common.config import strict
from lf_flame._common.threads import parallel
from lf_flame.errors import InputError
from lf_flame.lightfield import LightField

Leaves = namedtuple(
    "Leaves",
    "y x slope half_height half_width cosine sine squareness brightness contrast "
    "wave_y wave_x phase",
)
"""Numbers of leaves, nearest first, an array each; lengths are in pixels.

(cosine, sine) is the angle of a leaf's axes; a squareness of 2 makes an ellipse, a larger one a
superellipse closer to a rectangle.
"""


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
        is r^-3, with which an image looks the same at all scales.
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
                f"Leaves must be 1 or more, lengths increase from at least 0.5 pixels, contrast be "
                f"0 or above, got {self.leaves}, {self.smallest}, {self.largest}, {self.contrast}."
            )
        if self.slopes[0] > self.slopes[1] or not 2 <= self.wavelength[0] <= self.wavelength[1]:
            raise InputError(
                f"slopes and wavelength must be two increasing numbers, wavelength from 2 pixels, "
                f"got {self.slopes} and {self.wavelength}."
            )

    def draw(
        self, views: tuple[int, int], image: tuple[int, int], rng: np.random.Generator
    ) -> LightField:
        """Draw a grey light field of (v, u) views and (t, s) pixels, with values from 0 to 1."""
        out = np.empty((*views, *image), np.float32)
        render_leaves(self._draw_leaves(image, rng), rng.uniform(), out)
        return LightField(out)

    def _draw_leaves(self, image: tuple[int, int], rng: np.random.Generator) -> Leaves:
        n = self.leaves
        angle = rng.uniform(0, 2 * np.pi, n)
        shortest, longest = np.log(self.wavelength)
        period = np.exp(rng.uniform(shortest, longest, n))
        direction = rng.uniform(0, 2 * np.pi, n)
        return Leaves(
            y=rng.uniform(0, image[0], n),
            x=rng.uniform(0, image[1], n),
            slope=np.sort(rng.uniform(*self.slopes, n)),
            half_height=self._draw_lengths(rng),
            half_width=self._draw_lengths(rng),
            cosine=np.cos(angle),
            sine=np.sin(angle),
            squareness=rng.choice([2.0, 8.0], n),
            brightness=rng.uniform(0, 1, n),
            contrast=rng.uniform(0, self.contrast, n),
            wave_y=2 * np.pi / period * np.cos(direction),
            wave_x=2 * np.pi / period * np.sin(direction),
            phase=rng.uniform(0, 2 * np.pi, n),
        )

    def _draw_lengths(self, rng: np.random.Generator) -> np.ndarray:
        """Draw lengths between the smallest and the largest, with density r^-3."""
        near, far = self.smallest**-2, self.largest**-2
        return (near - (near - far) * rng.uniform(size=self.leaves)) ** -0.5


@njit
def shade(leaves, n, y, x):
    """Coverage and radiance of a leaf at a position relative to its centre."""
    down = leaves.cosine[n] * y - leaves.sine[n] * x
    right = leaves.sine[n] * y + leaves.cosine[n] * x
    p = leaves.squareness[n]
    tall, wide = abs(down) / leaves.half_height[n], abs(right) / leaves.half_width[n]
    rho = (tall**p + wide**p) ** (1.0 / p)
    # Distance to the edge along the ray from the centre, in pixels; the edge is a pixel wide.
    inside = 0.5 + math.hypot(down, right) * (1.0 - rho) / rho if rho > 0.0 else 1.0
    cover = min(max(inside, 0.0), 1.0)
    if cover == 0.0:
        return 0.0, 0.0
    wave = math.sin(leaves.wave_y[n] * down + leaves.wave_x[n] * right + leaves.phase[n])
    return cover, min(max(leaves.brightness[n] + leaves.contrast[n] * wave, 0.0), 1.0)


@parallel(lambda out: out.shape[0] * out.shape[1] * out.shape[2])
def render_leaves(m, leaves, background, out):
    """Render leaves, sorted nearest first, in every view: out[v, u, t, s]."""
    rows, columns, height, width = out.shape
    k, t = m // height, m % height
    v, u = k // columns - (rows - 1) / 2.0, k % columns - (columns - 1) / 2.0
    for s in range(width):
        light, through = 0.0, 1.0
        for n in range(len(leaves.slope)):
            y = t - leaves.y[n] - leaves.slope[n] * v
            x = s - leaves.x[n] - leaves.slope[n] * u
            reach = leaves.half_height[n] + leaves.half_width[n] + 1.0
            if abs(y) > reach or abs(x) > reach:
                continue
            cover, radiance = shade(leaves, n, y, x)
            light += through * cover * radiance
            through *= 1.0 - cover
            if through < 1e-3:  # light from leaves farther back is neglected
                break
        out[k // columns, k % columns, t, s] = light + through * background
