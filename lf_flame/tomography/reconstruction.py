"""Emission by depth from one light field, with error bars and warnings."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from lf_flame.lightfield import LightField
from lf_flame.tomography.frustum_grid import FrustumGrid
from lf_flame.tomography.iterative_methods import PENALISED
from lf_flame.tomography.penalties import ROUGHNESS, Penalty
from lf_flame.tomography.reconstruction_plan import ReconstructionPlan
from lf_flame.tomography.reconstruction_result import Reconstruction


def reconstruct(
    light_field: LightField,
    grid: FrustumGrid,
    *,
    noise: float | None = None,
    strength: float | None = None,
    iterations: int | None = None,
    bootstrap: int = 0,
    rng: int | np.random.Generator | None = 0,
    optical_thickness: ArrayLike | None = None,
    penalty: str | Penalty = ROUGHNESS,
    background: str | None = None,
    method: str = PENALISED,
) -> Reconstruction:
    """Find the emission on a grid's depth planes that explains a light field.

    It is a least-squares fit with regularisation (a penalty on roughness) and no negative light.
    The strength follows the discrepancy principle (Morozov 1966): the residual must equal the
    noise, reduced by the degrees of freedom of the fit (Wahba, SIAM J. Numer. Anal. 14, 651, 1977),
    here the trace of the linear fit times the fraction of cells above zero. If the model's own
    error keeps the residual higher, the strength with the smallest excess is used.

    Parameters
    ----------
    light_field : LightField
        Grey light field of the grid's camera, black level subtracted, divided by a white image
        (flat field). Unknown pixels (`LightField.valid`) have weight 0.
    grid : FrustumGrid
        Depth planes and cells.
    noise : float, optional
        Standard deviation of a pixel's noise in the unit of the light field (of the mean of a block
        of pixels, if the grid's cells are blocks). Default: measured from the residual that no
        emission on the grid can make.
    strength : float, optional
        Strength of the regularisation. Default: by the discrepancy principle.
    iterations : int, optional
        Largest number of iterations. Default: 80 of ADMM, which keep the emission from being
        negative, for "penalised"; 1000 for the other methods.
    bootstrap : int, optional
        Number of bootstrap light fields, each made of the found emission and new noise, with the
        measured dependence of noise on brightness, and fitted again for `Reconstruction.sigma`: 0,
        or 2 and more.
    rng : int, numpy.random.Generator or None, optional
        Seed or generator of the bootstrap; with None every call draws differently.
    optical_thickness : float, or array_like of shape (planes,) or (planes, rows, columns), optional
        Known absorption along the line of sight, 0 or above: the total, spread evenly over the
        planes, or a value for each plane, or for each plane and pixel of the central view. Like a
        `Layer`, a plane transmits ``(1 - exp(-tau)) / tau`` of its own light and ``exp(-tau)`` of
        the light from behind it, at greater depth. The penalty then acts on what is left of the
        emission after its own absorption. Default: no absorption.
    penalty : {"roughness", "variation"}, Roughness or TotalVariation, optional
        Kind of regularisation: roughness for flames, which are smooth, and total variation for
        emission with sharp edges, by name or as `lf_flame.tomography.Roughness` with its options.
        Strengths of "variation" are in standard deviations of a cell's filtered noise, 2 by
        default.
    background : {"fit"}, optional
        "fit" subtracts a uniform background of unknown level: the mean of the pixels that no
        emission reaches, so some of the field must be dark. Its error is in the error bars.
        Default: no background.
    method : {"penalised", "sart", "mlem", "lsqr", "nnls"}, optional
        Method: the penalised fit; or, to compare with, a classical one that has no penalty but
        stops as soon as the squared residual of the known rays falls to the noise. SART takes all
        views at once (SIRT), MLEM is Richardson-Lucy, NNLS is non-negative least squares by
        accelerated gradients, and LSQR is linear, with negative light. They have no error bars.

    Returns
    -------
    Reconstruction
        Emission of shape (planes, rows, columns) in the unit of the light field, with warnings,
        and with error bars if `bootstrap` is not 0.

    Raises
    ------
    InputError
        If light field and grid do not match, or a value cannot be used.

    Examples
    --------
    >>> from dataclasses import replace
    >>> import numpy as np
    >>> from lf_flame import PAPER_CAMERA, render
    >>> from lf_flame.tomography import FrustumGrid
    >>> camera = replace(PAPER_CAMERA, views=5, lenslets=(32, 40))
    >>> grid = FrustumGrid(camera, [6.0, -6.0])

    >>> y, x = np.mgrid[-1:1:32j, -1:1:40j]
    >>> glow = np.exp(-8 * (x**2 + y**2))
    >>> cells = np.zeros(grid.shape)
    >>> grid.crop(cells)[...] = glow, 0.5 * glow  # crop: the cells within the central view
    >>> light_field = render(grid.scene(cells), camera)
    >>> from lf_flame.tomography import reconstruct
    >>> found = reconstruct(light_field, grid, noise=0.001)
    >>> bool(np.abs(found.emission - grid.crop(cells)).max() < 0.1)
    True
    """
    plan = ReconstructionPlan(
        grid,
        noise=noise,
        strength=strength,
        iterations=iterations,
        optical_thickness=optical_thickness,
        penalty=penalty,
        background=background,
        method=method,
    )
    return plan.reconstruct(light_field, bootstrap=bootstrap, rng=rng)
