"""What tomography refuses, each in one sentence."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from sentences import each, refusals

from lf_flame import PAPER_CAMERA, LightField
from lf_flame._common.input_files import LIMIT
from lf_flame.calibration import CameraLaw
from lf_flame.tomography import (
    AbsorbingOperator,
    AxisymmetricGrid,
    FrustumGrid,
    SpectralResponses,
    calibrate_colours,
    depth_blur,
    find_axis,
    measure_source,
    profiles,
    read_responses,
    reconstruct,
    reconstruct_axisymmetric,
    reconstruct_soot,
    soot_temperature,
    two_colour_temperature,
)
from lf_flame.tomography.absorption import spread_thickness
from lf_flame.tomography.frequency_gram import FrequencyGram
from lf_flame.tomography.frustum_grid import planes_between

NAN, INF = float("nan"), float("inf")
CAMERA = replace(PAPER_CAMERA, views=7, lenslets=(54, 60))
GRID = FrustumGrid(CAMERA, (3.0, 0.0, -4.0))
ROUND = AxisymmetricGrid(CAMERA, 0.0, 0.0, 2.0)
EVEN = LightField(np.ones((7, 7, 54, 60), np.float32))
COLOURED = LightField(np.ones((7, 7, 54, 60, 3), np.float32))
LAW = CameraLaw(
    slope_at_infinity=2.0, slope_mm=-800.0, centre_mm=-400.0, scale=0.002,
    depth_range_mm=(-16.0, 8.0), views=7, lenslets=(54, 60),
)  # fmt: skip
THICKNESS = spread_thickness(GRID, 0.5)
PLANE = np.ones((10, 8))
NO_DRAWS = np.empty((0, 10, 8))
NM = np.arange(400.0, 701.0, 10.0)
CURVES = np.array([np.exp(-(((NM - at) / 40) ** 2)) for at in (460, 540, 610)])
BANDS = SpectralResponses(("blue", "green", "red"), NM, CURVES)
HALF, FEW = np.ones((7, 7)), np.zeros((7, 7))
HALF[3, 2] = 0.5
FEW[2, 2:5] = FEW[4, 2:5] = 1
LITTLE = np.zeros(EVEN.views.shape, bool)
LITTLE[3, 3, 27] = True


TABLES = {
    "nm,red\n500,1\n600,1\n": "must begin with a header row, wavelength_nm",
    "wavelength_nm,red\n500,1\n": "2 wavelengths or more, got 1",
    "wavelength_nm,red\n500,1\n600\n": "must contain 2 numbers in each row",
    "wavelength_nm,red\n500,1\n600,x\n": "must contain 2 numbers",
    "wavelength_nm,red\n0.5,1\n0.6,1\n": "must be in nm",
    "wavelength_nm,red\n600,1\n500,1\n": "must increase",
    "wavelength_nm,red\n500,-1\n600,1\n": "0 or above",
    "wavelength_nm,red,green\n500,1,0\n600,1,0\n": "'green' responds to no wavelength",
    "wavelength_nm,red\n500,nan\n600,1\n": "must be finite",
    "wavelength_nm,../up\n500,1\n600,1\n": "must be 1 to 40 letters.*got '../up'",
    "wavelength_nm,red,red\n500,1,1\n600,1,1\n": "must have different names",
}


def read_table(text):
    Path("camera.csv").write_text(text)
    read_responses("camera.csv")


def limited(call):
    """With a thousandth of a GB of memory."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(LIMIT, "0.001")
        call()


SINGLE = {"first": [1.0], "second": [1.0], "wavelengths_nm": (550.0, 650.0)}
REFUSED = [
    *each(
        partial(FrustumGrid, CAMERA),
        ({"depths_mm": [5.0, 5.0]}, "no two equal"),
        ({"depths_mm": [5.0, 0.0, 3.0]}, "increase or decrease"),
        ({"depths_mm": [-400.0]}, "main lens"),
        ({"depths_mm": ["a"]}, r"depths_mm must be real numbers, got \['a'\]"),
        ({"depths_mm": [0.0], "block": 5}, "Blocks of 5 x 5 .* do not divide .* 54 x 60"),
        ({"depths_mm": [0.0], "block": 0}, "Blocks of 0 x 0"),
        ({"depths_mm": [0.0], "block": 2.0}, r"whole numbers, got \(2.0, 2.0\)"),
        ({"depths_mm": [0.0], "used_views": np.ones((3, 3))}, r"of shape \(7, 7\), got \(3, 3\)"),
        ({"depths_mm": [0.0], "used_views": [[1], [1, 1]]}, "used_views must be real numbers"),
    ),
    *(
        (lambda change=change: FrustumGrid(replace(CAMERA, **change), [0.0]), next(iter(change)))
        for change in (
            {"rim_diameter_mm": 70.0}, {"chromatic_shift": 0.01}, {"lenslet_rotation_rad": 1e-3},
            {"lenslet_pitch_error": 1e-3}, {"falloff_corrected": False},
        )
    ),
    (
        lambda: FrustumGrid(replace(CAMERA, aperture_diameter_mm=3 * CAMERA.view_step_mm), [0.0]),
        "3 rows and 3 columns or more, got 1 and 1",
    ),
    (partial(FrustumGrid, LAW, [9.0, 0.0]), "from -16 to 8 mm, .* of its targets, got 9 mm"),
    (partial(planes_between, 0, 1, 0.3), "must divide the distance from 0 to 1 mm"),
    (partial(planes_between, 0, 1, 0), "finite ends and a step above 0 mm"),
    (
        lambda: FrequencyGram(FrustumGrid(PAPER_CAMERA, np.linspace(-20, 20, 200))),
        "200 planes of .* GB",
    ),
    (partial(AbsorbingOperator, GRID, THICKNESS[:2]), "grid's shape"),
    (partial(limited, partial(AbsorbingOperator, GRID, THICKNESS)), "Transmissions of 3 slabs"),
    *each(
        partial(reconstruct, EVEN, GRID),
        ({"noise": 0.0}, "noise must be above 0.*leave it out to have it measured"),
        ({"strength": 0.0}, "strength must be above 0.*leave it out to have it chosen"),
        ({"strength": NAN}, "strength must be"),
        ({"bootstrap": 1}, "bootstrap must be"),
        ({"background": "even"}, "'fit' or 'none'"),
        ({"optical_thickness": NAN}, "must be finite"),
        ({"optical_thickness": [0.1, -0.1, 0.1]}, "0 or above"),
        ({"optical_thickness": [1.0, 0.5, 0.6]}, "at most 2 in total, got 2.1"),
        ({"optical_thickness": [0.1, 0.1]}, "numbers for 3 planes"),
        ({"optical_thickness": np.zeros((3, 54, 59))}, "54 x 60 pixels, got shape"),
        ({"optical_thickness": "0.5"}, "thickness must be real numbers, got '0.5'"),
        ({"optical_thickness": [[0.1], [0.1, 0.2]]}, "thickness must be real numbers"),
    ),
    (
        lambda: reconstruct(EVEN, FrustumGrid(replace(CAMERA, lenslets=(54, 66)), [0.0])),
        "54 x 66",
    ),
    (partial(reconstruct, COLOURED, GRID), "grey"),
    (
        lambda: reconstruct(LightField(EVEN.views, weights=HALF), GRID),
        "of equal weight, or of weight 0, got weights from 0.5 to 1",
    ),
    (
        lambda: reconstruct(LightField(EVEN.views, valid=np.zeros(EVEN.views.shape)), GRID),
        "are marked unknown",
    ),
    (
        lambda: reconstruct(LightField(EVEN.views, valid=LITTLE), GRID),
        "degrees of freedom of the emission, got 60: state the noise",
    ),
    (partial(reconstruct_soot, COLOURED, GRID, None, optical_thickness=0.5), "cannot be stated"),
    (
        lambda: reconstruct(LightField(EVEN.views, weights=FEW), GRID),
        "3 rows and 3 columns or more, got 2 and 3",
    ),
    *each(
        partial(replace, ROUND),
        ({"which": "some"}, "which must be one of"),
        ({"finer": 0}, "finer must be a whole number, 1 or more, got 0"),
        ({"finer": 1.5}, "finer must be a whole number"),
        ({"axis_mm": NAN}, "must be finite"),
        ({"axis_mm": 9.0}, "must lie within the field"),
        ({"radius_mm": 0.3}, "at least four pixels"),
        ({"radius_mm": 1e20}, "at most the field's width"),
        ({"burner_mm": 8.0}, "burner_mm must be within the field"),
        ({"camera": replace(CAMERA, lenslets=(4000, 6000)), "radius_mm": 150.0}, "larger blocks"),
    ),
    *each(
        partial(reconstruct_axisymmetric, EVEN, ROUND),
        ({"noise": 0.0}, "noise must be"),
        ({"strength": 0.0}, "strength must be"),
        ({"bootstrap": 1}, "bootstrap must be"),
    ),
    (
        lambda: reconstruct_axisymmetric(LightField(EVEN.views[:, :, :-1]), ROUND),
        "must be grey, of the camera's",
    ),
    (lambda: find_axis(LightField(0 * EVEN.views), CAMERA), "contains no light"),
    (lambda: find_axis(LightField(EVEN.views[:, :1]), CAMERA), "3 or more view columns"),
    (partial(find_axis, COLOURED, CAMERA), "in colour, its colours need a calibration"),
    *(
        (partial(profiles.axial, *arguments), said)
        for arguments, said in (
            ((PLANE, NO_DRAWS, 0.5, 2.1), "must lie within the plane, -2 to 2 mm"),
            ((PLANE, NO_DRAWS, 0.5, 0.0, -1.0), "width must be"),
        )
    ),
    *((partial(depth_blur, PAPER_CAMERA, period), "above 0") for period in (0.0, NAN)),
    *each(
        lambda **options: two_colour_temperature(**SINGLE | options),
        ({"wavelengths_nm": (550, 550)}, "must increase"),
        ({"wavelengths_nm": (550, 550.1)}, "see nearly the same light"),
        ({"wavelengths_nm": (550,)}, "two colours or more"),
        ({"wavelengths_nm": (0.55, 0.65)}, "in nm, from 100"),
        ({"soot_exponent": INF}, "soot_exponent must be from -1 to 5, got inf"),
        ({"second": [1.0, 2.0]}, "need one shape"),
        ({"calibration": 0.0}, "calibration"),
    ),
    *((partial(read_table, text), said) for text, said in TABLES.items()),
    (
        lambda: soot_temperature([[1.0]], SpectralResponses.single((550,))),
        "two colours or more",
    ),
    (partial(soot_temperature, [[1.0]] * 2, BANDS), "each of the 3 spectral responses, got 2"),
    (
        lambda: soot_temperature([[1.0]] * 2, SpectralResponses(("a", "b"), NM, [CURVES[0]] * 2)),
        "see nearly the same light",
    ),
    (partial(soot_temperature, [[1.0]] * 3, BANDS, gains=(1, 0, 1)), "gains must be 3 finite"),
    (partial(calibrate_colours, [1500], [[1, 1, 1]], BANDS), "two temperatures or more"),
    (partial(calibrate_colours, [1500, 1600], [[1, 1]] * 2, BANDS), r"shape \(2, 3\)"),
    (partial(calibrate_colours, [1500, 1600], [[1, 1, 0]] * 2, BANDS), "above 0, got 0"),
    (partial(calibrate_colours, [9, 16], [[1, 1, 1]] * 2, BANDS, emissivity=2), "emissivity must"),
    (partial(measure_source, [np.ones((20, 20))]), "in colour and of equal size"),
    (partial(measure_source, [np.eye(20)[..., None] * [1, 1]]), "evenly bright over 100"),
]  # fmt: skip

test_it_is_refused_in_a_sentence = refusals(REFUSED)
