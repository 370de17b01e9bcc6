"""
A raw image of a plenoptic camera
=================================

A raw image shows thousands of small round micro-images. The lenslet grid is found in a *white
image*, a picture of an evenly lit surface with the same lens settings; then the micro-images are
resampled into views.
"""

import matplotlib.pyplot as plt
import numpy as np

from lf_flame.formats import decode_raw, estimate_grid
from lf_flame.refocus import find_sharpest_slope, shift_and_sum

# %%
# A raw image and its white image, made here: round micro-images of 10.3 pixels, rotated a little,
# that see a pattern at slope 0.6. Yours come from the camera:
# ``lf-flame refocus raw.png --white white.png`` does all of this page.
pitch, angle, true_slope = 10.3, 0.004, 0.6
y, x = np.mgrid[:600, :800].astype(float)
turned = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
down, right = np.tensordot(turned, [y - 300, x - 400], 1) / pitch
row, column = np.round(down), np.round(right)  # the pixel's lenslet
v, u = down - row, right - column  # its place under the lenslet, from -0.5 to 0.5
white = 1 / (1 + np.exp(40 * (np.hypot(v, u) - 0.46)))
scale = 9 * true_slope  # lenslets that the pattern moves from one edge of the aperture to the other
seen_y, seen_x = row - scale * v, column - scale * u
pattern = 0.5 + 0.5 * np.sin(0.9 * seen_x + 0.3 * seen_y) * np.sin(0.7 * seen_y)
raw = white * pattern

figure, axes = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
axes[0].imshow(white[:90, :110], cmap="gray")
axes[0].set_title("white image, enlarged")
axes[1].imshow(raw[:90, :110], cmap="gray")
axes[1].set_title("raw image, enlarged")

# %%
# The grid is found to a hundredth of a pixel.
grid = estimate_grid(white)
print(f"pitch {grid.pitch:.3f} pixels, layout {grid.layout}")
light_field = decode_raw(raw, grid, white=white)
print(light_field)

# %%
# The decoded views refocus as those of any other light field.
found = find_sharpest_slope(light_field)
print(f"sharpest at slope {found.slope:.3f}; the raw image was made with {true_slope}")

# sphinx_gallery_thumbnail_number = 2
figure, axes = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
titles = ("slope 0: out of focus", f"slope {found.slope:.2f}: in focus")
for axis, slope, title in zip(axes, (0.0, found.slope), titles, strict=True):
    axis.imshow(shift_and_sum(light_field, slope), cmap="gray", vmin=0, vmax=1)
    axis.set_title(title)
