"""Film of a processed video: each frame with its contour, beside its emission on depth planes."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import zarr
from skimage.draw import polygon_perimeter

from lf_flame._common.input_files import readable
from lf_flame._common.zarr_files import ZARR_ERRORS, open_array
from lf_flame.errors import InputError
from lf_flame.flame_video import processing
from lf_flame.flame_video.steps import Emission, Refocus, Step
from lf_flame.formats.images import to_preview
from lf_flame.formats.movie import check_movie, write_movie


def check_film(path: Path, steps: Sequence[Step]) -> None:
    """Refuse a film that cannot be made, before any work is done."""
    check_movie(path)
    if not any(isinstance(step, Refocus | Emission) for step in steps):
        raise InputError("A film needs pictures: the step refocus@... or emission.")


def write_film(video: str | Path, path: str | Path) -> None:
    """Write a film (.mp4 or .gif) of at most 300 frames, spread evenly; gaps are black.

    Raises
    ------
    InputError
        If the group is damaged or has no pictures, or the film cannot be written.
    """
    video = Path(video)
    group = processing.open_video(video)
    frames = sum(processing.count_frames(group, video).counts.values())
    picked = np.unique(np.linspace(0, frames - 1, min(frames, 300)).round().astype(int))
    with readable(video / "zarr.json", ZARR_ERRORS, "a frame is"):
        names = sorted(name for name in group if name.startswith("refocus_"))[-1:]
        names += ["emission"] if "emission" in group else []
        if not names:
            raise InputError(f"{video} holds no pictures for a film.")
        panels = [_panel(open_array(group, name), picked) for name in names]
        rows = max(panel.shape[1] for panel in panels)
        factor = -(-240 // rows)  # small pictures are enlarged by a whole factor
        factors = [factor * (rows // panel.shape[1]) for panel in panels]
        panels = [
            x.repeat(n, axis=1).repeat(n, axis=2) for x, n in zip(panels, factors, strict=True)
        ]
        film = np.concatenate(panels, axis=2)
        if "contour" in group:
            contours = open_array(group, "contour")
            for frame, number in zip(film, picked, strict=True):
                contour = np.asarray(contours[number], np.float64)
                if np.isfinite(contour).all():
                    # Row 0 is the centre of the first row of pixels.
                    places = np.rint((contour + 0.5) * factors[0] - 0.5).astype(int)
                    frame[polygon_perimeter(*places.T, shape=frame.shape, clip=True)] = 255
    write_movie(path, film)


def _panel(array: zarr.Array, picked: np.ndarray) -> np.ndarray:
    """Read pictures, at most four planes beside each other, as 8-bit levels of the brightest."""
    axes = array.metadata.dimension_names or ()  # type: ignore[union-attr]

    def read(frame: int) -> np.ndarray:
        picture = np.nan_to_num(np.asarray(array[frame]))
        picture = picture.mean(axis=0) if "colour" in axes else picture
        if "depth" in axes:
            planes = np.linspace(0, len(picture) - 1, min(len(picture), 4)).round().astype(int)
            return np.concatenate(picture[planes], axis=1)
        return picture.mean(axis=2) if "channel" in axes else picture

    white = max(float(np.finfo(np.float32).tiny), *(float(read(frame).max()) for frame in picked))
    return np.stack([to_preview(read(frame), white) for frame in picked])
