"""
Only the effects that a scene needs
===================================

Diffraction, vignetting, noise, absorption: each of 17 effects has a bound on how much it can change
the picture. Effects below the tolerance are left out and cost nothing.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from lf_flame import plan_effects
from lf_flame.scenes import read_scene

# %%
# This scene file states a round aperture, a sensor, an absorbing flame and an opaque disc.
checkout = next(x for x in (Path.cwd(), *Path.cwd().parents) if (x / "data_gen").is_dir())
scene, camera, _ = read_scene(checkout / "data_gen" / "scenes" / "effects.toml")
plan = plan_effects(scene, camera, tolerance=0.005)
print(plan)

# %%
# Right of the dashed line an effect may change a pixel by more than the tolerance. Each bar is a
# bound: the change is never larger, and often smaller. An effect without a bar has a bound of 0, or
# its cause is not stated by the scene file.
stated = [effect for effect in plan.effects if 0 < effect.bound < np.inf]
figure, axis = plt.subplots(figsize=(9, 4.5), layout="constrained")
colours = ["tab:orange" if effect.kept else "tab:gray" for effect in stated]
axis.barh([effect.name for effect in stated], [effect.bound for effect in stated], color=colours)
axis.axvline(plan.tolerance, color="black", linestyle="--", label="tolerance")
axis.set(xscale="log", xlabel="bound, relative to the brightest pixel")
axis.set_title("orange: simulated; grey: left out")
axis.invert_yaxis()
axis.legend()
