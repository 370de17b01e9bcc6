"""Photographs on surfaces, rendered by a separate program, and the true slope of each pixel.

A surface has a slope d(p) at each place p of the central view, and view (v, u) shows that place at
``p + d(p) (v, u)``. The renderer inverts this for 3 x 3 samples of each pixel, keeps the nearest
surface (the smallest slope) that covers the place it finds, and reads that surface's photograph
there. It shares nothing with the package's simulator: the truth is the geometry of these surfaces.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from io import BytesIO

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter, map_coordinates
from skimage import data

SIZE = (128, 160)
"""Number of pixels of a view, (t, s)."""

REPORTED = ("coffee", "camera", "brick", "grass", "retina", "moon", "stereo_motorcycle")
"""Photographs of scikit-image; the library's numbers were chosen on others."""

Points = tuple[np.ndarray, np.ndarray]

WALL = ("bar", 0.0, 0.0, np.inf, np.inf, 0.0)


@dataclass(frozen=True, eq=False)
class Surface:
    """Photograph on a surface; places (y, x) are in pixels from the middle of the central view."""

    picture: np.ndarray  # (h, w), from 0 to 1; repeated by reflection
    at: float  # slope at the middle
    gradient: tuple[float, float] = (0.0, 0.0)  # change of the slope per pixel
    bumps: tuple = ()  # of the slope: (height, y, x, radius)
    shape: tuple = WALL  # "bar" or "ellipse", y, x, half height, half width, angle
    place: tuple = (0.0, 0.0, 1.0, 0.0)  # of the photograph: origin (y, x), scale, angle
    shadows: tuple = ()  # on the surface: (strength, y, x, radius)
    gloss: tuple = ()  # mirror images at another slope: (strength, y, x, radius, slope)

    def slope(self, y: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Slope at places of the central view."""
        slope = self.at + self.gradient[0] * y + self.gradient[1] * x
        for height, *where in self.bumps:
            slope = slope + height * _spot(y, x, *where)
        return slope

    def places(self, y: np.ndarray, x: np.ndarray, v: float, u: float) -> Points:
        """Places of the central view that view (v, u) shows at (y, x)."""
        # The slope of a plane at the place is d(y, x) / (1 + gradient . (v, u)).
        slope = self.slope(y, x) / (1 + self.gradient[0] * v + self.gradient[1] * u)
        for _ in range(8 if self.bumps else 0):  # a fixed-point iteration
            slope = self.slope(y - slope * v, x - slope * u)
        return y - slope * v, x - slope * u

    def near(self, y: np.ndarray, x: np.ndarray, v: float, u: float) -> np.ndarray:
        """Whether view (v, u) may show the surface at (y, x): its slope varies by less than 1."""
        _, row, column, height, width, _ = self.shape
        slope, reach = self.slope(row, column), np.hypot(height, width) + np.hypot(v, u) + 1
        return (y - row - slope * v) ** 2 + (x - column - slope * u) ** 2 < reach**2

    def covers(self, y: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Whether the surface covers places of the central view."""
        kind, row, column, height, width, angle = self.shape
        down, across = _turned(y - row, x - column, angle)
        if kind == "ellipse":
            return (down / height) ** 2 + (across / width) ** 2 < 1
        return (np.abs(down) < height) & (np.abs(across) < width)

    def light(self, y: np.ndarray, x: np.ndarray, v: float, u: float) -> np.ndarray:
        """Radiance that view (v, u) receives from places of the central view."""
        *origin, scale, angle = self.place
        down, across = _turned(scale * y, scale * x, angle)
        at = [down + origin[0], across + origin[1]]
        light = map_coordinates(self.picture, at, order=1, mode="mirror")
        for strength, *where in self.shadows:
            light = light * (1 - strength * _spot(y, x, *where))
        for strength, *where, slope in self.gloss:
            moved = slope - self.slope(y, x)  # displacement of a highlight on the surface
            light = light + strength * _spot(y - moved * v, x - moved * u, *where)
        return light


def _spot(y, x, row: float, column: float, radius: float) -> np.ndarray:
    """Smooth spot of height 1, and 0 beyond its radius."""
    return np.maximum(1 - ((y - row) ** 2 + (x - column) ** 2) / radius**2, 0) ** 2


def _turned(y, x, angle: float) -> Points:
    return np.cos(angle) * y + np.sin(angle) * x, np.cos(angle) * x - np.sin(angle) * y


def _surface(rng, pictures, at: float, **more) -> Surface:
    picture = pictures[rng.integers(len(pictures))]
    origin = [rng.uniform(0.25, 0.75) * n for n in picture.shape]
    place = (*origin, rng.uniform(0.9, 1.6), rng.uniform(-0.5, 0.5))
    return Surface(picture, at, place=place, **more)


def _inside(rng) -> tuple[float, float]:
    return tuple(rng.uniform(-0.42, 0.42, 2) * SIZE)


def _cards(rng, pictures, count, kind, at, height, width, tilt=0.0) -> list[Surface]:
    """Bars or ellipses at random places, their numbers drawn from ranges."""
    cards = []
    for _ in range(count):
        slope, gradient = rng.uniform(*at), tilt * rng.uniform(-1, 1, 2) if tilt else (0.0, 0.0)
        middle, size = _inside(rng), (rng.uniform(*height), rng.uniform(*width))
        shape = (kind, *middle, *size, rng.uniform(0, 3))
        cards.append(_surface(rng, pictures, slope, gradient=gradient, shape=shape))
    return cards


def planes(rng, pictures) -> list[Surface]:
    """Slanted wall with slanted cards before it."""
    wall = _surface(rng, pictures, rng.uniform(0.6, 1.0), gradient=0.005 * rng.uniform(-1, 1, 2))
    return [wall, *_cards(rng, pictures, 3, "bar", (-1.2, -0.3), (16, 40), (16, 40), 0.004)]


def curved(rng, pictures) -> list[Surface]:
    """Wavy wall with round things before it."""
    bumps = [(rng.uniform(-0.4, 0.4), *_inside(rng), rng.uniform(40, 80)) for _ in range(4)]
    surfaces = [_surface(rng, pictures, 0.6, gradient=0.003 * rng.uniform(-1, 1, 2), bumps=bumps)]
    for at in rng.uniform(-0.9, -0.5, 2):
        middle, radius = _inside(rng), rng.uniform(18, 34)
        bumps = [(rng.uniform(-0.6, -0.3), *middle, 1.4 * radius)]
        shape = ("ellipse", *middle, radius, radius * rng.uniform(0.7, 1), 0.0)
        surfaces.append(_surface(rng, pictures, at, bumps=bumps, shape=shape))
    return surfaces


def thin(rng, pictures) -> list[Surface]:
    """Wall behind bars of 2 to 6 pixels."""
    bars = _cards(rng, pictures, 8, "bar", (-1.4, 0.0), (1, 3), (30, 90))
    at, gradient = rng.uniform(0.6, 1.2), 0.003 * rng.uniform(-1, 1, 2)
    return [_surface(rng, pictures, at, gradient=gradient), *bars]


def occluded(rng, pictures) -> list[Surface]:
    """Wall behind twenty leaves at many slopes."""
    leaves = _cards(rng, pictures, 20, "ellipse", (-1.6, 1.0), (8, 26), (8, 26), 0.004)
    return [_surface(rng, pictures, rng.uniform(1.2, 1.6)), *leaves]


def mixed(rng, pictures) -> list[Surface]:
    """Wavy wall, round things, a card, leaves and bars."""
    some = [*curved(rng, pictures), planes(rng, pictures)[1]]
    return [*some, *occluded(rng, pictures)[1:5], *thin(rng, pictures)[1:4]]


def shadowed(rng, pictures) -> list[Surface]:
    """Mixed scene with deep, soft shadows."""

    def shadow() -> tuple:
        return rng.uniform(0.5, 0.9), *_inside(rng), rng.uniform(15, 60)

    return [replace(x, shadows=[shadow() for _ in range(3)]) for x in mixed(rng, pictures)]


def glossy(rng, pictures) -> list[Surface]:
    """Mixed scene with highlights that glide over the wall and the things."""

    def highlight(at: float) -> tuple:
        return rng.uniform(0.2, 0.6), *_inside(rng), rng.uniform(6, 18), at + rng.uniform(0.4, 1)

    return [replace(x, gloss=[highlight(x.at) for _ in range(4)]) for x in mixed(rng, pictures)]


@dataclass(frozen=True)
class Kind:
    """Kind of scene, and how its views are taken."""

    draw: Callable[[np.random.Generator, list], list[Surface]]
    views: int = 9  # along each axis
    noise: float = 0.003  # standard deviation, relative to white
    jpeg: int = 0  # quality of the compression; 0: none
    uneven: float = 0.0  # largest loss of light at the rim; the views' gains vary by a fifth of it
    smooth: bool = False  # large shapes of the photographs, and 3 % of their texture
    transparent: bool = False  # the mean of two scenes: no pixel has one slope


KINDS: Mapping[str, Kind] = {
    "slanted planes": Kind(planes),
    "curved surfaces": Kind(curved),
    "thin things": Kind(thin),
    "occlusions": Kind(occluded),
    "smooth shading": Kind(shadowed, smooth=True),
    "shadow": Kind(shadowed),
    "gloss": Kind(glossy),
    "noise": Kind(mixed, noise=0.02),
    "JPEG": Kind(mixed, jpeg=85),
    "uneven views": Kind(mixed, uneven=0.15),
    "5 x 5 views": Kind(mixed, views=5),
    "15 x 15 views": Kind(mixed, views=15),
    "transparent": Kind(curved, transparent=True),
}


def photographs() -> list[np.ndarray]:
    """Photographs in grey, from 0 to 1."""
    found = (getattr(data, name)() for name in REPORTED)
    found = (one[0] if isinstance(one, tuple) else one for one in found)
    return [np.atleast_3d(one / 255).mean(axis=2) for one in found]


def make_sample(kind: Kind, seed: int, pictures: list[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Draw a scene and render it: views uint8 [v, u, t, s], slopes [t, s]; NaN: no one slope."""
    rng = np.random.default_rng(seed)
    steps = np.arange(kind.views) - (kind.views - 1) / 2
    if kind.smooth:
        pictures = [gaussian_filter(x, 12) + 0.03 * (x - gaussian_filter(x, 3)) for x in pictures]
    scenes = [kind.draw(rng, pictures) for _ in range(1 + kind.transparent)]
    views = np.mean([[[render_view(one, v, u) for u in steps] for v in steps] for one in scenes], 0)
    v, u = np.meshgrid(steps / steps[-1], steps / steps[-1], indexing="ij")
    v, u = v[..., None, None], u[..., None, None]
    t, s = np.linspace(-1, 1, SIZE[0])[:, None], np.linspace(-1, 1, SIZE[1])
    views *= 1 - kind.uneven * ((v + t) ** 2 + (u + s) ** 2) / 8
    views *= 1 + kind.uneven / 5 * rng.standard_normal(v.shape)
    views += kind.noise * rng.standard_normal(views.shape)
    views = np.uint8(np.rint(255 * np.clip(views, 0, 1)))
    if kind.jpeg:
        views = np.array([[_compressed(view, kind.jpeg) for view in row] for row in views])
    return views, np.full(SIZE, np.nan) if kind.transparent else true_slopes(scenes[0])


def render_view(surfaces: list[Surface], v: float, u: float) -> np.ndarray:
    """Radiance of each pixel of a view, as the mean of samples."""
    y, x = (line.ravel() for line in _grid(3))
    nearest, light = np.full(y.shape, np.inf), np.zeros(y.shape)
    for surface in surfaces:
        some = np.flatnonzero(surface.near(y, x, v, u))
        at = surface.places(y[some], x[some], v, u)
        slope = np.where(surface.covers(*at), surface.slope(*at), np.inf)
        seen = slope < nearest[some]
        nearest[some[seen]] = slope[seen]
        light[some[seen]] = surface.light(at[0][seen], at[1][seen], v, u)
    return light.reshape(SIZE[0], 3, SIZE[1], 3).mean(axis=(1, 3))


def true_slopes(surfaces: list[Surface]) -> np.ndarray:
    """Slope of the nearest surface at the middle of each pixel of the central view."""
    y, x = _grid(1)
    return np.min([np.where(one.covers(y, x), one.slope(y, x), np.inf) for one in surfaces], axis=0)


def _grid(samples: int) -> Points:
    """Places of the samples of a view, from its middle, in pixels."""
    lines = [(np.arange(n * samples) + 0.5) / samples - n / 2 for n in SIZE]
    return tuple(np.meshgrid(*lines, indexing="ij"))


def _compressed(view: np.ndarray, quality: int) -> np.ndarray:
    file = BytesIO()
    Image.fromarray(view).save(file, "JPEG", quality=quality)
    return np.asarray(Image.open(file))
