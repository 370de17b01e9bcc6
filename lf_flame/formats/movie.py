"""Focal sweeps as movies."""

from pathlib import Path

import numpy as np
from PIL import Image

from lf_flame._common.atomic_files import atomic_write
from lf_flame.errors import InputError

MOVIE_SUFFIXES = (".gif", ".mp4")

FRAMES_PER_S = 12


def check_movie(path: str | Path) -> None:
    """Refuse a movie that cannot be written, before any work is done.

    Raises
    ------
    InputError
        If the ending is unknown, or the encoder of .mp4 is not installed.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in MOVIE_SUFFIXES:
        raise InputError(f"A movie is written as {' or '.join(MOVIE_SUFFIXES)}, got {path}.")
    if suffix == ".mp4":
        try:
            import imageio_ffmpeg  # noqa: F401
        except ImportError:
            raise InputError(
                "Writing .mp4 needs the package imageio-ffmpeg, which is not installed: "
                "pip install imageio-ffmpeg, or write a .gif."
            ) from None


def write_movie(path: str | Path, frames: np.ndarray) -> None:
    """Write frames as a looping GIF or as an MP4 (H.264), at 12 frames per second.

    Parameters
    ----------
    path : str or Path
        Output file, ending in .gif or .mp4.
    frames : ndarray of uint8, shape (n, h, w) or (n, h, w, 3)

    Raises
    ------
    InputError
        If it cannot be written (`check_movie`).

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame.formats import write_movie
    >>> write_movie("sweep.gif", np.zeros((4, 20, 30), np.uint8))
    """
    check_movie(path)
    with atomic_write(path) as aside:
        if aside.suffix.lower() == ".gif":
            first, *others = (Image.fromarray(frame) for frame in frames)
            duration = round(1000 / FRAMES_PER_S)
            first.save(aside, save_all=True, append_images=others, duration=duration, loop=0)
        else:
            _write_mp4(aside, frames)


def _write_mp4(path: Path, frames: np.ndarray) -> None:
    import imageio.v2 as imageio

    colour = frames if frames.ndim == 4 else np.repeat(frames[..., None], 3, axis=-1)
    height, width = (n - n % 2 for n in colour.shape[1:3])  # H.264 halves the colour planes
    if min(height, width) < 2:
        raise InputError("An .mp4 needs frames of 2 x 2 pixels or more: write a .gif.")
    with imageio.get_writer(path, fps=FRAMES_PER_S, macro_block_size=2, quality=8) as movie:
        for frame in colour[:, :height, :width]:
            # imageio's type hints of a writer lack its own methods
            movie.append_data(frame)  # type: ignore[attr-defined]
