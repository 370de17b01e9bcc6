from .camera_law import CameraLaw as CameraLaw
from .camera_law import read_lens as read_lens
from .camera_law import thin_lens as thin_lens
from .fit import LawFit as LawFit
from .fit import fit_targets as fit_targets
from .targets import Target as Target
from .targets import measure_target as measure_target
