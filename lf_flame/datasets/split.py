"""Splitting samples into training, validation and test."""

import numpy as np

from lf_flame.errors import InputError


def split_indices(n: int, shares: tuple[float, float, float], seed: int) -> dict[str, np.ndarray]:
    """Split n samples at random into "train", "validation" and "test".

    Parameters
    ----------
    n : int
        Number of samples.
    shares : (float, float, float)
        Fractions of training, validation and test.
    seed : int
        Seed of the random order.

    Returns
    -------
    dict of ndarray of int
        Indices of each part, rising.

    Raises
    ------
    InputError
        If a part would be empty.

    Examples
    --------
    >>> from lf_flame.datasets import split_indices
    >>> {name: len(indices) for name, indices in split_indices(10, (0.8, 0.1, 0.1), 1).items()}
    {'train': 8, 'validation': 1, 'test': 1}
    """
    order = np.random.default_rng(seed).permutation(n)
    first, second = round(n * shares[0]), round(n * (shares[0] + shares[1]))
    parts = np.split(order, [first, second])
    if min(len(part) for part in parts) == 0:
        raise InputError(f"{n} samples are too few to split by {shares}: a part would be empty.")
    return dict(zip(("train", "validation", "test"), map(np.sort, parts), strict=True))
