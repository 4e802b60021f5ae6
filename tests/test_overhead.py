"""The curve of growth: found where the sky is as the law says, and better than none where not."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from physics.overhead import AIR_EXCESS_K, growth, overhead
from physics.planck import brightness_temperature, noise_sigma, planck
from physics.sky import Atmosphere, air_mass, sky_radiance, zenith_optical_depth

W = np.linspace(8.05, 13.95, 54)
NOISE = noise_sigma(W, 0.05)
AIR_K = 285.0


def by_the_law(rng, b, tau_1, air_masses):
    """Noisy spectra of a sky that is as the law says."""
    glow = planck(W, AIR_K)
    s = glow * -np.expm1(-tau_1 * air_masses[:, None] ** b)
    return s + NOISE * rng.standard_normal(s.shape)


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 2**32 - 1))
def test_growth_is_found_where_the_sky_follows_the_law(seed):
    rng = np.random.default_rng(seed)
    b = 1 - 0.4 * np.abs(np.sin(rng.uniform(1, 3) * W + rng.uniform(0, 6)))
    b = b / np.quantile(b, 0.9)
    tau_1 = rng.uniform(0.05, 0.15, W.size)
    sky = by_the_law(rng, b, tau_1, np.geomspace(3, 12, 400))
    found = growth(W, sky, NOISE, AIR_K, np.exp(-tau_1))
    np.testing.assert_allclose(found, np.clip(b, 0.3, 1.05), atol=0.06)


def test_without_a_range_of_air_masses_transmittance_decides():
    rng = np.random.default_rng(0)
    zenith = np.linspace(0.1, 0.9, W.size)
    sky = by_the_law(rng, np.ones(W.size), -np.log(zenith), np.full(300, 4.0))
    b = growth(W, sky, NOISE, AIR_K, zenith)
    assert (np.diff(b) > -0.02).all() and b[0] < 0.7 < 0.95 < b[-1]


@pytest.mark.parametrize("air_k, water_cm", [(275, 0.5), (285, 1.5), (290, 2.5)])
def test_overhead_is_nearer_a_layered_atmosphere_than_a_law_without_saturation(air_k, water_cm):
    """From 3 to 15 degrees of elevation to 40, against the sky of 28 layers (`physics.sky`)."""
    rng = np.random.default_rng(1)
    atmosphere = Atmosphere(air_k, water_cm)
    up = np.sin(np.radians(np.r_[np.linspace(3, 15, 500), 40.0]))
    clean = sky_radiance(W, up, atmosphere)
    sky = clean[:-1] + NOISE * rng.standard_normal((500, W.size))
    seen, true = sky[-25:].mean(axis=0), clean[-1]
    ratio = air_mass(up[-1:]) / air_mass(up[-25:-1]).mean()
    zenith = np.exp(-zenith_optical_depth(W, Atmosphere()))
    found = overhead(W, sky, NOISE, seen, ratio, zenith)[:, 0]
    assert len(found) == len(AIR_EXCESS_K)
    glow = planck(W, brightness_temperature(W, seen).max() + np.array(AIR_EXCESS_K)[:, None])
    plain = glow * (1 - (1 - seen / glow) ** ratio)
    off = lambda s: np.sqrt((((s - true) / NOISE) ** 2).mean(axis=1)).mean()
    assert off(found) < 0.5 * off(plain), (off(found), off(plain))


def test_overhead_at_the_air_mass_in_view_is_what_is_seen():
    rng = np.random.default_rng(2)
    sky = by_the_law(rng, np.ones(W.size), np.full(W.size, 0.1), np.geomspace(3, 12, 200))
    seen = sky[:20].mean(axis=0)
    skies = overhead(W, sky, NOISE, seen, (0.5, 1.0), np.full(W.size, 0.9))
    np.testing.assert_allclose(skies[:, 1], np.broadcast_to(seen, (3, W.size)), rtol=1e-6)
    assert (skies[:, 0] < skies[:, 1]).all()
