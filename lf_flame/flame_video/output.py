"""Output files of a flame's height and flicker."""

import numpy as np

from lf_flame._common import figures
from lf_flame._common.config import to_json
from lf_flame._common.output_folders import OutputFolder
from lf_flame.errors import InputError
from lf_flame.flame_video.figures import flicker_figure
from lf_flame.flame_video.flame_series import FlameSeries, Measures
from lf_flame.flame_video.flame_shape import row_error
from lf_flame.flame_video.flicker import Flicker, find_flicker
from lf_flame.flame_video.outliers import find_outliers

RECORD = "flicker.json"
TABLE = "flame.csv"
PICTURE = "flicker.png"

OUTLIER = (
    "The height is far from that of neighbouring frames, as with a spark or another object: it is "
    "left out of the frequency."
)

MOST_REPEATED = 0.05
"""Largest fraction of repeated frames with which times by the frame rate are used."""


def write_flicker(
    series: FlameSeries, measures: Measures, folder: OutputFolder, *, times_stated: bool = False
) -> tuple[Flicker | None, list[str]]:
    """Find the flicker; write ``flicker.png`` and the facts of the record.

    Parameters
    ----------
    series : FlameSeries
    measures : Measures
    folder : OutputFolder
    times_stated : bool, optional
        Whether each frame's time was given, and not the frame rate. Without, there is no frequency
        if more than `MOST_REPEATED` of the frames repeat the one before.

    Returns
    -------
    Flicker or None
        Flicker; None if too few frames have a height, or times are unknown.
    list of str
        Warnings.
    """
    times, heights = np.array(series.times_s), np.array(series.heights)
    outliers = find_outliers(heights, least=measures.pixel_mm or 1.0)
    for number in np.flatnonzero(outliers):
        series.doubts.setdefault(OUTLIER, []).append(series.names[number])
    warnings, found, repeated = series.warnings(), None, _repeated(series)
    left_out = outliers | repeated
    try:
        if not times_stated:
            _refuse_repeated(repeated)
        found = find_flicker(
            times,
            np.where(left_out, np.nan, heights),
            resolvable=row_error(measures.level) * (measures.pixel_mm or 1.0),
        )
    except InputError as error:  # the heights are useful without a frequency
        warnings.append(str(error))
    figures.save(flicker_figure(series, measures, found, left_out), folder.path(PICTURE))
    known = heights[np.isfinite(heights)]
    folder.facts |= {
        "frames": len(times),
        "frames_with_flame": len(known),
        "outliers": [series.names[number] for number in np.flatnonzero(outliers)],
        "repeated": [series.names[number] for number in np.flatnonzero(series.repeated)],
        "slope": measures.slope,
        "level": measures.level,
        "pixel_mm": measures.pixel_mm,
        "burner_row": measures.burner_row,
        "unit": measures.unit,
        "mean_height": float(known.mean()) if len(known) else None,
        "standard_deviation_of_height": float(known.std()) if len(known) else None,
        "flicker": None if found is None else _facts(found),
        "warnings": warnings,
    }
    return found, warnings


def _repeated(series: FlameSeries) -> np.ndarray:
    """Mark repeated frames, none in a video of one picture alone, where nothing moves."""
    repeated = np.array(series.repeated)
    return repeated & (not repeated[1:].all())


def _refuse_repeated(repeated: np.ndarray) -> None:
    count = np.count_nonzero(repeated)
    if count > MOST_REPEATED * len(repeated):
        raise InputError(
            f"{count} of {len(repeated)} frames repeat the one before, so that others are probably "
            f"lost and times by the frame rate wrong: no frequency is given. State the time of "
            f"each frame by --timestamps FILE."
        )


def _facts(found: Flicker) -> dict:
    names = (
        "frequency_hz", "resolution_hz", "false_alarm", "peak_hz", "amplitude", "swings_hz",
        "resolvable",
    )  # fmt: skip
    return {
        **{name: getattr(found, name) for name in names},
        "lines": [to_json(line) for line in found.lines],
        "unresolved": [to_json(line) for line in found.unresolved],
        "noise": to_json(found.noise),
    }
