from .flame_shape import FlameShape as FlameShape
from .flame_shape import measure_flame as measure_flame
from .flicker import Flicker as Flicker
from .flicker import find_flicker as find_flicker
from .outliers import find_outliers as find_outliers
from .processing.frames import process_frames as process_frames
from .processing.result import look_at as look_at
from .processing.step_names import find_steps as find_steps
