"""Refocus and decode with plenpy and PlenoptiCam, in the environment of `baselines.txt`.

One JSON object a line: on standard input {"tool", "views", "slopes", "out"} to get ready, refocus
once and save the images, then {"tool"} to time a call. The first line out holds the versions.
"""

import json
import logging
import os
import sys
import time
from importlib import metadata

import numpy as np


class Plenpy:
    """`LightField.get_refocus`: interp2d of every view, the interpolants kept over the slopes."""

    def __init__(self, views, slopes):
        from plenpy.lightfields import LightField

        self.shape = (*views.shape[2:], len(slopes))
        self.field = LightField(views.reshape(*views.shape[:4], -1), dtype=np.float32)
        # Its views move the other way, and its steps span N view steps in N - 1.
        self.slopes = [-slope * (len(views) - 1) / len(views) for slope in slopes]

    def make_ready(self):
        """Do nothing: a call leaves its light field as it was."""

    def refocus(self):
        """Refocus at all slopes."""
        self.images = self.field.get_refocus(self.slopes)

    def result(self):
        """Images as ours are ordered."""
        return np.moveaxis(self.images.reshape(self.shape), -1, 0)


class PlenoptiCam:
    """`LfpShiftAndSum.refo_from_vp`: whole slopes and three channels only, float64."""

    def __init__(self, views, slopes):
        from plenopticam.cfg import PlenopticamConfig
        from plenopticam.lfp_refocuser.lfp_shiftandsum import LfpShiftAndSum

        (slope,) = slopes
        settings = PlenopticamConfig()
        settings.params[settings.ptc_leng] = len(views)
        settings.params[settings.ran_refo] = [-int(slope), 1 - int(slope)]
        settings.params[settings.opt_refi] = settings.params[settings.opt_prnt] = False
        self.views = views
        self.tool = LfpShiftAndSum(vp_img_arr=views, cfg=settings)

    def make_ready(self):
        """Give it a new copy, as a call divides its light field by N in place."""
        self.tool.vp_img_arr = self.views.astype(np.float64)

    def refocus(self):
        """Refocus at the one slope."""
        self.tool.refo_from_vp()

    def result(self):
        """Images as a true mean: it divides their sum by N, not by N^2."""
        return np.asarray(self.tool.refo_stack) / len(self.views)


class PlenoptiCamDecoding:
    """`LfpLocalResampler`: linear interpolation of every micro-image about its centre."""

    def __init__(self, raw, centres, views):
        from plenopticam.cfg import PlenopticamConfig

        self.settings = PlenopticamConfig()
        self.settings.params[self.settings.ptc_leng] = views
        self.settings.params[self.settings.opt_prnt] = False
        self.settings.calibs[self.settings.mic_list] = centres
        self.settings.calibs[self.settings.pat_type] = "rec"
        self.raw, self.views = raw[..., None], views

    def make_ready(self):
        """Set it up anew, as a call changes its state."""
        from plenopticam.lfp_aligner.lfp_local_resampler import LfpLocalResampler

        self.tool = LfpLocalResampler(lfp_img=self.raw, cfg=self.settings)

    def refocus(self):
        """Decode."""
        self.tool.local_resampling()

    def result(self):
        """Order views as ours are."""
        cells = self.tool.lfp_img_align[..., 0]
        n = self.tool._size_pitch
        rows, columns = (size // n for size in cells.shape)
        return cells.reshape(rows, n, columns, n).transpose(1, 3, 0, 2)


TOOLS = {"plenpy": Plenpy, "plenopticam": PlenoptiCam}


def versions() -> dict:
    """Versions of what is installed."""
    found = {"python": sys.version.split()[0]}
    for name in ("numpy", "scipy", *TOOLS):
        try:
            found[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            continue
    return found


def main() -> None:
    """Answer line by line until standard input ends."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # both tools print as they go
    logging.disable(logging.WARNING)
    ready = {}
    answer = versions()
    while True:
        answers.write(json.dumps(answer) + "\n")
        answers.flush()
        line = sys.stdin.readline()
        if not line:
            return
        request = json.loads(line)
        name = request["tool"]
        if "centres" in request:
            raw = np.load(request["raw"])
            ready[name] = PlenoptiCamDecoding(raw, request["centres"], request["views"])
        elif "views" in request:
            ready[name] = TOOLS[name](np.load(request["views"]), request["slopes"])
        tool = ready[name]
        tool.make_ready()
        started = time.perf_counter()
        tool.refocus()
        answer = {"seconds": time.perf_counter() - started}
        if "out" in request:
            np.save(request["out"], tool.result())


if __name__ == "__main__":
    main()
