"""What T usually is in a scene, where most of it is bare metal under a clear sky; mixed pixels."""

from dataclasses import replace

import numpy as np
import pytest
from traced import names_of, traced

from physics import Environment, HeatCube, MaterialLibrary
from physics.bands import equidistant_bands, quadrature
from physics.estimate import estimate_environment
from physics.exact.reduced import reduce_model
from physics.planck import brightness_temperature, noise_sigma, planck
from physics.prior import SKY_CHI2, Mixtures, SampledSpectra, like_sky, usual_temperature
from physics.sky import Atmosphere, sky_radiance

AIR_K, METAL = 290.0, 0.05
TWO = MaterialLibrary.starter().subset(["steel", "soil"])  # and no sky


@pytest.mark.parametrize("bands", [4, 9, 54])
def test_metal_that_mirrors_a_cold_sky_does_not_make_the_scene_cold(bands):
    """Sky in view near the horizon; below it plates as warm as the air, e = 0.05, that show the
    sky overhead, tens of kelvin colder than they."""
    centre, width = equidistant_bands(bands)
    rng, air = np.random.default_rng(0), Atmosphere(AIR_K, 1.0)
    low, high = rng.uniform(0.03, 0.2, 600), rng.uniform(0.7, 1.0, 600)  # cosines of zenith angles
    s = np.empty((1200, bands))
    for band, fine in enumerate(quadrature(centre, width)):
        s[:600, band] = sky_radiance(fine, low, air).mean(axis=1)
        overhead = sky_radiance(fine, high, air).mean(axis=1)
        s[600:, band] = METAL * planck(fine, AIR_K).mean() + (1 - METAL) * overhead
    s += noise_sigma(centre, 0.05) * rng.normal(size=s.shape)
    cube = HeatCube(s.T.reshape(bands, 40, 30), centre, width, 0.05)
    environment = estimate_environment(cube, MaterialLibrary.starter())
    assert environment.sky
    usual = usual_temperature(cube, environment, SampledSpectra.of(cube))
    alone = np.median(SampledSpectra.of(cube).brightness_k.mean(axis=1))  # what they would say
    assert alone < AIR_K - 15
    assert AIR_K - 12 < usual < AIR_K + 3


@pytest.mark.parametrize("bands", [4, 9])
@pytest.mark.parametrize("metal", [0.0, 0.65])
def test_mirrors_in_the_window_leave_the_scene_as_warm_as_the_rest(bands, metal):
    """No band is opaque, so that each plate looks tens of kelvin colder than it is; the rest of
    the ground is nearly black."""
    w, air, rng = np.linspace(9.0, 12.0, bands), Atmosphere(AIR_K, 1.0), np.random.default_rng(0)
    black = planck(w, rng.normal(AIR_K, 2.0, 1200)[:, None])
    overhead = sky_radiance(w, rng.uniform(0.7, 1.0, 1200), air)
    plates = 0.2 * black + 0.8 * overhead
    s = np.where(rng.random(1200)[:, None] < metal, plates, black)
    s += noise_sigma(w, 0.05) * rng.normal(size=s.shape)
    cube = HeatCube(s.T.reshape(bands, 40, 30), w, netd_k=0.05)
    environment = estimate_environment(cube, TWO, 2)
    t = brightness_temperature(w, s).max(axis=1)
    assert np.median(t) < AIR_K - 15 if metal else np.median(t) > AIR_K - 1
    assert abs(usual_temperature(cube, environment, SampledSpectra.of(cube)) - AIR_K) < (
        15 if metal else 1
    )


@pytest.mark.parametrize("hot_k", [310.0, 330.0, 600.0])
@pytest.mark.parametrize("emissivity", [1.0, 0.7])
def test_a_part_that_is_hot_does_not_make_the_scene_hot(hot_k, emissivity):
    """Be the ground black or, as sand, half a mirror of the sky in one band of six."""
    w = np.linspace(8.0, 13.0, 6)
    t = np.where(np.arange(1200) % 8 == 0, hot_k, 290.0)
    e = np.where(w == 9.0, emissivity, 1.0)
    s = e * planck(w, t[:, None]) + (1 - e) * planck(w, 230.0)
    cube = HeatCube(s.T.reshape(6, 40, 30), w, netd_k=0.05)
    environment = estimate_environment(cube, TWO, 2)
    assert usual_temperature(cube, environment, SampledSpectra.of(cube)) == pytest.approx(
        290, abs=1
    )


@pytest.mark.parametrize("netd_k", [0.05, 1.0, 2.0])
def test_noise_does_not_make_the_scene_warm(netd_k):
    """Nor does a car's hood, the one thing that noise does not hide before the sky."""
    w = np.linspace(8.2, 13.8, 24)
    rng, air = np.random.default_rng(0), Atmosphere(AIR_K, 1.0)
    s = np.concatenate([
        sky_radiance(w, np.sort(rng.uniform(0.02, 0.2, 1600)), air),
        planck(w, rng.normal(AIR_K, 2.0, 1600)[:, None]),
    ])  # fmt: skip
    s[-24:] = planck(w, 340.0)
    s += noise_sigma(w, netd_k) * rng.normal(size=s.shape)
    cube = HeatCube(s.T.reshape(24, 80, 40), w, netd_k=netd_k)
    environment = estimate_environment(cube, MaterialLibrary.starter())
    assert environment.sky
    assert abs(usual_temperature(cube, environment, SampledSpectra.of(cube)) - AIR_K) < 3


@pytest.mark.parametrize("sky", [None, 0, 2])
@pytest.mark.parametrize("in_view", [True, False])
def test_every_material_is_pure_or_partly_sky_where_there_is_one(sky, in_view):
    of = Mixtures.of(np.arange(4) == (-1 if sky is None else sky), in_view)
    mixed = (of.share_sigma > 0) & (of.sky_share > 0) & (of.sky_share < 1)
    assert (of.sky_share[~mixed] == (of.material[~mixed] == sky)).all()
    if in_view and sky is not None:
        np.testing.assert_allclose(np.bincount(of.material, of.prior), 1)
        assert mixed.sum() == 4 == of.material[mixed].max() + 1
        more = of.sky_share[mixed & (of.material == sky)]
        assert more > 0.5 > of.sky_share[mixed & (of.material != sky)].max()
    else:
        assert not mixed.any() and of.material.tolist() == [0, 1, 2, 3]


@pytest.mark.parametrize("bands", [9, 54])
def test_little_that_is_as_warm_as_the_air_looks_like_the_sky(bands):
    """Though the sky's own deviations may lead there: near the horizon it is nearly black."""
    cube, truth = traced("forest", bands)
    around, w = estimate_environment(cube, MaterialLibrary.starter()), cube.wavelength_um
    sky = names_of(truth) == "sky"
    sigma = cube.sigma
    assert like_sky(cube.radiance[:, sky].T, around, sigma).mean() > 0.9
    air_k = brightness_temperature(w, around.sky_mean).max()
    black = planck(w, air_k + np.linspace(-3, 10, 14)[:, None])
    assert like_sky(black, around, sigma).mean() < 0.25
    # by chi-square alone much more of the ground does
    off, u = (cube.radiance[:, ~sky].T - around.sky_mean) / sigma, around.sky_spread / sigma
    near = np.linalg.solve(np.eye(bands) + u.T @ u, off.T).T
    alone = ((off * near).sum(axis=1) <= SKY_CHI2 * bands).mean()
    assert like_sky(cube.radiance[:, ~sky].T, around, sigma).mean() < 0.65 * alone


def test_the_sky_is_what_differs_from_it_by_noise_or_as_skies_do():
    """Not by many sigmas in all bands, nor by many of its own deviations."""
    w, rng = np.linspace(8, 14, 30), np.random.default_rng(0)
    sky, sigma = planck(w, 250.0), noise_sigma(w, 0.05)
    of_air = 40 * sigma * np.cos(w)
    around = Environment(sky[None], w, sky=(0,), sky_mean=sky, sky_spread=of_air[None])
    noise = sigma * rng.choice([-1, 1], (200, 30))
    like = lambda off: like_sky(sky + off, around, sigma).mean()
    assert like(noise) == like(2 * noise) == like(noise + 2 * of_air) == 1
    assert like(4.5 * noise) == like(noise + 3 * of_air) == 0


@pytest.mark.parametrize("bands", [3, 6, 54])
def test_a_rim_goes_from_the_mean_of_what_glows_in_a_band_to_the_mean_of_the_sky(bands):
    """Of wide bands, B at the centre is another by many times the noise."""
    w, fwhm = equidistant_bands(bands)
    sky = planck(w, 250.0)
    around = Environment(np.stack([sky, planck(w, 285.0)]), w, sky=(0,))
    around = replace(around, sky_mean=sky)
    s = planck(w, np.linspace(280, 295, 1200)[:, None])
    cube = HeatCube(s.T.reshape(bands, 40, 30), w, fwhm, netd_k=0.05)
    model = reduce_model(cube, MaterialLibrary.starter(), around)
    fine = w + fwhm * (np.arange(200)[:, None, None] + 0.5 - 100) / 200
    t = model.prior_mean_k + model.prior_sigma_k * np.random.default_rng(0).normal(size=4000)
    glow = planck(fine, t[:, None]).mean(axis=(0, 1))
    row = np.flatnonzero((model.sky_share > 0) & (model.sky_share < 1))
    step = np.tile(0.15 * (sky - glow) / cube.sigma, (len(row), 1))
    np.testing.assert_allclose(model.deviation[row, :, -1], step, rtol=0.03)
