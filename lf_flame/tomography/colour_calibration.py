"""Calibration of a camera's colours with a furnace (black body) or lamp of known temperatures.

A colour's signal is its gain times the exposure times the integral of its spectral response and the
source's radiance. One gain per colour is fitted in the logarithm, to pictures at several
temperatures; ratios of gains serve the temperature of soot, gains themselves its absorption.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import ndimage, stats

from lf_flame._common.config import build, strict
from lf_flame._common.input_files import read_toml
from lf_flame.errors import InputError
from lf_flame.tomography.spectra import SpectralResponses

TABLE = "colours"
"""Name of the table in a TOML file."""

MOST_RELATIVE = 0.05
"""Largest relative scatter of a colour's gain over the pictures; above, no gain explains them."""

LIT = 0.8
"""Brightness of the source's even part, relative to the brightest hundredth or 100 pixels."""

FEWEST_PIXELS = 100
"""Smallest number of pixels of the even part."""

MOST_UNEVEN = 0.05
"""Largest relative standard deviation within the even part without a warning."""


@strict
@dataclass(frozen=True, kw_only=True)
class _ColoursTable:
    """Table of a calibration in a TOML file."""

    names: tuple[str, ...]
    gains: tuple[float, ...]
    relative_errors: tuple[float, ...]
    temperature_range_K: tuple[float, float]
    wavelengths_nm: tuple[float, ...]
    responses: tuple[tuple[float, ...], ...]


@dataclass(frozen=True, eq=False)
class ColourCalibration:
    """Gains of a camera's colours, with their errors.

    Parameters
    ----------
    responses : SpectralResponses
        Spectral responses of the colours.
    gains : array_like, shape (colours,)
        Signal of each colour over the integral of response and radiance, above 0.
    relative_errors : array_like, shape (colours,)
        Relative standard error of each gain, 0 or above.
    temperature_range_K : (float, float)
        Lowest and highest temperature of the calibration.

    Raises
    ------
    InputError
        If a value cannot be used.
    """

    responses: SpectralResponses
    gains: np.ndarray
    relative_errors: np.ndarray
    temperature_range_K: tuple[float, float]  # noqa: N815 - the unit's own letter

    def __post_init__(self):
        count = len(self.responses.names)
        for name, least in (("gains", np.nextafter(0, 1)), ("relative_errors", 0.0)):
            values = np.asarray(getattr(self, name), float)
            if values.shape != (count,) or not np.all((values >= least) & (values < np.inf)):
                raise InputError(
                    f"{name} must be a finite number for each of the {count} colours, "
                    f"{'above 0' if least else '0 or above'}, got {values.tolist()}."
                )
            object.__setattr__(self, name, values)
        low, high = self.temperature_range_K
        if not 0 < low <= high < math.inf:
            raise InputError(
                f"temperature_range_K must be two increasing temperatures, got {low:g}, {high:g}."
            )

    def to_toml(self) -> str:
        """Format the calibration as a TOML file, which `read_colours` reads."""
        responses = self.responses
        rows = ",\n  ".join(_numbers(curve) for curve in responses.values)
        names = ", ".join(f'"{name}"' for name in responses.names)
        return (
            f"[{TABLE}]\n"
            f"names = [{names}]\n"
            f"gains = {_numbers(self.gains)}\n"
            f"relative_errors = {_numbers(self.relative_errors)}\n"
            f"temperature_range_K = {_numbers(self.temperature_range_K)}\n"
            f"wavelengths_nm = {_numbers(responses.wavelengths_nm)}\n"
            f"responses = [\n  {rows},\n]\n"
        )


class ColourFit(NamedTuple):
    """Fit of the gains of a camera's colours to pictures of a source.

    `residuals` are the relative deviations of each picture from the fit, (pictures, colours).
    """

    calibration: ColourCalibration
    residuals: np.ndarray


def calibrate_colours(
    kelvin: Sequence[float],
    signals: ArrayLike,
    responses: SpectralResponses,
    *,
    exposures: Sequence[float] | None = None,
    emissivity: float = 1.0,
) -> ColourFit:
    """Fit the gain of each colour to pictures of a source at known temperatures.

    Parameters
    ----------
    kelvin : sequence of float, shape (pictures,)
        Temperatures of the source in K, above 0; two pictures or more.
    signals : array_like, shape (pictures, colours)
        Signal of each colour in each picture, linear in light, black subtracted, above 0.
    responses : SpectralResponses
        Spectral responses of the colours.
    exposures : sequence of float, optional
        Exposure of each picture relative to the exposure of the flame's picture, above 0. Default:
        the same.
    emissivity : float, optional
        Emissivity of the source, above 0, at most 1; that of a furnace is 1.

    Returns
    -------
    ColourFit

    Raises
    ------
    InputError
        If a value cannot be used, or no constant gain explains the signals within 5 %.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.tomography import SpectralResponses, calibrate_colours
    >>> nm = np.arange(450, 701, 10.0)
    >>> curves = [np.exp(-(((nm - middle) / 40) ** 2)) for middle in (540, 610)]
    >>> camera = SpectralResponses(("green", "red"), nm, curves)
    >>> kelvin = [1300.0, 1500.0, 1700.0]
    >>> signals = camera.black_body(kelvin).T * [2e-5, 3e-5]
    >>> fit = calibrate_colours(kelvin, signals, camera)
    >>> np.round(fit.calibration.gains * 1e5, 3).tolist()
    [2.0, 3.0]
    """
    temperatures, signals, scale = _checked(kelvin, signals, responses, exposures, emissivity)
    expected = emissivity * scale[:, None] * responses.black_body(temperatures).T
    logs = np.log(signals / expected)
    mean = logs.mean(axis=0)
    rest = logs - mean
    scatter = rest.std(axis=0, ddof=1)
    worst = int(np.argmax(scatter))
    if scatter[worst] > MOST_RELATIVE:
        raise InputError(
            f"No gain explains the signals of {responses.names[worst]}: it scatters by "
            f"{scatter[worst]:.0%} between the pictures, more than {MOST_RELATIVE:.0%}. Check "
            f"whether the temperatures are in the order of the pictures, black is subtracted, "
            f"nothing is saturated, and exposures and responses are those of this camera."
        )
    # With few pictures the scatter is uncertain: Student's t, as one standard deviation.
    few = stats.t.ppf(stats.norm.cdf(1), len(temperatures) - 1)
    errors = few * scatter / np.sqrt(len(temperatures))
    calibration = ColourCalibration(
        responses, np.exp(mean), errors, (float(temperatures.min()), float(temperatures.max()))
    )
    return ColourFit(calibration, np.expm1(rest))


def _checked(kelvin, signals, responses, exposures, emissivity):
    """Check the arguments of `calibrate_colours`; temperatures, signals and exposures as arrays."""
    kelvin, signals = np.asarray(kelvin, float), np.asarray(signals, float)
    count, colours = kelvin.size, len(responses.names)
    known = kelvin.ndim == 1 and np.all((kelvin > 0) & (kelvin < np.inf))
    if not known or count < 2 or np.ptp(kelvin) == 0:
        raise InputError(
            f"Colours need pictures at two temperatures or more, in K, above 0, got "
            f"{kelvin.tolist()}."
        )
    if signals.shape != (count, colours):
        raise InputError(
            f"{count} pictures of a camera with {colours} spectral responses need signals of shape "
            f"{(count, colours)}, got {signals.shape}."
        )
    if not np.all((signals > 0) & (signals < np.inf)):
        raise InputError(f"Signals must be finite, above 0, got {float(signals.min()):g}.")
    exposures = np.ones(count) if exposures is None else np.asarray(exposures, float)
    if exposures.shape != (count,) or not np.all((exposures > 0) & (exposures < np.inf)):
        raise InputError(
            f"exposures must be a number above 0 for each of the {count} pictures, got "
            f"{exposures.tolist()}."
        )
    if not 0 < emissivity <= 1:
        raise InputError(f"emissivity must be above 0, at most 1, got {emissivity}.")
    return kelvin, signals, exposures


def read_colours(path: str | Path) -> ColourCalibration:
    """Read a calibration of colours from a TOML file, as `lf-flame calibrate-colours` writes it.

    Raises
    ------
    InputError
        If the file cannot be read, has no table ``[colours]``, or a value cannot be used.

    Examples
    --------
    >>> from pathlib import Path
    >>> from lf_flame.tomography import ColourCalibration, SpectralResponses, read_colours
    >>> camera = SpectralResponses.single((550, 650), ("green", "red"))
    >>> made = ColourCalibration(camera, [2.0, 3.0], [0.01, 0.01], (1200.0, 1700.0))
    >>> _ = Path("colours.toml").write_text(made.to_toml())
    >>> read_colours("colours.toml").gains.tolist()
    [2.0, 3.0]
    """
    values = read_toml(path)
    if TABLE not in values:
        raise InputError(f"{path} has no table [{TABLE}]: it is not a calibration of colours.")
    table = build(_ColoursTable, values[TABLE], f"{path}: {TABLE}")
    try:
        lengths = {len(row) for row in table.responses}
        if lengths != {len(table.wavelengths_nm)}:
            raise InputError("responses must contain a number for each of wavelengths_nm.")
        lengths_nm, curves = np.array(table.wavelengths_nm), np.array(table.responses)
        responses = SpectralResponses(table.names, lengths_nm, curves)
        gains, errors = np.array(table.gains), np.array(table.relative_errors)
        return ColourCalibration(responses, gains, errors, table.temperature_range_K)
    except InputError as error:
        raise InputError(f"{path}: {TABLE}: {error}") from None


def _numbers(values: ArrayLike) -> str:
    return f"[{', '.join(repr(float(value)) for value in np.asarray(values))}]"


class SourceSignals(NamedTuple):
    """Signals of a source, (pictures, colours), the mask of its even part, and how uneven it is.

    `uneven` is the relative standard deviation there of the mean of all pictures.
    """

    signals: np.ndarray
    mask: np.ndarray
    uneven: float


def measure_source(photographs: Sequence[np.ndarray]) -> SourceSignals:
    """Average the evenly bright part of a source, which is in the same place in all pictures.

    Parameters
    ----------
    photographs : sequence of ndarray, shape (rows, columns, colours)
        Photographs, linear in light, black subtracted.

    Returns
    -------
    SourceSignals
        Mean of each colour in each picture over the part that is evenly bright.

    Raises
    ------
    InputError
        If the pictures differ in shape, or no part of them is evenly bright.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.tomography import measure_source
    >>> y, x = np.mgrid[:270, :540]
    >>> disc = (np.hypot(y - 135, x - 270) < 10) + 0.01  # a small opening, and stray light
    >>> measure_source([disc[..., None] * [a, 5 * a] for a in (0.1, 0.2)]).signals.round(6).tolist()
    [[0.101, 0.505], [0.202, 1.01]]
    """
    shapes = {one.shape for one in photographs}
    if len(shapes) != 1 or len(next(iter(shapes))) != 3:
        raise InputError(
            f"The pictures of the source must be in colour and of equal size, got {sorted(shapes)}."
        )
    # Each picture and colour has equal weight: the source is dark in blue, and where it is cold.
    scaled = [one / max(float(np.max(one)), 1e-300) for one in map(_by_colour, photographs)]
    bright = np.mean(scaled, axis=0)
    smooth = ndimage.uniform_filter(bright, 3)
    common, top = np.percentile(smooth, 99), np.sort(smooth, axis=None)[-FEWEST_PIXELS:][0]
    mask = smooth > LIT * (top if top > 2 * common else common)  # of a small one beside stray light
    mask = mask if mask.all() else ndimage.binary_erosion(mask, iterations=2)  # without its rim
    if mask.sum() < FEWEST_PIXELS:
        raise InputError(
            f"The source must be evenly bright over {FEWEST_PIXELS} pixels or more, and only "
            f"{int(mask.sum())} are: bring it nearer, or into focus."
        )
    signals = [one[mask].mean(axis=0, dtype=np.float64) for one in photographs]
    uneven = float(smooth[mask].std() / smooth[mask].mean())
    return SourceSignals(np.stack(signals), mask, uneven)


def _by_colour(photograph: np.ndarray) -> np.ndarray:
    """Sum of the colours, each scaled to its own brightest hundredth."""
    tops = np.percentile(photograph, 99, axis=(0, 1))
    return (photograph / np.where(tops > 0, tops, 1.0)).sum(axis=2)
