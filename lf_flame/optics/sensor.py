"""The sensor: from true radiance to recorded radiance.

This is the linear camera model of EMVA 1288 (release 4.0): photo-electrons are counted with
Poisson statistics, the electronics add Gaussian noise, the pixel holds a limited charge, and the
converter rounds to integers. Results have the unit of the input, so that a perfect sensor changes
nothing. Converters add a black level, so that negative read noise is recorded; it is subtracted
here, and values may be negative.
"""

from __future__ import annotations

from collections.abc import Set
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from lf_flame._common.config import strict
from lf_flame.errors import InputError

STAGES = ("shot_noise", "read_noise", "saturation", "quantisation")
"""Names of the effects of a sensor on an image, in the order in which they act."""

MOST_ELECTRONS = 1e12
"""Largest number of electrons, above any real pixel; with its inverse all results fit float32."""

MOST_COUNTED = 1e9
"""Largest mean number of electrons that is drawn from the Poisson distribution itself. NumPy's
sampler fails near 9.2e18. Above, a normal distribution with the same mean and variance is used; it
differs by a fraction of an electron, where float32 values are 64 electrons apart."""

PIXELS_AT_ONCE = 2**20
"""Number of pixels held as float64 at a time; the result does not depend on it."""


@strict
@dataclass(frozen=True)
class Sensor:
    """A linear image sensor.

    Parameters
    ----------
    exposure_e : float
        Number of electrons that a pixel of radiance 1 collects, 1e-12 to 1e12.
    full_well_e : float, optional
        Number of electrons at which a pixel saturates, at the highest digital number; 1e-12 to
        1e12.
    bits : int, optional
        Number of bits of the converter, 1 to 16.
    read_noise_e : float, optional
        Standard deviation of the read noise, in electrons, 0 to 1e12.

    Raises
    ------
    InputError
        If a value is out of range; the message names it.

    Examples
    --------
    >>> from lf_flame import Sensor
    >>> Sensor(exposure_e=8000.0, full_well_e=10000.0, read_noise_e=5.0, bits=12).bits
    12
    """

    exposure_e: float
    full_well_e: float = 10_000.0
    bits: int = 12
    read_noise_e: float = 2.0

    def __post_init__(self):
        for name in ("exposure_e", "full_well_e", "read_noise_e"):
            value, low = getattr(self, name), 0 if name == "read_noise_e" else 1 / MOST_ELECTRONS
            if not low <= value <= MOST_ELECTRONS:
                raise InputError(
                    f"{name} must be {low:g} to {MOST_ELECTRONS:g} electrons, got {value}."
                )
        if self.bits not in range(1, 17):
            raise InputError(f"bits must be a whole number from 1 to 16, got {self.bits}.")

    @property
    def step_e(self) -> float:
        """Number of electrons per digital number."""
        return self.full_well_e / (2**self.bits - 1)


def expose(
    values: ArrayLike, sensor: Sensor, kept: Set[str], rng: np.random.Generator
) -> np.ndarray:
    """Record an image with a sensor.

    Parameters
    ----------
    values : array_like, any shape
        Finite radiance values. Negative values get no shot noise.
    sensor : Sensor
    kept : set of str
        Those of "shot_noise", "read_noise", "saturation" and "quantisation" to apply. Without
        "saturation" the converter has no highest number.
    rng : numpy.random.Generator
        Source of all random numbers. Each kind of noise draws from its own child generator, pixel
        after pixel in C order: the shot noise does not depend on the other stages.

    Returns
    -------
    ndarray of float32, same shape
        A new array, in the unit of `values`.

    Raises
    ------
    InputError
        If a stage is unknown or a value is not finite.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame import Sensor
    >>> from lf_flame.optics import expose
    >>> sensor = Sensor(exposure_e=8000.0, full_well_e=10000.0)
    >>> rng = np.random.default_rng(1)
    >>> image = expose(np.full((100, 100), 0.5), sensor, {"shot_noise"}, rng)
    >>> round(float(image.std()), 3)  # 4,000 electrons: 0.5 / sqrt(4000)
    0.008
    """
    unknown = sorted(map(str, set(kept) - set(STAGES)))
    if unknown:
        raise InputError(f"Unknown sensor stage {unknown[0]!r}; use {', '.join(STAGES)}.")
    image = np.array(values, np.float32, order="C")
    bad = image.size - np.count_nonzero(np.isfinite(image))
    if bad:
        raise InputError(f"A sensor needs finite radiance, got {bad} NaN or infinite pixels.")
    streams, pixels = rng.spawn(3), image.reshape(-1)
    for low in range(0, pixels.size, PIXELS_AT_ONCE):
        part = pixels[low : low + PIXELS_AT_ONCE]
        electrons = part.astype(np.float64) * sensor.exposure_e
        part[:] = _record(electrons, sensor, kept, streams) / sensor.exposure_e
    return image


def _record(
    electrons: np.ndarray, sensor: Sensor, kept: Set[str], streams: list[np.random.Generator]
) -> np.ndarray:
    """Find the number of electrons for each digital number."""
    few, many, read = streams
    if "shot_noise" in kept:
        electrons = _count(electrons, few, many)
    if "read_noise" in kept:
        electrons = electrons + sensor.read_noise_e * read.standard_normal(electrons.size)
    # after the read noise: EMVA 1288 finds saturation where the noise of the numbers breaks down
    if "saturation" in kept:
        electrons = np.minimum(electrons, sensor.full_well_e)
    if "quantisation" in kept:
        electrons = np.rint(electrons / sensor.step_e) * sensor.step_e
    return electrons


def _count(
    electrons: np.ndarray, few: np.random.Generator, many: np.random.Generator
) -> np.ndarray:
    """Poisson draws for means up to MOST_COUNTED, normal draws above; negative light stays."""
    light = np.maximum(electrons, 0)
    counted = few.poisson(np.minimum(light, MOST_COUNTED)).astype(np.float64)
    bright = light > MOST_COUNTED
    mean = light[bright]
    counted[bright] = mean + np.sqrt(mean) * many.standard_normal(mean.size)
    return counted + np.minimum(electrons, 0)
