"""Classical methods: against their formulas on dense matrices, and on light fields of own rays."""

from dataclasses import replace

import numpy as np
import pytest
from pylops import MatrixMult
from scipy.optimize import nnls

from experiments.emission.truth import Lens, Sheet, cells, record
from lf_flame import PAPER_CAMERA, InputError, LightField
from lf_flame.tomography import FrustumGrid, Roughness, reconstruct
from lf_flame.tomography.iterative_methods import METHODS, iterate

RIVALS = METHODS[1:]
A = np.random.default_rng(3).uniform(0, 1, (40, 9)) ** 4
A[:, 4] = 0  # a cell that no ray sees
LIGHT = np.array([0, 2, 0, 1, 0, 3, 0.5, 0, 1])
NOISE = 0.3
RAYS = (A @ LIGHT + NOISE * np.random.default_rng(4).standard_normal(40)).astype(np.float32)
OPERATOR = MatrixMult(A.astype(np.float32), dtype="float32")


def sart(steps):
    x, seen = np.zeros(9), A.sum(axis=0) > 0
    for _ in range(steps):
        more = np.zeros(9)
        for row, ray in zip(A, RAYS, strict=True):
            more += row * (ray - row @ x) / row.sum()
        x[seen] = np.maximum(x[seen] + more[seen] / A.sum(axis=0)[seen], 0)
    return x


def mlem(steps):
    seen = A.sum(axis=0) > 0
    x = np.where(seen, RAYS.sum() / A.sum(), 0)
    for _ in range(steps):
        ratio = np.maximum(RAYS + 2 * NOISE, 0) / (A @ x + 2 * NOISE)
        x[seen] *= (A.T @ ratio)[seen] / A.sum(axis=0)[seen]
    return x


def lsqr(steps):
    """Least squares in the Krylov space of so many products."""
    space = [A.T @ RAYS]
    for _ in range(steps - 1):
        space.append(A.T @ (A @ space[-1]))
        space[-1] /= np.linalg.norm(space[-1])
    return np.linalg.lstsq(A @ np.array(space).T, RAYS, rcond=None)[0] @ space


def fista(steps):
    x = ahead = np.zeros(9)
    speed, steepest = 1.0, A.sum(axis=0).max() * A.sum(axis=1).max()
    for _ in range(steps):
        before, x = x, np.maximum(ahead + A.T @ (RAYS - A @ ahead) / steepest, 0)
        slower, speed = speed, (1 + np.sqrt(1 + 4 * speed**2)) / 2
        ahead = x + (slower - 1) / speed * (x - before)
    return x


@pytest.mark.parametrize(
    ("method", "twin"), [("sart", sart), ("mlem", mlem), ("lsqr", lsqr), ("nnls", fista)]
)
@pytest.mark.parametrize("steps", [1, 4])
def test_a_method_is_its_formula(method, twin, steps):
    noise = NOISE if method == "mlem" else 1e-3  # MLEM depends on it, and has not reached it yet
    found = iterate(method, OPERATOR, RAYS, None, noise, steps)
    assert found.iterations == steps
    np.testing.assert_allclose(found.cells, twin(steps), atol=2e-5)


def test_nnls_is_scipys_and_lsqr_ends_at_least_squares():
    far = iterate("nnls", OPERATOR, RAYS, None, 1e-3, 3000)
    np.testing.assert_allclose(far.cells, nnls(A, RAYS.astype(float))[0], atol=1e-4)
    far = iterate("lsqr", OPERATOR, RAYS, None, 1e-3, 50)
    np.testing.assert_allclose(far.cells, np.linalg.lstsq(A, RAYS, rcond=None)[0], atol=1e-4)


@pytest.mark.parametrize("method", RIVALS)
def test_it_stops_at_the_first_residual_within_the_noise(method):
    noise = 1.2 * NOISE
    goal = 40 * noise**2
    found = iterate(method, OPERATOR, RAYS, None, noise)
    short = iterate(method, OPERATOR, RAYS, None, noise, found.iterations - 1)
    assert found.warnings == ()
    assert np.sum((A @ found.cells - RAYS) ** 2) <= goal < np.sum((A @ short.cells - RAYS) ** 2)
    assert (
        f"{method.upper()} was stopped after {found.iterations - 1} iterations" in short.warnings[0]
    )
    assert (found.cells.min() >= 0) or method == "lsqr"


@pytest.mark.parametrize("method", RIVALS)
def test_unknown_rays_are_as_rays_that_are_not_there(method):
    valid = np.arange(40) % 3 > 0
    found = iterate(method, OPERATOR, np.where(valid, RAYS, 50), valid, NOISE, 5)
    kept = MatrixMult(A[valid].astype(np.float32), dtype="float32")
    alone = iterate(method, kept, RAYS[valid], None, NOISE, 5)
    assert found.iterations == alone.iterations
    np.testing.assert_allclose(found.cells, alone.cells, atol=1e-5)


LENS, CAMERA = Lens(lenslets=(40, 48)), replace(PAPER_CAMERA, views=7, lenslets=(40, 48))
FLAMES = [Sheet(6.0, (0.1, -1.2), (0.8, 0.4)), Sheet(-8.0, (0.0, 1.2), (0.8, 0.4))]
GRID = FrustumGrid(CAMERA, [6.0, -8.0])
TRUTH = np.array([cells(LENS, flame) for flame in FLAMES])
CLEAN = record(LENS, FLAMES)
LIT = CLEAN + 0.02 * CLEAN.max() * np.random.default_rng(0).standard_normal(CLEAN.shape)


@pytest.fixture(scope="module")
def penalised():
    return error(reconstruct(LightField(LIT), GRID))


def error(found):
    return np.linalg.norm(found.emission - TRUTH) / np.linalg.norm(TRUTH)


@pytest.mark.slow
@pytest.mark.parametrize("method", RIVALS)
def test_flames_are_found_with_the_noise_left_and_worse_than_with_a_penalty(method, penalised):
    found = reconstruct(LightField(LIT), GRID, method=method)
    assert np.nanmean(found.chi_squared) == pytest.approx(1, abs=0.02)
    assert np.nanmean(found.chi_squared) <= 1
    assert found.warnings == ()
    assert found.noise == pytest.approx(0.02 * CLEAN.max(), rel=0.01)
    assert found.sigma is None
    assert found.tried == ()
    assert 2 * penalised < error(found) < 0.5
    assert found.emission.sum() == pytest.approx(TRUTH.sum(), rel=0.03)
    short = reconstruct(LightField(LIT), GRID, method=method, iterations=2)
    assert (short.iterations, len(short.warnings)) == (2, 1)


@pytest.mark.slow
def test_known_absorption_is_given_back():
    """Matter at -8 mm before the far flame: each view looks through another part of it."""

    def thickness(x):
        return 0.8 * np.exp(-(((x + 1.2) / 0.8) ** 2))

    at = (np.arange(48) - 23.5) * LENS.cell
    lens = (np.arange(7) - 3)[:, None] * LENS.step
    met = at + (at - lens) * -8.0 / LENS.focus
    through = np.exp(-thickness(met))[None, :, None]
    dimmed = through * record(LENS, FLAMES[:1]) + record(LENS, FLAMES[1:])
    known = np.zeros((2, 40, 48))
    known[1] = thickness(at * (1 - 8.0 / LENS.focus))
    plain, dim, thin = (
        reconstruct(LightField(views), GRID, noise=1e-3, iterations=300, method="nnls", **given)
        for views, given in (
            (CLEAN, {}), (dimmed, {"optical_thickness": known}), (dimmed, {}),
        )
    )  # fmt: skip
    assert thin.emission[0].sum() < 0.75 * plain.emission[0].sum()
    assert np.abs(dim.emission - plain.emission).max() < 0.04


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"method": "art"}, "method must be one of penalised, sart, mlem, lsqr, nnls, got 'art'"),
        ({"method": "sart", "bootstrap": 20}, "has no error bars"),
        ({"method": "mlem", "strength": 0.1}, "has no penalty and no strength"),
        ({"method": "nnls", "penalty": "variation"}, "has no penalty and no strength"),
        ({"method": "nnls", "penalty": Roughness()}, "has no penalty and no strength"),
        ({"method": "lsqr", "iterations": 0}, "iterations must be 1 or more, got 0"),
    ],
)
def test_what_a_method_cannot_do_is_refused(options, said):
    with pytest.raises(InputError, match=said):
        reconstruct(LightField(LIT), GRID, **options)


@pytest.mark.slow
def test_values_of_unknown_pixels_do_not_count():
    valid = np.random.default_rng(1).random(LIT.shape) > 0.1
    found = [
        reconstruct(LightField(np.where(valid, LIT, other), valid=valid), GRID, method="nnls")
        for other in (LIT, 3.0)
    ]
    assert found[0].noise == pytest.approx(found[1].noise, rel=1e-3)
    assert found[0].iterations == found[1].iterations
    np.testing.assert_allclose(found[0].emission, found[1].emission, atol=1e-5)
    assert error(found[1]) < 0.5
