"""The viewer in a notebook: Jupyter, JupyterLab, VS Code, Colab, marimo, through anywidget."""

from typing import Any

import anywidget
import traitlets

from lf_flame.calibration.camera_law import CameraLaw
from lf_flame.errors import InputError
from lf_flame.lightfield import LightField
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.viewer.exhibit import Exhibit, choose_slopes
from lf_flame.viewer.scripts import linked_script, read_static


class LightFieldWidget(anywidget.AnyWidget):
    """A viewer with a state that Python and the page share.

    Attributes
    ----------
    slope : float
        Slope of the image, in lenslets per view step.
    aperture : float
        Width of the aperture, in widths of the full one.
    shape : {"square", "round"}
        Shape of the aperture.
    viewpoint : (float, float)
        Centre of the aperture, in views from the central view.
    region : (int, int, int, int) or None
        First row, last row + 1, first column, last column + 1 of the selected region.
    """

    _esm = linked_script("widget.js")
    _css = read_static("viewer.css")
    metadata = traitlets.Dict().tag(sync=True)
    slope = traitlets.Float().tag(sync=True)
    aperture = traitlets.Float(1.0).tag(sync=True)
    shape = traitlets.Enum(("square", "round"), "square").tag(sync=True)
    viewpoint = traitlets.List(traitlets.Float(), [0.0, 0.0], 2, 2).tag(sync=True)
    region = traitlets.List(traitlets.Int(), None, minlen=4, maxlen=4, allow_none=True).tag(
        sync=True
    )

    def __init__(self, exhibit: Exhibit):
        self._data = exhibit.data()
        super().__init__(metadata=exhibit.describe_served(), slope=exhibit.slope)
        self.on_msg(self._answer)

    def _answer(self, _widget: Any, content: Any, _buffers: Any) -> None:
        """Send the data that the page requests, which it can only name."""
        asked = str(content.get("ask")) if isinstance(content, dict) else ""
        make = self._data.get(asked)
        if make is None:
            return
        try:
            self.send({"answer": asked}, [make()])
        except InputError as error:
            self.send({"answer": asked, "error": str(error)}, [])


def show(
    light_field: LightField,
    slopes: tuple[float, float] | None = None,
    camera: PlenopticCamera | CameraLaw | None = None,
    title: str = "Light field",
    with_map: bool = True,
) -> LightFieldWidget:
    """Show a light field in a notebook, with interactive refocusing.

    Parameters
    ----------
    light_field : LightField
        Grey light field, or one of three channels.
    slopes : (float, float), optional
        Ends of the slider in lenslets per view step, the lower one first. Default: found from the
        light field.
    camera : PlenopticCamera or CameraLaw, optional
        Camera for depths in mm and f-numbers.
    title : str, optional
        Title of the viewer.
    with_map : bool, optional
        Whether there is a slope map, which takes some seconds.

    Returns
    -------
    LightFieldWidget
        Viewer; its attributes can be read and set.

    Raises
    ------
    InputError
        If the light field cannot be shown, or the slopes cannot be used.

    Examples
    --------
    >>> import numpy as np
    >>> from lf_flame import LightField, viewer
    >>> light_field = LightField(np.random.default_rng(1).uniform(size=(3, 3, 20, 30)))
    >>> widget = viewer.show(light_field, slopes=(-1, 1), with_map=False)
    >>> widget.slope = 0.5  # moves the picture
    """
    chosen = choose_slopes(light_field, slopes)
    ends = chosen.low, chosen.high
    exhibit = Exhibit(light_field, title, ends, chosen.slope, camera, with_map=with_map)
    return LightFieldWidget(exhibit)
