from .flame_shape import FlameShape as FlameShape
from .flame_shape import measure_flame as measure_flame
from .flame_shape import row_error as row_error
from .flicker import Flicker as Flicker
from .flicker import find_flicker as find_flicker
from .processing import process_frames as process_frames
from .steps import find_steps as find_steps
