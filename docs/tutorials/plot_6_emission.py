"""
What each depth of a flame emits
================================

A refocused image also shows the blurred light of all other depths. A reconstruction asks another
question: what does each depth emit, so that all views come out as recorded?
"""

import matplotlib.pyplot as plt
import numpy as np

from lf_flame import Layer, LightField, PlenopticCamera, Scene, render
from lf_flame.refocus import shift_and_sum
from lf_flame.scenes import draw_wrinkles, flame_texture
from lf_flame.tomography import FrustumGrid, reconstruct

camera = PlenopticCamera(
    main_lens_focal_mm=150,
    focus_distance_mm=326,
    lenslet_focal_mm=0.4,
    lenslet_pitch_mm=0.112,
    views=9,
    lenslets=(120, 120),
)

# %%
# Three wrinkled flames behind each other, partly in line, recorded with 1 % of noise.
rng = np.random.default_rng(3)
depths_mm = [20.0, 5.0, -10.0]
layers = []
for depth, right, height in zip(depths_mm, (-2.0, 0.5, 2.5), (13.0, 11.0, 9.0), strict=True):
    texture = flame_texture(height, 1.6, draw_wrinkles(rng), sway_mm=0.5, swelling=0.1)
    layers.append(Layer(texture, depth, (height, 0.1 * texture.shape[1]), (0.0, right)))
views = render(Scene(layers), camera).views
light_field = LightField(views + rng.normal(0, 0.01 * views.max(), views.shape))

# %%
# The burners' depths are known; the emission of each is fitted, without negative light.
found = reconstruct(light_field, FrustumGrid(camera, depths_mm))
refocused = shift_and_sum(light_field, camera.depth_to_slope(depths_mm))
alone = [render(Scene([layer]), camera).views[4, 4] for layer in layers]  # the truth

figure, axes = plt.subplots(3, 3, figsize=(9, 9.3), layout="constrained")
rows = zip(("truth", "refocused", "reconstructed"), (alone, refocused, found.emission), strict=True)
for row, (name, images) in enumerate(rows):
    for column, image in enumerate(images):
        shown = axes[row, column].imshow(image, cmap="inferno", vmin=0, vmax=1)
        axes[row, column].set(xticks=[], yticks=[])
        axes[0, column].set_title(f"{depths_mm[column]:g} mm")
    axes[row, 0].set_ylabel(name, fontsize=12)
figure.colorbar(shown, ax=axes, label="emission", shrink=0.5)

# %%
# Relative errors, root mean square:
for depth, truth, image, emission in zip(depths_mm, alone, refocused, found.emission, strict=True):
    scale = np.sqrt(np.mean(truth**2))
    blurred, fitted = (np.sqrt(np.mean((one - truth) ** 2)) / scale for one in (image, emission))
    print(f"{depth:5g} mm: refocused {blurred:.0%}, reconstructed {fitted:.1%}")
