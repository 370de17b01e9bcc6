"""The falloff of light with the angle at which rays leave the main lens, compiled."""

from numba import njit


@njit
def shade(falloff, a, c, b, d):
    """Mean of cos^4 over the angles at which a pixel's rays leave the main lens."""
    if falloff is None:
        return 1.0
    return cos4(falloff.rows[a, c] + falloff.columns[b, d], falloff.patch)


@njit
def shade_ray(falloff, tilt, lenslet, pixel, ray):
    """Mean of cos^4 over a ray's box, through a lenslet."""
    if falloff is None:
        return 1.0
    down = falloff.rows[pixel.view_row, pixel.row] + falloff.down[ray.row]
    right = falloff.columns[pixel.view_column, pixel.column] + falloff.right[ray.column]
    if tilt is not None:
        down += tilt.rows[pixel.view_column, pixel.column] + lenslet.down * tilt.pitch
        right += tilt.columns[pixel.view_row, pixel.row] + lenslet.right * tilt.pitch
    return cos4(down * down + right * right, falloff.patch)


@njit
def cos4(squared, patch):
    """Mean of cos^4 over a patch of the main lens about a place of such a squared tangent.

    By the mean and the variance of the squared tangents over the patch, of a width w along both
    axes: ``w^2 / 6`` more than in its middle, which is `patch`, and ``r w^2 / 3 + w^4 / 90``.
    """
    cos2 = 1.0 / (1.0 + squared + patch)
    variance = patch * (2.0 * squared + 0.4 * patch)
    return cos2 * cos2 * (1.0 + 3.0 * variance * cos2 * cos2)
