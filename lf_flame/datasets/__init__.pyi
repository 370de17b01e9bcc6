from .config import DatasetConfig as DatasetConfig
from .config import read_config as read_config
from .encodings import InputEncoding as InputEncoding
from .making import make_dataset as make_dataset
from .store import Dataset as Dataset
from .store import split_indices as split_indices
from .templates import FlameTemplate as FlameTemplate
from .templates import ShapeTemplate as ShapeTemplate
