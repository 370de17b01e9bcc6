"""
Height and flicker of a flame in a video
========================================

Buoyant flames flicker, small burners at some 10 to 15 Hz. The height of the flame in each frame,
and the sine that stands out in it, give the frequency. ``lf-flame flicker FOLDER`` does it for
files.
"""

import matplotlib.pyplot as plt
import numpy as np

from lf_flame.flame_video import find_flicker, measure_flame, row_error
from lf_flame.scenes import draw_wrinkles, flame_texture

# %%
# A second and a half of a flame at 100 frames a second that flickers at 12.5 Hz and wanders slowly.
rng = np.random.default_rng(5)
times_s = np.arange(150) / 100
heights_mm = 12 + 1.5 * np.sin(2 * np.pi * 12.5 * times_s) + 0.5 * np.sin(2 * np.pi * times_s)
frames = []
for height in heights_mm:
    frame = np.zeros((160, 110))
    texture = flame_texture(height, 1.7, draw_wrinkles(rng), sway_mm=0.2)[:, :110]
    frame[-len(texture) :, : texture.shape[1]] = texture
    frames.append(frame + rng.normal(0, 0.02, frame.shape))

figure, axes = plt.subplots(1, 8, figsize=(10, 2.4), layout="constrained")
for axis, frame, time in zip(axes, frames, times_s, strict=False):
    axis.imshow(frame, cmap="inferno", vmin=0, vmax=1)
    axis.set(title=f"{1000 * time:.0f} ms", xticks=[], yticks=[])

# %%
# The tip is found between rows, to a tenth of a row (``row_error``); the sine is fitted to the
# heights, and counts if it is larger than that.
heights = np.array([measure_flame(frame, pixel_mm=0.1).height for frame in frames])
found = find_flicker(times_s, heights, resolvable=0.1 * row_error())
print(f"{found.frequency_hz:.2f} Hz, resolution {found.resolution_hz:.2f} Hz")

figure, axis = plt.subplots(figsize=(10, 3.2), layout="constrained")
axis.plot(times_s, heights, ".-", color="tab:orange")
axis.set(xlabel="time (s)", ylabel="height (mm)", title=f"{found.frequency_hz:.2f} Hz")
axis.grid(alpha=0.3)
