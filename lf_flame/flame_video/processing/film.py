"""Film of a processed video: each frame with its contour, beside its emission on depth planes."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import zarr
from skimage.draw import polygon_perimeter

from lf_flame._common.zarr_files import open_array
from lf_flame.errors import InputError
from lf_flame.flame_video.processing import result
from lf_flame.flame_video.processing.emission_steps import Emission
from lf_flame.flame_video.processing.steps import Refocus, Step
from lf_flame.formats.images import to_preview
from lf_flame.formats.movie import check_movie, write_movie

LONGEST, MOST_PLANES = 300, 4
"""Largest number of frames of a film, and of emission planes beside each other."""

SMALLEST = 240
"""Smallest height of a film in pixels; smaller pictures are enlarged by a whole factor."""


def check_film(path: Path | None, steps: Sequence[Step]) -> None:
    """Refuse a film that cannot be made, before any work is done.

    Raises
    ------
    InputError
        If no step gives pictures, the ending is unknown, or a package is missing.
    """
    if path is None:
        return
    check_movie(path)
    if not any(isinstance(step, Refocus | Emission) for step in steps):
        raise InputError("A film needs pictures: the step refocus@... or emission.")


def write_film(video: str | Path, path: str | Path) -> None:
    """Write a film of at most `LONGEST` frames, spread evenly; gaps are black.

    Parameters
    ----------
    video : str or Path
        Group of `process_frames`.
    path : str or Path
        File of the film, ending in .mp4 or .gif.

    Raises
    ------
    InputError
        If the group is damaged or has no pictures, or the film cannot be written.
    """
    video = Path(video)
    group = result.open_video(video)
    frames = result.count_frames(group, video).frames
    picked = np.unique(np.linspace(0, frames - 1, min(frames, LONGEST)).round().astype(int))
    with result.reading(video):
        names = sorted(name for name in group if name.startswith("refocus_"))[-1:]
        names += ["emission"] if "emission" in group else []
        if not names:
            raise InputError(f"{video} holds no pictures for a film.")
        panels = [_panel(open_array(group, name), picked) for name in names]
        rows = max(panel.shape[1] for panel in panels)
        panels = [_enlarged(panel, rows // panel.shape[1]) for panel in panels]
        factor = -(-SMALLEST // rows)
        film = _enlarged(np.concatenate(panels, axis=2), factor)
        if "contour" in group:
            _draw(film, open_array(group, "contour"), picked, factor)
    write_movie(path, film)


def _panel(array: zarr.Array, picked: np.ndarray) -> np.ndarray:
    """Read pictures, planes beside each other, as 8-bit levels of the brightest pixel of all."""
    axes = array.metadata.dimension_names or ()  # type: ignore[union-attr]

    def read(frame: int) -> np.ndarray:
        picture = np.nan_to_num(np.asarray(array[frame]))
        picture = picture.mean(axis=0) if "colour" in axes else picture
        if "depth" in axes:
            planes = np.linspace(0, len(picture) - 1, min(len(picture), MOST_PLANES))
            return np.concatenate(picture[planes.round().astype(int)], axis=1)
        return picture.mean(axis=2) if "channel" in axes else picture

    white = max(float(np.finfo(np.float32).tiny), *(float(read(frame).max()) for frame in picked))
    return np.stack([to_preview(read(frame), white) for frame in picked])


def _enlarged(film: np.ndarray, factor: int) -> np.ndarray:
    return film.repeat(factor, axis=1).repeat(factor, axis=2)


def _draw(film: np.ndarray, contours: zarr.Array, picked: np.ndarray, factor: int) -> None:
    """Draw each contour in white."""
    for frame, number in zip(film, picked, strict=True):
        contour = np.asarray(contours[number], np.float64)
        if np.isfinite(contour).all():
            # Row 0 is the centre of the first row of pixels.
            places = np.rint((contour + 0.5) * factor - 0.5).astype(int)
            frame[polygon_perimeter(*places.T, shape=frame.shape, clip=True)] = 255
