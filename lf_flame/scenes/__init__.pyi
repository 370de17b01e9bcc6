from .dead_leaves import DeadLeaves as DeadLeaves
from .flames import draw_wrinkles as draw_wrinkles
from .flames import flame_texture as flame_texture
from .scene import Layer as Layer
from .scene import Scene as Scene
from .scene_files import read_camera as read_camera
from .scene_files import read_scene as read_scene
from .shapes import shape_texture as shape_texture
