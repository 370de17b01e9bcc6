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


def write_flicker(
    series: FlameSeries, measures: Measures, folder: OutputFolder
) -> tuple[Flicker | None, list[str]]:
    """Find the flicker; write ``flicker.png`` and the facts of the record.

    Parameters
    ----------
    series : FlameSeries
    measures : Measures
    folder : OutputFolder

    Returns
    -------
    Flicker or None
        Flicker; None if too few frames have a height.
    list of str
        Warnings.
    """
    times, heights = np.array(series.times_s), np.array(series.heights)
    outliers = find_outliers(heights, least=measures.pixel_mm or 1.0)
    for number in np.flatnonzero(outliers):
        series.doubts.setdefault(OUTLIER, []).append(series.names[number])
    warnings, found = series.warnings(), None
    try:
        found = find_flicker(
            times,
            np.where(outliers, np.nan, heights),
            resolvable=row_error(measures.level) * (measures.pixel_mm or 1.0),
        )
    except InputError as error:  # the heights are useful without a frequency
        warnings.append(str(error))
    figures.save(flicker_figure(series, measures, found, outliers), folder.path(PICTURE))
    known = heights[np.isfinite(heights)]
    folder.facts |= {
        "frames": len(times),
        "frames_with_flame": len(known),
        "outliers": [series.names[number] for number in np.flatnonzero(outliers)],
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
