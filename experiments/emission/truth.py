"""Light fields of flames along rays that are written out here, and what each depth truly emits.

Nothing of the package is used. A thin lens of focal length f focuses a plane at the distance a on
lenslets at the distance i, 1/f = 1/a + 1/i; they are pitch (1 + f_lenslet / i) apart as
micro-images of N pixels. View v therefore looks through the place ``x = (v - centre) step`` of the
lens, step = (i + f_lenslet) pitch / (N f_lenslet); lenslet t sees ``y = (t - centre) pitch a / i``
of the plane in focus. A ray meets the depth d behind that plane at ``y + (y - x) d / a``. A pixel
is the mean over its square lenslet and its square of the lens.
Lengths are in mm; y runs down, x to the right, depth away from the camera.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
from numpy.polynomial.legendre import leggauss
from scipy.special import erf


@dataclass(frozen=True)
class Lens:
    """A plenoptic camera; the defaults are the optics of the paper."""

    views: int = 7
    lenslets: tuple[int, int] = (72, 84)
    focal: float = 150.0
    focus: float = 326.0
    lenslet_focal: float = 0.4
    pitch: float = 0.112

    @property
    def image(self) -> float:
        """Distance of the lenslets behind the lens."""
        return 1 / (1 / self.focal - 1 / self.focus)

    @property
    def cell(self) -> float:
        """Side of a lenslet's picture in the plane in focus."""
        return self.pitch * self.focus / self.image

    @property
    def step(self) -> float:
        """Distance of neighbouring views' places on the lens."""
        return (self.image + self.lenslet_focal) * self.pitch / (self.views * self.lenslet_focal)

    def numbers(self) -> dict:
        """Arguments with which `lf_flame.PlenopticCamera` is this camera."""
        lengths = self.focal, self.focus, self.lenslet_focal, self.pitch
        names = "main_lens_focal_mm", "focus_distance_mm", "lenslet_focal_mm", "lenslet_pitch_mm"
        return dict(zip(names, lengths, strict=True)) | {
            "views": self.views,
            "lenslets": self.lenslets,
        }


def _places(count: int, nodes: np.ndarray) -> np.ndarray:
    """Gauss-Legendre nodes in elements of width 1 about 0, shape (elements, nodes)."""
    return np.arange(count)[:, None] - (count - 1) / 2 + nodes / 2


@dataclass(frozen=True)
class Sheet:
    """A glow of ``peak exp(-((y - y0) / sy)^2 - ((x - x0) / sx)^2)`` at one depth."""

    depth: float
    middle: tuple[float, float]
    width: tuple[float, float]
    peak: float = 1.0


def _line(lens: Lens, sheet: Sheet, axis: int) -> np.ndarray:
    """Mean of a Gaussian over each pixel along an axis, shape (views, lenslets)."""
    nodes, weights = leggauss(6)
    y = lens.cell * _places(lens.lenslets[axis], nodes)[:, None]
    x = lens.step * _places(lens.views, nodes)[:, None, :, None]
    place = y + (y - x) * sheet.depth / lens.focus
    glow = np.exp(-(((place - sheet.middle[axis]) / sheet.width[axis]) ** 2))
    return glow @ weights @ weights / 4


def record(lens: Lens, sheets: Sequence[Sheet]) -> np.ndarray:
    """Give the views of sheets whose light adds, float64, shape (v, u, t, s)."""
    lines = ((one.peak * _line(lens, one, 0), _line(lens, one, 1)) for one in sheets)
    return sum(down[:, None, :, None] * across[None, :, None, :] for down, across in lines)


def cells(lens: Lens, sheet: Sheet, depth: float | None = None) -> np.ndarray:
    """Mean of a sheet over the cells of a plane at a depth, by default its own."""
    lines = []
    for count, middle, width in zip(lens.lenslets, sheet.middle, sheet.width, strict=True):
        edges = (np.arange(count + 1) - count / 2) * lens.cell
        edges = edges * (1 + (sheet.depth if depth is None else depth) / lens.focus)
        whole = np.sqrt(np.pi) / 2 * width * erf((edges - middle) / width)
        lines.append(np.diff(whole) / np.diff(edges))
    return sheet.peak * np.outer(*lines)


@dataclass(frozen=True, eq=False)
class Slab:
    """Matter at one depth, within a box (least y, largest y, least x, largest x).

    At places y (a column) and x (a row) the light gives what it would emit if it absorbed nothing,
    and its optical thickness, shapes (y, x) or (y, x, wavelengths).
    """

    depth: float
    light: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray | float]]
    box: tuple[float, float, float, float] = (-np.inf, np.inf, -np.inf, np.inf)


def trace(
    lens: Lens, matter: Sequence[Slab], spots: int = 2, parts: int = 2, where=None, channels=()
) -> np.ndarray:
    """Follow rays through slabs; gives views, float64, shape (v, u, t, s, *channels).

    A pixel is a sum over spots x spots places of its lenslet and parts x parts of its square of the
    lens; views outside the mask `where` are 0. Of its glow a slab adds ``(1 - exp(-tau)) / tau``,
    attenuated by exp(-tau) of all slabs nearer to the camera.
    """
    nodes, weights = leggauss(spots)
    y, x = (lens.cell * _places(count, nodes).ravel() for count in lens.lenslets)
    nodes, shares = leggauss(parts)
    pupil = lens.step * _places(lens.views, nodes)
    where = np.ones((lens.views, lens.views), bool) if where is None else where
    views = np.zeros((*where.shape, *lens.lenslets, *channels))
    for v, u in np.argwhere(where):
        for i, j in np.ndindex(parts, parts):
            light, before = np.zeros((2, y.size, x.size, *channels))
            for slab in sorted(matter, key=lambda one: one.depth):
                far = slab.depth / lens.focus
                down, right = y + (y - pupil[v, i]) * far, x + (x - pupil[u, j]) * far
                rows = slice(*np.searchsorted(down, slab.box[:2]))
                columns = slice(*np.searchsorted(right, slab.box[2:]))
                glow, tau = slab.light(down[rows, None], right[None, columns])
                own = -np.expm1(-tau) / tau if np.any(tau) else 1.0
                light[rows, columns] += glow * own * np.exp(-before[rows, columns])
                before[rows, columns] += tau
            pixels = light.reshape(lens.lenslets[0], spots, lens.lenslets[1], spots, *channels)
            mean = np.einsum("tisj...,i,j->ts...", pixels, weights / 2, weights / 2)
            views[v, u] += mean * shares[i] * shares[j] / 4
    return views


def on_planes(lens: Lens, matter: Sequence[Slab], depths: Sequence[float]) -> np.ndarray:
    """Give the mean glow of slabs on the nearest plane's cells, shape (planes, rows, columns)."""
    nodes, weights = leggauss(6)
    planes = np.zeros((len(depths), *lens.lenslets))
    for slab in matter:
        nearest = int(np.argmin(np.abs(np.subtract(depths, slab.depth))))
        side = lens.cell * (1 + depths[nearest] / lens.focus)
        y, x = (side * _places(count, nodes).ravel() for count in lens.lenslets)
        glow = slab.light(y[:, None], x[None])[0].reshape(lens.lenslets[0], 6, -1, 6)
        planes[nearest] += np.einsum("tisj,i,j->ts", glow, weights, weights) / 4
    return planes


def volume(glow: Callable[..., np.ndarray], reach: float, step: float, box=Slab.box) -> list[Slab]:
    """Cut a flame that glows by ``glow(y, x, z)`` per mm into slabs."""
    middles = (np.arange(round(2 * reach / step)) + 0.5) * step - reach
    return [Slab(z, lambda y, x, z=z: (step * glow(y, x, z), 0.0), box) for z in middles]


def _burner(up: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Inside or not, b and c by share of the height; R(r) = (1 + c (r/b)^2) exp(-(r/b)^2)."""
    inside = (up > 0) & (up < 1)
    h = np.where(inside, up, 0.5)
    return inside, radius * np.sqrt(1 - h) * (0.6 + 1.2 * h), 3 * (1 - h)


def round_glow(up: np.ndarray, r: np.ndarray, radius: float) -> np.ndarray:
    """Emission R(r) of an axisymmetric flame per mm, by share of its height."""
    inside, b, c = _burner(up, radius)
    return inside * (1 + c * (r / b) ** 2) * np.exp(-((r / b) ** 2))


def burner_sheet(depth: float, height: float, radius: float, foot: float, across: float) -> Slab:
    """Put such a flame, which rises from y = `foot` and is fainter there, all at one depth."""

    def light(y, x):
        up = (foot - y) / height
        inside, b, c = _burner(up, radius)
        q = ((x - across) / b) ** 2
        lit = inside * (1 - 0.85 * np.exp(-((up / 0.15) ** 2)))
        return lit * np.sqrt(np.pi) * b * np.exp(-q) * (1 + c * (q + 0.5)), 0.0

    return Slab(depth, light, (foot - height, foot, across - 3.2 * radius, across + 3.2 * radius))


def planck(nm: np.ndarray | float, kelvin: np.ndarray | float) -> np.ndarray:
    """Radiance of a black body in W / (m^2 sr nm)."""
    return 1.191042972397188e20 / nm**5 / np.expm1(1.4387768775e7 / (nm * kelvin))


class Soot:
    """Soot by its absorption per mm at 600 nm and temperature, at places and heights."""

    steps, reach, box = 40, 0.0, Slab.box
    absorption: Callable[..., np.ndarray]
    kelvin: Callable[..., np.ndarray]

    def place(self, x: np.ndarray, z: float) -> np.ndarray:
        """Place of a point across and in depth; by default its radius."""
        return np.hypot(x, z)

    def slabs(self, nm: np.ndarray, exponent: float = 1.0) -> list[Slab]:
        """Slabs whose glow and thickness have a value for each wavelength."""
        nm, step = np.asarray(nm, float), 2 * self.reach / self.steps

        def light(y, x, z):
            place = self.place(x, z)
            tau = step * self.absorption(place, -y)[..., None] * (600 / nm) ** exponent + 1e-300
            return tau * planck(nm, self.kelvin(place, -y)[..., None]), tau

        middles = (np.arange(self.steps) + 0.5) * step - self.reach
        return [Slab(z, partial(light, z=z), self.box) for z in middles]


@dataclass(frozen=True)
class SootFlame(Soot):
    """A hollow sooty flame about the middle of the field.

    Largest optical thickness through the axis at 600 nm; extent in depth relative to that across;
    soot on the axis relative to the shell's.
    """

    thickness: float = 0.5
    radius: float = 2.4
    height: float = 7.0
    depth_ratio: float = 1.0
    core: float = 0.15

    @property
    def reach(self) -> float:  # type: ignore[override]
        """Extent in depth."""
        return 1.5 * self.radius * self.depth_ratio

    @property
    def box(self) -> tuple[float, float, float, float]:  # type: ignore[override]
        """Extent in y and x."""
        half, side = self.height / 2, 1.5 * self.radius
        return -half, half, -side, side

    def place(self, x: np.ndarray, z: float) -> np.ndarray:
        """Radius in a flame that is stretched in depth."""
        return np.hypot(x, z / self.depth_ratio)

    def _soot(self, r, up):
        inside = (np.abs(up) < self.height / 2) & (r < 2 * self.radius)
        h = np.where(inside, up / self.height + 0.5, 0.5)
        x = r / self.radius / (0.6 + 0.8 * h - 1.1 * h * h)
        shell = np.exp(-(((x - 0.75) / 0.3) ** 2)) + self.core * np.exp(-((x / 0.5) ** 2))
        return inside * shell * np.sin(np.pi * h) ** 1.5

    @cached_property
    def _scale(self) -> float:
        r, up = np.linspace(0, 2 * self.radius, 1001), np.linspace(-0.5, 0.5, 201)[:, None]
        return self.thickness / (2 * np.trapezoid(self._soot(r, up * self.height), r).max())

    def absorption(self, r: np.ndarray, up: np.ndarray) -> np.ndarray:
        """Absorption by radius."""
        return self._scale * self._soot(r, up)

    def kelvin(self, r: np.ndarray, up: np.ndarray) -> np.ndarray:
        """Temperature: 160 K hotter outside than on the axis, and cooler with height."""
        r, h = r / self.radius, up / self.height + 0.5
        return 1900.0 - 200.0 * h + 80.0 * np.tanh(3 * (r - 0.6))
