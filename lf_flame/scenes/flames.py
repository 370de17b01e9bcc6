"""Burner flames as layer textures: an axisymmetric luminous body seen along the line of sight.

At height fraction ``h`` (0 = burner, 1 = tip) the body glows with
``R(r) = (1 + c (r/b)^2) exp(-(r/b)^2)``. The hollow parameter c(h) falls from the burner, where the
flame is a sheet, to the tip, which is filled; b(h) is the radius. The projection along the line of
sight has the closed form (Abel transform, term by term of the Gaussian moments)
``I(x) = sqrt(pi) b exp(-q^2) (1 + c (q^2 + 1/2))``, ``q = x / b``.
Wrinkles displace the axis and change the radius along the height, as a random sum of waves with
energy proportional to the wave number to the power -5/3.
"""

import numpy as np

from lf_flame.errors import InputError

WAVES = 4
"""Number of wrinkle waves over the height of a flame."""

HOLLOW_AT_BURNER = 3.0
"""Hollow parameter c at the burner; above 2 the projection is brightest beside the axis."""

HALF_WIDTH = 3.2
"""Half-width of the texture in units of the radius; the glow outside it is below 1e-4."""

MOST_CELLS = 2000
"""Largest number of texture cells along an axis; a larger flame gets larger cells."""


def radius_profile(h: np.ndarray) -> np.ndarray:
    """Radius b of the flame relative to its nominal radius, 0.6 at the burner and 0 at the tip."""
    return np.sqrt(np.clip(1 - h, 0, None)) * (0.6 + 1.2 * h)


def projected_glow(x: np.ndarray, b: np.ndarray, hollow: np.ndarray) -> np.ndarray:
    """Line-of-sight integral of ``(1 + c (r/b)^2) exp(-(r/b)^2)`` at distance x from the axis."""
    q2 = (x / b) ** 2
    return np.sqrt(np.pi) * b * np.exp(-q2) * (1 + hollow * (q2 + 0.5))


def draw_wrinkles(rng: np.random.Generator) -> np.ndarray:
    """Draw the random wrinkles (waves) of one flame.

    Returns
    -------
    ndarray of float64, shape (2, WAVES, 2)
        Cosine and sine coefficients of the sway and of the change of radius. Averaged over draws,
        each of the two has a root mean square of 1 over the height.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.scenes import draw_wrinkles, flame_texture
    >>> wrinkles = draw_wrinkles(np.random.default_rng(1))
    >>> flame_texture(20.0, 3.0, wrinkles).shape == flame_texture(20.0, 3.0).shape
    True
    """
    amplitude = np.arange(1, WAVES + 1.0) ** (-5 / 6)
    amplitude /= np.sqrt(np.sum(amplitude**2))
    return rng.normal(size=(2, WAVES, 2)) * amplitude[:, None]


def flame_texture(
    height_mm: float,
    radius_mm: float,
    wrinkles: np.ndarray | None = None,
    sway_mm: float = 0.0,
    swelling: float = 0.0,
    cell_mm: float = 0.1,
) -> np.ndarray:
    """Radiance of a flame as a layer's texture: base on the last row, tip on the first.

    Parameters
    ----------
    height_mm : float
        Height from burner to tip, the height of the texture.
    radius_mm : float
        Nominal radius; the texture is ``2 * HALF_WIDTH * radius_mm`` wide, 6.4 radii.
    wrinkles : ndarray, shape (2, WAVES, 2), optional
        Coefficients from `draw_wrinkles`. Default: a smooth flame.
    sway_mm : float, optional
        Root mean square of the axis's displacement at the tip; it grows from 0 at the burner.
    swelling : float, optional
        Root mean square of the relative change of the radius at the tip.
    cell_mm : float, optional
        Desired size of a texture cell.

    Returns
    -------
    ndarray of float64, shape (rows, columns), values in [0, 1]
        Radiance, scaled so that the brightest cell is 1.

    Examples
    --------
    >>> from lf_flame import Layer
    >>> from lf_flame.scenes import flame_texture
    >>> texture = flame_texture(20.0, 3.0)
    >>> flame = Layer(texture, 10.0, (20.0, 0.1 * texture.shape[1]))
    """
    lengths = height_mm, radius_mm, cell_mm
    if not all(0 < length < np.inf for length in lengths):
        raise InputError(f"height_mm, radius_mm and cell_mm must be above 0, got {lengths}.")
    rows = round(np.clip(height_mm / cell_mm, 2, MOST_CELLS))
    columns = round(np.clip(2 * HALF_WIDTH * radius_mm / cell_mm, 3, MOST_CELLS))
    h = (1 - (np.arange(rows) + 0.5) / rows)[:, None]
    x = ((np.arange(columns) + 0.5) / columns * 2 - 1) * HALF_WIDTH * radius_mm
    waves = np.zeros((2, WAVES, 2)) if wrinkles is None else wrinkles
    phase = 2 * np.pi * h * np.arange(1, WAVES + 1)
    sway, swell = (
        (np.cos(phase) @ wave[:, 0] + np.sin(phase) @ wave[:, 1])[:, None] for wave in waves
    )
    b = radius_mm * radius_profile(h) * np.exp(swelling * h * swell)
    ignition = 0.15 + 0.85 * (1 - np.exp(-((h / 0.15) ** 2)))
    glow = ignition * projected_glow(x - sway_mm * h * sway, b, HOLLOW_AT_BURNER * (1 - h))
    return glow / glow.max()
