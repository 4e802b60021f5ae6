"""Wavelengths stated wrongly are found by the sky's ozone, and right ones are left alone."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from traced import averaged, one_thread, traced  # noqa: F401

from physics import HeatCube, InputError, MaterialLibrary
from physics.bands import equidistant_bands, quadrature
from physics.blind import library_from_cube
from physics.cube.spectral_shift import registered, spectral_shift
from physics.estimate import estimate_environment
from physics.planck import noise_sigma, planck
from physics.sky import Atmosphere, sky_radiance
from texnet.budget import choose
from texnet.cli import main
from texnet.files.cube_io import write_cube
from texnet.methods import METHODS
from texnet.pipeline import decompose

LIBRARY = MaterialLibrary.starter()
LEAST_UM, NEAR_UM = 0.03, 0.025
BANDS = equidistant_bands(54)


def stated(cube, too_long):
    return HeatCube(cube.radiance, cube.wavelength_um + too_long, cube.fwhm_um, cube.netd_k)


def uniform(spectrum, wavelength_um, fwhm_um, netd_k=0.05, seed=0):
    """A picture of one spectrum (bands,), with noise."""
    noise = np.random.default_rng(seed).normal(size=(len(spectrum), 30, 40))
    s = spectrum[:, None, None] + noise * noise_sigma(wavelength_um, netd_k)[:, None, None]
    return HeatCube(np.maximum(s, 1e-3), wavelength_um, fwhm_um, netd_k)


def sky(atmosphere, cos_zenith, wavelength_um, fwhm_um):
    nodes = quadrature(wavelength_um, fwhm_um)
    s = sky_radiance(nodes.ravel(), np.array([cos_zenith]), atmosphere)[0]
    return s.reshape(nodes.shape).mean(axis=1)


def bell_curve(air_k, air_mass, wavelength_um, fwhm_um):
    """A sky that has the ozone's place and nothing else of it."""
    w = quadrature(wavelength_um, fwhm_um)
    ozone = np.exp(-0.5 * ((w - 9.66) / 0.2) ** 2)
    flanks = 1 / (1 + np.exp((w - 13.4) / 0.2)) / (1 + np.exp((8.1 - w) / 0.15))
    clear = 0.8 * (1 - 0.5 * ozone) * flanks
    return (planck(w, air_k) * (1 - clear**air_mass)).mean(axis=1)


@pytest.mark.parametrize("name", ["forest", "street"])
@pytest.mark.parametrize("too_long", [-0.4, -0.11, 0.05, 0.23, 0.34])
def test_of_a_traced_scene(name, too_long):
    cube = traced(name, 54)[0]
    assert spectral_shift(cube, LIBRARY) == 0
    assert abs(spectral_shift(stated(cube, too_long), LIBRARY) - too_long) < NEAR_UM


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("first_um", [7.8, 8.0, 8.075, 8.15])
def test_bands_just_as_coarse_as_they_may_be(first_um, dtype):
    """Whatever a multiple of 0.15 um is rounded to."""
    w = (first_um + 0.15 * np.arange(40)).astype(dtype).astype(float)
    width = np.full(40, 0.15)
    cube = uniform(sky(Atmosphere(280.0, 1.0), 0.5, w, width), w, width)
    assert abs(spectral_shift(stated(cube, 0.3), LIBRARY) - 0.3) < 0.05


@pytest.mark.parametrize("air_mass", [1.5, 4.0])
@pytest.mark.parametrize("too_long", [-0.4, -0.11, 0.0, 0.23, 0.34])
def test_of_a_sky_of_another_shape_to_half_a_band(too_long, air_mass):
    w, fwhm = BANDS
    cube = uniform(bell_curve(285.0, air_mass, w, fwhm), w, fwhm)
    assert abs(spectral_shift(stated(cube, too_long), LIBRARY) - too_long) < 0.055


@settings(max_examples=40)
@given(
    st.floats(250, 310), st.floats(0.2, 4), st.floats(200, 450), st.floats(0.02, 1),
    st.floats(-0.4, 0.4), st.sampled_from([44, 54, 100]),
)  # fmt: skip
def test_of_any_clear_sky(air_k, water_cm, ozone_du, cos_zenith, too_long, bands):
    """Right to a third of a band, or 0 where less than LEAST_UM is wrong or the sky is opaque."""
    w, fwhm = equidistant_bands(bands)
    of = Atmosphere(air_k, min(8.0, water_cm * np.exp((air_k - 290) / 15)), ozone_du)
    cube = uniform(sky(of, cos_zenith, w, fwhm), w, fwhm)
    found = spectral_shift(stated(cube, too_long), LIBRARY)
    near = max(NEAR_UM, 0.33 * 6 / bands)
    assert found == 0 or abs(found - too_long) < near
    if air_k < 285 and cos_zenith > 0.4:
        assert found != 0 or abs(too_long) < max(LEAST_UM, 6 / bands / 4) + near


@pytest.mark.parametrize("too_long", [-0.7, -0.5, 0.5, 0.7])
def test_what_is_farther_off_than_is_looked_for_is_not_given_as_less(too_long):
    assert spectral_shift(stated(traced("forest", 54)[0], too_long), LIBRARY) == 0


@settings(max_examples=60)
@given(
    st.integers(0, len(LIBRARY) - 1), st.floats(260, 320), st.floats(-20, 40) | st.floats(100, 600),
    st.sampled_from([None, 1.0, 0.3, 0.05]), st.floats(-3, 30), st.integers(0, 9),
)  # fmt: skip
@example(18, 260.0, 22.0, 0.3, 0.0, 0)  # glass, whose own band lies beside the ozone's
@example(18, 260.0, 35.0, 1.0, 0.0, 0)
@example(18, 275.0, 10.0, 0.3, 0.0, 0)
@example(18, 275.0, 0.0, 1.0, 0.0, 0)
def test_no_material_passes_for_a_shifted_sky(m, air_k, warmer, cos_zenith, roof, seed):
    """Under a sky, or a roof (None) some kelvin warmer than the air; and where it glows."""
    w, fwhm = BANDS
    nodes = quadrature(w, fwhm)
    e = LIBRARY.at(nodes.ravel())[m].reshape(nodes.shape).mean(axis=1)
    assume(m != LIBRARY.sky_index)
    light = planck(w, air_k + roof)
    if cos_zenith is not None:
        light = sky(Atmosphere(air_k), cos_zenith, w, fwhm)
    s = e * planck(w, air_k + warmer) + (1 - e) * light
    assert spectral_shift(uniform(s, w, fwhm, seed=seed), LIBRARY) == 0


def test_where_nothing_can_be_said():
    cube = stated(traced("forest", 54)[0], 0.25)
    assert spectral_shift(cube, LIBRARY) != 0
    names = [n for n in LIBRARY.names if n != "sky"]
    assert spectral_shift(cube, LIBRARY.subset(names)) == 0  # nothing to compare with
    assert spectral_shift(cube.only(cube.wavelength_um > 10), LIBRARY) == 0  # no ozone
    assert spectral_shift(averaged(cube, 18), LIBRARY) == 0  # bands too wide
    room = stated(traced("room", 54)[0], 0.25)
    assert spectral_shift(room, LIBRARY) == 0  # no sky


def test_a_library_that_does_not_reach():
    """Bands that turn out to lie beyond it are left out; a cube that is right is not moved."""
    cube = traced("forest", 54)[0]
    w, inside = LIBRARY.wavelength_um, LIBRARY.wavelength_um >= 8.1
    narrow = replace(LIBRARY, wavelength_um=w[inside], emissivity=LIBRARY.emissivity[:, inside])
    wrong = stated(cube, 0.25)
    part, shift = registered(wrong, narrow)
    assert shift == registered(wrong, LIBRARY)[1] != 0
    np.testing.assert_allclose(part.wavelength_um, wrong.wavelength_um[1:] - shift)
    np.testing.assert_array_equal(part.radiance, wrong.radiance[1:])
    d = decompose(wrong, narrow, method="local")
    assert d.left_out == {wrong.wavelength_um[0]: "beyond the library"}
    assert d.spectral_shift_um == shift and len(d.wavelength_um) == 53
    with pytest.raises(InputError, match="8.1-14.5 um but the bands need 8.056-13.94"):
        decompose(cube, narrow, method="local")


def test_dead_bands_beside_it():
    cube = stated(traced("forest", 54)[0], 0.25)
    s = cube.radiance.copy()
    s[[20, 21, 40]] = s[[20, 21, 40]].mean(axis=(1, 2), keepdims=True)
    cube = HeatCube(s, cube.wavelength_um, cube.fwhm_um, cube.netd_k)
    d = decompose(cube, method="local", k=3)
    assert len(d.left_out) == 3 and d.spectral_shift_um == pytest.approx(0.25, abs=0.02)


def test_a_few_pixels_that_flare_up_do_not_matter():
    cube = stated(traced("forest", 54)[0], 0.25)
    s = cube.radiance.copy()
    s[np.arange(5) + 15, np.arange(5) * 9, 30] = planck(9.0, 3000.0)
    cube = HeatCube(s, cube.wavelength_um, cube.fwhm_um, cube.netd_k)
    assert spectral_shift(cube, LIBRARY) == pytest.approx(0.25, abs=0.02)


def test_a_library_from_the_cube_is_at_right_wavelengths():
    cube = traced("forest", 54)[0]
    right, wrong = library_from_cube(cube)[0], library_from_cube(stated(cube, 0.23))
    assert "0.2" in wrong[1] and "um less than stated" in wrong[1]
    ozone = [
        lib.wavelength_um[8:24][lib.emissivity[lib.index("sky"), 8:24].argmax()]
        for lib in (right, wrong[0])
    ]
    assert ozone[0] == pytest.approx(ozone[1], abs=0.06)


def test_a_budget_sees_the_same_wavelengths():
    cube = stated(traced("forest", 54)[0], 0.3)
    inside = LIBRARY.wavelength_um <= 14.2
    narrow = replace(
        LIBRARY, wavelength_um=LIBRARY.wavelength_um[inside],
        emissivity=LIBRARY.emissivity[:, inside],
    )  # fmt: skip
    assert choose(cube, narrow, 4, 1e9, lambda _: None)[0] in METHODS


def test_the_answer_is_that_of_right_wavelengths():
    cube = traced("forest", 54)[0]
    right = decompose(cube, method="local", k=3)
    wrong = stated(cube, 0.23)
    answer = decompose(wrong, method="local", k=3)
    assert right.spectral_shift_um == 0
    assert answer.spectral_shift_um == pytest.approx(0.23, abs=0.02)
    np.testing.assert_array_equal(answer.wavelength_um, wrong.wavelength_um)
    off = lambda d: np.median(np.abs(d.temperature_k - right.temperature_k))
    assert off(answer) < 0.1 and (answer.material == right.material).mean() > 0.9
    # an environment as measured by the same camera moves along
    environment = estimate_environment(cube, LIBRARY, 3)
    environment = replace(environment, wavelength_um=wrong.wavelength_um)
    given = decompose(wrong, method="local", environment=environment)
    assert off(given) < 0.1


def test_the_command_says_so(tmp_path, capsys):
    cube = tmp_path / "cube.npz"
    write_cube(stated(traced("forest", 54)[0], -0.23), cube)
    out = ["--out", str(tmp_path / "a"), "--json"]
    assert main(["decompose", str(cube), "--method", "local", *out]) == 0
    text, result = capsys.readouterr().out.rsplit("\n", 2)[:2]
    assert re.search("0.2[23][0-9]* um more than stated", text)
    assert json.loads(result)["spectral_shift_um"] == pytest.approx(-0.23, abs=0.02)
    with np.load(tmp_path / "a" / "decomposition.npz") as npz:
        assert npz["spectral_shift_um"] == pytest.approx(-0.23, abs=0.02)


def test_a_fire_hides_no_wrong_wavelengths():
    """Granite at 1200 K, whose bands differ more than the sky's, in a twentieth of the picture."""
    cube = traced("forest", 54)[0]
    w, s = cube.wavelength_um, cube.radiance.copy()
    e = LIBRARY.at(w)[LIBRARY.index("granite")]
    height, width = (n // 4 for n in cube.shape)
    burns = e * planck(w, 1200.0) + (1 - e) * planck(w, 288.0)
    s[:, -height:, :width] = burns[:, None, None]
    burning = HeatCube(s, w, cube.fwhm_um, cube.netd_k)
    assert spectral_shift(stated(burning, 0.23), LIBRARY) == pytest.approx(0.23, abs=NEAR_UM)
    assert spectral_shift(burning, LIBRARY) == 0


def test_bands_that_overlap_are_no_trouble():
    """Nine tenths of a micrometre wide, a tenth apart: they reach beyond what is looked at."""
    cube = traced("forest", 54)[0]
    wide = replace(cube, fwhm_um=np.full(54, 0.9))
    assert spectral_shift(wide, LIBRARY) == 0
