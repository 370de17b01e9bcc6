"""Files that hold a camera's law, and the thin-lens camera that has it."""

from pathlib import Path

from lf_flame._common.config import build
from lf_flame._common.input_files import read_toml
from lf_flame.calibration.camera_law import TABLE, CameraLaw
from lf_flame.errors import InputError
from lf_flame.optics.camera import PlenopticCamera
from lf_flame.scenes.scene_files import read_camera


def read_law(path: str | Path) -> CameraLaw:
    """Read a law from the table ``[law]`` of a TOML file, as `lf-flame calibrate` writes it.

    Raises
    ------
    InputError
        If the file cannot be read, has no such table, or a value cannot be used.

    Examples
    --------
    >>> from pathlib import Path
    >>> from lf_flame.calibration import CameraLaw, read_law
    >>> law = CameraLaw(
    ...     slope_at_infinity=2.0, slope_mm=-800.0, slope_centre_mm=-400.0, scale=0.002,
    ...     scale_centre_mm=-400.0, depth_range_mm=(-50.0, 50.0), views=9, lenslets=(60, 90),
    ... )
    >>> _ = Path("calibration.toml").write_text(law.to_toml())
    >>> read_law("calibration.toml") == law
    True
    """
    values = read_toml(path)
    if TABLE not in values:
        raise InputError(f"{path} has no table [{TABLE}]: it is not a calibration.")
    return build(CameraLaw, values[TABLE], f"{path}: {TABLE}")


def read_lens(path: str | Path) -> PlenopticCamera | CameraLaw:
    """Read a camera from a file: its table ``[law]``, or else its table ``[camera]``.

    Parameters
    ----------
    path : str or Path
        Calibration, camera or scene file (.toml), or the ``simulation.json`` of a simulation.

    Returns
    -------
    CameraLaw or PlenopticCamera
        The law of a calibration, else the thin-lens camera.

    Raises
    ------
    InputError
        If the file cannot be read, has neither, or a value cannot be used.

    Examples
    --------
    >>> from lf_flame.calibration import read_lens
    >>> read_lens("scene.toml").views
    9
    """
    if Path(path).suffix != ".json" and TABLE in read_toml(path):
        return read_law(path)
    return read_camera(path)


def thin_lens(law: CameraLaw, lenslet_mm: float) -> PlenopticCamera:
    """Make the thin-lens camera that has a law, for simulations and reconstructions.

    Its depths are from the focal plane, at `CameraLaw.focal_plane_mm` of the law. The views divide
    a micro-image evenly, as those of decoded pictures do.

    Parameters
    ----------
    law : CameraLaw
        Law with equal centres of slope and scale.
    lenslet_mm : float
        Distance between the centres of neighbouring lenslets, by their maker.

    Raises
    ------
    InputError
        If no thin lens has this law.

    Examples
    --------
    >>> from lf_flame.calibration import CameraLaw, thin_lens
    >>> law = CameraLaw(
    ...     slope_at_infinity=2.0, slope_mm=-800.0, slope_centre_mm=-400.0, scale=0.002,
    ...     scale_centre_mm=-400.0, depth_range_mm=(-50.0, 50.0), views=9, lenslets=(60, 90),
    ... )
    >>> round(thin_lens(law, 0.1).image_distance_mm, 6)
    50.0
    """
    if not law.slope_mm < 0:
        raise InputError(
            "No thin lens has this law: its slopes fall with depth, so the order of the views is "
            "reversed."
        )
    if law.scale_centre_mm != law.slope_centre_mm:
        raise InputError("No thin lens has this law: slope and scale have different centres.")
    image = lenslet_mm / law.scale
    width = -law.slope_mm * law.scale * law.views  # of the pupil: B d is the step of a view
    if not width > lenslet_mm:
        raise InputError(
            f"No thin lens has this law with lenslets of {lenslet_mm:g} mm: its pupil would be "
            f"{width:.3g} mm wide."
        )
    distance = law.focus_distance_mm
    return PlenopticCamera(
        main_lens_focal_mm=distance * image / (distance + image),
        focus_distance_mm=distance,
        lenslet_focal_mm=lenslet_mm * image / (width - lenslet_mm),
        lenslet_pitch_mm=lenslet_mm,
        views=law.views,
        lenslets=law.lenslets,
        aperture_diameter_mm=law.aperture_diameter_mm,
    )
