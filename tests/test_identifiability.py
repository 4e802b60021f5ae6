"""The Cramer-Rao bound against closed forms and against estimates from noisy spectra."""

import numpy as np
import pytest

from physics.identifiability import cramer_rao, jacobian
from physics.planck import noise_sigma, planck, planck_derivative

W = np.linspace(8, 14, 12)
NOISE = noise_sigma(W, 0.05)
ENVIRONMENT = np.stack([planck(W, 230.0) * np.linspace(0.4, 1, 12), planck(W, 288.0)])
E = 0.9 + 0.08 * np.sin(W)


def test_a_black_body_is_known_as_well_as_its_slope_says():
    slope = planck_derivative(W, 300.0) / NOISE
    bound = cramer_rao(W, NOISE, np.ones((1, 12)), ENVIRONMENT, np.array([300.0]))
    assert bound == pytest.approx(1 / np.linalg.norm(slope), rel=1e-12)


def test_the_inverse_of_the_information_says_the_same():
    j = jacobian(W, NOISE, E[None], ENVIRONMENT, np.array([290.0]))[0]
    assert cramer_rao(W, NOISE, E[None], ENVIRONMENT, np.array([290.0]))[0] == pytest.approx(
        np.sqrt(np.linalg.inv(j.T @ j)[0, 0]), rel=1e-9
    )


@pytest.mark.parametrize("k", [2, 3, 5])
def test_k_objects_need_k_bands(k):
    """T and V without its last make k unknowns."""
    objects = [planck(W, t) for t in np.linspace(200, 300, k)]
    for bands, known in ((k - 1, False), (k, True)):
        w = slice(bands)
        given = W[w], NOISE[w], E[None, w], np.stack(objects)[:, w]
        assert np.isfinite(cramer_rao(*given, np.array([290.0]))[0]) == known


def test_the_likeliest_t_of_noisy_spectra_scatters_as_the_bound_says():
    """Newton's iteration on Eq. 1 itself, V free of bounds, 20,000 draws of noise."""
    rng = np.random.default_rng(0)
    n, t, v = 20_000, 295.0, np.array([0.4, 0.6])
    s = E * planck(W, t) + (1 - E) * (v @ ENVIRONMENT) + NOISE * rng.normal(size=(n, 12))
    reflected = (1 - E) * ENVIRONMENT
    found = np.full(n, 290.0)
    for _ in range(5):
        rest = s - E * planck(W, found[:, None]) - reflected[1]
        slope = E * planck_derivative(W, found[:, None])
        a = np.stack([slope, np.broadcast_to(reflected[0] - reflected[1], (n, 12))], axis=2)
        normal = np.einsum("pbi,b,pbj->pij", a, NOISE**-2, a)
        right = np.einsum("pbi,b,pb->pi", a, NOISE**-2, rest)
        found += np.linalg.solve(normal, right[..., None])[:, 0, 0]
    bound = cramer_rao(W, NOISE, E[None], ENVIRONMENT, np.array([t]))[0]
    assert found.std() == pytest.approx(bound, rel=4 / np.sqrt(2 * n))
    assert found.mean() == pytest.approx(t, abs=4 * bound / np.sqrt(n))
