"""Tomography: from one light field to the emission at each depth, with errors and temperature.

`lf_flame.tomography.resolution` shows what a light field of one camera cannot resolve.

Names load on first use: operator and fit need the extra ``lf_flame[tomography]``.
"""

from typing import Any

import lazy_loader

_find, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    if name in (
        "find_flicker",
        "measure_flame",
    ):  # former names, from before `lf_flame.flame_video`
        from lf_flame import flame_video

        return getattr(flame_video, name)
    return _find(name)
