"""Plenoptic simulation, refocusing and learned refocusing of burner flames.

Submodules and public names load on first use, so that ``import lf_flame`` needs neither Numba
nor Keras.
"""

import lazy_loader

__version__ = "0.1.0"

__getattr__, __dir__, __all__ = lazy_loader.attach(
    __name__,
    submodules=["refocus", "models"],
    submod_attrs={
        "errors": ["InputError"],
        "camera": ["PAPER_CAMERA", "PlenopticCamera"],
        "scene": ["Layer", "Scene"],
        "sensor": ["Sensor"],
        "lightfield": ["LightField"],
        "formats": ["read_light_field"],
        "plan": ["plan_effects"],
        "render": ["render"],
    },
)
