from .flame_shape import FlameShape as FlameShape
from .flame_shape import measure_flame as measure_flame
from .flicker import Flicker as Flicker
from .flicker import find_flicker as find_flicker
from .outliers import find_outliers as find_outliers
