from .config import DatasetConfig as DatasetConfig
from .config import read_config as read_config
from .encodings import InputEncoding as InputEncoding
from .making import make_dataset as make_dataset
from .split import split_indices as split_indices
from .store import Dataset as Dataset
from .templates import FlameTemplate as FlameTemplate
from .templates import ShapeTemplate as ShapeTemplate
