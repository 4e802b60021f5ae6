"""The exact solver against a slow general-purpose one, the Cramer-Rao bound and its limits."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import small_environment
from scipy.optimize import minimize

from physics import Environment, HeatCube, InputError, MaterialLibrary
from physics.bands import at_nodes, equidistant_bands, quadrature
from physics.eq1 import render
from physics.exact.local import HOPELESS, _over_minima, energy_given, solve_given, solve_local
from physics.exact.reduced import reduce_model
from physics.planck import brightness_temperature, noise_sigma, planck, planck_derivative
from physics.sky import Atmosphere, sky_radiance


def solve(p):
    model = reduce_model(p.cube, p.library, p.environment)
    return model, solve_local(model, p.cube.spectra)


def slow_minimum(model, spectrum, material):
    """min over T and V on the simplex of J, by SLSQP from several starts, band by band."""
    k, env, e = model.k, model.environment.radiance, model.emissivity[material]
    usual = model.environment.usual_lighting

    def cost(x):
        t, v = max(model.prior_mean_k + 10 * x[0], 1.0), x[1:]
        r = (e * planck(model.wavelength_um, t) + (1 - e) * (v @ env) - spectrum) / model.sigma
        prior_t = ((t - model.prior_mean_k) / model.prior_sigma_k) ** 2
        return 0.5 * (r @ r + prior_t + 3 * k * ((v - usual) ** 2).sum())

    return min(
        minimize(
            cost, np.r_[t, np.full(k, 1 / k)], method="SLSQP",
            bounds=[(None, None)] + [(0, 1)] * k,
            constraints={"type": "eq", "fun": lambda x: x[1:].sum() - 1},
            options={"maxiter": 500, "ftol": 1e-12},
        ).fun
        for t in (-1.5, 0.0, 1.5)
    )  # fmt: skip


@pytest.mark.parametrize("k", [1, 2, 5])
def test_agrees_with_a_general_purpose_minimiser(make_pixels, k):
    p = make_pixels(k=k, shape=(2, 3), seed=k)
    usual = np.arange(1, k + 1) / np.arange(1, k + 1).sum()
    p.environment = replace(p.environment, usual_lighting=usual)
    model, local = solve(p)
    zero = np.zeros(6)
    for material in (p.material, np.zeros(6, int)):
        given = solve_given(model, p.cube.spectra, material, p.temperature, zero, zero)[0]
        for i, m in enumerate(material):
            slow = slow_minimum(model, p.cube.spectra[i].astype(float), m) + model.occam[m]
            # the Chebyshev series is exact to 0.005 noise units per band
            slack = 0.005 * np.sqrt(54) * np.sqrt(2 * abs(slow)) + 1e-2
            assert given[i] == pytest.approx(slow, abs=slack)
            if slow < local.energy[i].min() + HOPELESS:
                assert local.energy[i, m] == pytest.approx(slow, abs=slack)
            else:
                assert local.energy[i].min() + HOPELESS < local.energy[i, m] < slow + slack


def test_a_quiet_camera_shows_what_it_would_in_the_mean_with_the_noise_that_is_missing(make_pixels):
    """Of the right material, where no V is at its bounds: J is all but quadratic in spectra."""
    p = make_pixels(k=2, shape=(5, 8), seed=1)
    model, local = solve(p)
    quiet = np.random.default_rng(0).uniform(0, 1, p.cube.bands)
    inside = np.flatnonzero((local.lighting > 0.1).all(axis=1))

    def energy(model, spectra):
        found = solve_local(model, spectra, hopeless=np.inf, threads=1)
        return found.energy[inside, p.material[inside]]

    plain, step = energy(model, p.cube.spectra), 0.5  # noise units
    expected = plain.astype(float)
    for b, share in enumerate(quiet):
        off = np.zeros(p.cube.bands)
        off[b] = step * p.cube.sigma[b]
        around = [energy(model, p.cube.spectra + sign * off) - plain for sign in (-1, 1)]
        expected += share * np.sum(around, axis=0) / (2 * step**2)
    quiet_model = reduce_model(replace(p.cube, quiet=quiet), p.library, p.environment)
    ours = energy(quiet_model, p.cube.spectra)
    assert len(ours) > 10
    np.testing.assert_allclose(ours, expected, atol=0.3)
    assert (ours > plain + 5).all()


def test_temperature_error_meets_the_cramer_rao_bound(make_pixels):
    p = make_pixels(shape=(60, 60))
    model, local = solve(p)
    i = np.arange(len(p.material))
    z = (local.temperature_k[i, p.material] - p.temperature) / local.sigma_k[i, p.material]
    n = len(z)
    assert abs(z.mean()) < 5 / np.sqrt(n)
    assert z.std() == pytest.approx(1, abs=5 / np.sqrt(2 * n))


def test_picks_the_material_and_its_lighting(make_pixels):
    p = make_pixels(shape=(40, 40), netd=0.01)
    model, local = solve(p)
    best = local.energy.argmin(axis=1)
    assert (best == p.material).mean() > 0.97
    zero = np.zeros(len(best))
    _, t, v, _ = solve_given(model, p.cube.spectra, p.material, p.temperature, zero, zero)
    assert (v >= 0).all()
    np.testing.assert_allclose(v.sum(axis=1), 1, atol=1e-9)
    error = np.abs(v @ p.environment.radiance - p.texture).mean()
    assert error < 0.1 * np.abs(p.texture - p.texture.mean(axis=0)).mean()


@pytest.mark.parametrize("k", [1, 4])
def test_lighting_is_that_of_the_best_material(make_pixels, k):
    p = make_pixels(k=k, shape=(9, 11), seed=k)
    model, local = solve(p)
    i, best = np.arange(99), local.energy.argmin(axis=1)
    assert (local.lighting >= 0).all()
    np.testing.assert_allclose(local.lighting.sum(axis=1), 1, atol=1e-6)
    t = local.temperature_k[i, best].astype(float)
    energy = energy_given(model, p.cube.spectra, local.row[i, best], t, local.lighting)
    np.testing.assert_allclose(energy, local.energy[i, best], atol=1e-3)


def test_noiseless_pixel_returns_exactly(make_pixels):
    p = make_pixels(netd=1e-3, shape=(5, 5))
    model, local = solve(p)
    i = np.arange(25)
    assert np.abs(local.temperature_k[i, p.material] - p.temperature).max() < 0.02


def test_permuting_the_library_permutes_the_answer(pixels):
    order = np.random.default_rng(3).permutation(len(pixels.library))
    shuffled = pixels.library.subset([pixels.library.names[i] for i in order])
    _, a = solve(pixels)
    b = solve_local(reduce_model(pixels.cube, shuffled, pixels.environment), pixels.cube.spectra)
    np.testing.assert_allclose(a.energy[:, order], b.energy, rtol=1e-5, atol=1e-3)
    np.testing.assert_allclose(a.temperature_k[:, order], b.temperature_k, atol=1e-3)


def test_permuting_the_environment_changes_no_energy(pixels):
    _, a = solve(pixels)
    swapped = Environment(pixels.environment.radiance[::-1], pixels.wavelength)
    b = solve_local(reduce_model(pixels.cube, pixels.library, swapped), pixels.cube.spectra)
    np.testing.assert_allclose(a.energy, b.energy, rtol=1e-5, atol=1e-3)


@pytest.mark.parametrize("bands", [1, 2, 3, 4])
@pytest.mark.parametrize("k", [1, 5, 10])
def test_too_few_bands_still_answer_and_say_so(make_pixels, bands, k):
    p = make_pixels(bands=bands, k=k, shape=(10, 10))
    model, local = solve(p)
    assert np.isfinite(local.energy).all() and np.isfinite(local.temperature_k).all()
    i = np.arange(100)
    t, s = local.temperature_k[i, p.material], local.sigma_k[i, p.material]
    assert (s <= model.prior_sigma_k + 1e-3).all()
    # an error beyond three of its own sigmas is a false claim of knowledge
    assert (np.abs(t - p.temperature) < 3 * s + 0.05).mean() > 0.95
    if bands == 1 and k > 1:  # one number cannot give T and V: sigma is far above the noise's
        floor = p.cube.netd_k * planck_derivative(10.0, 300.0) / planck_derivative(10.0, 280.0)
        assert (s > 1.5 * floor).all()


def test_mirror_cannot_know_its_temperature():
    w = np.linspace(8, 14, 30)
    env = Environment(planck(w, np.array([[270.0], [300.0]])), w)
    mirror = MaterialLibrary(["mirror", "black"], w, [np.zeros(30), np.ones(30)])
    cube = HeatCube(planck(w, 285.0)[:, None, None] * np.ones((30, 2, 2)), w, netd_k=0.05)
    model = reduce_model(cube, mirror, env)
    local = solve_local(model, cube.spectra)
    np.testing.assert_allclose(local.sigma_k[:, 0], model.prior_sigma_k, rtol=1e-3)
    np.testing.assert_allclose(local.temperature_k[:, 0], model.prior_mean_k, atol=0.1)
    np.testing.assert_allclose(local.temperature_k[:, 1], 285.0, atol=0.01)


def test_evidence_prefers_the_simpler_explanation():
    """A blackbody pixel that a mirror with free V reproduces as well is called black."""
    w = np.linspace(8, 14, 54)
    env = Environment(planck(w, np.array([[275.0], [295.0]])), w)
    library = MaterialLibrary(["mirror", "black"], w, [np.full(54, 0.02), np.full(54, 0.999)])
    cube = HeatCube(planck(w, 295.0)[:, None, None] * np.ones((54, 3, 3)), w, netd_k=0.05)
    local = solve_local(reduce_model(cube, library, env), cube.spectra)
    assert (local.energy.argmin(axis=1) == 1).all()


def test_energy_at_an_answer_is_what_the_solver_found(pixels):
    model, local = solve(pixels)
    zero = np.zeros(len(pixels.material))
    args = model, pixels.cube.spectra, pixels.material
    energy, t, v, sigma = solve_given(*args, pixels.temperature, zero, zero)
    i = np.arange(len(t))
    np.testing.assert_allclose(energy, local.energy[i, pixels.material], atol=1e-3)
    np.testing.assert_allclose(energy_given(*args, t, v), energy, atol=1e-6)
    # and no nearby T or V is better
    assert (energy_given(*args, t + 0.01, v) >= energy).all()
    assert (energy_given(*args, t, 0.99 * v + 0.01 / v.shape[1]) >= energy - 1e-9).all()


def test_material_that_reflects_true_deviations_is_not_punished_for_them(make_pixels):
    """Surroundings off the k spectra along `spread` cost chi^2 unless C_m knows them."""
    p = make_pixels(shape=(20, 20))
    direction = 0.05 * planck(p.wavelength, 290.0) * np.sin(p.wavelength)
    rng = np.random.default_rng(0)
    e = p.library.at(p.wavelength)[p.material]
    off = (1 - e) * rng.normal(size=(len(e), 1)) * direction
    cube = HeatCube(p.cube.radiance + off.T.reshape(p.cube.radiance.shape), p.wavelength,
                    netd_k=0.05)  # fmt: skip
    knows = Environment(p.environment.radiance, p.wavelength, spread=direction[None])
    i = np.arange(len(e))
    blind = solve_local(reduce_model(cube, p.library, p.environment), cube.spectra)
    aware = solve_local(reduce_model(cube, p.library, knows), cube.spectra)
    right = [(s.energy.argmin(axis=1) == p.material).mean() for s in (blind, aware)]
    assert right[1] > right[0]
    z = (aware.temperature_k - p.temperature[:, None])[i, p.material] / aware.sigma_k[i, p.material]
    assert z.std() == pytest.approx(1, abs=5 / np.sqrt(2 * len(z)))


@pytest.mark.parametrize("kelvin", [-20, -5, 5, 20])
def test_an_environment_that_is_off_as_far_as_is_stated_does_not_deceive(make_pixels, kelvin):
    """Objects so much warmer or colder than they are: T is off by more than sigma, unless told."""
    p = make_pixels(shape=(20, 20))
    seen = brightness_temperature(p.wavelength, p.environment.radiance)
    wrong = replace(p.environment, radiance=planck(p.wavelength, seen + kelvin))
    i, error, within = np.arange(len(p.material)), [], []
    for environment in (p.environment, wrong, wrong.off_by(abs(kelvin))):
        found = solve_local(reduce_model(p.cube, p.library, environment), p.cube.spectra)
        off = (found.temperature_k - p.temperature[:, None])[i, p.material]
        error.append(np.abs(off).mean())
        within.append((np.abs(off) < 2 * found.sigma_k[i, p.material]).mean())
    assert error[2] < 1.6 * error[0] < 0.8 * error[1]
    assert within[1] < 0.7 and within[2] > 0.8


def test_an_environment_is_off_by_what_kelvin_are_worth(pixels):
    """`off_by` makes room for objects that are so much warmer, whatever V is."""
    w, s = pixels.wavelength, pixels.environment.radiance
    rows = pixels.environment.off_by(2.0).spread
    warmer = planck(w, brightness_temperature(w, s) + 2.0) - s
    off = pixels.lighting @ warmer
    left = off - off @ np.linalg.pinv(rows) @ rows
    assert np.abs(left).max() < 0.05 * np.abs(off).max()
    # one standard deviation along the first, about as likely along the second
    shares = off @ np.linalg.pinv(rows)
    assert np.abs(shares[:, 0]).mean() == pytest.approx(1, abs=0.1)
    assert 0.3 < shares[:, 1].std() < 3


def test_its_sky_may_be_off_alone(pixels):
    w, s = pixels.wavelength, pixels.environment.radiance
    rows = pixels.environment.off_by(2.0, [1]).spread
    warmer = planck(w, brightness_temperature(w, s[1]) + 2.0) - s[1]
    along = rows @ warmer / (np.linalg.norm(rows, axis=1) * np.linalg.norm(warmer) + 1e-12)
    long = np.linalg.norm(rows, axis=1) > 1e-6 * np.linalg.norm(rows)
    assert long.any() and np.abs(along[long]) == pytest.approx(1, abs=0.01)
    every = np.arange(len(s))
    np.testing.assert_allclose(
        pixels.environment.off_by(2.0, every).spread, pixels.environment.off_by(2.0).spread
    )


def test_an_environment_can_be_off_by_some_kelvin_only(pixels):
    for kelvin in (-1, 101, np.nan, "much", [1.0]):
        with pytest.raises(InputError):
            pixels.environment.off_by(kelvin)


def test_of_a_wide_band_the_light_within_counts():
    """Stone and glass are dark where the sky is bright: the mean of their product is another than
    the product of their means, by several times the noise."""
    centre, width = equidistant_bands(4)
    nodes, rng, n = quadrature(centre, width), np.random.default_rng(0), 2000
    library = MaterialLibrary.starter().subset(["sandstone", "glass", "granite"])
    sky = at_nodes(lambda w: sky_radiance(w, [0.6], Atmosphere(288.0, 1.0)), nodes)
    light = np.concatenate([sky, planck(nodes, 290.0)[None]])
    environment = Environment(light.mean(axis=-1), centre, sky=(0,), within=sky)
    material, t, v = rng.integers(0, 3, n), rng.normal(290, 5, n), rng.dirichlet(np.ones(2), n)
    s = render(t, library.at(nodes)[material], v, light, nodes)[0]
    s = s + noise_sigma(centre, 0.05) * rng.normal(size=s.shape)
    cube = HeatCube(s.T.reshape(4, 40, 50), centre, width, 0.05)

    def misfit(environment):
        model = reduce_model(cube, library, environment)
        cost = energy_given(model, cube.spectra, material, t, v) - model.occam[material]
        cost -= 0.5 * ((t - model.prior_mean_k) / model.prior_sigma_k) ** 2
        return (cost - 3 * ((v - 0.5) ** 2).sum(axis=1)).mean()

    assert misfit(environment) == pytest.approx(len(centre) / 2, rel=0.1)
    assert misfit(replace(environment, within=None)) > 2 * misfit(environment)


def test_metal_warmer_than_anything_looks_is_within_reach():
    """All of it mirrors a dry sky, which no band shows to be as warm as the plates."""
    w, rng = np.linspace(8.1, 13.9, 20), np.random.default_rng(0)
    library = MaterialLibrary.starter().subset(["sky", "aluminium"])
    overhead = sky_radiance(w, [0.8], Atmosphere(288.0, 0.3))[0]
    ground = planck(w, 288.0)
    t, v = 300 + 2 * rng.normal(size=(600, 1)), rng.uniform(0.9, 1, (600, 1))
    e = library.at(w)[1]
    s = e * planck(w, t) + (1 - e) * (v * overhead + (1 - v) * ground)
    s += noise_sigma(w, 0.05) * rng.normal(size=s.shape)
    cube = HeatCube(s.T.reshape(20, 20, 30), w, netd_k=0.05)
    environment = Environment(np.stack([overhead, ground]), w, sky=(0,))
    model = reduce_model(cube, library, environment)
    assert model.mid_k + model.half_k > 310
    found = solve_local(model, cube.spectra).temperature_k[:, 1]
    assert np.sqrt(np.mean((found - t[:, 0]) ** 2)) < 0.6


@pytest.mark.parametrize("metal", ["copper", "steel", "oxidised"])
def test_of_several_temperatures_that_fit_metal_the_likeliest_is_found(metal):
    """From sixteen starts each, none is likelier; and sigma is over all of them."""
    w, rng, n = np.linspace(8.05, 13.95, 20), np.random.default_rng(0), 400
    oxidised = MaterialLibrary(["oxidised"], [7.0, 15.0], [[0.55, 0.55]])
    library = oxidised if metal == "oxidised" else MaterialLibrary.starter().subset([metal])
    environment = small_environment(w)
    t, v = rng.uniform(278, 308, n), rng.dirichlet(np.full(3, 0.6), n)
    s = render(t, library.at(w)[np.zeros(n, int)], v, environment.radiance, w)[0]
    s = s + noise_sigma(w, 0.05) * rng.normal(size=s.shape)
    cube = HeatCube(s.T.reshape(20, 20, 20), w, netd_k=0.05)
    model = reduce_model(cube, library, environment)
    found, zero = solve_local(model, cube.spectra), np.zeros(n)
    starts = model.mid_k + model.half_k * np.linspace(-0.9, 0.9, 16)
    from_each = np.array([
        solve_given(model, cube.spectra, np.zeros(n, int), np.full(n, start), zero, zero)[:2]
        for start in starts
    ])  # fmt: skip
    energy, there = from_each[:, 0], from_each[:, 1]
    near = energy < energy.min(axis=0) + 3
    spread = np.where(near, there, np.nan)
    several = np.nanmax(spread, axis=0) - np.nanmin(spread, axis=0) > 10
    assert several.mean() > (0.1 if metal != "oxidised" else 0.01)
    np.testing.assert_allclose(found.energy[:, 0], energy.min(axis=0), atol=0.01)
    off = np.abs(found.temperature_k[:, 0] - t) / found.sigma_k[:, 0]
    assert (off[several] < 3).mean() > 0.9


def test_sigma_over_minima_is_that_of_a_mixture_of_gaussians():
    """About the best one; a minimum that was found twice counts once."""
    nats, t, variance = (
        np.array([3.0, 2.0, 3.0]),
        np.array([30.0, 10.0, 30.0]),
        np.array([4.0, 1, 4]),
    )
    weight = np.array([np.exp(-1.0) * 2, 1.0])
    wanted = (weight @ [4 + 20**2, 1]) / weight.sum()
    assert _over_minima(nats, t, variance, 1) == pytest.approx(wanted)
    assert _over_minima(nats[1:2], t[1:2], variance[1:2], 0) == 1


@pytest.mark.parametrize("kelvin", [260.0, 320.0])
def test_of_a_black_body_whose_material_is_given_t_is_as_sure_as_all_bands_together(kelvin):
    w = np.linspace(8, 14, 30)
    black = MaterialLibrary(["black", "grey"], [7.0, 15.0], [[1.0, 1.0], [0.9, 0.9]])
    around = Environment(planck(w, np.array([[260.0], [290.0]])), w)
    cube = HeatCube(planck(w, kelvin)[:, None, None] * np.ones((1, 4)), w, netd_k=0.1)
    model, none = reduce_model(cube, black, around), np.zeros(4)
    _, t, _, sigma = solve_given(model, cube.spectra, np.zeros(4, int), none + 290, none, none)
    in_all = np.sum((planck_derivative(w, kelvin) / noise_sigma(w, 0.1)) ** 2) ** -0.5
    np.testing.assert_allclose(t, kelvin, atol=0.02)
    np.testing.assert_allclose(sigma, in_all, rtol=0.01)
