"""
The temperature of soot from two colours
========================================

Hot soot glows as Planck's law says. The ratio of its emission at two wavelengths therefore gives
its temperature, without knowing how much soot there is.
"""

import matplotlib.pyplot as plt
import numpy as np

from lf_flame.scenes import flame_texture
from lf_flame.tomography import two_colour_temperature

# %%
# Soot between 1,600 and 1,900 K, hotter towards the tip, seen at 550 and 650 nm with 0.5 % of
# noise. Soot absorbs, and so emits, in proportion to one over the wavelength.
amount = flame_texture(18.0, 2.5)
height = np.linspace(1, 0, len(amount))[:, None]
true_kelvin = 1600 + 300 * height + 0 * amount


def soot(wavelength_nm):
    """Emission of the soot in arbitrary units."""
    return amount * wavelength_nm**-6.0 / np.expm1(1.4387768775e7 / (wavelength_nm * true_kelvin))


rng = np.random.default_rng(2)
green, red = soot(550.0), soot(650.0)
sigmas = 0.005 * green.max(), 0.005 * red.max()
green = green + rng.normal(0, sigmas[0], green.shape)
red = red + rng.normal(0, sigmas[1], red.shape)
widths = tuple(np.full(amount.shape, sigma) for sigma in sigmas)
found = two_colour_temperature(green, red, wavelengths_nm=(550.0, 650.0), sigmas=widths)

# %%
# Where the light is faint there is no temperature, rather than a wrong one.
figure, axes = plt.subplots(1, 4, figsize=(11, 4.4), layout="constrained")
pictures = (red / red.max(), true_kelvin, found.kelvin, found.sigma)
titles = ("light at 650 nm", "true temperature (K)", "found (K)", "standard deviation (K)")
ranges = ((0, 1), (1500, 2000), (1500, 2000), (0, 100))
for axis, picture, title, (low, high) in zip(axes, pictures, titles, ranges, strict=True):
    kind = "inferno" if "light" in title else "plasma" if "(K)" in title[-5:] else "viridis"
    shown = axis.imshow(picture, cmap=kind, vmin=low, vmax=high)
    axis.set(title=title, xticks=[], yticks=[])
    figure.colorbar(shown, ax=axis, shrink=0.7)
bright = amount > 0.5
off = found.kelvin[bright] - true_kelvin[bright]
print(f"where it is bright: off by {np.nanmean(off):.1f} K, scatter {np.nanstd(off):.1f} K")
