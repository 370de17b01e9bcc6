"""Scores of images over a set of samples, plane by plane."""

import numpy as np
import pandas as pd

from lf_flame._common.metrics import psnr, psnr_foreground, ssim


def score(targets: np.ndarray, predictions: np.ndarray) -> pd.DataFrame:
    """Score every plane over all samples.

    Parameters
    ----------
    targets, predictions : ndarray, shape (n, planes, h, w) or (n, planes, h, w, channels)

    Returns
    -------
    DataFrame
        One row a plane: mean and standard deviation (over the samples, n - 1) of SSIM, of PSNR,
        and of PSNR over the foreground pixels, where samples without any are left out.
    """
    measures = {"ssim": ssim, "psnr_db": psnr, "psnr_foreground_db": psnr_foreground}
    rows = []
    for truths, images in zip(
        np.swapaxes(targets, 0, 1), np.swapaxes(predictions, 0, 1), strict=True
    ):
        row: dict[str, float] = {"n_test": len(truths)}
        for name, measure in measures.items():
            values = pd.Series([measure(a, b) for a, b in zip(truths, images, strict=True)])
            row |= {
                name: values.mean(),
                f"{name.removesuffix('_db')}_sd": standard_deviation(values),
            }
        rows.append(row)
    return pd.DataFrame(rows)


def standard_deviation(values: pd.Series) -> float:
    """Take the standard deviation (n - 1), where equal images may make a PSNR infinite.

    Infinite values among finite ones spread infinitely, infinite ones alone not at all; pandas
    would take the difference of two infinite numbers. NaN is left out.
    """
    values = values.dropna()
    if len(values) < 2 or np.all(np.isfinite(values)):
        return values.std()
    return 0.0 if np.all(np.isinf(values)) else np.inf
