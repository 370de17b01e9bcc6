"""Scores of images: structural similarity and peak signal-to-noise ratio, single and averaged."""

import numpy as np
import pandas as pd
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from lf_flame.errors import InputError

FOREGROUND = 0.01
"""Value of the truth, relative to the peak 1, above which a pixel is foreground. Two thirds of the
pixels are background, black in the truth and easily so in a prediction. Included, they dilute the
error of the objects, and PSNR is 4 to 6 dB higher, more so for smaller objects."""


def ssim(truth: np.ndarray, image: np.ndarray) -> float:
    """Structural similarity as Wang et al. (2004) define it, for values in [0, 1].

    For colours (a third axis) it is the mean over the channels. The window is Gaussian with a
    standard deviation of 1.5 pixels, K1 = 0.01, K2 = 0.03, population covariance (deviation 12).
    """
    if min(np.shape(truth)[:2]) < 11:
        raise InputError(f"SSIM needs images of 11 x 11 pixels or more, got {np.shape(truth)}.")
    return structural_similarity(
        truth, image, data_range=1.0, gaussian_weights=True, sigma=1.5, use_sample_covariance=False,
        channel_axis=-1 if np.ndim(truth) == 3 else None,
    )  # fmt: skip


def psnr(truth: np.ndarray, image: np.ndarray) -> float:
    """Peak signal-to-noise ratio in dB for values in [0, 1]; infinite for equal images."""
    with np.errstate(divide="ignore"):
        return peak_signal_noise_ratio(truth, image, data_range=1.0)


def psnr_foreground(truth: np.ndarray, image: np.ndarray) -> float:
    """`psnr` of the foreground pixels alone; NaN if there are none."""
    foreground = truth > FOREGROUND
    return psnr(truth[foreground], image[foreground]) if foreground.any() else np.nan


def score(targets: np.ndarray, predictions: np.ndarray) -> pd.DataFrame:
    """Score predicted images against the truth, image by image of the stack, over all samples.

    Parameters
    ----------
    targets, predictions : ndarray, shape (n, planes, h, w) or (n, planes, h, w, channels)
        Truth and prediction of n samples, with `planes` refocused images each.

    Returns
    -------
    DataFrame
        One row for each refocused image: mean and standard deviation (over the samples, n - 1) of
        SSIM, of PSNR, and of PSNR over the foreground pixels, without samples that have none.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.learning import score
    >>> truth = np.zeros((3, 4, 20, 20))
    >>> score(truth, truth + 0.1)["psnr_db"].round(6).tolist()  # 10 log10(1 / 0.01) for each plane
    [20.0, 20.0, 20.0, 20.0]
    """
    measures = {"ssim": ssim, "psnr_db": psnr, "psnr_foreground_db": psnr_foreground}
    rows = []
    planes = (np.swapaxes(x, 0, 1) for x in (targets, predictions))
    for truths, images in zip(*planes, strict=True):
        row: dict[str, float] = {"n_test": len(truths)}
        for name, measure in measures.items():
            values = pd.Series([measure(a, b) for a, b in zip(truths, images, strict=True)])
            row[name] = values.mean()
            row[f"{name.removesuffix('_db')}_sd"] = standard_deviation(values)
        rows.append(row)
    return pd.DataFrame(rows)


def standard_deviation(values: pd.Series) -> float:
    """Find the standard deviation (n - 1) of values of which some may be infinite.

    It is infinite for finite and infinite values together, and 0 for infinite values alone; pandas
    would subtract infinite numbers. NaN is left out.
    """
    values = values.dropna()
    if len(values) < 2 or np.all(np.isfinite(values)):
        return values.std()
    return 0.0 if np.all(np.isinf(values)) else np.inf
