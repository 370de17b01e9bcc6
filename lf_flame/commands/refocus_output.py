"""From a light field to the refocused pictures a user looks at."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from lf_flame._common import figures, provenance
from lf_flame._common.atomic_files import write_json
from lf_flame._common.config import read_record
from lf_flame.errors import InputError
from lf_flame.formats.images import to_preview, white_level, write_image
from lf_flame.formats.movie import write_movie
from lf_flame.formats.stacks import write_focal_stack
from lf_flame.lightfield import LightField
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.refocus import (
    SlopeSearch,
    all_in_focus,
    annular_aperture,
    f_number_aperture,
    farthest_slope,
    find_sharpest_slope,
    refocus,
    round_aperture,
)
from lf_flame.refocus.composite import TRUSTED
from lf_flame.refocus.figures import regions_figure, search_figure, slope_map_figure

SWEEP_FRAMES = 41
"""Frames from one end of a sweep to the other; the movie goes there and back."""

SLOPE_MAP_STEPS = 33
"""Slopes of the stack from which a slope map is made."""


def aperture_weights(
    views: tuple[int, int],
    diameter: float | None = None,
    ring: float | None = None,
    f_number: float | None = None,
    camera: PlenopticCamera | None = None,
) -> np.ndarray | None:
    """Weights of the views for an aperture as a user states it.

    Parameters
    ----------
    views : (int, int)
    diameter : float, optional
        Of a round aperture, in widths of the full one. Default: the full one, or of a ring 1.
    ring : float, optional
        Diameter of the middle that is covered.
    f_number : float, optional
        In place of a diameter; needs the camera.
    camera : PlenopticCamera, optional

    Returns
    -------
    ndarray, shape (v, u), or None for all views alike
    """
    if f_number is not None:
        if diameter is not None or ring is not None:
            raise InputError("An f-number and a diameter of the aperture cannot both be given.")
        if views != (camera.views, camera.views):
            raise InputError(
                f"The camera has {camera.views} x {camera.views} views, "
                f"but the light field {views[0]} x {views[1]}."
            )
        return f_number_aperture(camera, f_number)
    if ring is not None:
        return annular_aperture(views, ring, 1.0 if diameter is None else diameter)
    return None if diameter is None else round_aperture(views, diameter)


@dataclass(frozen=True, eq=False)
class Refocusing:
    """What to make of a light field, and where to put it.

    Attributes
    ----------
    light_field : LightField
    out : Path
        Folder for the pictures and ``refocus.json``, the record.
    options : dict
        `interpolation`, `method` and `weights` of `lf_flame.refocus.refocus`.
    network : optional
        A system of `lf_flame.systems` that refocuses instead, from values from 0 to 1.
    record : dict
        What the record says beside what each call adds.
    written : list of str
        Names of the files, as they are written.
    """

    light_field: LightField
    out: Path
    options: dict = field(default_factory=dict)
    network: object = None
    record: dict = field(default_factory=dict)
    written: list[str] = field(default_factory=list)

    @cached_property
    def white(self) -> float:
        """Radiance shown as white."""
        return white_level(self.light_field.views)

    @property
    def views_to_white(self) -> np.ndarray:
        """Views from 0 to 1, as networks take them."""
        views = self.light_field.views
        return views if self.white == 1 else views / np.float32(self.white)

    def check(
        self,
        slopes: Sequence[float],
        sweep: Sequence[float] = (),
        slope_map: Sequence[float] = (),
    ) -> None:
        """Refuse what cannot be done before any work is done.

        Parameters
        ----------
        slopes, sweep, slope_map : sequence of float
            To refocus at, and first and last of a sweep and of a slope map; none: not asked for.

        Raises
        ------
        InputError
            If the folder holds pictures of another light field, a slope shifts views by more than
            the image, a sweep or a slope map has no length, or the network cannot take the light
            field or a slope.
        """
        self._refuse_other_source()
        self._check_slopes([*slopes, *sweep, *slope_map])
        if sweep and sweep[0] == sweep[1]:
            raise InputError(f"A sweep needs two slopes, got {sweep[0]} twice.")
        if slope_map and not slope_map[0] < slope_map[1]:
            raise InputError(
                f"A slope map needs the lower slope first, got {slope_map[0]} and {slope_map[1]}."
            )
        if self.network is not None:
            self.network.check(self.light_field.views, [*slopes, *sweep])

    def _refuse_other_source(self) -> None:
        source, path = self.record.get("source"), self.out / "refocus.json"
        before = read_record(path).get("source") if path.exists() else source
        if before != source and Path(str(before)).resolve() != Path(str(source)).resolve():
            raise InputError(
                f"{self.out} holds the pictures of {before}; for those of {source} choose another "
                f"folder with --out."
            )

    def _check_slopes(self, slopes: Sequence[float]) -> None:
        limit = farthest_slope(self.light_field.views)
        wrong = [slope for slope in slopes if not abs(slope) <= limit]
        if wrong:
            raise InputError(
                f"Slopes must be finite and from {-limit:g} to {limit:g}, beyond which views are "
                f"shifted by more than the image, got {wrong[0]:g}."
            )

    def refocus_at(self, slopes: Sequence[float]) -> None:
        """Write ``focal_stack.tif`` (float32) and ``refocused_N_slopeS.png`` for some slopes."""
        stack = self._refocus(slopes)
        write_focal_stack(stack, slopes, self._path("focal_stack.tif"))
        digits = len(str(len(slopes)))
        for number, (slope, image) in enumerate(zip(slopes, stack, strict=True), 1):
            name = f"refocused_{number:0{digits}}_slope{slope + 0.0:+.3f}.png"
            write_image(self._path(name), self._preview(image))
        self.record["slopes"] = [float(slope) for slope in slopes]
        self.record["radiance_of_white_in_png"] = self.white

    def search(self) -> SlopeSearch:
        """Find the slope of sharpest focus; writes its curve as ``slope_search.png``."""
        search = find_sharpest_slope(self.light_field)
        figures.save(search_figure([search]), self._path("slope_search.png"))
        self.record["search"] = {"slope": search.slope, "confidence": search.confidence}
        return search

    def sweep(self, first: float, last: float, movie: str, progress: Callable = iter) -> None:
        """Write a movie through focus, from one slope to another and back.

        Parameters
        ----------
        first, last : float
        movie : str
            Name of the file, which ends in .gif or .mp4.
        progress : callable, optional
            Wraps the list of the slopes that are refocused together.
        """
        slopes = np.linspace(first, last, SWEEP_FRAMES)
        # Slopes that are asked for together share one reading, or one transform, of the views.
        count = 1 if self.options.get("interpolation") == "sinc" else SWEEP_FRAMES // 8
        frames = [
            self._preview(image)
            for some in progress(np.array_split(slopes, count))
            for image in self._refocus(some)
        ]
        write_movie(self._path(movie), np.stack(frames + frames[-2:0:-1]))
        self.record["sweep"] = [first, last]

    def map_slopes(self, first: float, last: float) -> float:
        """Write ``all_in_focus.png`` and each pixel's slope, ``slope_map.tif`` and ``.png``.

        Returns
        -------
        float
            Share of the pixels whose slope is certain.
        """
        slopes = np.linspace(first, last, SLOPE_MAP_STEPS)
        chosen = {k: self.options[k] for k in ("interpolation", "weights") if k in self.options}
        found = all_in_focus(self.light_field, slopes, **chosen)
        write_image(self._path("all_in_focus.png"), self._preview(found.all_in_focus))
        write_image(self._path("slope_map.tif"), found.slope.astype(np.float32))
        figures.save(slope_map_figure(found), self._path("slope_map.png"))
        self.record["slope_map"] = [first, last]
        return float(np.mean(found.confidence >= TRUSTED))

    def write_regions(
        self,
        image: np.ndarray,
        surface: np.ndarray,
        regions: Sequence[Sequence[int]],
        found: Sequence[dict],
    ) -> None:
        """Write an image of which some regions are in focus, and the slope of each pixel.

        Parameters
        ----------
        image : ndarray, shape (t, s) or (t, s, channels)
            1 is `white`.
        surface : ndarray, shape (t, s)
        regions : sequence of (int, int, int, int)
            First and last but one row, first and last but one column.
        found : sequence of dict
            What the record is to say of each region.
        """
        image = image * np.float32(self.white)
        write_image(self._path("regions.tif"), image)
        write_image(self._path("regions.png"), self._preview(image))
        write_image(self._path("regions_slope.tif"), surface.astype(np.float32))
        figure = regions_figure(image / self.white, surface, regions)
        figures.save(figure, self._path("regions_slope.png"))
        self.record["regions"] = [
            {"region": list(region), **one} for region, one in zip(regions, found, strict=True)
        ]
        self.record["radiance_of_white_in_png"] = self.white

    def write_record(self) -> dict:
        """Write ``refocus.json``; returns the record."""
        path = self._path("refocus.json")
        before = read_record(path).get("files", []) if path.exists() else []
        v, u, t, s = self.light_field.views.shape[:4]
        record = {
            "views": [v, u],
            "lenslets": [t, s],
            **{k: value for k, value in self.options.items() if k != "weights"},
            **self.record,
            "files": self.written,
            **provenance.environment(),
        }
        write_json(path, record)
        for name in set(before) - set(self.written):  # pictures of an earlier call
            (self.out / name).unlink(missing_ok=True)
        return record

    def _refocus(self, slopes: Sequence[float]) -> np.ndarray:
        if self.network is None:
            return refocus(self.light_field, slopes, **self.options)
        return self.white * self.network.refocus(self.views_to_white, slopes)

    def _path(self, name: str) -> Path:
        self.written.append(name)
        return self.out / name

    def _preview(self, image: np.ndarray) -> np.ndarray:
        return to_preview(image, self.white)
