"""Filling of unknown pixels from the known ones around them."""

import numpy as np

AROUND = [(i, j, 0.5 if i and j else 1.0) for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j]
"""Rows and columns from a pixel to its eight neighbours, and their weights."""


def fill_unknown(images: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Fill unknown pixels of images with means of known neighbours, from the rim of a hole inwards.

    A pixel that holds more than that mean keeps its value, which is a lower bound of the light, as
    where a sensor is saturated.

    Parameters
    ----------
    images : ndarray of float32, shape (..., rows, columns, channels)
    known : ndarray of bool, shape (..., rows, columns)

    Returns
    -------
    ndarray of float32, shape of `images`
        Images; one without a known pixel stays as it is.
    """
    out = images.reshape(-1, *images.shape[-3:]).copy()
    given, done = images.reshape(out.shape), known.reshape(out.shape[:3]).copy()
    rows, columns = out.shape[1:3]
    places = np.nonzero(~done)
    unknown = places
    while places[0].size:
        n, y, x = places
        total, weight = np.zeros((n.size, out.shape[3])), np.zeros(n.size)
        for down, right, share in AROUND:
            beside = n, np.clip(y + down, 0, rows - 1), np.clip(x + right, 0, columns - 1)
            inside = (beside[1] == y + down) & (beside[2] == x + right)
            counts = share * (done[beside] & inside)
            total += counts[:, None] * out[beside]
            weight += counts
        ready = weight > 0
        if not ready.any():
            break
        filled = tuple(place[ready] for place in places)
        out[filled] = total[ready] / weight[ready, None]
        done[filled] = True
        places = tuple(place[~ready] for place in places)
    out[unknown] = np.maximum(out[unknown], given[unknown])
    return out.reshape(images.shape)
