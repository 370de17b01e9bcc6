"""Spectral responses of a camera's colours, and the light of black bodies and soot in each.

A colour with the response S sees the radiance of a black body at temperature T as the integral of
S(l) B(l, T) over the wavelength l, with Planck's B; thin soot emits (l / 600 nm)^-a times that for
each unit of its optical thickness at 600 nm (Modest, Radiative Heat Transfer, chapters on the
equation of transfer and on particulate media).
"""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import Akima1DInterpolator

from lf_flame._common.input_files import read_text, readable
from lf_flame.errors import InputError

SECOND_RADIATION_NM_K = 1.4387768775e7
"""Second radiation constant c2 = h c / k in nm K (CODATA 2018, exact)."""

FIRST_RADIATION = 1.191042972397188e20
"""First radiation constant 2 h c^2 in W nm^4 / (m^2 sr), for radiance per nm."""

REFERENCE_NM = 600.0
"""Wavelength at which the optical thickness of soot is stated."""

LEAST_NM, MOST_NM = 100.0, 1e5
"""Range of wavelengths in nm; a value such as 0.55 would be in micrometres, and is refused."""

LEAST_EXPONENT, MOST_EXPONENT = -1.0, 5.0
"""Range of the exponent a of soot's absorption; measured ones are between 0.7 and 3."""

STEP_NM, GAUSS_POINTS = 10.0, 4
"""Largest step of the integration over a curve, and number of points in it."""

PLAIN_NAME = re.compile(r"[A-Za-z0-9](?:[A-Za-z0-9 _.-]{0,38}[A-Za-z0-9_-])?")
"""Names of colours: results of each lie in a folder of its name, so no name may be a path."""


@dataclass(frozen=True, eq=False)
class SpectralResponses:
    """Spectral responses of the colours of a camera, with its lens and filters.

    Parameters
    ----------
    names : tuple of str
        Name of each colour, in the order of the camera's channels; plain and all different.
    wavelengths_nm : array_like, shape (n,)
        Wavelengths in nm, increasing, from 100 to 100,000.
    values : array_like, shape (colours, n)
        Signal per radiance at each wavelength, 0 or above, in any unit: a calibration by a furnace
        finds the colours' constants. Between the wavelengths a curve is the square of
        Akima's (1970) through the values' square roots. A band needs four wavelengths or so across
        its half width, and a steep edge of a filter several on the edge. With as many wavelengths
        as colours and one value above 0 for each, every colour is a single wavelength.

    Raises
    ------
    InputError
        If a value cannot be used.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.tomography import SpectralResponses
    >>> nm = np.arange(400, 701, 10.0)
    >>> green, red = (np.exp(-(((nm - middle) / 40) ** 2)) for middle in (540, 610))
    >>> camera = SpectralResponses(("green", "red"), nm, [green, red])
    >>> green, red = camera.black_body([1500.0, 1900.0])
    >>> bool(np.all(np.diff(green / red) > 0))  # hotter is bluer
    True
    """

    names: tuple[str, ...]
    wavelengths_nm: np.ndarray
    values: np.ndarray

    def __post_init__(self):
        lengths = np.asarray(self.wavelengths_nm, float)
        values = np.asarray(self.values, float)
        names = tuple(str(name) for name in self.names)
        if lengths.ndim != 1 or values.shape != (len(names), lengths.size) or not names:
            raise InputError(
                f"Responses need a row of values for each of the {len(names)} colours and a value "
                f"for each of the wavelengths, got shapes {values.shape} and {lengths.shape}."
            )
        in_nm = np.all((lengths >= LEAST_NM) & (lengths <= MOST_NM))
        if not (in_nm and np.all(np.diff(lengths) > 0) and lengths.size >= min(2, len(names))):
            shown = ", ".join(f"{length:g}" for length in lengths[:4])
            raise InputError(
                f"Wavelengths, two or more, must increase, and must be in nm, from {LEAST_NM:g} to "
                f"{MOST_NM:g}, got {shown}{', ...' * (lengths.size > 4)}."
            )
        if not np.isfinite(values).all() or values.min() < 0:
            raise InputError(
                f"Responses must be finite, 0 or above, got values from {values.min():g} to "
                f"{values.max():g}."
            )
        if len({name.casefold() for name in names}) < len(names):
            raise InputError(f"Colours must have different names, got {', '.join(names)!r}.")
        for name, curve in zip(names, values, strict=True):
            if not PLAIN_NAME.fullmatch(name):
                raise InputError(
                    f"The name of a colour must be 1 to 40 letters, digits, spaces, -, _ or dots "
                    f"after a first letter or digit, as it names a folder, got {name[:80]!r}."
                )
            if not curve.any():
                raise InputError(f"The colour {name!r} responds to no wavelength.")
        for name, value in (("names", names), ("wavelengths_nm", lengths), ("values", values)):
            object.__setattr__(self, name, value)

    @classmethod
    def single(
        cls, wavelengths_nm: Sequence[float], names: Sequence[str] | None = None
    ) -> SpectralResponses:
        """Responses to single wavelengths, as of narrow filters.

        Parameters
        ----------
        wavelengths_nm : sequence of float
            Wavelength of each colour in nm, in any order.
        names : sequence of str, optional
            Default: the wavelengths.
        """
        given = np.asarray(wavelengths_nm, float)
        order = np.argsort(given)
        values = (order[None, :] == np.arange(given.size)[:, None]).astype(float)
        named = [f"{length:g} nm" for length in given] if names is None else names
        return cls(tuple(named), given[order], values)

    @property
    def single_wavelengths(self) -> bool:
        """Whether every colour is a single wavelength."""
        square = self.values.shape[0] == self.values.shape[1]
        return square and bool(np.all((self.values > 0).sum(axis=1) == 1))

    def black_body(self, kelvin: ArrayLike) -> np.ndarray:
        """Light of a black body in each colour.

        Parameters
        ----------
        kelvin : array_like, shape (...)
            Temperatures in K, above 0.

        Returns
        -------
        ndarray of float64, shape (colours, ...)
            For responses without unit, in W / (m^2 sr); of a single wavelength, per nm.
        """
        return self._integral(kelvin, 0.0)

    def soot(self, kelvin: ArrayLike, soot_exponent: float = 1.0) -> np.ndarray:
        """Light of thin soot in each colour, for an optical thickness of 1 at 600 nm.

        Parameters
        ----------
        kelvin : array_like, shape (...)
            Temperatures in K, above 0.
        soot_exponent : float, optional
            Exponent a of its absorption, ``wavelength^-a``, from -1 to 5. 1 holds for particles
            much smaller than the wavelength with a constant refractive index.

        Returns
        -------
        ndarray of float64, shape (colours, ...)

        Raises
        ------
        InputError
            If the exponent is out of range.
        """
        check_exponent(soot_exponent)
        return self._integral(kelvin, soot_exponent)

    def _integral(self, kelvin: ArrayLike, exponent: float) -> np.ndarray:
        lengths, weights = self._nodes()
        weights = weights * FIRST_RADIATION * lengths**-5.0 * (lengths / REFERENCE_NM) ** -exponent
        over = np.expand_dims(SECOND_RADIATION_NM_K / np.asarray(kelvin, float), 0)
        out = np.zeros((len(weights), *over.shape[1:]))
        for length, weight in zip(lengths, weights.T, strict=True):
            x = over[0] / length
            # exp(-x) / (1 - exp(-x)) keeps its digits for cold bodies, and does not overflow.
            out += weight.reshape(-1, *[1] * x.ndim) * (np.exp(-x) / -np.expm1(-x))
        return out

    def _nodes(self) -> tuple[np.ndarray, np.ndarray]:
        """Wavelengths of the integration, shape (n,), and their weights, shape (colours, n)."""
        lengths, values = self.wavelengths_nm, self.values
        if self.single_wavelengths:
            return lengths, values
        # Between two wavelengths a curve is a polynomial of degree 6: a few Gauss points suffice.
        parts = [
            np.linspace(low, high, int(np.ceil((high - low) / STEP_NM)), endpoint=False)
            for low, high in zip(lengths[:-1], lengths[1:], strict=True)
        ]
        edges = np.concatenate([*parts, lengths[-1:]])
        points, shares = np.polynomial.legendre.leggauss(GAUSS_POINTS)
        half = np.diff(edges)[:, None] / 2
        nodes = (edges[:-1, None] + half * (1 + points)).ravel()
        steps = (half * shares).ravel()
        # Straight lines through the samples would widen a band, and make soot seem colder. A smooth
        # curve through the roots does not, and its square is never negative. Akima's depends on two
        # neighbours at each side alone: a spline would oscillate in a gap between two filters.
        # Beyond the table's ends it is extrapolated linearly, but never below 0.
        roots = np.sqrt(values)
        before, first = _extrapolated(lengths, roots)
        after, last = _extrapolated(lengths[::-1], roots[:, ::-1])
        knots = np.concatenate([before, lengths, after[::-1]])
        roots = np.concatenate([first, roots, last[:, ::-1]], axis=1)
        curve = Akima1DInterpolator(knots, roots, axis=1)
        return nodes, curve(nodes) ** 2 * steps


def _extrapolated(lengths: np.ndarray, roots: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two wavelengths before the first, and roots there by a straight line, 0 or above."""
    back = np.array([2.0, 1.0])
    before = lengths[0] - back * (lengths[1] - lengths[0])
    return before, np.clip(roots[:, :1] - back * (roots[:, 1:2] - roots[:, :1]), 0, None)


def read_responses(path: str | Path) -> SpectralResponses:
    """Read spectral responses from a CSV file.

    Parameters
    ----------
    path : str or Path
        File with a header row, ``wavelength_nm`` and the names of the colours in the order of the
        camera's channels, and a row for each wavelength.

    Returns
    -------
    SpectralResponses

    Raises
    ------
    InputError
        If the file cannot be read, or a value cannot be used.

    Examples
    --------
    >>> from pathlib import Path
    >>> from lf_flame.tomography import read_responses
    >>> rows = "wavelength_nm,green,red", "500,1,0", "550,1,1", "600,0,1"
    >>> _ = Path("camera.csv").write_text(chr(10).join(rows))
    >>> read_responses("camera.csv").names
    ('green', 'red')
    """
    path = Path(path)
    lines = read_text(path).splitlines()
    with readable(path, "not a CSV file"):
        rows = [row for row in csv.reader(lines) if any(cell.strip() for cell in row)]
    if not rows or rows[0][0].strip() != "wavelength_nm" or len(rows[0]) < 2:
        raise InputError(
            f"{path} must begin with a header row, wavelength_nm and the names of the colours, got "
            f"{','.join(rows[0])[:80] if rows else 'nothing'!r}."
        )
    names, table = [name.strip() for name in rows[0][1:]], rows[1:]
    if len(table) < 2:
        raise InputError(f"{path} must contain 2 wavelengths or more, got {len(table)}.")
    try:
        numbers = np.array(table, float).reshape(len(table), len(names) + 1)
    except ValueError:
        raise InputError(
            f"{path} must contain {len(names) + 1} numbers in each row below its header."
        ) from None
    try:
        return SpectralResponses(tuple(names), numbers[:, 0], numbers[:, 1:].T)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def check_exponent(soot_exponent: float) -> None:
    """Refuse an exponent of soot's absorption that is out of range."""
    if not LEAST_EXPONENT <= soot_exponent <= MOST_EXPONENT:
        raise InputError(
            f"soot_exponent must be from {LEAST_EXPONENT:g} to {MOST_EXPONENT:g}, got "
            f"{soot_exponent}."
        )
