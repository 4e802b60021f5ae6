"""Eq. 6 without V's bounds: a lower bound, exact where V needs none; and what `local` prunes."""

import numpy as np
import pytest

from physics import Environment, HeatCube, MaterialLibrary
from physics.local import HOPELESS, solve_given, solve_local
from physics.reduced import reduce_model
from physics.unbounded import LANES, solve_unbounded, tables, times


@pytest.mark.parametrize("m, n", [(1, 1), (2, 4), (5, 7), (26, 55)])
def test_times_is_a_matrix_product(m, n):
    r = np.random.default_rng(m)
    a, s, out = r.normal(size=(m, n)), r.normal(size=(n, LANES)), np.empty((m, LANES))
    a[: m // 2] = 0
    times(a, s, out)
    np.testing.assert_allclose(out, a @ s, atol=1e-12)


def everything(p, k):
    """Value, bound, T, V of LANES pixels and every hypothesis, and J of each by `solve_given`."""
    model = reduce_model(p.cube, p.library, p.environment)
    spectra, n = p.cube.spectra[:LANES].astype(float), model.terms
    prior = model.prior_sigma_k**-2.0, model.prior_mean_k - model.mid_k
    rows = len(model.gram)
    value, bound, curvature, x = np.empty((4, rows, LANES))
    v, exact = np.empty((rows, k, LANES)), np.empty((rows, LANES))
    zero = np.zeros(LANES)
    work = np.empty((2 * n + k + 10, LANES))
    for r in range(rows):
        h, constant = model.inner_products(spectra / model.sigma, r)
        value[r], x[r] = constant + model.occam[r], 0.0
        solve_unbounded(
            np.ascontiguousarray(h.T), model.gram[r], tuple(tables(model.gram, n)), r, n, k,
            model.half_k, *prior, x[r], work, value[r], bound[r], curvature[r], v[r],
        )  # fmt: skip
        row = np.full(LANES, r)
        exact[r] = solve_given(model, spectra, row, p.temperature[:LANES], zero, zero)[0]
    return model, value, bound, model.mid_k + model.half_k * x, v, exact


@pytest.mark.parametrize("k", [1, 2, 5])
@pytest.mark.parametrize("bands", [3, 54])
def test_it_is_a_lower_bound_and_exact_where_no_lighting_factor_is_negative(make_pixels, k, bands):
    p = make_pixels(k=k, bands=bands, shape=(8, 8), seed=k)
    model, value, bound, t, v, exact = everything(p, k)
    done = value > -np.inf
    assert done.mean() > 0.9
    np.testing.assert_allclose(v.sum(axis=1), 1, atol=1e-9)
    slack = 1e-3 + 1e-6 * np.abs(exact)
    assert (value <= exact + slack)[done].all() and (value <= bound)[done].all()
    # the bound takes (T, V) for a Gaussian where T moves by a few kelvin between the two
    assert (bound <= exact + 0.1 * (exact - value) + slack)[done].all()
    positive = done & (v >= 0).all(axis=1)
    assert positive.any()
    np.testing.assert_allclose(value[positive], exact[positive], rtol=1e-6, atol=1e-3)
    if k == 1:
        assert positive[done].all()
    else:
        assert (bound > value)[done & ~positive].mean() > 0.5


@pytest.mark.parametrize("k, bands", [(1, 54), (4, 54), (8, 54), (5, 3)])
def test_what_is_pruned_is_hopeless(make_pixels, k, bands):
    p = make_pixels(bands=bands, k=k, shape=(9, 11), seed=k, netd=0.3)  # no multiple of LANES
    model = reduce_model(p.cube, p.library, p.environment)
    local = solve_local(model, p.cube.spectra)
    best, zero = local.energy.min(axis=1), np.zeros(99)
    pruned = 0
    for m in range(len(p.library)):
        row = np.full(99, m)
        exact, t, _, sigma = solve_given(model, p.cube.spectra, row, p.temperature, zero, zero)
        near = exact < best + HOPELESS
        np.testing.assert_allclose(local.energy[near, m], exact[near], atol=1e-3)
        np.testing.assert_allclose(local.temperature_k[near, m], t[near], atol=1e-2)
        np.testing.assert_allclose(local.sigma_k[near, m], sigma[near], rtol=1e-3)
        assert (local.energy[~near, m] > best[~near] + HOPELESS - 1e-3).all()
        assert (local.energy[~near, m] <= exact[~near] * (1 + 1e-5) + 1e-3).all()
        pruned += (local.energy[:, m] < exact - 1e-3).sum()
    assert k == 1 or bands == 3 or pruned > 0


def test_a_pixel_answers_alike_in_any_company(make_pixels):
    p = make_pixels(shape=(15, 10))
    model = reduce_model(p.cube, p.library, p.environment)
    together = solve_local(model, p.cube.spectra)
    order = np.random.default_rng(1).permutation(150)[: LANES + 3]
    some = solve_local(model, p.cube.spectra[order])
    np.testing.assert_allclose(some.energy, together.energy[order], rtol=1e-5, atol=1e-3)


def test_the_best_that_is_not_sky_is_exact_however_hopeless(make_pixels):
    """Of sky pixels too: T of what may stand before the sky is asked for."""
    p = make_pixels(k=3, shape=(9, 11), seed=4)
    w, sky = p.wavelength, p.environment.radiance[0]
    environment = Environment(
        p.environment.radiance, w, sky=(0,), sky_mean=sky, sky_spread=0.01 * sky[None]
    )
    library = MaterialLibrary(
        [*p.library.names, "sky"], p.library.wavelength_um,
        [*p.library.emissivity, np.full(p.library.wavelength_um.size, 0.98)],
    )  # fmt: skip
    s = p.cube.radiance.copy()
    noise = np.random.default_rng(0).normal(size=s[:, :4].shape) * p.cube.sigma[:, None, None]
    s[:, :4] = sky[:, None, None] + noise
    model = reduce_model(HeatCube(s, w, netd_k=p.cube.netd_k), library, environment)
    spectra = s.reshape(len(s), -1).T
    every, few = (solve_local(model, spectra, hopeless=h) for h in (1e9, 1.0))
    is_sky = every.energy.argmin(axis=1) == library.sky_index
    assert 0 < is_sky.sum() < len(is_sky)
    i, best = np.arange(99), every.energy[:, :-1].argmin(axis=1)
    beyond = every.energy[i, best] > every.energy.min(axis=1) + 1.0
    assert beyond[is_sky].any()
    np.testing.assert_array_equal(few.energy[:, :-1].argmin(axis=1), best)
    np.testing.assert_allclose(few.energy[i, best], every.energy[i, best], rtol=1e-6, atol=1e-3)
    np.testing.assert_allclose(few.temperature_k[i, best], every.temperature_k[i, best], atol=1e-2)
