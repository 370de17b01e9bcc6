"""A few hundred pixels of an image, rendered to find how finely a scene must be divided.

They lie where chosen rows and columns cross: those that see the brightest points, those where light
or matter changes most from lenslet to lenslet, and some spread evenly over all views. Both
integrators render them with every effect but diffraction.

The tolerance that effects which are left out do not use is divided among the numbers that are
finite: slabs of thick layers, colours of a chromatic lens, parts of pixels for diffraction, and
rays. Each is doubled, with few of the others, until the chosen pixels change by less than its
share, or will after two more doublings: that takes a fraction of the time of a large image.
"""

import math
import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np

from lf_flame.errors import InputError
from lf_flame.optics.camera import ROW_SPACING, PlenopticCamera
from lf_flame.optics.ray_bundle import trace_footprint
from lf_flame.scenes.scene import Layer, Scene
from lf_flame.simulation.diffraction import (
    blur_on_sensor,
    leaves_gaps,
    lenslet_share_leaving,
    main_lens_share_leaving,
    tiled_sensor,
)
from lf_flame.simulation.integration import gather
from lf_flame.simulation.optical_pass import Lines, OpticalPass, optical_passes
from lf_flame.simulation.slabs import Plane, slice_scene

BRIGHTEST, CHANGING, EVEN = 4, 8, 12
"""Number of lines along each axis: brightest of the central view, changing most, and spread evenly
over all views."""

ENOUGH_LINES = 96
"""Number of lines of an image along an axis; if it has fewer, fewer are chosen in proportion."""

TIMED_CROSSINGS = 1_000_000
"""Number of crossings of rays and planes that are timed: several hundredths of a second."""

MOST_VIEWS, MOST_LENSLETS = 15, 1024
"""Largest numbers of views and lenslets along an axis among which lines are chosen."""

FEWEST_RAYS = 4
"""Number of rays along each axis from which they are doubled. Slabs and colours are found with
twice as many, parts of pixels with as many in each."""

LEFT_OUT_SHARE = 0.25
"""Fraction of the tolerance that all effects that are left out may use together."""

MOST = {"slabs": 1024, "colours": 1024, "parts of pixels": 32, "rays": 2048}
"""Largest numbers of slabs of a layer, colours, parts of a pixel and rays along each axis."""

PEAK_ERROR = 0.02
"""Largest relative error of the brightest pixel by few rays, slabs and colours."""

WINDOW = 3
"""Number of lenslets along each side of the windows in which diffraction is measured."""


class ChosenPixels:
    """Pixels of a scene in front of a camera at the crossings of chosen lines.

    weights: share of the image that each pixel represents (of the lines nearest to its own), shape
    (1, 1, rows, columns).
    """

    def __init__(self, scene: Scene, camera: PlenopticCamera):
        self.scene, self.camera = scene, camera
        views = _spread(camera.views, MOST_VIEWS)
        everywhere = [
            np.concatenate([view * n + _spread(n, MOST_LENSLETS) for view in views])
            for n in camera.lenslets
        ]
        columns = self._start()
        rows = self._choose(everywhere[0], columns, 0)
        columns = self._choose(everywhere[1], rows, 1)
        self.lines = Lines(rows, columns)
        self.weights = np.multiply.outer(
            *(_nearest(*each) for each in zip(everywhere, self.lines, strict=True))
        )[None, None]

    def _start(self) -> np.ndarray:
        """Columns of the central view that see the brightest points and the edges of layers."""
        count, view = self.camera.lenslets[1], self.camera.views // 2
        lenslets = [*_spread(count, 2 * EVEN)]
        for layer in self.scene.layers:
            edges = layer.cell_edges_mm[1]
            brightest = edges[np.unravel_index(layer.texture.argmax(), layer.texture.shape)[1]]
            centres = trace_footprint(self.camera, layer.depth_mm, 1).centres_mm[view]
            for place in (edges[0], brightest, edges[-1]):
                lenslets.append(int(np.abs(centres - place).argmin()))
        return view * count + np.unique(lenslets)

    def _choose(self, candidates: np.ndarray, across: np.ndarray, axis: int) -> np.ndarray:
        """Choose some of the candidates along an axis by their pixels on lines across."""
        lines = Lines(candidates, across) if axis == 0 else Lines(across, candidates)
        change, bright = np.zeros(candidates.size), []
        for planes in self._light_and_matter():
            image = gather(planes, [OpticalPass(self.camera)], lines, None)[0, 0]
            image = (image if axis == 0 else image.T) / max(float(image.max()), 1e-30)
            steps = np.abs(np.diff(image, axis=0, prepend=image[:1])).max(axis=1)
            steps[candidates % self.camera.lenslets[axis] == 0] = 0  # the next view begins
            change = np.maximum(change, steps)
            bright.append(image.max(axis=1))
        changing, brightest, even = (
            math.ceil(lines * min(1, candidates.size / ENOUGH_LINES))
            for lines in (CHANGING, BRIGHTEST, EVEN)
        )
        # The brightest ones in the central view, which stops darken least, and half of them the
        # densest: matter may be as dense where there is no light.
        aside = np.abs(candidates // self.camera.lenslets[axis] - self.camera.views // 2)
        best = [
            *np.argsort(change, kind="stable")[-changing:],
            *(k for one in bright for k in np.lexsort((one, -aside))[-brightest // len(bright) :]),
            *_spread(candidates.size, even),
        ]
        return candidates[np.unique(best)]

    def _light_and_matter(self) -> list[list[Plane]]:
        """Planes that shine like the layers, and planes that shine where there is matter."""
        layers = self.scene.front_to_back
        found = [[Plane(layer.texture, None, layer.depth_mm, layer) for layer in layers]]
        matter = [
            Plane(layer.opacity + -np.expm1(-layer.optical_thickness), None, layer.depth_mm, layer)
            for layer in layers
            if has_matter(layer)
        ]
        return [*found, matter] if matter else found

    def render(
        self,
        kept: Collection[str],
        traced: Collection[str],
        *,
        slabs: Sequence[int] | None = None,
        colours: int = 1,
        rays: int | None = None,
        camera: PlenopticCamera | None = None,
        lines: Lines | None = None,
    ) -> np.ndarray:
        """Render the chosen pixels without diffraction: float32, shape (1, 1, rows, columns).

        The parameters are those of an `EffectPlan`; slabs: one for each layer by default. Another
        camera and other lines may be given.
        """
        counts = [1] * len(self.scene.layers) if slabs is None else slabs
        parts = dict(zip(self.scene.layers, counts, strict=True))
        planes = slice_scene(self.scene, parts, "self_absorption" in kept, set(traced))
        passes = optical_passes(camera or self.camera, kept, traced, colours)
        return gather(planes, passes, lines or self.lines, rays)

    def peak(self) -> float:
        """Radiance of the brightest pixel, from few rays, with every effect that is stated."""
        camera, layers = self.camera, self.scene.layers
        causes = {
            "occlusion": any(layer.opaque for layer in layers),
            "self_absorption": any(layer.optical_thickness.any() for layer in layers),
            "round_aperture": camera.aperture_diameter_mm is not None,
            "f_number_mismatch": camera.aperture_diameter_mm is not None,
            "vignetting": camera.rim_diameter_mm is not None,
            "lenslet_rotation": camera.lenslet_rotation_rad != 0,
        }
        traced = [name for name, stated in causes.items() if stated]
        kept = [*traced, "defocus", "cos4", "lenslet_pitch_error"]
        slabs = [4 if layer.depth_extent_mm else 1 for layer in layers]
        colours = 2 if camera.chromatic_shift else 1
        rays = 2 * FEWEST_RAYS if traced else None
        image = self.render(kept, traced, slabs=slabs, colours=colours, rays=rays)
        peak = float(image.max())
        exact = not traced and colours == 1 and max(slabs) == 1
        peak *= 1 - PEAK_ERROR * (0.1 if exact else 1.0)  # other effects may take a little of it
        if camera.wavelength_nm is not None:
            peak *= (1 - lenslet_share_leaving(camera)) * (1 - main_lens_share_leaving(camera))
        sensor = camera.sensor
        return peak if sensor is None else min(peak, sensor.full_well_e / sensor.exposure_e)

    def time(self, kept: Collection[str], traced: Collection[str], counts: "Counts") -> float:
        """Time in seconds that the whole image takes, by that of pixels spread evenly over it.

        It is that of two slabs of each layer in one colour; others take as long. Diffraction is not
        counted.
        """
        slabs = [min(count, 2) for count in counts.slabs]
        crossings = (counts.rays or 1) ** 2 * sum(slabs)
        seen = tiled_sensor(self.camera, counts.parts) if counts.parts > 1 else self.camera
        lengths = [seen.views * n for n in seen.lenslets]
        some = min(TIMED_CROSSINGS // crossings, math.prod(lengths) // 20, 2**16)
        lines = Lines(*(_spread(n, max(math.isqrt(some), 4)) for n in lengths))
        started = time.perf_counter()
        self.render(kept, traced, slabs=slabs, rays=counts.rays, camera=seen, lines=lines)
        share = lines.rows.size * lines.columns.size / math.prod(lengths)
        share *= sum(slabs) / (sum(counts.slabs) * counts.colours)
        boxes = 13 * ROW_SPACING["hexagonal"] if self.camera.layout == "hexagonal" else 1
        return (time.perf_counter() - started) * boxes / share

    def diffracted(
        self, kept: Collection[str], traced: Collection[str], parts: int, rays: int | None
    ) -> np.ndarray:
        """Pixels of several windows of lenslets, diffracted by the light on their parts."""
        tiled, sides = tiled_sensor(self.camera, parts), []
        for axis, count in enumerate(self.camera.lenslets):
            chosen = np.unique(self.lines[axis] % count)
            side = min(WINDOW, count)
            middles = chosen[_spread(chosen.size, WINDOW)]
            if count < 3 * WINDOW:  # others would overlap with it
                middles = middles[[middles.size // 2]]
            first = np.clip(middles - side // 2, 0, count - side)
            lenslets = (first[:, None] + np.arange(side)).ravel()
            sides.append((np.arange(tiled.views) * count + lenslets[:, None]).ravel())
        tiles = self.render(kept, traced, rays=rays, camera=tiled, lines=Lines(*sides))[0, 0]
        size = min(WINDOW, self.camera.lenslets[0]), min(WINDOW, self.camera.lenslets[1])
        window, around = replace(self.camera, lenslets=size), replace(tiled, lenslets=size)
        high, wide = (n * tiled.views for n in size)
        found = []
        for top in range(0, tiles.shape[0], high):
            for left in range(0, tiles.shape[1], wide):
                part = tiles[top : top + high, left : left + wide]
                raw = blur_on_sensor(part, around, window)[None, None]
                found.append(raw[0, 0])
        return np.array(found)


class Counts(NamedTuple):
    """Numbers into which a scene is divided: fields of an `EffectPlan`."""

    slabs: tuple[int, ...]
    colours: int
    parts: int
    rays: int | None


def find_counts(
    pixels: ChosenPixels,
    kept: Collection[str],
    traced: Collection[str],
    tolerance: float,
    by_rays: bool,
    rays: int | None = None,
) -> Counts:
    """Find the numbers of slabs, colours, parts of pixels and rays that a tolerance needs.

    by_rays: whether rays are traced. rays: their number, if it is given; parts of pixels are then
    not found either.
    """
    layers = pixels.scene.layers
    thick = [k for k, layer in enumerate(layers) if layer.depth_extent_mm and "thickness" in kept]
    chromatic, finding_rays = "chromatic" in kept, by_rays and rays is None
    of_lenslets = "lenslet_diffraction" in kept and pixels.camera.wavelength_nm is not None
    diffracts = of_lenslets and rays is None
    number = len(thick) + chromatic + diffracts + finding_rays
    share = (1 - LEFT_OUT_SHARE) * tolerance / max(number, 1)
    slabs, colours, weights = [1] * len(layers), 1, pixels.weights
    # Next to gaps light is uneven.
    parts = 4 if of_lenslets and rays and leaves_gaps(pixels.camera) else 1
    low = 2 * FEWEST_RAYS if finding_rays else rays

    @cache
    def image(slabs: tuple[int, ...], colours: int, rays: int | None) -> np.ndarray:
        return pixels.render(kept, traced, slabs=slabs, colours=colours, rays=rays)

    for k in thick:

        def sliced(n: int, k: int = k) -> np.ndarray:
            return image((*slabs[:k], n, *slabs[k + 1 :]), 1, low)

        slabs[k] = refine("slabs", sliced, 1, share, weights)
    if chromatic:
        colours = refine("colours", lambda n: image(tuple(slabs), n, low), 1, share, weights)
    if finding_rays:
        rays = refine("rays", lambda n: image(tuple(slabs), 1, n), FEWEST_RAYS, share, weights, 3)
    if diffracts:

        def diffracted(n: int) -> np.ndarray:
            few = rays and min(max(math.ceil(rays / n), 2), FEWEST_RAYS)
            return pixels.diffracted(kept, traced, n, few)

        parts = refine("parts of pixels", diffracted, 1, share)
        # Rays tile pixel and lenslet; a part has less of the pixel, but all of the lenslet.
        rays = rays and max(math.ceil(rays / parts), math.ceil(math.sqrt(rays)), FEWEST_RAYS)
    return Counts(tuple(slabs), colours, parts, rays)


def refine(
    what: str,
    image: Callable[[int], np.ndarray],
    first: int,
    allowance: float,
    weights: np.ndarray | None = None,
    fewest: int = 2,
) -> int:
    """Double a number of rays, slabs, ... until chosen pixels change by no more than an allowance.

    The error falls about as one over the number or faster: with the doubled number it is at most
    about the change. As soon as it falls so, up to two more doublings are not rendered: the change
    is assumed to keep falling, by 15 % less each time. Raises InputError if `MOST` are too few.

    allowance: of the root mean square, relative to the brightest pixel. weights: share of the image
    that each pixel represents. fewest: number of images that decide; two with few rays agree about
    an edge that both miss.
    """
    most = MOST[what]
    counts = [first * 2**k for k in range(1, 16) if first * 2**k <= most]
    coarse, before, last = image(first), first, 0.0
    for images, count in enumerate(counts, 2):
        fine = image(count)
        squares = np.square(fine - coarse, dtype=np.float64)
        change = math.sqrt(np.average(squares, weights=weights)) / max(float(fine.max()), 1e-300)
        if images >= fewest:
            if 4 * change <= allowance and before > 1:  # one alone would hide the effect
                return before
            fall = 0.85 * min(last / max(change, 1e-300), 4)
            for skipped in range(3 if last >= 2 * change else 1):
                if change <= allowance * fall**skipped and count << skipped <= most:
                    return count << skipped
        coarse, before, last = fine, count, change
    raise InputError(
        f"The tolerance is too small: the number of {what} would exceed {most}; raise it, or "
        f"force the effect that needs them off."
    )


def has_matter(layer: Layer) -> bool:
    """Whether a layer can occlude or attenuate light from behind."""
    return layer.opaque or bool(layer.optical_thickness.any())


def _nearest(candidates: np.ndarray, lines: np.ndarray) -> np.ndarray:
    """Share of the candidates that are nearest to each of the lines, which are among them."""
    middles = (lines[1:] + lines[:-1]) / 2
    near = np.searchsorted(middles, candidates)
    return np.bincount(near, minlength=lines.size) / candidates.size


def _spread(count: int, chosen: int) -> np.ndarray:
    """Spread indices evenly over `count`, ends included."""
    return np.unique(np.linspace(0, count - 1, min(count, chosen)).round().astype(int))
