"""Eq. 6 on faces of the simplex: exact where V is inside, else a bound; and what `local` prunes."""

import numpy as np
import pytest

from physics import Environment, HeatCube, MaterialLibrary
from physics.exact.faces import LANES, lower_bound, solve_on_face, tables, times
from physics.exact.local import HOPELESS, energy_given, solve_given, solve_local
from physics.exact.reduced import reduce_model
from physics.planck import planck


@pytest.mark.parametrize("m, n", [(1, 1), (2, 4), (5, 7), (26, 55)])
def test_times_is_a_matrix_product(m, n):
    r = np.random.default_rng(m)
    a, s, out = r.normal(size=(m, n)), r.normal(size=(n, LANES)), np.empty((m, LANES))
    a[: m // 2] = 0
    times(a, s, out, LANES)
    np.testing.assert_allclose(out, a @ s, atol=1e-12)


def everything(p, k):
    """Value, bound, T, V of LANES pixels and every hypothesis, and J of each by `solve_given`."""
    model = reduce_model(p.cube, p.library, p.environment)
    spectra, n = p.cube.spectra[:LANES].astype(float), model.terms
    prior = model.prior_sigma_k**-2.0, model.prior_mean_k - model.mid_k
    rows = len(model.gram)
    value, bound, curvature, x = np.zeros((4, rows, LANES))
    v, exact = np.empty((rows, k, LANES)), np.empty((rows, LANES))
    zero, v_gradient = np.zeros(LANES), np.empty((k, LANES))
    work = np.empty((4 * n + 2 * k + 6, LANES))
    known = tuple(tables(model.gram, n, model.half_k, *prior))
    for r in range(rows):
        h, constant = model.inner_products(spectra / model.sigma, r)
        solve_on_face(
            np.ascontiguousarray(h.T), constant + model.occam[r], LANES, known, r, 0, model.half_k,
            *prior, x[r], work, value[r], curvature[r], v[r], v_gradient,
        )  # fmt: skip
        np.testing.assert_allclose(
            v_gradient[:, value[r] > -np.inf], 0, atol=1e-4
        )  # on no other face
        lower_bound(known, r, model.half_k, x[r], work, value[r], curvature[r], v[r], bound[r])
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
    positive = done & (v >= 0).all(axis=1)
    assert positive.any()
    np.testing.assert_array_equal(bound == np.inf, positive)
    # the bound takes (T, V) for a Gaussian where T moves by a few kelvin between the two
    outside = done & ~positive
    assert (bound <= exact + 0.1 * (exact - value) + slack)[outside].all()
    np.testing.assert_allclose(value[positive], exact[positive], rtol=1e-6, atol=1e-3)
    if k == 1:
        assert positive[done].all()
    else:
        assert (bound > value)[done & ~positive].mean() > 0.5


@pytest.mark.parametrize("k", [2, 5])
def test_on_every_face_neither_what_is_free_nor_temperature_would_lower_energy(make_pixels, k):
    p = make_pixels(k=k, shape=(8, 8), seed=k)
    model = reduce_model(p.cube, p.library, p.environment)
    spectra, n, r = p.cube.spectra[:LANES].astype(float), model.terms, 1
    prior = model.prior_sigma_k**-2.0, model.prior_mean_k - model.mid_k
    h, constant = model.inner_products(spectra / model.sigma, r)
    known = tables(model.gram, n, model.half_k, *prior)
    assert len(known.free) == {2: 3, 5: 26}[k]
    for face, free in enumerate(known.free):
        x, value, curvature = np.zeros((3, LANES))
        v, v_gradient, work = np.empty((k, LANES)), np.empty((k, LANES)), np.empty((90, LANES))
        solve_on_face(
            np.ascontiguousarray(h.T), constant + model.occam[r], LANES, tuple(known), r, face,
            model.half_k, *prior, x, work, value, curvature, v, v_gradient,
        )  # fmt: skip
        assert (v[~free] == 0).all() and (value > -np.inf).all()
        np.testing.assert_allclose(v.sum(axis=0), 1, atol=1e-9)
        t = model.mid_k + model.half_k * x
        at = lambda t, v: energy_given(model, spectra, np.full(LANES, r), t, v.T)
        np.testing.assert_allclose(value, at(t, v), rtol=1e-7)
        assert (at(t + 0.01, v) > value).all() and (at(t - 0.01, v) > value).all()
        for j in np.flatnonzero(free):
            for i in np.flatnonzero(free):
                off = v.copy()
                off[i] += 1e-3
                off[j] -= 1e-3
                assert i == j or (at(t, off) > value).all()
        for j in np.flatnonzero(~free):  # by how much others would, to first order
            i, step = np.flatnonzero(free)[0], 1e-6
            off = v.copy()
            off[j] += step
            off[i] -= step
            slope = (at(t, off) - at(t, v)) / step
            np.testing.assert_allclose(slope, v_gradient[j], rtol=1e-2, atol=0.3)


@pytest.mark.parametrize("k, bands", [(1, 54), (4, 54), (8, 54), (10, 54), (5, 3)])
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
    np.testing.assert_allclose(some.energy, together.energy[order], rtol=1e-6)
    np.testing.assert_allclose(some.temperature_k, together.temperature_k[order], rtol=1e-6)


@pytest.mark.parametrize("hot", [1500.0, 6000.0])
def test_a_fire_in_the_picture_does_not_blur_the_rest(make_pixels, hot):
    """The wider the range of T, the longer the series; T near its end is as exact as ever."""
    p = make_pixels(k=3, shape=(8, 9), seed=2)
    s = p.cube.radiance.copy()
    s[:, 0, 0] = planck(p.wavelength, hot)
    cube = HeatCube(s, p.wavelength, netd_k=p.cube.netd_k)
    model = reduce_model(cube, p.library, p.environment)
    assert model.terms > 15
    local, zero = solve_local(model, cube.spectra), np.zeros(72)
    i, best = np.arange(72), local.energy.argmin(axis=1)
    exact = solve_given(model, cube.spectra, best, np.r_[hot, p.temperature[1:]], zero, zero)
    # what is left of terms of up to 1e13
    np.testing.assert_allclose(local.energy[i, best], exact[0], rtol=1e-5, atol=1e-2)
    np.testing.assert_allclose(local.temperature_k[i, best], exact[1], atol=1e-2)
    assert np.abs(local.temperature_k[i, best] - p.temperature)[1:].max() < 5


@pytest.mark.parametrize("pixels", [0, 1, 135])
def test_threads_change_nothing(make_pixels, pixels):
    p = make_pixels(shape=(9, 15))
    model = reduce_model(p.cube, p.library, p.environment)
    one, two = (solve_local(model, p.cube.spectra[:pixels], threads=n) for n in (1, 2))
    assert one.energy.shape == (pixels, len(p.library))
    for name in ("energy", "temperature_k", "sigma_k", "row", "lighting"):
        np.testing.assert_allclose(getattr(one, name), getattr(two, name), rtol=1e-6)


def under_a_sky(p):
    """ReducedModel and spectra of Pixels of which four rows are sky, the last of the materials."""
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
    return model, s.reshape(len(s), -1).T


def test_the_best_that_is_not_sky_is_exact_however_hopeless(make_pixels):
    """Of sky pixels too: T of what may stand before the sky is asked for."""
    model, spectra = under_a_sky(make_pixels(k=3, shape=(9, 11), seed=4))
    every, few = (solve_local(model, spectra, hopeless=h) for h in (1e9, 1.0))
    is_sky = every.energy.argmin(axis=1) == model.library.sky_index
    assert 0 < is_sky.sum() < len(is_sky)
    i, best = np.arange(99), every.energy[:, :-1].argmin(axis=1)
    beyond = every.energy[i, best] > every.energy.min(axis=1) + 1.0
    assert beyond[is_sky].any()
    np.testing.assert_array_equal(few.energy[:, :-1].argmin(axis=1), best)
    np.testing.assert_allclose(few.energy[i, best], every.energy[i, best], rtol=1e-6, atol=1e-3)
    np.testing.assert_allclose(few.temperature_k[i, best], every.temperature_k[i, best], atol=1e-2)


def test_no_pixel_is_partly_sky_where_sky_is_not_among_them(make_pixels):
    model, spectra = under_a_sky(make_pixels(k=3, shape=(9, 11), seed=4))
    among = np.arange(len(model.library)) % 2 == 0
    assert among[model.library.sky_index]
    some = solve_local(model, spectra, hopeless=1e9, among=among)
    assert (model.sky_share[some.row[:, among]] > 0).any()
    among[model.library.sky_index] = False
    none = solve_local(model, spectra, hopeless=1e9, among=among)
    assert (model.sky_share[none.row[:, among]] == 0).all()
    pure = among & (model.sky_share[some.row] == 0)
    np.testing.assert_allclose(none.energy[pure], some.energy[pure], rtol=1e-6)
    assert (none.energy[:, among] > some.energy[:, among] - 1e-3).all()


def test_among_some_materials_each_has_the_energy_that_it_has_among_all(make_pixels):
    p = make_pixels(k=3, shape=(9, 11), seed=4)
    model = reduce_model(p.cube, p.library, p.environment)
    among = np.arange(len(p.library)) % 2 == 0
    every = solve_local(model, p.cube.spectra, hopeless=1e9)
    some = solve_local(model, p.cube.spectra, hopeless=1e9, among=among)
    assert np.isposinf(some.energy[:, ~among]).all()
    np.testing.assert_allclose(some.energy[:, among], every.energy[:, among], rtol=1e-6)
    best = some.energy.argmin(axis=1)
    q = np.arange(len(best))
    np.testing.assert_array_equal(some.row[q, best], every.row[q, best])
    np.testing.assert_allclose(some.lighting.sum(axis=1), 1, atol=1e-5)
