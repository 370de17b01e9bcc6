from . import formats as formats
from . import models as models
from . import refocus as refocus
from .errors import InputError as InputError
from .formats import read_light_field as read_light_field
from .lightfield import LightField as LightField
from .optics.camera import PAPER_CAMERA as PAPER_CAMERA
from .optics.camera import PlenopticCamera as PlenopticCamera
from .optics.sensor import Sensor as Sensor
from .scenes.scene import Layer as Layer
from .scenes.scene import Scene as Scene
from .simulation.planning.decisions import plan_effects as plan_effects
from .simulation.rendering import render as render

__version__: str
