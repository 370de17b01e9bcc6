"""Filling a slope map where it is uncertain, by votes that spread through a guide image.

Each certain pixel votes for its slope. Votes decay on their way, faster across edges of the guide
image, by the recursive filter of the domain transform (Gastal, Oliveira, ACM Trans. Graph. 30 (4),
69, 2011). A pixel takes the slope with most votes, as the mean of those votes. Unlike smoothing of
slopes, this invents no surface halfway between two others, and the noise of neighbours on one
surface averages out.
"""

from itertools import pairwise

import numpy as np

from lf_flame._common.threads import pieces, shared

REACH = 20.0
"""Standard deviation of a vote's distance, in lenslets, where the guide image is uniform."""

BLOCK = 64
"""Number of columns that are processed together."""

EDGE = 0.5
"""Change of brightness that is as far as REACH, in standard deviations of the guide image."""

TURNS = 3
"""Number of passes along rows and columns, as in Gastal and Oliveira."""


def fill_slopes(
    values: np.ndarray, votes: np.ndarray, picture: np.ndarray, slopes: np.ndarray
) -> np.ndarray:
    """Give each pixel the slope with most votes around it.

    Parameters
    ----------
    values : ndarray of float64, shape (t, s)
        Slopes.
    votes : ndarray of float64, shape (t, s)
        Weight of each slope, 0 or above; 0 where it is uncertain.
    picture : ndarray, shape (t, s) or (t, s, channels)
        Guide image; its edges stop votes.
    slopes : ndarray of float64, shape (n,)
        Slopes in equal rising steps: votes closer than a step are for the same slope.

    Returns
    -------
    ndarray of float64, shape (t, s)
        Slopes. Where no vote arrives, the mean of all votes, or without any, of all values.
    """
    if not votes.any():
        return np.full(values.shape, values.mean())
    links = _links(picture)
    most = np.zeros(values.shape)
    filled = np.full(values.shape, np.average(values, weights=votes))
    at = (values - slopes[0]) / (slopes[1] - slopes[0])
    arriving = (_arriving(values, votes * _nearness(at, k), links) for k in range(len(slopes)))
    for below, above in pairwise(arriving):
        weight, weighted = below + above
        more = weight > most
        filled[more] = weighted[more] / weight[more]
        most[more] = weight[more]
    return filled


def _nearness(at: np.ndarray, k: int) -> np.ndarray:
    """Weights, 1 at slope number k, and 0 from one step away on; ends hold the rest."""
    return np.maximum(1 - np.abs(at - k), 0)


def _arriving(values: np.ndarray, votes: np.ndarray, links: list) -> np.ndarray:
    """Votes, and votes times slopes, after they have spread: shape (2, t, s)."""
    planes = np.stack([votes, votes * values])
    if votes.any():
        for down, across in links:
            _smooth_rows(planes, across)
            _smooth_columns(planes, down)
    return planes


def _links(picture: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Find how strongly each pixel is linked to the one above and to the left, in each pass.

    In pass i of N the standard deviation is ``REACH sqrt(3) 2^(N - i) / sqrt(4^N - 1)``, so that
    the variances add up to that of REACH (equation 14 there).
    """
    picture = np.atleast_3d(picture).astype(np.float64)
    spread = float(picture.std())
    if spread > 0:
        picture = picture / spread
    ways = []
    for axis in (0, 1):
        first = picture.take([0], axis=axis)
        change = np.abs(np.diff(picture, axis=axis, prepend=first)).max(axis=2)
        ways.append(1 + REACH / EDGE * change)
    deviations = REACH * np.sqrt(3) * 2.0 ** np.arange(TURNS - 1, -1, -1) / np.sqrt(4**TURNS - 1)
    return [tuple(np.exp(-np.sqrt(2) / one * way) for way in ways) for one in deviations]


@shared
def _smooth_rows(queue, planes, links):
    """Smooth planes[k, t, s] along s, forth and back; links[t, s], 0 to 1, is from s - 1 to s."""
    width = planes.shape[2]
    for t in pieces(queue, planes.shape[1]):
        for k in range(planes.shape[0]):
            line, link = planes[k, t], links[t]
            for s in range(1, width):
                line[s] += link[s] * (line[s - 1] - line[s])
            for s in range(width - 2, -1, -1):
                line[s] += link[s + 1] * (line[s + 1] - line[s])


@shared
def _smooth_columns(queue, planes, links):
    """Smooth planes[k, t, s] along t, forth and back; links[t, s], 0 to 1, is from t - 1 to t."""
    height, width = planes.shape[1:]
    for block in pieces(queue, (width + BLOCK - 1) // BLOCK):
        first, last = np.uint64(block * BLOCK), np.uint64(min((block + 1) * BLOCK, width))
        for k in range(planes.shape[0]):
            plane = planes[k]
            for t in range(1, height):
                for s in range(first, last):
                    plane[t, s] += links[t, s] * (plane[t - 1, s] - plane[t, s])
            for t in range(height - 2, -1, -1):
                for s in range(first, last):
                    plane[t, s] += links[t + 1, s] * (plane[t + 1, s] - plane[t, s])
