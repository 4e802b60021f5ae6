"""The doubt that edges and the camera's calibration add to sigma of T."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import maximum_filter, minimum_filter, uniform_filter
from scipy.optimize import minimize_scalar
from traced import names_of, one_thread, right, traced  # noqa: F401

from physics import HeatCube, MaterialLibrary
from physics.errors import InputError
from physics.estimate import estimate_environment
from physics.planck import brightness_temperature, noise_sigma, planck
from physics.prior import MIN_TEMPERATURE_SPREAD_K
from texnet.camera.correction import RIGHT, Calibration, corrected
from texnet.cli import main
from texnet.files.cube_io import write_cube
from texnet.files.library_io import with_sky
from texnet.pipeline import decompose
from texnet.uncertainty import (
    ROWS,
    SCATTER,
    SCATTER_OF_MATERIALS,
    local_trust,
    shared_error_k,
    sigma_among_neighbours,
    smooth_trust,
    unreliable,
    with_calibration_error,
    with_level_error,
)


@pytest.mark.parametrize("method", ["local", "sgd"])
def test_what_is_called_sky_though_something_stands_before_it_has_a_sigma_that_holds(method):
    """Leaves, which the sky shows through: T is that of the likeliest of many materials."""
    truth, d = traced("forest", 54)[1], right("forest", 54, method)
    at = (names_of(truth) != "sky") & (names_of(d) == "sky")
    off = np.abs(d.temperature_k - truth.temperature_k)[at]
    assert at.sum() > 100 and (off < 2 * d.temperature_sigma_k[at]).mean() > 0.95


@settings(max_examples=20)
@given(st.integers(1, 6), st.integers(1, 6), st.floats(60, 900), st.integers(0, 2**32 - 1))
def test_it_is_what_a_slow_window_gives(height, width, level, seed):
    rng = np.random.default_rng(seed)
    t = level + 20 * rng.standard_normal((height, width))
    m, sigma = rng.integers(0, 3, t.shape), rng.uniform(0.01, 2, t.shape)
    window = lambda of, a: of(a, 3, mode="nearest")
    variance = window(uniform_filter, t * t) - window(uniform_filter, t) ** 2
    edge = window(minimum_filter, m) != window(maximum_filter, m)
    slow = sigma**2 + (SCATTER**2 + edge * SCATTER_OF_MATERIALS**2) * variance
    fast = sigma_among_neighbours(sigma, t.astype(np.float32), m)
    np.testing.assert_allclose(fast, np.sqrt(slow), rtol=1e-3)


def test_rows_that_are_worked_on_apart_know_their_neighbours():
    t = np.full((2 * ROWS + 3, 4), 290.0, np.float32)
    t[ROWS] = 300.0
    sigma = sigma_among_neighbours(np.full(t.shape, 0.1), t, np.zeros(t.shape, int))
    near = np.abs(np.arange(len(t)) - ROWS) <= 1
    assert (sigma[near] > 0.4).all() and sigma[~near] == pytest.approx(0.1)


def test_where_all_is_alike_nothing_is_added():
    sigma = np.full((5, 7), 0.3)
    t, m = np.full((5, 7), 300.0, np.float32), np.ones((5, 7), int)
    assert sigma_among_neighbours(sigma, t, m) == pytest.approx(0.3)
    m[2] = 0  # another material as warm as the others
    assert sigma_among_neighbours(sigma, t, m) == pytest.approx(0.3)


@settings(max_examples=20)
@given(st.floats(250, 350), st.floats(0.05, 1), st.floats(0, 1))
def test_a_calibration_error_is_what_moves_t(t, e, share):
    """An offset below 300 K, a gain above it, of what the surroundings radiate, too, moves T of any
    grey body by this sigma; whichever moves it less is held, too."""
    w = np.linspace(8, 14, 30)
    light, small = planck(w, t - 20), noise_sigma(w, 1e-3)

    def moved_by(seen):
        s = seen(e * planck(w, t) + (1 - e) * light) - (1 - e) * seen(light)
        return brightness_temperature(w, s / e).mean() - t

    offset = moved_by(lambda s: s + small)
    gain = moved_by(lambda s: s * (1 + small / planck(w, 300.0)))
    moved = offset if t < 300 else gain
    assert moved >= max(offset, gain) * (1 - 1e-3)
    own = 1e-3 * share
    sigma = with_calibration_error(np.full((ROWS + 2, 3), own), np.full((ROWS + 2, 3), t), w, 1e-3)
    assert sigma == pytest.approx(np.hypot(own, moved), rel=1e-3)


@given(st.floats(250, 350), st.floats(0.1, 1.0))
def test_light_that_was_given_moves_t_by_one_over_e_as_much(t, e):
    """By Eq. 1: an offset is all of the glow's, of which there is e B."""
    w, light = np.linspace(8, 14, 54), planck(np.linspace(8, 14, 54), 230.0)
    small = noise_sigma(w, 1e-3)
    s = e * planck(w, t) + (1 - e) * light + small
    moved = brightness_temperature(w, (s - (1 - e) * light) / e).mean() - t
    maps = np.full((2, 3), 0.0), np.full((2, 3), t)
    sigma = with_calibration_error(*maps, w, 1e-3, np.full((2, 3), e))
    assert (sigma >= moved * (1 - 1e-3)).all()
    black = with_calibration_error(*maps, w, 1e-3)
    np.testing.assert_allclose(sigma, black / e, rtol=1e-5)
    # of what shows nothing of its T no more is known than beforehand
    mirror = with_calibration_error(*maps, w, 1.0, np.zeros((2, 3)))
    np.testing.assert_allclose(mirror, MIN_TEMPERATURE_SPREAD_K, rtol=1e-6)


@pytest.mark.parametrize("name, right", [("forest", 0.2), ("street", 0.8)])
def test_neighbours_do_not_make_sure_what_two_bands_leave_open(name, right):
    """They share the doubt: most is unknown, and T of the rest is covered, though in the forest
    three of four materials that are not unknown are wrong."""
    cube, truth = traced(name, 2)
    d = decompose(cube, method="sgd")
    ground = names_of(truth) != "sky"
    within = np.abs(d.temperature_k - truth.temperature_k) <= 2 * d.temperature_sigma_k
    assert within[ground].mean() > 0.92 and d.unknown.mean() > 0.5
    assert (names_of(d) == names_of(truth))[~d.unknown].mean() > right


@pytest.mark.parametrize("bands", [1, 2, 3, 4, 9, 54])
def test_log_evidence_never_counts_more_than_once_nor_for_nothing(bands):
    assert 0 < smooth_trust(bands) <= local_trust(bands) <= 1


@pytest.mark.parametrize("method", ["local", "net+sgd"])
def test_sigma_holds_a_calibration_error_that_is_stated(method):
    cube, truth = traced("forest", 54)
    off = noise_sigma(cube.wavelength_um, 1.0)[:, None, None]
    cube = HeatCube(cube.radiance + off, cube.wavelength_um, cube.fwhm_um, cube.netd_k)
    ground = np.array(truth.material_names)[truth.material] != "sky"
    held = []
    # where it is given, no error of the camera is suspected
    environment = estimate_environment(cube, MaterialLibrary.starter(), 4)
    for stated in (0.0, 1.0):
        d = decompose(cube, method=method, environment=environment, calibration_error_k=stated)
        error = np.abs(d.temperature_k - truth.temperature_k)[ground]
        held.append((error <= 2 * d.temperature_sigma_k[ground]).mean())
    assert held[0] < 0.75 and held[1] > 0.95


def test_what_is_stated_is_of_the_radiance_as_it_came():
    """Of which a gain that was found is taken out."""
    cube, more = traced("forest", 54)[0], []
    for gain in (1.0, 1.1):
        shown = HeatCube(gain * cube.radiance, cube.wavelength_um, cube.fwhm_um, gain * cube.netd_k)
        without, stated = (decompose(shown, method="local", calibration_error_k=k) for k in (0, 2))
        assert without.gain == pytest.approx(gain, abs=0.01)
        squares = stated.temperature_sigma_k**2 - without.temperature_sigma_k**2
        more.append(np.sqrt(np.median(squares)))
    assert more[1] == pytest.approx(more[0] / 1.1, rel=0.02)


@pytest.mark.parametrize("wrong", [-1, float("nan"), 11, "1", None, [1, 2]])
def test_a_calibration_error_that_is_none(wrong):
    with pytest.raises(InputError, match="calibration_error_k must be"):
        decompose(traced("forest", 54)[0], calibration_error_k=wrong)


def test_the_command_takes_it(tmp_path, capsys):
    write_cube(traced("forest", 54)[0], tmp_path / "cube.npz")
    for error_k, name in (("0", "without"), ("2", "with")):
        command = "decompose", str(tmp_path / "cube.npz"), "--method", "local", "--out"
        assert main([*command, str(tmp_path / name), "--calibration-error", error_k]) == 0
    sigma = [
        np.load(tmp_path / name / "decomposition.npz")["temperature_sigma_k"]
        for name in ("without", "with")
    ]
    assert (sigma[0] < sigma[1]).all() and 1.8 < sigma[1].min() < 2.5
    assert main([*command, str(tmp_path / "no"), "--calibration-error", "-1"]) == 2
    assert "need 0 to 10 K" in capsys.readouterr().err


def test_where_noise_was_raised_or_curves_or_air_are_off_more_is_unknown():
    """What is not likely, the more so the more it was raised, and what fits worse than most."""
    p = np.linspace(0.02, 0.98, 25).reshape(5, 5)
    maps = {
        "material": np.zeros((5, 5), np.int16), "material_probability": np.stack([p, 1 - p]),
        "residual": np.full((5, 5), 0.25),
    }  # fmt: skip
    for noise, least in ((1.01, 0.0), (1.5, 0.35), (2.0, 0.7), (9.0, 0.7)):
        of = Calibration(noise=noise, misfit=0.25 * noise)
        np.testing.assert_array_equal(unreliable(maps, of, 54), p < least)
    for bands, least in ((3, 0.5), (18, 0.5), (54, 0.0)):
        np.testing.assert_array_equal(unreliable(maps, RIGHT, bands), p < least)
    for curves, least in ((0.005, 0.35), (0.02, 0.7)):
        np.testing.assert_array_equal(unreliable(maps, Calibration(curves=curves), 54), p < least)
    for error, least in ((0.4, 0.35), (0.8, 0.7)):
        np.testing.assert_array_equal(unreliable(maps, Calibration(air_error=error), 54), p < least)
    raised = Calibration(noise=1.01, misfit=0.25)
    maps["residual"][0] = 0.5  # chi^2 is four times what it is where most fits
    np.testing.assert_array_equal(unreliable(maps, raised, 54)[0], True)
    maps["residual"][1] = np.nan
    unknown = unreliable(maps, raised, 54)
    assert unknown[:2].all() and not unknown[2:].any()


@settings(max_examples=20)
@given(st.floats(250, 330), st.floats(0.3, 0.95), st.floats(0.001, 0.02))
def test_a_level_error_of_a_curve_moves_t_as_eq_1_solved_anew_says(t, e, level):
    """S as it is, with the curve higher by its sigma: T by least squares over all bands."""
    w = np.linspace(8, 14, 20)
    curve = e + 0.04 * np.sin(2 * w)
    light = 0.5 * planck(w, 260.0)
    s = curve * planck(w, t) + (1 - curve) * light
    cube = HeatCube(np.tile(s[:, None, None], (1, 2, 3)), w, netd_k=0.05)
    higher = curve + level

    def misfit(guess):
        return ((higher * planck(w, guess) + (1 - higher) * light - s) / cube.sigma) ** 2

    found = minimize_scalar(lambda g: misfit(g).sum(), bounds=(t - 40, t + 40), method="bounded").x
    maps = {
        "material": np.zeros((2, 3), np.int16), "temperature_k": np.full((2, 3), t),
        "texture": np.tile(light[:, None, None], (1, 2, 3)),
    }  # fmt: skip
    library = MaterialLibrary(("a", "b"), w, [curve, curve], level_sigma=[level, 0])
    sigma = with_level_error(np.full((2, 3), 0.3), maps, library, cube)
    moved = abs(found - t)
    np.testing.assert_allclose(sigma, np.hypot(0.3, moved), rtol=0.1)
    # what all curves may be off by counts likewise, and adds in squares
    both = with_level_error(np.full((2, 3), 0.3), maps, library, cube, level)
    np.testing.assert_allclose(both**2 - 0.3**2, 2 * (sigma**2 - 0.3**2), rtol=1e-3, atol=1e-5)
    maps["material"] += 1
    np.testing.assert_array_equal(
        with_level_error(np.full((2, 3), 0.3), maps, library, cube), np.float32(0.3)
    )
    nothing = MaterialLibrary(("sky", "b"), w, [curve, 0 * curve], level_sigma=[0.1, level])
    capped = with_level_error(np.full((2, 3), 0.3), maps, nothing, cube)
    assert (capped <= np.hypot(0.3, 15) + 1e-4).all()
    maps["material"] -= 1  # of sky T is the air's, whatever its curve
    np.testing.assert_array_equal(
        with_level_error(np.full((2, 3), 0.3), maps, nothing, cube), np.float32(0.3)
    )


def test_no_level_error_moves_t_by_more_than_is_known_beforehand():
    """By Eq. 1 alone a mirror of e = 0.01 that may be 0.1 more is hundreds of kelvin off."""
    w = np.linspace(8, 14, 20)
    cube = HeatCube(np.tile(planck(w, 250.0)[:, None, None], (1, 2, 3)), w, netd_k=0.05)
    maps = {
        "material": np.zeros((2, 3), np.int16), "temperature_k": np.full((2, 3), 290.0),
        "texture": np.tile(planck(w, 250.0)[:, None, None], (1, 2, 3)),
    }  # fmt: skip
    library = MaterialLibrary(("a", "b"), w, np.full((2, 20), 0.01), level_sigma=[0.1, 0])
    sigma = with_level_error(np.full((2, 3), 0.3), maps, library, cube)
    np.testing.assert_allclose(sigma, np.hypot(0.3, MIN_TEMPERATURE_SPREAD_K), rtol=1e-6)


def test_an_error_that_all_bands_share_is_of_the_noise_that_was_stated():
    """However much noise the cube is then taken to have."""
    w = np.linspace(8, 14, 20)
    cube = HeatCube(np.tile(planck(w, 290.0)[:, None, None], (1, 2, 3)), w, netd_k=0.05)
    c = Calibration(noise=3.0, shared=6.0)
    assert shared_error_k(c, corrected(cube, c)) == pytest.approx(6 * 0.05)


def test_sigma_holds_what_the_level_of_the_curves_may_be_off():
    cube, _ = traced("forest")
    starter = MaterialLibrary.starter()
    unsure_of_it = replace(starter, level_sigma=np.full(len(starter), 0.02))
    a, b = (decompose(cube, library, method="local") for library in (starter, unsure_of_it))
    np.testing.assert_array_equal(a.temperature_k, b.temperature_k)
    ground = a.material != starter.sky_index
    assert (b.temperature_sigma_k >= a.temperature_sigma_k - 1e-5).all()
    more = np.sqrt(np.maximum(b.temperature_sigma_k**2 - a.temperature_sigma_k**2, 0))[ground]
    assert 0.1 < np.median(more) < 2


def test_the_level_of_a_curve_is_kept(tmp_path):
    library = MaterialLibrary(("a", "b"), [7.0, 15.0], np.full((2, 2), 0.9), level_sigma=[0, 0.1])
    library.save(tmp_path / "a.json")
    assert "level_sigma" not in (tmp_path / "a.json").read_text().splitlines()[2]
    for kept in (MaterialLibrary.load(tmp_path / "a.json"), library.subset(["a", "b"])):
        assert kept.level_sigma.tolist() == [0, 0.1]
    assert with_sky(library).level_sigma.tolist() == [0, 0.1, 0]
    assert (MaterialLibrary.starter().level_sigma == 0).all()


@pytest.mark.parametrize("wrong", [[0.1], [-0.1, 0], [1.0, 0], [np.nan, 0], "no"])
def test_a_level_that_is_none_is_refused(wrong):
    with pytest.raises(InputError, match="level_sigma must"):
        MaterialLibrary(("a", "b"), [7.0, 15.0], np.full((2, 2), 0.9), level_sigma=wrong)
