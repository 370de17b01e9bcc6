"""
One exposure, many focal planes
===============================

A plenoptic camera records from where light comes as well as where it lands. One exposure therefore
contains pictures of the scene from many viewpoints, and can be focused afterwards.
"""

import matplotlib.pyplot as plt

from lf_flame.refocus import shift_and_sum
from lf_flame.viewer import DEMO_CAMERA, demo_light_field

# %%
# The demonstration scene has three flames at three depths, a patterned burner in front and a
# patterned wall behind. ``light_field.views`` has the axes (v, u, t, s): row and column of the
# view, row and column of the pixel.
light_field = demo_light_field()
print(light_field)

# %%
# The sub-aperture views look from different points of the main lens, so near and far objects move
# in opposite directions from view to view.
figure, axes = plt.subplots(3, 3, figsize=(9, 6.2), layout="constrained")
for row, v in enumerate((0, 4, 8)):
    for column, u in enumerate((0, 4, 8)):
        axes[row, column].imshow(light_field.views[v, u], cmap="inferno", vmin=0, vmax=1)
        axes[row, column].set_title(f"view ({v}, {u})", fontsize=9)
        axes[row, column].axis("off")

# %%
# Refocusing shifts each view in proportion to its place and averages all of them. The *slope* is
# that shift, in pixels from one view to the next; the camera converts depths into slopes.
depths_mm = [15.0, 0.0, -10.0]
images = shift_and_sum(light_field, DEMO_CAMERA.depth_to_slope(depths_mm))

# sphinx_gallery_thumbnail_number = 2
figure, axes = plt.subplots(3, 1, figsize=(7, 14), layout="constrained")
for image, depth, what, axis in zip(
    images, depths_mm, ("the wall", "the middle flame", "the burner"), axes, strict=True
):
    axis.imshow(image, cmap="inferno", vmin=0, vmax=1)
    axis.set_title(f"focused at {depth:g} mm: {what}")
    axis.axis("off")
