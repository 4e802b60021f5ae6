"""The peers recover what their own assumptions make recoverable, and stay finite beyond.

Pixels here are lit by one uniform sky and free of noise: what temperature-emissivity separation
assumes. That tests the peers, never how accurate they are on scenes.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.peers import brightness, isstes, nem
from benchmarks.peers.band_planck import BandPlanck, emissivity
from benchmarks.peers.naming import light, nearest
from benchmarks.peers.scipy_fit import cost, fit, pure_hypotheses
from benchmarks.peers.surroundings import downwelling
from physics.bands import equidistant_bands, quadrature
from physics.exact.local import solve_local
from physics.exact.reduced import reduce_model
from physics.planck import planck
from physics.sky import Atmosphere, sky_radiance

COARSE = {
    n: (BandPlanck(*equidistant_bands(n)), downwelling(Atmosphere(), *equidistant_bands(n)))
    for n in (3, 9)
}
METHODS = [brightness, nem, isstes]
W, FWHM = equidistant_bands(54)
PLANCK = BandPlanck(W, FWHM)
SKY = downwelling(Atmosphere(), W, FWHM)
TEMPERATURES = np.array([292.3, 300.0, 317.7, 333.4])  # warmer than the sky in every band


def lit(temperature_k, e, sky=SKY, law=PLANCK):
    """Spectra (pixels, bands) of Eq. 1 under a uniform sky."""
    return e * law.radiance(temperature_k) + (1 - e) * sky


def test_band_planck_is_the_mean_over_each_band_and_has_an_inverse():
    w, fwhm = equidistant_bands(4)
    law = BandPlanck(w, fwhm)
    fine = w[:, None] + fwhm[:, None] * (np.linspace(0.001, 0.999, 499) - 0.5)
    for t in (211.13, 300.0, 455.55):
        s = law.radiance(np.array([t]))
        np.testing.assert_allclose(s[0], planck(fine, t).mean(axis=-1), rtol=2e-4)
        np.testing.assert_allclose(s[0], planck(quadrature(w, fwhm), t).mean(-1), rtol=5e-6)
        np.testing.assert_allclose(law.brightness_temperature(s), t, atol=1e-6)


def test_the_downwelling_sky_lies_between_zenith_and_horizon_and_sums_to_the_irradiance():
    ends = sky_radiance(W, np.array([1.0, 0.0]), Atmosphere())
    sky = downwelling(Atmosphere(), W, np.zeros_like(W))
    assert (ends[0] < sky).all() and (sky < ends[1]).all()
    # pi L = integral of L cos over the hemisphere, by a plain sum over angles
    angle = (np.arange(500) + 0.5) / 500 * np.pi / 2
    ring = 2 * np.sin(angle) * np.cos(angle) * (np.pi / 2 / 500)
    np.testing.assert_allclose(sky, ring @ sky_radiance(W, np.cos(angle), Atmosphere()), rtol=1e-3)


@pytest.mark.parametrize("method", METHODS)
def test_without_contrast_every_method_gives_the_common_temperature(method):
    """In a cavity as warm as itself every emissivity is as good, and T is the cavity's."""
    cavity = PLANCK.radiance(np.array([290.0]))[0]
    t, e = method.separate(lit(np.array([290.0]), 0.7, cavity), PLANCK, cavity)
    assert t == pytest.approx(290.0, abs=1e-3)
    assert np.isfinite(e).all()


def test_brightness_temperature_is_exact_where_e_is_what_it_assumes():
    t, e = brightness.separate(lit(TEMPERATURES, 0.95), PLANCK, SKY)
    np.testing.assert_allclose(t, TEMPERATURES, atol=1e-4)
    np.testing.assert_allclose(e, 0.95, atol=1e-4)


def test_brightness_temperature_is_low_where_e_is_lower():
    t, _ = brightness.separate(lit(TEMPERATURES, 0.9), PLANCK, SKY)
    assert (t < TEMPERATURES - 1).all()


def test_nem_is_exact_where_the_largest_e_is_what_it_assumes():
    true = 0.97 - 0.25 * np.abs(np.sin(W))  # reaches 0.97 between bands
    true += 0.97 - true.max()
    t, e = nem.separate(lit(TEMPERATURES, true), PLANCK, SKY)
    np.testing.assert_allclose(t, TEMPERATURES, atol=5e-3)
    np.testing.assert_allclose(e, np.broadcast_to(true, e.shape), atol=1e-3)


@pytest.mark.parametrize("largest, sign", [(0.96, -1), (1.0, 1)])
def test_nem_errs_as_the_largest_e_differs_from_the_assumed(largest, sign):
    true = largest - 0.1 * np.linspace(0, 1, len(W))
    t, _ = nem.separate(lit(TEMPERATURES, true), PLANCK, SKY)
    assert (sign * (t - TEMPERATURES) > 0).all()


@pytest.mark.parametrize("slope", [0.0, 0.03, -0.02])
def test_isstes_is_exact_where_e_is_a_straight_line(slope):
    true = 0.97 + slope * np.linspace(-0.5, 0.5, len(W))
    t, e = isstes.separate(lit(TEMPERATURES, true), PLANCK, SKY)
    np.testing.assert_allclose(t, TEMPERATURES, atol=5e-3)
    np.testing.assert_allclose(e, np.broadcast_to(true, e.shape), atol=2e-3)


def test_isstes_gives_a_pixel_the_same_answer_in_any_company():
    s = np.tile(lit(TEMPERATURES, 0.96), (isstes.PIXELS_PER_BLOCK, 1))
    t, _ = isstes.separate(s, PLANCK, SKY)
    np.testing.assert_array_equal(t.reshape(-1, 4), np.broadcast_to(t[:4], (len(t) // 4, 4)))


@pytest.mark.parametrize("method", METHODS)
@given(
    t=st.floats(150, 500), low=st.floats(0, 1), high=st.floats(0, 1), bands=st.sampled_from([3, 9])
)
def test_whatever_a_pixel_is_the_answer_is_finite(method, t, low, high, bands):
    law, sky = COARSE[bands]
    s = lit(np.array([t]), np.linspace(low, high, bands), sky, law)
    found, e = method.separate(s, law, sky)
    assert np.isfinite(found).all() and ((e >= 0) & (e <= 1)).all()


def test_the_emissivity_of_the_true_temperature_is_the_true_one():
    true = np.random.default_rng(0).uniform(0.2, 1.0, (4, len(W)))
    e = emissivity(lit(TEMPERATURES, true), TEMPERATURES, PLANCK, SKY)
    np.testing.assert_allclose(e, true, atol=1e-6)


def test_the_nearest_curve_is_blind_to_level_and_the_curve_itself():
    curves = np.random.default_rng(0).uniform(0.6, 1.0, (9, len(W)))
    for scale in (1.0, 0.8):
        np.testing.assert_array_equal(nearest(scale * curves, curves), np.arange(9))


def test_light_is_what_eq_1_was_given():
    e = np.random.default_rng(0).uniform(0.2, 0.9, (4, len(W)))
    grey = np.full(len(W), 3.0)
    x, mean = light(lit(TEMPERATURES, e, grey), TEMPERATURES, e, PLANCK)
    np.testing.assert_allclose(x, 3.0, rtol=1e-9)
    np.testing.assert_allclose(mean, 3.0, rtol=1e-9)


def test_a_band_in_which_nothing_is_reflected_says_nothing_of_the_light():
    e = np.full((4, len(W)), 0.6)
    e[:, 10] = 1 - 1e-6
    s = lit(TEMPERATURES, e, np.full(len(W), 3.0))
    s[:, 10] += 0.1  # of the glow
    np.testing.assert_allclose(light(s, TEMPERATURES, e, PLANCK)[1], 3.0, rtol=1e-3)


def test_scipy_fits_as_well_as_the_exact_solver_and_no_better(make_pixels):
    """By Planck's law itself, of which the solver has a series: what that errs moves T and V so
    little that J does not notice."""
    p = make_pixels(shape=(2, 4), k=3)
    model = reduce_model(p.cube, p.library, p.environment)
    rows, w = pure_hypotheses(model), p.cube.fwhm_um
    exact = solve_local(model, p.cube.spectra)
    for i, spectrum in enumerate(p.cube.spectra.astype(float)):
        m = exact.energy[i].argmin()
        assert exact.row[i, m] in rows
        t, v = exact.temperature_k[i, m], exact.lighting[i]
        ours = cost(model, spectrum, exact.row[i, m], w, t, v)
        fits = [fit(model, spectrum, r, w) for r in rows]
        for r, (value, t_r, v_r) in zip(rows, fits, strict=True):
            assert value == pytest.approx(cost(model, spectrum, r, w, t_r, v_r), rel=1e-4)
            assert v_r.sum() == pytest.approx(1, abs=1e-3)
        theirs = [
            cost(model, spectrum, r, w, t_r, v_r / v_r.sum())
            for r, (_, t_r, v_r) in zip(rows, fits, strict=True)
        ]
        best = np.argmin(theirs)
        assert ours == pytest.approx(theirs[best], abs=1e-5) and rows[best] == exact.row[i, m]
        assert t == pytest.approx(fits[best][1], abs=0.01)
        np.testing.assert_allclose(v, fits[best][2], atol=0.01)
