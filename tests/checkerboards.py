"""Flat targets before a thin-lens plenoptic camera, by pinholes of their own.

A ray leaves the pupil at U, crosses the focal plane at P, which a lenslet's centre is the image of,
and hits the target, Z from the lens, at ``U + (P - U) Z / a0``. No line is the package's.
"""

from dataclasses import dataclass

import numpy as np

from lf_flame import LightField


@dataclass(frozen=True)
class Bench:
    """A camera on a bench: f = 50 mm, focused at 400 mm, lenslets of 0.1 mm, 7 x 7 views."""

    focal: float = 50.0
    focus: float = 400.0
    pitch: float = 0.1
    step: float = 1.7  # mm on the lens between views
    views: int = 5
    lenslets: tuple[int, int] = (44, 52)
    turn: float = 0.0  # rad, of the array
    pitch_error: float = 0.0
    pupil: tuple[float, float] = (0.0, 0.0)  # mm, row and column
    distortion: float = 0.0  # r (1 + k r^2) in the image is free of distortion

    @property
    def image(self) -> float:
        return 1 / (1 / self.focal - 1 / self.focus)

    @property
    def lenslet_mm(self) -> float:
        return self.pitch * (1 + self.pitch_error)

    def slope(self, distance):
        """Lenslets by which a point moves from view to view: similar triangles."""
        on_focal_plane = self.step * (distance - self.focus) / distance
        return on_focal_plane * self.image / self.focus / self.lenslet_mm

    def scale(self, distance):
        """Size in mm, on a target at a distance, of a lenslet seen through one point."""
        return self.lenslet_mm * distance / self.image

    def picture(
        self, distance, square, *, turn=0.1, tilt=0.0, dots=False, noise=0.0, seed=0, fine=5
    ):
        """Light field of a checkerboard, or of a grid of dots, at a distance from the lens."""
        rows, columns = self.lenslets
        sub = (np.arange(fine) + 0.5) / fine - 0.5
        y = (np.arange(rows)[:, None] + sub).ravel() - (rows - 1) / 2
        x = (np.arange(columns)[:, None] + sub).ravel() - (columns - 1) / 2
        y, x = np.meshgrid(y, x, indexing="ij")
        free = 1 + self.distortion * (y**2 + x**2)
        y, x = (axis * free * self.lenslet_mm * self.focus / self.image for axis in (y, x))
        cos, sin = np.cos(self.turn), np.sin(self.turn)
        y, x = cos * y + sin * x, cos * x - sin * y
        steps = self.step * (np.arange(self.views) - (self.views - 1) / 2)
        views = np.empty((self.views, self.views, rows, columns))
        for v, u in np.ndindex(self.views, self.views):
            # A view of a turned array is cut from turned pixels too.
            down = self.pupil[0] + cos * steps[v] + sin * steps[u]
            right = self.pupil[1] + cos * steps[u] - sin * steps[v]
            # Where the ray hits a target that is farther at the right.
            lean = np.tan(tilt)
            far = (distance + lean * right) / (1 - lean * (x - right) / self.focus)
            seen_y = down + (y - down) * far / self.focus
            seen_x = (right + (x - right) * far / self.focus) / np.cos(tilt)
            seen = _dots if dots else _board
            fine_view = seen(seen_y / square, seen_x / square, turn)
            views[v, u] = fine_view.reshape(rows, fine, columns, fine).mean(axis=(1, 3))
        if noise:
            views += np.random.default_rng(seed).normal(0, noise, views.shape)
        return LightField(views)


def _turned(y, x, turn):
    return np.cos(turn) * y + np.sin(turn) * x + 0.17, np.cos(turn) * x - np.sin(turn) * y + 0.41


def _board(y, x, turn):
    y, x = _turned(y, x, turn)
    return 0.1 + 0.8 * ((np.floor(y) + np.floor(x)) % 2)


def _dots(y, x, turn):
    y, x = (axis % 1 - 0.5 for axis in _turned(y, x, turn))
    return np.where(np.hypot(y, x) < 0.27, 0.1, 0.9)
