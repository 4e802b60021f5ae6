"""Air between scene and camera: what it does to light, and that it is found and taken out."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from traced import names_of, one_thread, right, said, scene_of, traced  # noqa: F401

from physics import HeatCube, InputError, MaterialLibrary
from physics.air import OPAQUE, Air
from physics.bands import equidistant_bands, quadrature
from physics.environment import Environment
from physics.estimate import estimate_environment
from physics.planck import brightness_temperature, noise_sigma, planck
from physics.simulator import simulate
from physics.simulator.presets import preset
from physics.sky import Atmosphere, level_transmittance, usual_atmosphere
from texnet.camera.air_between import air_between
from texnet.camera.air_error import AIR_ERRORS, air_error_k
from texnet.camera.correction import (
    RIGHT,
    Calibration,
    Distances,
    corrected,
    corrected_environment,
    lifted_nats,
)
from texnet.camera.distances import OCTAVES, among_neighbours, far, likeliest_octaves
from texnet.camera.nats import NegativeLogEvidence
from texnet.camera.pixels import SampledPixels
from texnet.files.cube_io import write_cube
from texnet.glance import from_afar
from texnet.learned import shipped_network
from texnet.methods import Look
from texnet.pipeline import decompose
from training.finetune import calibrated

LIBRARY = MaterialLibrary.starter()
W = np.linspace(8, 14, 13)
FWHM = np.full(13, 0.5)
metres, kelvins = st.floats(1, 2000), st.floats(240, 310)


def through(cube, air, at=True):
    """What shows of a HeatCube's pixels, those that are at, behind some Air."""
    t, glow = (np.array(a)[:, None, None] for a in (air.transmittance, air.path_radiance))
    s = np.where(at, t * cube.radiance + glow, cube.radiance)
    return HeatCube(s, cube.wavelength_um, cube.fwhm_um, cube.netd_k)


def behind(cube, truth, metres, humidity=0.5, kelvin=285.0):
    """A HeatCube whose ground is so far away, through air of another humidity than is usual."""
    atmosphere, w = usual_atmosphere(kelvin, humidity), cube.wavelength_um
    t = level_transmittance(w, metres, atmosphere)
    air = Air(metres, kelvin, tuple(t), tuple((1 - t) * planck(w, kelvin)))
    return through(cube, air, names_of(truth) != "sky")


@given(metres, kelvins)
@settings(max_examples=20)
def test_a_black_body_as_warm_as_the_air_looks_the_same_through_it(metres, kelvin):
    air = Air.of(metres, kelvin, quadrature(W, np.zeros(13)))
    black = planck(W, kelvin)
    np.testing.assert_allclose(air.transmittance * black + air.path_radiance, black, rtol=1e-12)


def test_behind_air_that_hides_all_nothing_is_likely():
    """Where what it lets through is nothing, what a right camera would have shown has no end."""
    cube, _ = traced("forest", 24)
    hidden = Air(1e6, 285.0, (0.0,) * 24, tuple(planck(cube.wavelength_um, 285.0)))
    environment = estimate_environment(cube, LIBRARY, 5)
    never = lambda *_: pytest.fail("there is nothing to look at")
    with np.errstate(divide="ignore", invalid="ignore"):
        nats = SampledPixels(cube, environment, LIBRARY, None).nats(never, Calibration(air=hidden))
    assert nats.shape == cube.radiance[0].ravel().shape and (nats == np.inf).all()


def test_what_is_wrong_with_the_machine_is_no_unlikely_air():
    cube, _ = traced("forest", 24)

    def full(*_):
        raise InputError("no room")

    with pytest.raises(InputError, match="no room"):
        SampledPixels(cube, estimate_environment(cube, LIBRARY, 5), LIBRARY, None).nats(full, RIGHT)


@given(metres, metres, kelvins)
@settings(max_examples=20)
def test_more_air_lets_less_through_but_lines_saturate(one, other, kelvin):
    t = partial(level_transmittance, W, atmosphere=usual_atmosphere(kelvin))
    near, far, both = t(one), t(other), t(one + other)
    assert (both < np.minimum(near, far)).all() and (both > 0).all()
    assert (both >= near * far * (1 - 1e-9)).all()  # Beer's law is for a single absorption


def test_no_air_and_air_without_gases_are_clear():
    np.testing.assert_allclose(level_transmittance(W, 0.0, usual_atmosphere(290)), 1)
    empty = Atmosphere(290, water_cm=0, ozone_du=0, co2_ppm=0)
    other = (W < 9.2) | (W > 10) & (W < 11.6) | (W > 12.8)  # where methane and N2O absorb, too
    np.testing.assert_allclose(level_transmittance(W[~other], 1000.0, empty), 1)


def test_carbon_dioxide_and_vapour_close_the_window_from_its_ends():
    """A kilometre of summer air: four fifths and more of 10-11 um come through, as cameras with
    long lenses live on, little of 14 um."""
    t = dict(zip(W, level_transmittance(W, 1000.0, usual_atmosphere(290)), strict=True))
    assert t[14.0] < 0.3 < t[13.0] < t[11.0] and t[8.0] < t[9.0] and t[11.0] > 0.8
    dry = level_transmittance(W, 1000.0, Atmosphere(290, water_cm=0))
    assert t[14.0] < dry[-1] < 0.6 and (dry[3:8] > 0.95).all()


@given(st.floats(0, 300), kelvins, st.floats(0.9, 1.1), st.floats(-1, 1))
@settings(max_examples=20)
def test_the_correction_undoes_what_air_and_camera_did(metres, kelvin, gain, offset_k):
    s = planck(W, np.linspace(250, 320, 20)[:, None]).T.reshape(13, 4, 5)
    cube, air = HeatCube(s, W, FWHM, 0.05), Air.of(metres, kelvin, quadrature(W, FWHM))
    seen = through(cube, air)
    c = Calibration(gain, offset_k, air=air)
    offset = noise_sigma(W, offset_k)[:, None, None]
    shown = HeatCube(gain * seen.radiance + offset, W, FWHM, 0.05)
    back = corrected(shown, c)
    np.testing.assert_allclose(back.radiance, cube.radiance, rtol=1e-3)
    noisy = replace(shown, radiance=shown.radiance + shown.sigma[:, None, None].astype(np.float32))
    more = np.median(corrected(noisy, c).radiance - back.radiance, axis=(1, 2))
    np.testing.assert_allclose(more, back.sigma, rtol=0.02)  # of each band, by what it lets through


def test_the_sky_overhead_is_not_behind_the_air():
    air = Air.of(300.0, 285.0, quadrature(W, FWHM))
    spectra = planck(W, np.array([[230.0], [290.0]]))
    seen = Environment(spectra, W, sky=(0,), sky_mean=planck(W, 280.0))
    own = corrected_environment(seen, Calibration(air=air))
    np.testing.assert_array_equal(own.radiance[0], spectra[0])
    t, glow = np.array(air.transmittance), np.array(air.path_radiance)
    np.testing.assert_allclose(t * own.radiance[1] + glow, spectra[1])
    np.testing.assert_allclose(t * own.sky_mean + glow, seen.sky_mean)


def test_deviations_are_corrected_as_what_deviates_by_them():
    c = Calibration(1.1, 0.5, air=Air.of(300.0, 285.0, quadrature(W, FWHM)))
    spectra, small = planck(W, np.array([[230.0], [290.0]])), 0.01 * planck(W, 280.0)
    kinds = ("spread", "skylight_spread", "curve_spread", "sky_spread")
    seen = Environment(
        spectra, W, sky=(0,), sky_mean=planck(W, 280.0), **dict.fromkeys(kinds, small[None])
    )
    other = replace(seen, radiance=spectra + small, sky_mean=seen.sky_mean + small)
    own, other = (corrected_environment(e, c) for e in (seen, other))
    of_sky, of_ground = other.radiance - own.radiance
    np.testing.assert_allclose(own.skylight_spread[0], of_sky)
    np.testing.assert_allclose(own.spread[0], of_ground)
    np.testing.assert_allclose(own.curve_spread[0], of_ground)
    np.testing.assert_allclose(own.sky_spread[0], other.sky_mean - own.sky_mean)


def searched(peak_m, peak_k, gains):
    """What is found where pixels are likelier by so many nats with so much air, and by less with
    more or less of it, or warmer or colder: the less there is, the less its temperature matters."""

    def nats_of(c):
        share = c.air.metres / peak_m if c.air else 0.0
        warmer = c.air.temperature_k - peak_k if c.air else 0.0
        return np.full(100, 10.0 - gains * share * (2 - share - share * warmer**2 / 4))

    air_of = lambda m, k: Air(m, k, (1.0,), (0.0,))
    return air_between(NegativeLogEvidence(nats_of), air_of, 280.0)


@given(st.floats(15, 1000), st.floats(279, 287))
@settings(max_examples=50)
def test_the_search_finds_the_likeliest_air(peak_m, peak_k):
    air = searched(peak_m, peak_k, 2.0).air
    assert peak_m / 1.6 < air.metres < 1.6 * peak_m
    assert air.temperature_k == pytest.approx(peak_k, abs=1)


def test_air_that_hardly_helps_is_not_taken():
    assert searched(100, 283, 0.25) == RIGHT and searched(100, 283, 0.5) != RIGHT
    assert searched(100, 283, -2.0) == RIGHT
    assert searched(1e4, 283, 5.0) == RIGHT  # beyond all that is tried


@pytest.mark.parametrize(
    ("name", "bands", "method"),
    [("street", 24, "net+sgd"), ("street", 54, "local"), ("patterned", 54, "net+sgd")],
)
def test_what_is_far_away_is_answered_as_what_is_near(name, bands, method):
    """200 m of air a quarter more humid than is usual, which takes up to half of a band's light."""
    cube, truth = traced(name, bands)
    kelvin = scene_of(name).atmosphere.air_temperature_k
    near = right(name, bands, method)
    assert near.air_m == 0 and np.isnan(near.air_k)
    d = decompose(behind(cube, truth, 200.0, 0.62, kelvin), method=method)
    assert 100 < d.air_m < 400 and d.air_k == pytest.approx(kelvin, abs=2)
    assert (d.gain, d.offset_k) == (1, 0) and (d.band_gains == 1).all()
    # the camera's noise is what it was, though behind air it hides more
    assert (d.camera_netd_k, d.noise_raised) == (cube.netd_k, 1) and d.netd_k > cube.netd_k
    ground = names_of(truth) != "sky"
    off = lambda of: np.abs(of.temperature_k - truth.temperature_k)[ground]
    assert np.median(off(d)) < np.median(off(near)) + 0.12  # 0.9 K, if not taken out
    named = lambda of: (names_of(of) == names_of(truth)).mean()
    assert named(d) > named(near) - 0.03  # in the street 0.25
    assert (off(d) < 2 * d.temperature_sigma_k[ground]).mean() > 0.95
    assert d.air_error == AIR_ERRORS[0] and 0 < d.air_error_k < 0.3


@pytest.mark.parametrize(
    ("seed", "metres", "method"),
    [(5_000_003, 1000, "local"), (5_000_003, 1000, "net+sgd"), (5_000_002, 300, "local")],
)
def test_air_that_absorbs_otherwise_is_air_all_the_same(seed, metres, method, tmp_path, capsys):
    """By turns a third more and less along the wavelengths: no distance explains the pixels, which
    fit mirrors and wrong curves without air as well, T off by 7 to 13 K."""
    scene, (w, fwhm) = preset("random", seed), equidistant_bands(54)
    cube, truth = simulate(scene, wavelength_um=w, fwhm_um=fwhm, size=(64, 96), spp=16, seed=1)
    kelvin, ground = scene.atmosphere.air_temperature_k, names_of(truth) != "sky"
    usual = level_transmittance(w, metres, usual_atmosphere(kelvin, 0.6))
    t = usual ** (1 + 0.3 * np.sin(2 * np.pi * (w - 8) / 3))
    air = Air(metres, kelvin, tuple(t), tuple((1 - t) * planck(w, kelvin)))
    far = through(cube, air, ground)
    d = decompose(far, method=method)
    assert metres / 2 < d.air_m < 2 * metres and d.air_k == pytest.approx(kelvin, abs=2)
    assert d.air_error in AIR_ERRORS and d.curve_error == 0
    off = np.abs(d.temperature_k - truth.temperature_k)[ground]
    assert off.mean() < 3 and (off < 2 * d.temperature_sigma_k[ground]).mean() > 0.8
    if method == "net+sgd":
        write_cube(far, tmp_path / "far.exr")
        text, result, npz = said(capsys, tmp_path / "far.exr", tmp_path / "far")
        assert result["air_error"] == npz["air_error"] == d.air_error
        assert result["air_error_k"] == npz["air_error_k"] == pytest.approx(d.air_error_k, rel=1e-3)
        assert d.air_error_k > 0
        assert f"may differ by {d.air_error:.0%} from that of usual air, so that T may" in text


def test_the_air_is_as_warm_as_the_scene_where_no_band_is_opaque():
    cube, truth = traced("street", 54)
    held = cube.wavelength_um < 12.5
    far = behind(cube, truth, 200.0, 0.5, 283.0).only(held)
    d = decompose(far, method="local")
    assert 100 < d.air_m < 400 and d.air_k == pytest.approx(283, abs=2)


def test_air_and_a_gain_at_once():
    (cube, truth), gain = traced("street", 54), 1.05
    near = right("street", 54, "local")
    far = behind(cube, truth, 200.0, 0.5, 283.0)
    far = HeatCube(far.radiance * gain, far.wavelength_um, far.fwhm_um, far.netd_k * gain)
    d = decompose(far, method="local")
    assert d.gain == pytest.approx(gain, abs=0.01) and 100 < d.air_m < 400
    ground = names_of(truth) != "sky"
    assert np.median(np.abs(d.temperature_k - near.temperature_k)[ground]) < 0.3


def test_bands_that_are_off_do_not_pass_for_air():
    """The last six, which air would change most. They are found; but the search for gains may go
    astray among materials: then they are said to be noise."""
    cube, truth = traced("patterned", 54)
    ground, found = names_of(truth) != "sky", 0
    for off in (0.98, 0.985, 1.015, 1.02, 1.025):
        shown = cube.radiance.copy()
        shown[-6:] *= off
        d = decompose(replace(cube, radiance=shown), method="local")
        error = np.abs(d.temperature_k - truth.temperature_k)[ground]
        assert d.air_m == 0 and error.mean() < 0.6
        assert (error < 2 * d.temperature_sigma_k[ground]).mean() > 0.95
        right = (names_of(d) == names_of(truth)).mean()
        found += d.noise_raised == 1 and d.unknown.mean() < 0.1 and right > 0.9
    assert found >= 4


def test_nor_do_mirrors_behind_hot_air_that_fit_them():
    """Bands 0.5 % off each by itself: where few are too flexible for gains of their own, most of
    the street fits as copper and steel behind 160 m of air, T off by 4 K."""
    cube, truth = traced("street", 9)
    off = 0.005 * np.random.default_rng(3).normal(size=(9, 1, 1))
    shown = HeatCube(cube.radiance * (1 + off), cube.wavelength_um, cube.fwhm_um, cube.netd_k)
    d = decompose(shown, method="local")
    ground = names_of(truth) != "sky"
    assert d.air_m == 0 and d.noise_raised > 4
    assert np.abs(d.temperature_k - truth.temperature_k)[ground].mean() < 1.5


@pytest.mark.parametrize("name, bands", [("patterned", 18), ("patches", 54)])
@pytest.mark.parametrize("method", ["net+sgd", "local"])
def test_none_is_found_where_none_is(name, bands, method):
    assert right(name, bands, method).air_m == 0


def test_each_part_is_as_far_as_the_air_before_it_says():
    """Half of a forest eight times as far as the other half."""
    cube, truth = traced("forest", 24)
    here, there = (behind(cube, truth, metres).radiance for metres in (40.0, 320.0))
    left, ground = np.arange(cube.shape[1]) < cube.shape[1] // 2, names_of(truth) != "sky"
    s = np.where(left, here, there)
    d = decompose(HeatCube(s, cube.wavelength_um, cube.fwhm_um, cube.netd_k))
    assert 27 < np.median(d.distance_m[ground & left]) < 93
    assert 160 < np.median(d.distance_m[ground & ~left]) < 533
    # of both halves alike, 0.9 K
    assert np.abs(d.temperature_k - truth.temperature_k)[ground].mean() < 0.6


def test_pixels_are_corrected_by_the_air_before_them():
    cube = traced("forest", 24)[0]
    c = Calibration(1.03, 0.5, air=Air.of(100.0, 283.0, cube.nodes_um))
    metres = np.geomspace(20, 1000, cube.shape[1]) * np.ones(cube.shape)
    near = corrected(cube, c, Distances(metres, 500.0))
    for column in (0, 30, 71):
        of = Air.of(metres[0, column], 283.0, cube.nodes_um)
        by_itself = corrected(cube, c._replace(air=of)).radiance[..., column]
        t = lambda s: brightness_temperature(cube.wavelength_um[:, None], s)
        np.testing.assert_allclose(
            t(near.radiance[..., column]), t(by_itself), atol=0.05 * (t(by_itself).max() - 250)
        )


@given(st.floats(10, 1000), st.floats(260, 300), st.floats(-5, 5))
@settings(max_examples=20)
def test_bands_are_as_noisy_as_air_that_absorbs_otherwise_moves_them(metres, kelvin, warmer):
    air, share = Air.of(metres, kelvin, quadrature(W, FWHM)), 1e-3
    t, glow = np.array(air.transmittance), planck(W, kelvin)
    air = air._replace(path_radiance=tuple((1 - t) * glow))
    warm = HeatCube(np.broadcast_to(planck(W, kelvin + warmer)[:, None, None], (13, 4, 4)), W)
    seen = replace(through(warm, air), netd_k=0.02)
    of = lambda error: Calibration(air=air, air_error=error, contrast_k=abs(warmer))
    bare, off = corrected(seen, of(0.0)), corrected(seen, of(share))
    more = np.sqrt(off.sigma**2 - bare.sigma**2)
    s = seen.radiance[:, 0, 0].astype(float)
    moved = (s - (1 - t ** (1 + share)) * glow) / t ** (1 + share) - (s - (1 - t) * glow) / t
    # one temperature for all bands: a tenth is the curvature of Planck's law
    clear = np.abs(moved) > 1e-3 * noise_sigma(W, 0.02)
    np.testing.assert_allclose(more[clear], np.abs(moved)[clear], rtol=0.1)
    np.testing.assert_array_equal(off.radiance, bare.radiance)


@given(st.floats(10, 500), st.floats(270, 300), st.floats(-10, 10), st.floats(0.01, 1))
@settings(max_examples=20)
def test_t_is_in_doubt_by_as_much_as_other_air_would_move_it(metres, kelvin, warmer, share):
    """Of black bodies, whose T one band shows: of what is as warm as the air, by nothing."""
    air = Air.of(metres, kelvin, quadrature(W, FWHM * 1e-3))
    t, glow, band = np.array(air.transmittance), planck(W, kelvin), 4
    warm = HeatCube(np.broadcast_to(planck(W, kelvin + warmer)[:, None, None], (13, 5, 5)), W)

    def look(environment, cube, seen):
        maps = {name: np.zeros(cube.shape) for name in ("log_evidence", "material", "residual")}
        maps["material"] += LIBRARY.sky_index + 1
        return maps | {"temperature_k": brightness_temperature(W[band], cube.radiance[band])}

    somewhere = Environment(np.stack([planck(W, 200.0), glow]), W, sky=(0,))
    somewhere = replace(somewhere, sky_mean=planck(W, 200.0))
    pixels = SampledPixels(
        replace(through(warm, air), fwhm_um=FWHM * 1e-3, netd_k=0.02),
        somewhere,
        LIBRARY,
        lambda: Look(look),
    )
    found = Calibration(air=air, air_error=share, contrast_k=abs(warmer))
    x = np.arange(13) / 12
    factors = np.exp(share * np.sqrt(0.5) * np.cos(np.pi * np.outer((1, 2, 3, 4), x)))[:, band]
    s = glow[band] + (planck(W[band], kelvin + warmer) - glow[band]) * t[band] ** (1 - factors)
    moved = np.sqrt(np.sum((brightness_temperature(W[band], s) - kelvin - warmer) ** 2))
    assert air_error_k(pixels, found, 1.0) == pytest.approx(moved, rel=1e-3, abs=1e-3)
    assert air_error_k(pixels, found._replace(air_error=0.0), 1.0) == 0


@given(metres, kelvins, st.lists(st.floats(0.3, 3), min_size=13, max_size=13))
def test_air_that_absorbs_so_many_times_as_much_is_so_many_times_as_deep(metres, kelvin, times):
    narrow = np.full(13, 1e-3)
    usual = Air.of(metres, kelvin, quadrature(W, narrow))
    t = np.maximum(np.array(usual.transmittance) ** times, OPAQUE)
    seen = np.array(usual.transmittance) > OPAQUE
    other = Air.of(metres, kelvin, quadrature(W, narrow), tuple(times))
    np.testing.assert_allclose(np.array(other.transmittance)[seen], t[seen], rtol=1e-6)
    glow = (1 - np.array(other.transmittance)) * planck(W, kelvin)
    np.testing.assert_allclose(other.path_radiance, glow, rtol=1e-4)


def test_of_many_distances_the_noise_is_that_of_a_far_one():
    cube = traced("forest", 24)[0]
    of = lambda m: Calibration(air=Air.of(m, 283.0, cube.nodes_um))
    metres = np.where(np.arange(cube.shape[1]) < 20, 50.0, 400.0) * np.ones(cube.shape)
    distances = Distances(metres, 400.0)
    several, all_far = corrected(cube, of(100.0), distances), corrected(cube, of(400.0))
    np.testing.assert_allclose(several.sigma, all_far.sigma, rtol=1e-9)
    assert (all_far.sigma / cube.sigma).max() > 2 > 1.2 > (all_far.sigma / cube.sigma).min() > 1


def test_neither_the_sky_nor_what_is_dead_is_a_far_part_of_the_ground():
    cube, truth = traced("forest", 24)
    environment = estimate_environment(cube, LIBRARY, 5)
    is_sky = names_of(truth) == "sky"
    dead = np.broadcast_to(np.arange(cube.shape[1]) < 10, cube.shape)
    cube = replace(cube, dead=dead)
    metres = np.where(is_sky, 3.0, np.where(dead, 5000.0, 400.0))
    assert is_sky.mean() > 0.15 and far(metres, cube, environment) == 400
    # what little is unlike the sky may be noise
    few = replace(cube, dead=dead | ~is_sky)
    assert far(np.where(is_sky, 3.0, 400.0), few, environment) == 400 > is_sky.mean()


def test_three_quarters_of_the_ground_are_nearer_than_a_far_pixel():
    w, metres = np.array([9.0, 11.0]), np.linspace(10, 500, 400).reshape(20, 20)
    cube = HeatCube(planck(w[:, None, None], np.full((20, 20), 290.0)), w, netd_k=0.05)
    at = far(metres, cube, Environment(planck(w, np.array([[290.0]])), w))
    assert (metres < at).mean() == pytest.approx(0.75, abs=0.01)


def test_what_would_be_darker_than_dark_is_unlikely():
    """By the chi-square of the noise that would make it so."""
    air = Air.of(1000.0, 290.0, quadrature(W, FWHM))
    t, glow = (np.array(a)[:, None, None] for a in (air.transmittance, air.path_radiance))
    s = planck(W[:, None], np.array([250.0, 300.0]))[..., None]  # where opaque, less than the glow
    cube, c = HeatCube(s, W, FWHM, 1.0), Calibration(air=air)
    too_much = (t * corrected(cube, c).radiance + glow - s) / cube.sigma[:, None, None]
    of_cold, of_warm = lifted_nats(cube, c)[:, 0]
    assert of_cold == pytest.approx((too_much[:, 0] ** 2).sum() / 2, rel=1e-3) and of_cold > 10
    assert of_warm == 0 and (lifted_nats(cube, RIGHT) == 0).all()
    assert lifted_nats(cube, c._replace(noise=2.0))[0] == pytest.approx(of_cold / 4)


def test_what_correcting_hides_counts_against_an_air():
    cube, _ = traced("forest", 24)
    certain = lambda environment, part, seen: {"log_evidence": np.zeros(part.shape)}
    pixels = SampledPixels(cube, estimate_environment(cube, LIBRARY, 5), LIBRARY, lambda: certain)
    hot = Calibration(air=Air.of(1000.0, 300.0, cube.nodes_um))
    nats = pixels.nats(certain, hot)
    np.testing.assert_allclose(nats, lifted_nats(cube, hot).ravel())
    assert nats.max() > 1 and (pixels.nats(certain, RIGHT) == 0).all()


def test_noise_by_band_stays_with_the_cube():
    cube = traced("forest", 24)[0]
    air = Air.of(300.0, 283.0, cube.nodes_um)
    behind = corrected(cube, Calibration(air=air))
    np.testing.assert_allclose(from_afar(behind, 4).sigma, behind.sigma / 2)
    some = np.arange(24) % 3 > 0
    np.testing.assert_allclose(behind.only(some).sigma, behind.sigma[some])
    np.testing.assert_allclose(behind.moved(0.0).sigma, behind.sigma)


@pytest.mark.parametrize("wrong", [np.ones(5), np.zeros(13), np.full(13, np.nan), -np.ones(13)])
def test_relative_noise_is_a_positive_number_for_each_band(wrong):
    s = planck(W, 290.0)[:, None, None] * np.ones((1, 6, 7))
    with pytest.raises(InputError, match="one number above 0 per band"):
        HeatCube(s, W, FWHM, 0.05, relative_noise=wrong)


def octaves(nats, *among):
    """(6, 7) octaves taken where air at each of OCTAVES costs nats (octaves, 6, 7)."""
    s = planck(W, 290.0)[:, None, None] * np.ones((1, 6, 7))
    of = lambda c: nats[np.abs(OCTAVES - np.log2(c.air.metres / 100)).argmin()]
    here = Calibration(air=Air.of(100.0, 283.0, quadrature(W, FWHM)))
    return likeliest_octaves(here, NegativeLogEvidence(of), HeatCube(s, W, FWHM, 0.05), *among)


def test_all_distances_are_judged_by_one_noise_of_what_is_shown():
    """By that of their own air's error the farther would be likelier, being noisier."""
    air = Air.of(100.0, 283.0, quadrature(W, FWHM))
    cube = HeatCube(planck(W, 290.0)[:, None, None] * np.ones((1, 6, 7)), W, FWHM, 0.05)
    shown = []

    def of(c):
        shown.append(corrected(cube, c).sigma * c.air.transmittance)
        return np.zeros((6, 7))

    found = Calibration(air=air, air_error=0.4, contrast_k=10.0)
    likeliest_octaves(found, NegativeLogEvidence(of), cube)
    assert len(shown) == len(OCTAVES) and (shown[0] > 2 * cube.sigma).any()
    np.testing.assert_allclose(shown, np.tile(shown[0], (len(OCTAVES), 1)), rtol=1e-6)


@given(st.floats(-4.5, 3.5), st.integers(0, 2**31))
@settings(max_examples=30)
def test_the_likeliest_distance_is_as_sure_as_the_pixels_are(octave, seed):
    flat = np.random.default_rng(seed).uniform(-50, 50, (1, 6, 7)) * np.ones((len(OCTAVES), 1, 1))
    np.testing.assert_allclose(octaves(flat), 0, atol=1e-6)  # nothing known: as far as usual
    sharp = flat + 15 * (OCTAVES[:, None, None] - octave) ** 2
    np.testing.assert_allclose(octaves(sharp), octave, atol=0.2)
    unsure = octaves(flat + 0.1 * (OCTAVES[:, None, None] - octave) ** 2)
    assert (np.abs(unsure) <= abs(octave)).all() and (unsure * octave >= 0).all()
    sharp[:, 2, 3] = np.nan  # not measured: as its neighbours
    np.testing.assert_allclose(octaves(sharp, among_neighbours), octave, atol=0.2)
    assert octaves(sharp)[2, 3] == 0


def test_none_is_looked_for_without_sky_in_view_or_where_the_environment_is_given():
    cube = traced("room", 54)[0]
    hazy = through(cube, Air.of(200.0, 280.0, cube.nodes_um))
    assert decompose(hazy).air_m == 0
    cube, truth = traced("forest", 54)
    given = Environment(planck(cube.wavelength_um, np.array([[285.0]])), cube.wavelength_um)
    assert decompose(behind(cube, truth, 200.0), environment=given).air_m == 0


def test_the_command_says_so(tmp_path, capsys):
    cube, truth = traced("forest", 54)
    write_cube(behind(cube, truth, 200.0), tmp_path / "far.exr")
    text, result, npz = said(capsys, tmp_path / "far.exr", tmp_path / "far")
    assert 100 < result["air_m"] == npz["air_m"] < 400
    assert 0.5 < np.median(npz["distance_m"]) / npz["air_m"] < 2
    assert f"Air          {result['air_m']:.0f} m of {result['air_k']:.0f} K" in text
    write_cube(cube, tmp_path / "near.exr")
    text, result, npz = said(capsys, tmp_path / "near.exr", tmp_path / "near")
    assert result["air_m"] == 0 and result["air_k"] is None and "Air  " not in text
    assert "distance_m" not in npz


def test_fine_tuning_sees_the_cube_without_it():
    cube, truth = traced("forest", 54)
    clear = calibrated(behind(cube, truth, 200.0), LIBRARY, shipped_network()).cube
    ground, w = names_of(truth) != "sky", cube.wavelength_um[:, None]
    of = lambda c: brightness_temperature(w, c.radiance[:, ground])[-1]
    # in the most opaque band
    assert np.median(np.abs(of(clear) - of(cube))) < 0.5
    assert np.median(np.abs(of(behind(cube, truth, 200.0)) - of(cube))) > 0.5


@pytest.mark.parametrize("octave", [0, 3, len(OCTAVES) - 1])
def test_the_nearest_and_the_farthest_are_found_where_nothing_else_fits(octave):
    nats = np.full((len(OCTAVES), 6, 7), 500.0)
    nats[octave] = 0
    np.testing.assert_allclose(octaves(nats), OCTAVES[octave], atol=0.1)
