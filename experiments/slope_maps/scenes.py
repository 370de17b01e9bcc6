"""Photographs on surfaces, rendered by a program of its own, and the slope of each pixel.

A surface has a slope d(p) at each place p of the central view. View (v, u) shows that place at
``p + d(p) (v, u)``. The renderer inverts this for every sample of a view, keeps the nearest surface
(the smallest slope) that covers the place it finds, reads that surface's photograph there, and
averages 3 x 3 samples for each pixel. It shares nothing with the package's simulator: the truth is
the geometry of these surfaces.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from io import BytesIO

import numpy as np
from PIL import Image
from scipy.ndimage import map_coordinates
from skimage import data

SIZE = (128, 160)
"""Number of pixels of a view, (t, s)."""

SAMPLES = 3
"""Number of samples along each axis of a pixel."""

SLOPES = (-2.0, 2.0)
"""Range of the slopes of all surfaces."""

TUNED = ("astronaut", "chelsea", "coins", "gravel", "rocket")
REPORTED = ("coffee", "camera", "brick", "grass", "retina", "moon", "stereo_motorcycle")
"""Photographs of scikit-image on which the method's numbers were chosen, and on which it is
measured."""

TURNS = 8
"""Number of steps of the fixed-point iteration that finds a place on a curved surface."""

Points = tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True, eq=False)
class Surface:
    """Photograph on a surface.

    Attributes
    ----------
    picture : ndarray of float, shape (h, w)
        Photograph, from 0 to 1; repeated by reflection.
    at : float
        Slope at the origin, the middle of the image.
    gradient : (float, float)
        Change of the slope per pixel down and to the right.
    bumps : list of (height, y, x, radius)
        Bumps of the slope.
    shape : tuple
        Empty for a wall; ("ellipse" or "bar", y, x, half height, half width, angle).
    place : (float, float, float, float)
        Origin (y, x), scale in pixels of the photograph per pixel, and angle of the photograph.
    shadows : list of (strength, y, x, radius)
        Soft shadows on the surface.
    gloss : list of (strength, y, x, radius, slope)
        Highlights, mirror images at another slope than the surface.
    """

    picture: np.ndarray
    at: float
    gradient: tuple[float, float] = (0.0, 0.0)
    bumps: list = field(default_factory=list)
    shape: tuple = ()
    place: tuple[float, float, float, float] = (0.0, 0.0, 1.0, 0.0)
    shadows: list = field(default_factory=list)
    gloss: list = field(default_factory=list)

    def slope(self, y: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Slope at places of the central view."""
        slope = self.at + self.gradient[0] * y + self.gradient[1] * x
        for height, *where in self.bumps:
            slope = slope + height * _spot(y, x, *where)
        return slope

    def places(self, y: np.ndarray, x: np.ndarray, v: float, u: float) -> Points:
        """Places of the central view that view (v, u) shows at (y, x)."""
        # A plane's slope at the place is d(y, x) / (1 + gradient . (v, u)).
        slope = self.slope(y, x) / (1 + self.gradient[0] * v + self.gradient[1] * u)
        for _ in range(TURNS if self.bumps else 0):
            slope = self.slope(y - slope * v, x - slope * u)
        return y - slope * v, x - slope * u

    def near(self, y: np.ndarray, x: np.ndarray, v: float, u: float) -> np.ndarray:
        """Whether view (v, u) may show the surface at (y, x): its slope varies by less than 1."""
        if not self.shape:
            return np.ones(y.shape, bool)
        _, row, column, height, width, _ = self.shape
        slope, reach = self.slope(row, column), np.hypot(height, width) + np.hypot(v, u) + 1
        return (y - row - slope * v) ** 2 + (x - column - slope * u) ** 2 < reach**2

    def covers(self, y: np.ndarray, x: np.ndarray) -> np.ndarray:
        """Whether the surface covers places of the central view."""
        if not self.shape:
            return np.ones(y.shape, bool)
        kind, *middle, height, width, angle = self.shape
        down, across = _turned(y - middle[0], x - middle[1], angle)
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
            moved = slope - self.slope(y, x)  # how far a highlight glides over the surface
            light = light + strength * _spot(y - moved * v, x - moved * u, *where)
        return light


def _spot(y, x, row: float, column: float, radius: float) -> np.ndarray:
    """Smooth spot of height 1, and 0 beyond its radius."""
    return np.maximum(1 - ((y - row) ** 2 + (x - column) ** 2) / radius**2, 0) ** 2


def _turned(y, x, angle: float) -> Points:
    return np.cos(angle) * y + np.sin(angle) * x, np.cos(angle) * x - np.sin(angle) * y


@dataclass(frozen=True)
class Kind:
    """Scene of a kind, and how its views are taken.

    Attributes
    ----------
    draw : callable
        Function ``draw(rng, pictures)`` that gives the surfaces.
    views : int
        Number of views along each axis.
    noise : float
        Standard deviation of the noise, relative to white.
    jpeg : int
        Quality of JPEG compression, or 0 for none.
    uneven : float
        Largest loss of light at the rim of the aperture and the corners; a fifth of it is the
        standard deviation of the views' gains.
    transparent : bool
        Whether the views are the mean of those of two scenes; there is no one slope then.
    """

    draw: Callable[[np.random.Generator, list], list]
    views: int = 9
    noise: float = 0.003
    jpeg: int = 0
    uneven: float = 0.0
    transparent: bool = False


def _surface(rng, pictures, at: float, **more) -> Surface:
    picture = pictures[rng.integers(len(pictures))]
    origin = [rng.uniform(0.25, 0.75) * n for n in picture.shape]
    place = (*origin, rng.uniform(0.9, 1.6), rng.uniform(-0.5, 0.5))
    return Surface(picture, at, place=place, **more)


def _tilt(rng, largest: float) -> tuple[float, float]:
    return tuple(largest * rng.uniform(-1, 1, 2))


def _inside(rng) -> tuple[float, float]:
    return tuple(rng.uniform(-0.42, 0.42, 2) * SIZE)


def planes(rng, pictures) -> list[Surface]:
    """Slanted wall with slanted cards before it."""
    wall = _surface(rng, pictures, rng.uniform(0.6, 1.0), gradient=_tilt(rng, 0.005))
    cards = [
        _surface(
            rng, pictures, rng.uniform(-1.2, -0.3), gradient=_tilt(rng, 0.004),
            shape=("bar", *_inside(rng), *rng.uniform(16, 40, 2), rng.uniform(0, 3)),
        )
        for _ in range(3)
    ]  # fmt: skip
    return [wall, *cards]


def curved(rng, pictures) -> list[Surface]:
    """Wavy wall with round things before it."""
    bumps = [(rng.uniform(-0.4, 0.4), *_inside(rng), rng.uniform(40, 80)) for _ in range(4)]
    wall = _surface(rng, pictures, 0.6, gradient=_tilt(rng, 0.003), bumps=bumps)
    things = []
    for at in rng.uniform(-0.9, -0.5, 2):
        middle, radius = _inside(rng), rng.uniform(18, 34)
        bump = (rng.uniform(-0.6, -0.3), *middle, 1.4 * radius)
        shape = ("ellipse", *middle, radius, radius * rng.uniform(0.7, 1), 0.0)
        things.append(_surface(rng, pictures, at, bumps=[bump], shape=shape))
    return [wall, *things]


def thin(rng, pictures) -> list[Surface]:
    """Wall behind bars of 2 to 6 pixels."""
    bars = [
        _surface(
            rng, pictures, rng.uniform(-1.4, 0.0),
            shape=("bar", *_inside(rng), rng.uniform(1, 3), rng.uniform(30, 90), rng.uniform(0, 3)),
        )
        for _ in range(8)
    ]  # fmt: skip
    return [_surface(rng, pictures, rng.uniform(0.6, 1.2), gradient=_tilt(rng, 0.003)), *bars]


def occluded(rng, pictures) -> list[Surface]:
    """Wall behind twenty leaves at many slopes."""
    leaves = [
        _surface(
            rng, pictures, rng.uniform(-1.6, 1.0), gradient=_tilt(rng, 0.004),
            shape=("ellipse", *_inside(rng), *rng.uniform(8, 26, 2), rng.uniform(0, 3)),
        )
        for _ in range(20)
    ]  # fmt: skip
    return [_surface(rng, pictures, rng.uniform(1.2, 1.6)), *leaves]


def mixed(rng, pictures) -> list[Surface]:
    """Wavy wall, a card, round things, leaves and bars."""
    wall, *things = curved(rng, pictures)
    return [wall, *things, planes(rng, pictures)[1], *occluded(rng, pictures)[1:5],
            *thin(rng, pictures)[1:4]]  # fmt: skip


def shadowed(rng, pictures) -> list[Surface]:
    """Mixed scene with deep, soft shadows."""
    return [
        replace(one, shadows=[
            (rng.uniform(0.5, 0.9), *_inside(rng), rng.uniform(15, 60)) for _ in range(3)
        ])
        for one in mixed(rng, pictures)
    ]  # fmt: skip


def glossy(rng, pictures) -> list[Surface]:
    """Mixed scene with highlights that glide over the wall and the things."""
    return [
        replace(one, gloss=[
            (rng.uniform(0.2, 0.6), *_inside(rng), rng.uniform(6, 18), one.at + rng.uniform(0.4, 1))
            for _ in range(4)
        ])
        for one in mixed(rng, pictures)
    ]  # fmt: skip


KINDS: Mapping[str, Kind] = {
    "slanted planes": Kind(planes),
    "curved surfaces": Kind(curved),
    "thin things": Kind(thin),
    "occlusions": Kind(occluded),
    "shadow": Kind(shadowed),
    "gloss": Kind(glossy),
    "noise": Kind(mixed, noise=0.02),
    "JPEG": Kind(mixed, jpeg=85),
    "uneven views": Kind(mixed, uneven=0.15),
    "5 x 5 views": Kind(mixed, views=5),
    "15 x 15 views": Kind(mixed, views=15),
    "transparent": Kind(curved, transparent=True),
}


@dataclass(frozen=True, eq=False)
class Sample:
    """Light field and its true slopes.

    Attributes
    ----------
    views : ndarray of uint8, shape (v, u, t, s)
    slopes : ndarray of float64, shape (t, s)
        Slope of the surface at the middle of each pixel of the central view; NaN without one.
    """

    views: np.ndarray
    slopes: np.ndarray


def photographs(names: tuple[str, ...] = REPORTED) -> list[np.ndarray]:
    """Photographs in grey, from 0 to 1."""
    pictures = []
    for name in names:
        picture = getattr(data, name)()
        picture = np.asarray(picture[0] if isinstance(picture, tuple) else picture, float) / 255
        pictures.append(picture if picture.ndim == 2 else picture.mean(axis=2))
    return pictures


def make_sample(kind: Kind, seed: int, pictures: list[np.ndarray]) -> Sample:
    """Draw a scene, render its views and give its slopes."""
    rng = np.random.default_rng(seed)
    steps = np.arange(kind.views) - (kind.views - 1) / 2
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
    return Sample(views, np.full(SIZE, np.nan) if kind.transparent else true_slopes(scenes[0]))


def render_view(surfaces: list[Surface], v: float, u: float) -> np.ndarray:
    """Radiance of each pixel of a view, as the mean of samples."""
    y, x = (line.ravel() for line in _grid(SAMPLES))
    nearest, light = np.full(y.shape, np.inf), np.zeros(y.shape)
    for surface in surfaces:
        some = np.flatnonzero(surface.near(y, x, v, u))
        at = surface.places(y[some], x[some], v, u)
        slope = np.where(surface.covers(*at), surface.slope(*at), np.inf)
        seen = slope < nearest[some]
        nearest[some[seen]] = slope[seen]
        light[some[seen]] = surface.light(at[0][seen], at[1][seen], v, u)
    return light.reshape(SIZE[0], SAMPLES, SIZE[1], SAMPLES).mean(axis=(1, 3))


def true_slopes(surfaces: list[Surface]) -> np.ndarray:
    """Slope of the nearest surface at each pixel of the central view."""
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
