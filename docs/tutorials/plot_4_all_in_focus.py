"""
A slope for every pixel, and everything in focus
================================================

Where the scene has texture, the views tell the slope of each pixel, and with it the depth. A
picture focused at every pixel's own slope is sharp everywhere.
"""

import matplotlib.pyplot as plt
import numpy as np

from lf_flame.refocus import all_in_focus, shift_and_sum
from lf_flame.scenes import DeadLeaves

# %%
# Overlapping leaves at random slopes from -1.5 to 1.5: opaque, textured, and with a true slope for
# every pixel.
leaves = DeadLeaves(leaves=60, smallest=12.0, largest=60.0, slopes=(-1.5, 1.5), contrast=0.25)
light_field = leaves.draw((7, 7), (160, 240), np.random.default_rng(4))

found = all_in_focus(light_field, np.linspace(-2, 2, 33))

# sphinx_gallery_thumbnail_number = 1
figure, axes = plt.subplots(2, 2, figsize=(10, 7), layout="constrained")
axes[0, 0].imshow(shift_and_sum(light_field, 1.0), cmap="gray", vmin=0, vmax=1)
axes[0, 0].set_title("focused at slope 1")
axes[0, 1].imshow(found.all_in_focus, cmap="gray", vmin=0, vmax=1)
axes[0, 1].set_title("everything in focus")
shown = axes[1, 0].imshow(found.slope, cmap="viridis", vmin=-1.5, vmax=1.5)
axes[1, 0].set_title("slope of each pixel")
figure.colorbar(shown, ax=axes[1, 0], label="slope (pixels per view)", shrink=0.8)
shown = axes[1, 1].imshow(found.confidence, cmap="cividis", vmin=0, vmax=1)
axes[1, 1].set_title("confidence")
figure.colorbar(shown, ax=axes[1, 1], shrink=0.8)
for axis in axes.flat:
    axis.axis("off")
