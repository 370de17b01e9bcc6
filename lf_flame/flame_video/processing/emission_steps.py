"""Steps of processing that find the emission by depth, and the temperature of soot.

Tomography is imported where it is used, as it doubles the time that other steps take to start.
"""

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from lf_flame.flame_video.processing.steps import Frame, Values
from lf_flame.lightfield import LightField
from lf_flame.optics.lens import Lens

if TYPE_CHECKING:
    from lf_flame.tomography import ColourCalibration, ReconstructionPlan
    from lf_flame.tomography import Emission as Reconstruction

ALIKE = 2.0
"""Largest ratio of the light of two frames of which one takes the strength of the penalty, and the
dependence of noise on brightness, from the other: a dark frame knows neither."""


@dataclass(frozen=True)
class Emission:
    """Reconstruct the emission on depth planes, as `lf_flame.tomography.reconstruct` does.

    A frame's fit starts from that of the frame before in the same task, and takes its strength,
    unless its light differs by more than `ALIKE` from that for which the strength was chosen. All
    colours have the largest of their strengths, so that the effect of the penalty cancels in their
    ratios.

    Attributes
    ----------
    camera : Lens
    depths_mm : tuple of float
        Depths of the planes.
    block, noise, strength, background
        As for `FrustumGrid` and `reconstruct`.
    colours : tuple of str
        Names of the channels of frames in colour; empty for grey frames.
    """

    camera: Lens = field(repr=False)
    depths_mm: tuple[float, ...]
    block: int = 1
    noise: float | None = None
    strength: float | None = None
    background: str = "fit"
    colours: tuple[str, ...] = ()

    def __getstate__(self):
        # Each process makes its own plan, which is large.
        return {name: value for name, value in vars(self).items() if name != "_plan"}

    @cached_property
    def _plan(self) -> "ReconstructionPlan":
        from lf_flame.tomography import FrustumGrid, ReconstructionPlan

        return ReconstructionPlan(
            FrustumGrid(self.camera, self.depths_mm, self.block),
            noise=self.noise,
            strength=self.strength,
            background=self.background,
        )

    def __call__(self, frame: Frame) -> dict[str, Values]:
        """Give emission, noise of a pixel, and number of warnings; the first two by colour."""
        from lf_flame.tomography.soot import split_colours

        light_field = frame.light_field
        lights = split_colours(light_field, self.colours) if self.colours else [light_field]
        last, light = frame.before.get("emission", (None, 0.0))
        found = self._anew(lights) if last is None else self._from(lights, last)
        now = sum(float(one.emission.sum(dtype=np.float64)) for one in found)
        if not light / ALIKE <= now <= light * ALIKE:
            found = found if last is None else self._anew(lights)
            light = now
        frame.before["emission"], frame.emissions = (found, light), found
        for name, one in zip(self.colours or ("",), found, strict=True):
            frame.warnings += [f"{name}: {said}" if name else said for said in one.warnings]
        warnings = sum(len(one.warnings) for one in found)
        emission = np.stack([one.emission for one in found])
        noise = np.array([one.noise for one in found], np.float32)
        by_colour = ("colour",) if self.colours else ()
        known = {"colours": list(self.colours)}
        if not self.colours:
            known, emission, noise = {}, emission[0], noise[0]
        return {
            "depth": Values(np.array(self.depths_mm), ("depth",), {"units": "mm"}),
            "emission": Values(emission, (*by_colour, "depth", "y", "x"), known),
            "emission_noise": Values(noise, by_colour, known),
            "emission_warnings": Values(np.uint8(min(warnings, 255))),
        }

    def _anew(self, lights: list[LightField]) -> "tuple[Reconstruction, ...]":
        """Reconstruct each colour from its light field alone, all with one strength."""
        found = tuple(self._plan.reconstruct(one) for one in lights)
        strengths = {one.strength for one in found}
        if len(strengths) == 1:
            return found
        plan = self._plan.absorbing(None, strength=max(strengths))
        return tuple(plan.reconstruct(one) for one in lights)

    def _from(
        self, lights: list[LightField], last: "tuple[Reconstruction, ...]"
    ) -> "tuple[Reconstruction, ...]":
        """Reconstruct each colour starting from the frame before."""
        both = zip(lights, last, strict=True)
        return tuple(self._plan.reconstruct(light, start=start) for light, start in both)


@dataclass(frozen=True)
class Temperature:
    """Find the temperature of optically thin soot from the emission in each colour.

    Cells whose emission is not above three standard deviations of its noise in every colour have
    none (NaN). Only ratios of the gains count, so the exposure does not.

    Attributes
    ----------
    calibration : ColourCalibration
        Gains and spectral responses of the channels.
    soot_exponent : float
        Exponent a of soot's absorption, ``wavelength^-a``, from -1 to 5.
    """

    calibration: "ColourCalibration"
    soot_exponent: float = 1.0

    def __post_init__(self):
        from lf_flame.tomography.spectra import check_exponent

        check_exponent(self.soot_exponent)

    def __repr__(self):
        # Arrays are cut short by NumPy, and the text of the file is not.
        return f"Temperature({self.calibration.to_toml()!r}, {self.soot_exponent!r})"

    def __call__(self, frame: Frame) -> dict[str, Values]:
        """Give temperatures in K and their standard deviations due to noise, NaN where unknown."""
        from lf_flame.tomography import soot_temperature

        colours = frame.emissions
        if not colours:  # refused, which is told
            return {}
        shape = colours[0].emission.shape
        errors = [np.broadcast_to(one.sigma_linear[:, None, None], shape) for one in colours]
        found = soot_temperature(
            [one.emission for one in colours],
            self.calibration.responses,
            sigmas=errors,
            gains=self.calibration.gains,
            soot_exponent=self.soot_exponent,
        )
        assert found.sigma is not None
        axes, unit = ("depth", "y", "x"), {"units": "K"}
        return {
            "temperature": Values(found.kelvin.astype(np.float32), axes, unit),
            "temperature_sigma": Values(found.sigma.astype(np.float32), axes, unit),
        }
