"""The sky overhead: of the air through which the sky in view is seen, ours or another's."""

import numpy as np
import pytest

from physics.bands import at_nodes, band_means, equidistant_bands, quadrature
from physics.overhead import _through, air_temperature, overhead, seen_sky
from physics.planck import noise_sigma, planck, planck_derivative
from physics.sky import Atmosphere, sky_along

SHARES = 1.0, 0.4, 0.0
AIRS = [Atmosphere(268, 0.35, 420), Atmosphere(283, 1.2, 300), Atmosphere(297, 3.0, 260)]


def sky_at(bands, atmosphere, mass):
    """Centres, widths, noise and band means of a sky along air masses."""
    w, fwhm = equidistant_bands(bands)
    s = band_means(lambda x: sky_along(x, np.array(mass), atmosphere), quadrature(w, fwhm))
    return w, fwhm, noise_sigma(w, 0.05), s


def overhead_of(w, nodes, noise, seen, air_k, air_doubt_k, shares):
    sky = seen_sky(w, nodes, noise, seen, air_k, air_doubt_k)
    return overhead(w, nodes, sky, shares)


def found(w, fwhm, noise, seen, scene_k, shares=SHARES):
    """Mean and covariance, by objects, of the skies that are found, and K of the air."""
    nodes = quadrature(w, fwhm)
    air = air_temperature(w, nodes, seen[None], seen, scene_k)
    skies = overhead_of(w, nodes, noise, seen, *air, shares)[0] / planck_derivative(w, 300.0)
    return skies.mean(axis=0), skies - skies.mean(axis=0)


def off_by(sky, deviations, true, error_k=0.3):
    """(root mean square over bands in K at 300 K, and in standard deviations with error_k)."""
    off = sky - true
    covariance = deviations.T @ deviations / len(deviations) + error_k**2 * np.eye(len(off))
    return np.sqrt((off**2).mean()), np.sqrt(off @ np.linalg.solve(covariance, off) / len(off))


@pytest.mark.parametrize("bands", [4, 9, 54])
@pytest.mark.parametrize("mass", [4.0, 12.0])
@pytest.mark.parametrize("atmosphere", AIRS)
def test_the_zenith_is_that_of_the_air(atmosphere, mass, bands):
    w, fwhm, noise, (zenith, seen) = sky_at(bands, atmosphere, [1.0, mass])
    mean, deviations = found(w, fwhm, noise, seen, atmosphere.air_temperature_k + 4)
    per = planck_derivative(w, 300.0)
    rms, sigmas = off_by(mean[0], deviations[:, 0], zenith / per)
    assert sigmas < 1.2
    # three quarters of the way from what is in view, and from no sky's light at all
    assert rms < 0.25 * np.sqrt((((seen - zenith) / per) ** 2).mean())


@pytest.mark.parametrize("bands", [1, 2, 4, 54])
def test_the_sky_in_view_is_what_is_seen(bands):
    w, fwhm, noise, (seen,) = sky_at(bands, AIRS[1], [6.0])
    seen = seen * (1 + 0.02 * np.sin(9 * w))  # which no model has
    skies = overhead_of(w, quadrature(w, fwhm), noise, seen, 284.0, 2.0, (0.0,))[0]
    clear = seen / planck(w, 284.0) < 0.8
    np.testing.assert_allclose(skies[:, 0, clear].mean(axis=0), seen[clear], rtol=0.005)


@pytest.mark.parametrize("off_k", [-1.0, 1.0])
def test_what_a_glow_that_is_off_does_to_optical_depth_is_what_is_doubted(off_k):
    """Not of a clear sky, S = B tau, of which a kelvin more in B takes 2 % from tau: what it has
    more of than the model is overhead, too. Of an opaque one nothing is known."""
    w, more = np.full(5, 10.0), 1.3
    own = np.array([0.02, 0.1, 0.3, 1.0, 6.0])
    model = planck(w, 285.0) * -np.expm1(-own * np.array([[1.0], [0.2]]))
    seen = planck(w, 285.0 + off_k) * -np.expm1(-own * more)
    (overhead_,) = _through(w, seen, 285.0, model)
    share = np.log(-np.log1p(-overhead_ / planck(w, 285.0)) / (0.2 * own)) / np.log(more)
    np.testing.assert_allclose(share[:3], 1, atol=0.1)
    assert 0.5 < share[3] < 1.1 and share[4] < 0.1


@pytest.mark.parametrize("bands", [4, 6, 9])
@pytest.mark.parametrize("atmosphere", AIRS)
def test_within_wide_bands_it_is_that_of_the_air_too(atmosphere, bands):
    w, fwhm, noise, (zenith, seen) = sky_at(bands, atmosphere, [1.0, 8.0])
    air = air_temperature(w, quadrature(w, fwhm), seen[None], seen, atmosphere.air_temperature_k)
    (within,) = overhead_of(w, quadrature(w, fwhm), noise, seen, *air, (1.0,))[1]
    nodes = quadrature(w, fwhm)
    true = at_nodes(lambda x: sky_along(x, np.array([1.0]), atmosphere), nodes)[0]
    off = within * (zenith / within.mean(axis=-1))[:, None] - true
    even = zenith[:, None] - true
    assert np.sqrt((off**2).mean()) < 0.25 * np.sqrt((even**2).mean())


def test_skies_clear_up_towards_the_zenith():
    w, fwhm, noise, (seen,) = sky_at(54, AIRS[1], [8.0])
    skies = overhead_of(w, quadrature(w, fwhm), noise, seen, 284.0, 2.0, np.linspace(0, 1, 5))[0]
    assert skies.shape == (8, 5, 54)
    assert (np.diff(skies, axis=1) < 0).all() and (skies > 0).all()


def test_another_sky_keeps_what_is_its_own_overhead():
    """A line that the model lacks is there overhead, too, as deep for its air mass."""
    w, fwhm, noise, (zenith, seen) = sky_at(54, AIRS[0], [1.0, 6.0])
    glow, at = planck(w, 268.0), int(np.argmin(np.abs(w - 11.0)))
    more = lambda s: 1 - (1 - s[at] / glow[at]) ** 2  # twice the optical depth
    seen_too = seen.copy()
    seen_too[at] = glow[at] * more(seen)
    (plain, _), (lined, _) = (found(w, fwhm, noise, s, 270.0, (1.0,)) for s in (seen, seen_too))
    wanted = (glow[at] * more(zenith) - zenith[at]) / planck_derivative(w[at], 300.0)
    assert lined[0, at] - plain[0, at] == pytest.approx(wanted, rel=0.35)


@pytest.mark.parametrize("bands, tells", [(54, True), (4, False)])
def test_the_air_is_as_warm_as_opaque_bands_show(bands, tells):
    w, fwhm, _, skies = sky_at(bands, AIRS[1], np.geomspace(2, 30, 50))
    for scene_k in (275.0, 290.0):
        air_k, doubt_k = air_temperature(w, quadrature(w, fwhm), skies, skies[0], scene_k)
        assert abs(air_k - 283.0) < 2 * doubt_k
        assert (doubt_k < 2.5) == tells


@pytest.mark.parametrize("bands", [9, 54])
@pytest.mark.parametrize("mass", [8.0, 20.0])
@pytest.mark.parametrize("atmosphere", [Atmosphere(303, 8.0), Atmosphere(283, 2.8)])
def test_of_a_sky_that_is_nearly_opaque_as_much_is_said_as_is_known(atmosphere, mass, bands):
    w, fwhm, noise, (zenith, seen) = sky_at(bands, atmosphere, [1.0, mass])
    mean, deviations = found(w, fwhm, noise, seen, atmosphere.air_temperature_k + 4)
    per = planck_derivative(w, 300.0)
    assert off_by(mean[0], deviations[:, 0], zenith / per)[1] < 2.5
