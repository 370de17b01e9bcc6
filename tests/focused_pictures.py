"""Raw pictures of focused plenoptic cameras, traced here, and their calibration files.

Nothing of the package is used. Lengths are in pixels of the sensor, from the optical axis. The main
lens is at the distance D in front of the lenslets, the sensor at the distance B behind them, and
the picture that the main lens forms at the distance a behind them (in front, if negative). A pixel
x under the lenslet c sees the place ``c + (x - c) a / B`` of that picture; the micro-image is
centred at ``c (1 + B / D)``. The picture is a sum of waves, so that the disc by which a lenslet
blurs it has a closed form.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.special import j1


@dataclass(frozen=True)
class Waves:
    """A picture ``1/2 + sum of cos``: waves of some lengths in all directions, from a seed."""

    lengths: tuple[float, float] = (16.0, 50.0)
    count: int = 16
    seed: int = 1

    def at(self, y, x, radius=0.0):
        """Light at places, mean over discs of a radius (one for each place)."""
        rng = np.random.default_rng(self.seed)
        light = np.full(np.shape(y), 0.5)
        radii, where = np.unique(radius, return_inverse=True)
        where = where.reshape(np.shape(radius))
        for _ in range(self.count):
            wave, angle = 2 * np.pi / rng.uniform(*self.lengths), rng.uniform(0, np.pi)
            phase = wave * (np.sin(angle) * y + np.cos(angle) * x) + rng.uniform(0, 2 * np.pi)
            light += np.cos(phase) * disc(wave * radii)[where] / 2 / self.count
        return light


def disc(radius):
    """Mean of a wave of one radian over a disc, in terms of the wave at its centre."""
    radius = np.maximum(radius, 1e-9)
    return 2 * j1(radius) / radius


@dataclass(frozen=True)
class Camera:
    """A camera with focused lenslets, hexagonal or square."""

    pitch: float = 23.3  # of the micro-images
    rotation: float = 0.012  # counter-clockwise
    offset: tuple[float, float] = (4.2, -3.1)  # right, up, of a lenslet of the first kind
    shape: tuple[int, int] = (320, 350)
    gap: float = 60.0  # B
    lens: float = 9000.0  # D
    hexagonal: bool = True
    blur: tuple[float, float, float] = (0.0, 0.0, 0.0)  # radius in a micro-image, by kind
    fall: float = 0.4  # of light at the rim of a micro-image
    columns: bool = False  # the array stands in straight columns

    @property
    def turn(self):
        """Matrix from (along, up) of the array to (down, right) of the sensor."""
        angle = self.rotation + (np.pi / 2 if self.columns else 0)
        cos, sin = np.cos(angle), np.sin(angle)
        return np.array([[-sin, -cos], [cos, -sin]])

    def nearest(self, y, x):
        """Centres (y, x) of the micro-images nearest to places, and the kinds of the lenslets."""
        up = np.sqrt(3) / 2 if self.hexagonal else 1.0
        origin = np.array([-self.offset[1], self.offset[0]])
        along, rise = np.tensordot(
            np.linalg.inv(self.turn), np.stack([y - origin[0], x - origin[1]]) / self.pitch, 1
        )
        best = np.full(np.shape(y), np.inf)
        found, kind = np.zeros((2, *np.shape(y))), np.zeros(np.shape(y), int)
        for step in (0, 1):
            row = np.floor(rise / up) + step
            shift = row / 2 if self.hexagonal else 0.0
            column = np.rint(along - shift)
            away = (along - column - shift) ** 2 + (rise - row * up) ** 2
            closer = away < best
            best = np.where(closer, away, best)
            place = np.tensordot(self.turn, np.stack([column + shift, row * up]), 1) * self.pitch
            found = np.where(closer, place + origin[:, None, None], found)
            # Two neighbouring steps of a triangle lead to the next lenslet of the same kind.
            kind = np.where(closer, ((column - row) % 3).astype(int), kind)
        return found, kind

    def apparent(self, depth):
        """Virtual depth in terms of micro-images, which lie a little wider than lenslets."""
        return depth * (1 + self.gap / self.lens) / (1 + depth * self.gap / self.lens)

    def scale(self, depth):
        """Places of the main lens's picture over those in the raw picture."""
        return depth / self.apparent(depth)

    @cache  # noqa: B019 - there are few cameras
    def record(self, depth, texture, sub=2):
        """Raw picture of a texture at a virtual depth a / B: a number, or a function of places."""
        y, x = ((np.arange(n * sub) + 0.5) / sub - n / 2 for n in self.shape)
        y, x = np.meshgrid(y, x, indexing="ij")
        (down, right), kind = self.nearest(y, x)
        lenslet = np.stack([down, right]) / (1 + self.gap / self.lens)
        here = depth(down, right) if callable(depth) else np.full(y.shape, float(depth))
        seen = lenslet + (np.stack([y, x]) - lenslet) * here
        light = texture.at(*seen, radius=np.array(self.blur)[kind] * np.abs(here))
        return self._pixels(light * self._lit(y - down, x - right), sub)

    @cache  # noqa: B019
    def white(self, sub=2):
        """Raw picture of uniform light."""
        y, x = ((np.arange(n * sub) + 0.5) / sub - n / 2 for n in self.shape)
        y, x = np.meshgrid(y, x, indexing="ij")
        (down, right), _ = self.nearest(y, x)
        return self._pixels(self._lit(y - down, x - right), sub)

    def _lit(self, down, right):
        share = (down**2 + right**2) / (self.pitch / 2) ** 2
        return np.where(share <= 1, 1 - self.fall * share, 0.0)

    def _pixels(self, light, sub):
        return light.reshape(self.shape[0], sub, self.shape[1], sub).mean(axis=(1, 3))

    def xml(self, **changes):
        """Calibration as the maker's program writes it."""
        cos, sin = (0.0, 1.0) if self.columns else (1.0, 0.0)
        values = {
            "diameter": self.pitch,
            "rotation": self.rotation + (np.pi / 2 if self.columns else 0),
            "x": self.offset[0],
            "y": self.offset[1],
            "border": 1.0,
            "second": 1,  # on which side of a lenslet of the first kind one of the second is
        } | changes
        right, up = values["second"] * cos, values["second"] * sin
        kinds = [(0, 0, 1, 3), (right, up, 2.8, 4), (-right, -up, 3.8, 100)]
        types = "".join(
            f'<lens_type id="{k}"><offset units="lens"><x>{x:.12f}</x><y>{y:.12f}</y></offset>\n'
            f'<depth_range units="virtual_depth"><min>{low}</min><max>{high}</max></depth_range>'
            f"</lens_type>\n"
            for k, (x, y, low, high) in enumerate(kinds)
        )
        return f"""<?xml version="1.0"?>
<RayCalibData version="1.0">
  <offset units="pix">\n    <x>{values["x"]}</x>\n    <y>{values["y"]}</y>\n  </offset>
  <diameter units="pix">{values["diameter"]}</diameter>
  <rotation units="rad">{values["rotation"]}</rotation>
  <lens_border units="pix">{values["border"]}</lens_border>
  <tcp units="virtual_depth">2.11002731323</tcp>
  <lens_base_x units="lens"><x>{right}</x><y>{up}</y></lens_base_x>
  <lens_base_y units="lens"><x>0.5</x><y>-0.866025388241</y></lens_base_y>
  <sub_grid_base units="lens"><x>3</x><y>-1.732050776482</y></sub_grid_base>
  <distortion type="radial"><function>constant</function><parameter count="0">0</parameter>
  <offset units="pix"><x>0</x><y>0</y></offset></distortion>
{types}</RayCalibData>
"""
