from .demo import DEMO_CAMERA as DEMO_CAMERA
from .demo import demo_light_field as demo_light_field
from .demo import demo_scene as demo_scene
from .widget import LightFieldWidget as LightFieldWidget
from .widget import show as show
