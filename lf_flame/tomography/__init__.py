"""From one light field to the light of each depth: resolution, operator, inversion, temperature.

What no light field of one camera can give is said by `lf_flame.tomography.resolution`.

Names load on first use: operator and fit need the extra ``lf_flame[tomography]``, not the rest.
"""

from typing import Any

import lazy_loader

_find, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    if name in (
        "find_flicker",
        "measure_flame",
    ):  # names as they were before `lf_flame.flame_video`
        from lf_flame import flame_video

        return getattr(flame_video, name)
    return _find(name)
