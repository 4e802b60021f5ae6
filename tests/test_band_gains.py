"""What the bands' gains are taken to be, of pixels that Eq. 1 describes."""

from itertools import chain, repeat

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from physics import HeatCube, MaterialLibrary
from physics.bands import equidistant_bands, quadrature
from physics.environment import Environment
from physics.eq1 import render
from texnet.camera.band_gains import band_gains

LIBRARY = MaterialLibrary.starter()
W, WIDTH = equidistant_bands(20)
SKY = LIBRARY.sky_index
GROUND = [m for m in range(len(LIBRARY)) if m != SKY][:6]


def scene(seed, materials, wrong=None):
    """(cube, maps) of 12 x 20 pixels of materials as Eq. 1 has them: nothing is left. wrong is a
    material whose curve is not the library's."""
    rng = np.random.default_rng(seed)
    material = rng.choice(materials, size=(12, 20))
    nodes = quadrature(W, WIDTH)
    e = LIBRARY.at(nodes.ravel()).reshape(len(LIBRARY), *nodes.shape)
    t = rng.uniform(270, 310, size=material.shape)
    environment = rng.uniform(2, 9, size=(3, 20))
    v = rng.dirichlet(np.ones(3), size=material.shape)
    true = e.copy()
    if wrong is not None:
        true[wrong] *= 0.9
    s, x = render(t, true[material], v, environment, nodes)
    cube = HeatCube(np.moveaxis(s, -1, 0), W, WIDTH, 0.05)
    maps = {
        "material": material, "temperature_k": t, "texture": np.moveaxis(x, -1, 0),
        "residual": rng.uniform(0.5, 1.5, size=material.shape),
    }  # fmt: skip
    return cube, maps


def gains_of(cube, maps, left=(1.0, 0.5, 9.0)):
    """Calibration where a fit finds T, m and X whatever the bands do, and leaves as much as left
    says in one step after the other, and then as in the last."""
    environment, left = Environment(np.full((1, 20), 5.0), W), chain(left, repeat(left[-1]))
    return band_gains(cube, environment, lambda *_: maps, LIBRARY, lambda _: next(left))


def found(*of):
    c = gains_of(*of)
    assert (c.gain, c.offset_k, c.noise, c.misfit) == (1, 0, 1, 1)
    return np.array(c.bands)


def shown(cube, gains):
    return HeatCube(cube.radiance * gains[:, None, None].astype(np.float32), W, WIDTH, 0.05)


@settings(max_examples=20)
@given(st.integers(0, 1000), st.sampled_from([0.001, 0.01, 0.03]))
def test_gains_are_found_as_they_are(seed, much):
    cube, maps = scene(seed, GROUND)
    gains = np.exp(much * np.random.default_rng(seed).normal(size=20))
    gains /= np.exp(np.log(gains).mean())
    np.testing.assert_allclose(found(shown(cube, gains), maps), gains, rtol=1e-5)


def test_a_gain_of_all_bands_is_not_theirs():
    cube, maps = scene(0, GROUND)
    np.testing.assert_allclose(found(shown(cube, np.full(20, 1.05)), maps), 1.0, rtol=1e-5)


def test_a_wrong_curve_has_no_voice():
    """A tenth lower, one of six, however many of the pixels it covers."""
    for n in (0, 6):
        of = scene(1, [*GROUND, *[GROUND[0]] * n], wrong=GROUND[0])
        np.testing.assert_allclose(found(*of), 1.0, atol=1e-6)


def test_sky_and_what_is_no_number_say_nothing():
    cube, maps = scene(2, [*GROUND, SKY])
    gains = 1 + 0.01 * np.random.default_rng(0).normal(size=20)
    wild = shown(cube, gains).radiance.copy()
    sky = maps["material"] == SKY
    wild[:, sky] *= 2.0
    maps["residual"][3:5] = np.nan
    wild[:, 3:5] *= 1.5
    got = found(HeatCube(wild, W, WIDTH, 0.05), maps)
    np.testing.assert_allclose(got / got.mean(), gains / gains.mean(), rtol=1e-4)


@pytest.mark.parametrize("materials", [[SKY], GROUND[:1]])
def test_one_material_alone_cannot_tell_a_curve_from_the_bands(materials):
    cube, maps = scene(4, materials)
    assert gains_of(cube, maps) is None


def test_where_texture_went_below_zero_nothing_is_said():
    cube, maps = scene(5, GROUND)
    gains = np.exp(0.01 * np.random.default_rng(5).normal(size=20))
    maps["texture"][:, ::4] = -1e3
    np.testing.assert_allclose(
        found(shown(cube, gains), maps), gains / np.exp(np.log(gains).mean()), rtol=1e-5
    )


def test_the_noise_goes_down_to_what_is_stated():
    """From where wrong materials have little to make up for to where they cannot."""
    cube, maps = scene(0, GROUND)
    cube, noise = shown(cube, np.linspace(0.97, 1.03, 20)), []

    def solve(_, part):
        noise.append(part.netd_k / cube.netd_k)
        return maps

    left = chain((20.0, 9.0, 3.0), repeat(1.0))  # in units of the noise that is taken
    environment = Environment(np.full((1, 20), 5.0), W)
    band_gains(
        cube,
        environment,
        solve,
        LIBRARY,
        lambda _: next(left) * cube.netd_k / (noise[-1] * cube.netd_k),
    )
    assert noise[0] == pytest.approx(32) and noise[-1] == pytest.approx(1.0)
    assert (np.diff(noise) < 1e-9).all()


def test_gains_do_not_run_away():
    cube, maps = scene(3, GROUND)
    maps["texture"] = maps["texture"] * np.linspace(0.1, 60, 20)[:, None, None]
    much = 10 * 0.9 ** np.arange(30)
    log_gain = np.log(found(cube, maps, much))
    assert np.abs(log_gain).max() == pytest.approx(0.15, abs=1e-6)
    # as much as that cannot be wrong where little is left
    assert gains_of(cube, maps, 0.1 * much) is None


def test_a_step_that_leaves_more_is_taken_back():
    cube, maps = scene(6, GROUND)
    off = shown(cube, np.linspace(0.98, 1.02, 20))
    np.testing.assert_array_equal(found(off, maps, (1.0, 1.1)), 1.0)
    assert np.ptp(found(off, maps, (1.0, 0.99, 1.1))) > 0.03  # little less is less
