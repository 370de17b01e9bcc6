"""Measures of disagreement between a light field and the model, each with a limit and a warning."""

from typing import NamedTuple

import numpy as np

from lf_flame.errors import InputError
from lf_flame.lightfield import LightField
from lf_flame.tomography.axis import MARGIN, find_axis
from lf_flame.tomography.axisymmetric_grid import AxisymmetricGrid
from lf_flame.tomography.frustum_grid import FrustumGrid
from lf_flame.tomography.geometries import SectionGeometry, project
from lf_flame.tomography.noise import inner, measure_edge
from lf_flame.tomography.resolution import NO_DEPTH, angular_width, depth_blur, finest_period

MODEL_ERROR = 2e-3
"""Residual relative to the peak that may be due to the grid."""

APART = 3
"""Distance in pixels over which the residual is compared with itself: farther than decoding spreads
noise, and less than the flame's detail."""

STRUCTURE, SHARED = 0.015, 0.005
"""Correlation of residuals `APART` pixels apart above which they are not white noise, and its
increase where neighbours share noise: the penalty is stronger then, and leaves more light."""

MOST_SIGMAS = 4.0
"""Number of standard errors that a departure of the axis must exceed to be more than noise."""

ALIKE = 0.3
"""Smallest cosine between the light of two depth planes with flames behind each other: flames side
by side reach 0.15, flames behind each other 0.6 and more."""


class Check(NamedTuple):
    """A measure of disagreement between data and model, and the warning if it is too large."""

    name: str
    number: float
    limit: float
    sentence: str

    @property
    def failed(self) -> bool:
        """Whether the number is above its limit."""
        return bool(self.number > self.limit)


def left_out(grid: FrustumGrid | AxisymmetricGrid, valid: np.ndarray | None) -> list[Check]:
    """Check how many views and rays are not fitted; refuse a light field without known rays."""
    every, fitted, checks = grid.camera.views**2, grid.view_count, []
    if 1 < fitted < every:  # the central view alone is a choice
        sentence = (
            f"{fitted} of the {every} views are fitted: the others have weight 0, or the round "
            f"aperture cuts them."
        )
        checks.append(Check("left out", every - fitted, 0, sentence))
    lost = 0 if valid is None else int(np.count_nonzero(~valid))
    if valid is not None and lost:
        if lost == valid.size:
            raise InputError(
                "All pixels of this light field are marked unknown; there is nothing to fit."
            )
        sentence = (
            f"{lost} of the {valid.size} rays are unknown, such as saturated ones, and have weight "
            f"0: emission that almost no other ray sees is a guess, with error bars too narrow."
        )
        checks.append(Check("left out", lost, 0, sentence))
    return checks


def depth_checks(grid: FrustumGrid, emission: np.ndarray) -> list[Check]:
    """Check for planes nearer than the blur of the finest detail, or of light behind each other."""
    steps = np.abs(np.diff(grid.depths_mm))
    if not steps.size:
        return []
    finest = finest_period(grid.camera, grid.block)
    flat = emission.reshape(len(emission), -1).astype(np.float64)
    products = flat @ flat.T
    power = np.diagonal(products)
    # Mean squared frequency of the light's own detail.
    rough = sum(float(np.sum(np.square(np.diff(emission, axis=axis)))) for axis in (1, 2))
    period = 2 * np.pi * finest / 2 * float(np.sqrt(power.sum() / rough)) if rough else finest
    blur = depth_blur(grid.seen_from, max(period, finest))
    apart = np.abs(np.subtract.outer(grid.depths_mm, grid.depths_mm))
    alike = products / np.sqrt(np.maximum(np.outer(power, power), 1e-300))
    behind = (apart > 0) & (apart < blur) & (alike >= ALIKE)
    least = float(apart[behind].min() if behind.any() else steps.min())
    nearer = depth_blur(grid.seen_from, finest) > steps.min()
    sentence = (
        f"{NO_DEPTH}: its detail, of {period:.2g} mm, is blurred over {blur:.2g} mm in depth; "
        f"planes {least:.3g} mm apart resolve periods up to "
        f"{least * angular_width(grid.seen_from):.2g} mm. The penalty shares the rest of the light "
        f"among planes, and error bars do not include all of that."
    )
    return [Check("depth", blur / least if nearer or behind.any() else 0.0, 1.0, sentence)]


def data_checks(
    views: np.ndarray,
    residual: np.ndarray,
    chi_squared: np.ndarray,
    found,
    *,
    stated: bool = False,
    fitted_background: bool | None = None,
) -> list[Check]:
    """Check light, noise, single views, structure of the residual, and the edge of the field.

    views : light field that was fitted, (v, u, t, s), or its views one after the other
    residual : part of all views that the emission does not explain, (v, u, t, s)
    chi_squared : its mean square in each view, in units of the noise's variance; NaN if unknown
    found : the fit; `stated` : whether its noise was; `fitted_background` : None if not wanted
    """
    noise, peak = found.noise, float(views.max())
    means = views.mean(axis=(0, 1), dtype=np.float64)
    error = noise / np.sqrt(np.prod(views.shape[:2]))
    brightest, darkest = float(means.max()), float(means.min())
    if not brightest > 5 * error:
        said = "contains no light above its noise"
        if -darkest > 5 * error:
            said = "is negative: its sign is flipped, or too much was subtracted"
        sentence = (
            f"The light field {said} (means over the views from {darkest:.3g} to {brightest:.3g}): "
            f"check the exposure, and what was subtracted."
        )
        return [Check("light", 5 * (error + 1e-30) / max(brightest, 1e-30), 1, sentence)]
    times = found.measured / max(noise, 1e-30)
    ceiling = int(np.count_nonzero(views == peak))
    return [
        Check(
            "noise", times if stated else 0.0, 1.1,
            f"The light that no emission explains is {times:.3g} times the stated noise: "
            f"depths, alignment, gains or a background may be wrong.",
        ),
        *_misfit(views, residual, chi_squared, found),
        *_edge(views, error, fitted_background),
        Check(
            "saturation", ceiling, 3,
            f"{ceiling} pixels are at exactly the brightest value, {peak:g}: the sensor may be "
            f"saturated, and emission is then too low.",
        ),
        Check(
            "absorption", float(not found.settled), 0,
            "The correction for absorption has not converged: the flame is too thick.",
        ),
    ]  # fmt: skip


def _misfit(views, residual, chi_squared, found) -> list[Check]:
    """Check for one view that is explained worse than all others, and for structure in all."""
    peak = float(views.max())
    worst = np.unravel_index(np.nanargmax(chi_squared), chi_squared.shape)
    middle, highest = float(np.nanmedian(chi_squared)), float(chi_squared[worst])
    by_view, known = residual[np.isfinite(chi_squared)], chi_squared[np.isfinite(chi_squared)]
    alone = highest - middle > 2 * (np.sort(known)[-3:][0] - middle)
    visible = np.sqrt(highest) * found.noise > MODEL_ERROR * peak
    excess = highest / middle if alone and visible and middle > 0 else 1.0
    if excess > 1.3:
        # Least squares leaves more of a fault in its view than in all other views together.
        order = np.argsort(known)
        rest, odd = by_view[order[:-2]], by_view[order[-2:]]
        shared = _correlation(rest) * inner(rest, rest)
        by_view = rest
        if shared < inner(odd, odd):
            by_view = np.zeros_like(rest)
        else:
            excess = 1.0
    correlation = _correlation(by_view)
    size = float(np.sqrt(inner(by_view, by_view) / by_view.size))
    # Five standard errors of a correlation of white noise, of pairs along rows and columns.
    limit = max(STRUCTURE + SHARED * (found.shared**2 - 1), 5 / np.sqrt(2 * by_view.size))
    structured = np.sqrt(max(correlation, 0)) * size > MODEL_ERROR * peak
    far_above = middle > 1.3 and size > MODEL_ERROR * peak
    number = max(correlation / limit if structured else 0.0, middle / 1.3 if far_above else 0.0)
    return [
        Check(
            "view", excess, 1.3,
            f"View {worst[0]}, {worst[1]} is explained {excess:.3g} times worse than the median "
            f"view: its gain, or the alignment, may be off.",
        ),
        Check(
            "structure", number, 1.0,
            f"No emission explains the views: the residual is {size / peak:.1%} of the peak, "
            f"{max(correlation, 0):.0%} of it is structure that noise does not have, and "
            f"chi-squared of the median view is {middle:.3g}. Check depths or axis, camera, "
            f"alignment, gains, black level, linearity and occlusion; error bars exclude this.",
        ),
    ]  # fmt: skip


def _correlation(residual: np.ndarray) -> float:
    """Correlation of residuals of pixels `APART` from each other, over rows and columns."""
    power = inner(residual, residual) / residual.size
    pairs = (
        (residual[..., APART:, :], residual[..., :-APART, :]),
        (residual[..., APART:], residual[..., :-APART]),
    )
    found = [inner(one, other) / one.size for one, other in pairs if one.size]
    return float(np.mean(found)) / power if found and power else 0.0


def _edge(views: np.ndarray, error: float, fitted: bool | None) -> list[Check]:
    """Check for light at the edges of the field: a background, or emission that is cut off."""
    edge, peak = measure_edge(views), float(views.max())
    adds = abs(edge.adds) if abs(edge.level) > 5 * edge.error else 0.0  # else it is noise
    share = f"{adds:.0%} of the" if adds < 1 else "more than the rest of its"
    advice = {
        None: "subtract the dark frame, or fit the background (--background fit)",
        False: "no pixel is free of emission, so none could be fitted: subtract the dark frame",
        True: "it is uneven: subtract a picture without the flame",
    }[fitted]
    bright = edge.brightest if edge.brightest > 8 * max(error, 1e-6 * peak) else 0.0
    return [
        Check(
            "background", adds, 0.01,
            f"The field's edge is at {edge.level:.3g} +- {edge.error:.1g}, which "
            f"{'adds' if edge.level > 0 else 'takes away'} about {share} light if nothing glows "
            f"there; {advice}.",
        ),
        Check(
            "edge", bright / peak if adds <= 0.01 else 0.0, 0.01,
            f"Light reaches the field's edge ({edge.brightest:.3g}): emission is cut off "
            f"there, and wrong within the parallax of the edge.",
        ),
    ]  # fmt: skip


def axis_checks(
    light_field: LightField, geometry: SectionGeometry, views: np.ndarray
) -> list[Check]:
    """Check whether a flame is upright, where it is stated, and axisymmetric.

    `views` are those of the light field that are fitted. A number is in units of its limit: the
    larger of a tenth of a pixel, or of what is negligible, and four standard errors.
    """
    grid = geometry.grid
    depth = grid.depth_mm if light_field.views.shape[1] < 3 else None
    try:
        axis = find_axis(light_field, grid.camera, depth)
    except InputError as error:  # of views whose weights differ, for example, which can be fitted
        return [Check("axis", 2.0, 1.0, f"The axis is not checked: {error}")]
    least = 0.1 * grid.pixel_mm
    pupil = grid.camera.views * grid.camera.view_step_mm
    half_angle = pupil / 2 / grid.camera.distance_mm(grid.depth_mm)
    # In mm at the stated depth, where the central view sees the axis and the edge.
    scale = grid.camera.field_mm(grid.depth_mm)[1] / grid.camera.field_mm(axis.depth_mm)[1]
    across, edge = axis.across_mm * scale, axis.radius_mm * scale / MARGIN
    lit = project(geometry.operator, np.ones(grid.shape))
    outside, beyond = 0.9 * edge / grid.radius_mm, _light_outside(grid, views, lit)
    extent = f"there is light out to {edge:.3g} mm" if outside > 1 else "light lies beyond it"
    shown = "the light field shows it at"
    places = [
        (axis.lean_deg, 1.0, axis.lean_error_deg, f"leans by {axis.lean_deg:.1f} degrees"),
        (axis.depth_lean_deg, 5.0, axis.depth_lean_error_deg,
         f"leans by {axis.depth_lean_deg:.0f} degrees in depth"),
        (axis.wander_mm, least, axis.wander_error_mm,
         f"is not straight: it moves by up to {axis.wander_mm:.2g} mm across with height"),
        (grid.axis_mm - across, least, axis.across_error_mm * scale,
         f"was stated {grid.axis_mm:.3f} mm across, {shown} {across:.3f} mm"),
        # A wrong depth displaces the axis in the outermost views by the parallax.
        (grid.depth_mm - axis.depth_mm, least / half_angle, axis.depth_error_mm,
         f"was stated at a depth of {grid.depth_mm:.2f} mm, {shown} {axis.depth_mm:.2f} mm"),
        (max(outside, beyond), 1.0, 0.0,
         f"is that of a flame of {grid.radius_mm:.3g} mm radius, but {extent}"),
    ]  # fmt: skip
    checks = [
        Check("axis", abs(number) / max(limit, MOST_SIGMAS * error), 1.0,
              f"The axis {words}: emission is wrong there by more than its error bars.")
        for number, limit, error, words in places
    ]  # fmt: skip
    sentence = (
        f"The flame is not axisymmetric: its halves differ by {axis.lopsided:.1%} of its light, "
        f"and the result is the axisymmetric flame most like it."
    )
    checks.append(Check("roundness", axis.lopsided, 0.03, sentence))
    return checks


def _light_outside(grid: AxisymmetricGrid, views: np.ndarray, lit: np.ndarray) -> float:
    """Light where no flame within a grid's radius can be, over 0.2 % of all, or 0 if noise."""
    dark = grid.place(lit).max(axis=(0, 2)) <= 0  # view column, column
    views = grid.place(views)
    rows = views.sum(axis=0, dtype=np.float64).transpose(1, 0, 2)[:, dark].sum(axis=1)
    # Noise differs between neighbouring rows, the flame very little.
    error = np.sqrt(np.sum(np.square(np.diff(rows))) / 2)
    light, total = float(rows.sum()), float(views.sum(dtype=np.float64))
    return light / (2e-3 * total) if light > MOST_SIGMAS * error and total > 0 else 0.0
