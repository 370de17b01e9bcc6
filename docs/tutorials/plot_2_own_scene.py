"""
A scene of your own
===================

A scene is a list of layers: pictures, shapes or flames at chosen depths. Here an opaque disc stands
in front of a flame, and each sub-aperture view looks past it from another side.
"""

import matplotlib.pyplot as plt
import numpy as np

from lf_flame import Layer, PlenopticCamera, Scene, plan_effects, render
from lf_flame.scenes import flame_texture, shape_texture

camera = PlenopticCamera(
    main_lens_focal_mm=150,
    focus_distance_mm=326,  # from the main lens to the focal plane
    lenslet_focal_mm=0.4,
    lenslet_pitch_mm=0.112,
    views=9,  # pixels under a lenslet, each way
    lenslets=(130, 150),
)

# %%
# Depths count from the focal plane, in mm, and are positive behind it. A disc with a coverage is
# opaque where it is covered, and hides what is farther away.
disc = shape_texture("circle", (5.0, 5.0))
flame = flame_texture(15.0, 2.5)
scene = Scene(
    [
        Layer(flame, depth_mm=20.0, size_mm=(15.0, 16.0)),
        Layer(0.25 * disc, -12.0, (5.0, 5.0), (2.0, 0.0), opaque=True, coverage=disc),
    ]
)

# %%
# Before anything is rendered, the plan says which physical effects this scene needs, and why.
print(plan_effects(scene, camera, tolerance=0.01))

# %%
# The raw image has a small picture of the aperture under every lenslet. The enlarged part lies at
# the disc's edge, where one half of each aperture sees the flame and the other half the disc.
light_field = render(scene, camera, tolerance=0.01)
raw = light_field.to_raw()
row, column = 70 * 9, 53 * 9

figure, axes = plt.subplots(1, 2, figsize=(10, 4.6), layout="constrained")
axes[0].imshow(light_field.views.mean((0, 1)), cmap="inferno")
axes[0].set_title("photograph: the mean of all views")
axes[1].imshow(raw[row : row + 90, column : column + 110], cmap="inferno")
axes[1].set_title("raw image, 10 x 12 lenslets")
axes[1].set_xticks(np.arange(0, 110, 9) - 0.5, [])
axes[1].set_yticks(np.arange(0, 90, 9) - 0.5, [])
axes[1].grid(color="white", alpha=0.3, linewidth=0.5)

# %%
# From the left, in the middle and from the right:
figure, axes = plt.subplots(1, 3, figsize=(10, 3.3), layout="constrained")
for axis, u in zip(axes, (0, 4, 8), strict=True):
    axis.imshow(light_field.views[4, u], cmap="inferno")
    axis.set_title(f"view (4, {u})")
    axis.axis("off")
