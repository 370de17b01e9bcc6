"""The viewer inside a report: planes of emission, or a light field of a simulation or data set."""

from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lf_flame._common.config import load_record
from lf_flame._common.printable import printable
from lf_flame.commands.report_folder import Folder
from lf_flame.errors import InputError

if TYPE_CHECKING:
    from lf_flame.lightfield import LightField
    from lf_flame.viewer.exhibit import Exhibit

LARGEST_LIGHT_FIELD = 1 << 26
"""Largest size of a light field's file in bytes, and largest number of pixels of one that is
rendered; a larger one would take long."""

SCORED = "table2.json", "table1.json"
"""Records of networks that were scored on a data set; the first that names its data set counts."""

BEYOND = 1.0
"""Slopes that the slider goes beyond those of the refocused images."""


@dataclass(frozen=True)
class SimulationRecord:
    """Content of a record of `lf-flame simulate` that the viewer needs.

    Attributes
    ----------
    slopes : list of float
        Slopes of the refocused images, at least one.
    """

    slopes: list[float]

    def __post_init__(self):
        if not self.slopes:
            raise InputError("slopes must hold at least one number.")


@dataclass(frozen=True)
class DatasetRecord(SimulationRecord):
    """Content of a network's record on its data set that the viewer needs.

    Attributes
    ----------
    slopes
        As of a simulation.
    config : dict
        Configuration of the data set.
    """

    config: dict[str, Any]


@dataclass(frozen=True)
class ScoredRecord:
    """Content of a network's record that the viewer needs; older ones do not name a data set."""

    dataset: DatasetRecord | None = None


def viewer_page(folder: Folder, most_bytes: int) -> str:
    """Make the viewer's page of a folder; empty if the folder holds nothing to drag.

    The same folder gives the same text. Where the page cannot be made, `folder.left_out` says why.

    Parameters
    ----------
    folder : Folder
    most_bytes : int
        Largest size of the page in bytes. A light field that needs more is stored less exactly.
    """
    from lf_flame.viewer.page import single_page

    try:
        exhibit = _exhibit(folder)
        return single_page(exhibit, most_bytes)[0] if exhibit else ""
    except InputError as error:
        folder.left_out.append(printable(f"The viewer is not shown: {error}", 400))
        return ""


def _exhibit(folder: Folder) -> "Exhibit | None":
    from lf_flame.commands.viewer import emission_exhibit

    if "reconstruct.json" in folder.records and "emission.tif" in folder.names:
        return emission_exhibit(folder.path, None)
    if "simulation.json" in folder.records and "light_field.npz" in folder.names:
        return _light_field(folder)
    for name in SCORED:
        if name in folder.records:
            scored = load_record(ScoredRecord, folder.path / name)
            if scored.dataset is not None:
                return _sample(scored.dataset, folder.path / name)
    return None


def _sample(dataset: DatasetRecord, source: Path) -> "Exhibit":
    """Render the first sample of a network's data set anew."""
    from lf_flame.datasets.config import config_from_json
    from lf_flame.datasets.sampling import render_sample

    config = config_from_json(dataset.config, source)
    pixels = config.camera.views**2 * prod(config.camera.lenslets)
    if pixels > LARGEST_LIGHT_FIELD:
        raise InputError(f"a light field of the data set has {pixels / 1e6:.0f} million pixels.")
    light_field, _ = render_sample(config, 0)
    return _about(light_field, "the first light field", dataset.slopes, config.camera)


def _light_field(folder: Folder) -> "Exhibit":
    """Show a simulated light field, its slider about the slopes of the refocused images."""
    from lf_flame.calibration import read_lens
    from lf_flame.formats import read_light_field

    record, file = folder.path / "simulation.json", folder.path / "light_field.npz"
    if file.stat().st_size > LARGEST_LIGHT_FIELD:
        raise InputError(f"{file.name} has more than 64 MB; `lf-flame view` shows it.")
    slopes = load_record(SimulationRecord, record).slopes
    title = printable(folder.path.resolve().name)
    return _about(read_light_field(file), title, slopes, read_lens(record))


def _about(light_field: "LightField", title: str, slopes: list[float], camera) -> "Exhibit":
    """Show a light field, its slider about some slopes."""
    from lf_flame.refocus import farthest_slope
    from lf_flame.viewer.exhibit import Exhibit

    limit = farthest_slope(light_field.views)
    ends = max(min(slopes) - BEYOND, -limit), min(max(slopes) + BEYOND, limit)
    return Exhibit(light_field, title, ends, slopes[0], camera, with_map=False)
