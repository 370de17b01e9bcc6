"""Diffraction at an aperture: the blur of an incoherent image, through the transfer function.

Input and output are constant over each sample: the weights are the pattern averaged over one
sample and summed over another. The transfer functions are those of a square and a round pupil in
focus (J. W. Goodman, Introduction to Fourier Optics, 3rd ed., section 6.3). A spread is wavelength
times distance over the width of the aperture: from the centre of a square aperture's pattern to its
first dark line.
"""

import math

import numpy as np
import scipy  # its parts load when they are used

COARSE_FREQUENCIES = 65
"""Number of frequencies along each axis at which the aliases of a round aperture's response are
summed; the sum is smooth between these."""

MOST_ALIASES = 16
"""Number of aliases on each side above which a round aperture is treated along each axis alone."""

BORDER, MOST_BORDER = 200, 2048
"""Width by which lines are continued at their border, in spreads, and at most in samples."""

VIEW_BORDER = 256
"""Largest width in pixels by which views are continued at their border."""

FINEST = 1e-5
"""Spread in cells below which diffraction is left out: it would move 3e-5 of the light."""


def blur_cells(
    cells: np.ndarray,
    spread_mm: float,
    cell_mm: tuple[float, float],
    round_aperture: bool,
    over: tuple[tuple[int, int], tuple[int, int]],
    dark: tuple[int, int],
) -> np.ndarray:
    """Blur light that is constant over each cell of (rows, columns), float64; means over cells.

    The light is multiplied by the aperture's transfer function in the frequency domain, so that
    the whole pattern is included, and cells may be large compared with it.

    over: range of rows and of columns to return, (first, last + 1), counted from the first cell;
    it may extend beyond the cells. dark: number of dark rows and columns added next to all these,
    because the transform repeats the light periodically.
    """
    firsts = [min(first, 0) for first, _ in over]
    ends = [max(end, count) for (_, end), count in zip(over, cells.shape, strict=True)]
    counts = [
        scipy.fft.next_fast_len(end - first + beside, real=True)
        for first, end, beside in zip(firsts, ends, dark, strict=True)
    ]
    field = np.zeros(counts)
    field[tuple(slice(-f, n - f) for f, n in zip(firsts, cells.shape, strict=True))] = cells
    spectrum = scipy.fft.rfft2(field) * _response(counts, spread_mm, cell_mm, round_aperture)
    blurred = scipy.fft.irfft2(spectrum, counts)
    wanted = tuple(slice(a - f, b - f) for (a, b), f in zip(over, firsts, strict=True))
    return blurred[wanted].clip(0)


def blur_lines(image: np.ndarray, spread_mm: float, sample_mm: float) -> np.ndarray:
    """Blur an image along its first axis with the whole pattern of a square aperture, in float64.

    Values are constant over each sample; the outermost samples continue beyond the border.
    """
    count, beside = len(image), math.ceil(min(BORDER * spread_mm / sample_mm, MOST_BORDER)) + 1
    size = scipy.fft.next_fast_len(count + 2 * beside, real=True)
    border = ((beside, size - count - beside), (0, 0))
    (response,) = _along_axes([size], spread_mm, [sample_mm], _triangle)
    spectrum = scipy.fft.rfft(np.pad(image.astype(np.float64), border, "edge"), axis=0)
    return scipy.fft.irfft(spectrum * response[:, None], size, axis=0)[beside : beside + count]


def blur_views(
    views: np.ndarray, spread_mm: float, pixel_mm: float, round_aperture: bool
) -> np.ndarray:
    """Blur each sub-aperture view (v, u, t, s); its outermost pixels continue beyond the border.

    The spread is wavelength times distance over the aperture's width.
    """
    beside = math.ceil(min(BORDER * spread_mm / pixel_mm, VIEW_BORDER)) + 1
    sizes = [scipy.fft.next_fast_len(n + 2 * beside, real=True) for n in views.shape[2:]]
    border = [(beside, m - n - beside) for m, n in zip(sizes, views.shape[2:], strict=True)]
    inner = tuple(slice(beside, beside + n) for n in views.shape[2:])
    passed = _response(sizes, spread_mm, (pixel_mm, pixel_mm), round_aperture)
    out = np.empty(views.shape, np.float32)
    for view in np.ndindex(views.shape[:2]):
        spectrum = scipy.fft.rfft2(np.pad(views[view].astype(np.float64), border, "edge"))
        blurred = scipy.fft.irfft2(spectrum * passed, sizes)[inner]
        # Rounding of the Fourier transform must not make dark pixels negative.
        out[view] = blurred.clip(views[view].min(), views[view].max())
    return out


def share_leaving_square(spread_mm: float, side_mm: float, round_aperture: bool) -> float:
    """Fraction of the light of a uniformly lit square that diffraction moves out of it.

    It bounds the change of the mean over the square, relative to the range of the light: the loss
    if all is bright inside and dark outside. Each axis is taken alone: for a round aperture this
    is up to a seventh too much.
    """
    ratio = spread_mm / side_mm
    if ratio == 0:
        return 0.0
    if ratio < 1e-4:  # the limit of a small spread, of a round aperture at most
        lost = ratio / math.pi**2 * (math.log(2 * math.pi) - math.log(ratio) + 1 + np.euler_gamma)
        return 1 - (1 - (4 / math.pi if round_aperture else 1) * lost) ** 2
    transfer = _round_transfer if round_aperture else _triangle
    cycles = np.linspace(0, 1 / ratio, 16 * math.ceil(1 / ratio + 16) + 1)
    passed = transfer(cycles * ratio) * np.sinc(cycles) ** 2
    return 1 - (2 * scipy.integrate.simpson(passed, x=cycles)) ** 2


def _response(counts, spread_mm: float, cell_mm, round_aperture: bool) -> np.ndarray:
    """Transfer factor at each frequency of a real transform in two dimensions.

    The smooth aliases of a round aperture's come from a coarse grid. Compared with a pattern of
    many aliases cells are large, their edges straight: there it is taken along each axis alone.
    """
    if not round_aperture or max(_aliases(spread_mm, x) for x in cell_mm) > MOST_ALIASES:
        transfer = _round_transfer if round_aperture else _triangle
        rows, columns = _along_axes(counts, spread_mm, cell_mm, transfer)
        return _mirrored(rows[:, None] * columns, counts[0])
    ratios = [spread_mm / cell for cell in cell_mm]

    def passed(y: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Fraction transmitted at frequencies in cycles per cell along y and along x."""
        tall, wide = (y * ratios[0])[:, None], (x * ratios[1])[None, :]
        boxes = (np.sinc(y) ** 2)[:, None] * np.sinc(x) ** 2
        return _round_transfer(np.hypot(tall, wide)) * boxes

    coarse = np.linspace(0, 0.5, COARSE_FREQUENCIES)
    folded = np.zeros((coarse.size, coarse.size))
    most = [_aliases(spread_mm, cell) for cell in cell_mm]
    for i in range(-most[0], most[0] + 1):
        for j in range(-most[1], most[1] + 1):
            if i or j:
                folded += passed(coarse + i, coarse + j)
    y, x = (scipy.fft.rfftfreq(count) for count in counts)
    half = passed(y, x) + scipy.interpolate.RectBivariateSpline(coarse, coarse, folded)(y, x)
    return _mirrored(half, counts[0])


def _along_axes(counts, spread_mm: float, cell_mm, transfer) -> list[np.ndarray]:
    """Transfer factors along each axis, from frequency 0 up, for a separable pattern."""
    coarse, found = np.linspace(0, 0.5, COARSE_FREQUENCIES), []
    for count, cell in zip(counts, cell_mm, strict=True):
        if spread_mm < FINEST * cell:
            found.append(np.ones(count // 2 + 1))
            continue
        aliases = np.arange(1, _aliases(spread_mm, cell) + 1)
        cycles = coarse[:, None] + np.concatenate([-aliases, aliases])
        passed = transfer(np.abs(cycles) * (spread_mm / cell)) * np.sinc(cycles) ** 2
        folded = scipy.interpolate.CubicSpline(coarse, passed.sum(axis=1))
        here = scipy.fft.rfftfreq(count)
        found.append(transfer(here * (spread_mm / cell)) * np.sinc(here) ** 2 + folded(here))
    return found


def _mirrored(half: np.ndarray, count: int) -> np.ndarray:
    """Append the negative frequencies of the first axis."""
    return np.concatenate([half, half[(count - 1) // 2 : 0 : -1]])


def _aliases(spread_mm: float, cell_mm: float) -> int:
    """Count the multiples of the sampling frequency that the transfer function reaches a side."""
    return math.ceil(cell_mm / spread_mm + 0.5)


def _triangle(q: np.ndarray) -> np.ndarray:
    """Transfer function of a square aperture at frequencies times its spread (Goodman, 6.3)."""
    return np.maximum(1 - q, 0)


def _round_transfer(q: np.ndarray) -> np.ndarray:
    """Transfer function of a round aperture at frequencies times its spread (Goodman, 6.3)."""
    inside = np.minimum(q, 1)
    return 2 / np.pi * (np.arccos(inside) - inside * np.sqrt(1 - inside**2))
