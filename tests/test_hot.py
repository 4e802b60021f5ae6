"""Fires and furnaces: pixels far hotter than the rest are solved apart, and spoil no others."""

import gc
from dataclasses import replace
from functools import cache
from itertools import product

import numpy as np
import pytest
from traced import names_of, traced

from physics.bands import equidistant_bands
from physics.cube.heat_cube import MAX_NETD_K, HeatCube
from physics.cube.hot import KNOWN, far_hotter, netd_k, split_hot, spread_of_hot
from physics.estimate import estimate_environment
from physics.library import MaterialLibrary
from physics.planck import noise_sigma, planck
from physics.simulator import trace_scene
from physics.simulator.presets import preset
from texnet.methods import METHODS
from texnet.pipeline import decompose
from texnet.solver import solve_hot

LIBRARY = MaterialLibrary.starter()


@cache
def burning():
    """`random`, traced, with an object 300 K hotter, whose light the paths carry."""
    scene = preset("random", 5_000_009)
    objects = list(scene.objects)
    objects[1] = replace(objects[1], temperature_k=objects[1].temperature_k + 300)
    scene = replace(scene, objects=objects)
    return trace_scene(scene, (72, 96), 32, 1, LIBRARY)


@cache
def fire(bands):
    """HeatCube and Truth of that."""
    return burning().shade(LIBRARY, *equidistant_bands(bands), 0.05)


@pytest.mark.parametrize(
    ("bands", "method"), [*product((36,), METHODS), (9, "local"), (9, "net+sgd")]
)
def test_a_fire_gets_its_temperature_and_its_material(bands, method):
    cube, truth = fire(bands)
    d = decompose(cube, method=method)
    fire_k = truth.temperature_k > 450
    assert 0.01 < fire_k.mean() < 0.2 and (d.hot & fire_k).sum() == fire_k.sum()
    off = np.abs(d.temperature_k - truth.temperature_k)
    right = names_of(d) == names_of(truth)
    assert np.median(off[fire_k]) < 1.5 and right[fire_k].mean() > 0.9
    ground = ~d.hot & (names_of(truth) != "sky")
    assert np.median(off[ground]) < 0.5
    assert right[ground].mean() > (0.8 if method in ("net+sgd", "sgd") else 0.7)
    # net's T is as the network proposes it
    assert (off < 2 * d.temperature_sigma_k)[fire_k | ground].mean() > (
        0.85 if method == "net" else 0.9
    )


def test_a_fire_is_no_object_that_lights_the_scene():
    """As one of k it would explain all that is warm, as a mirror of it."""
    cube, truth = fire(36)
    e = estimate_environment(cube, LIBRARY)
    hottest = planck(cube.wavelength_um, np.nanmax(np.where(far_hotter(cube), 0, 330.0)))
    assert (e.radiance < hottest).all()
    burning = cube.radiance[:, far_hotter(cube)].mean(axis=1)
    along = e.spread @ burning / np.linalg.norm(burning) / np.linalg.norm(e.spread, axis=1)
    assert np.abs(along).max() > 0.999


def test_without_a_fire_nothing_is_split_off():
    cube = traced("forest")[0]
    cold, hot, alone = split_hot(cube)
    assert cold is cube and not hot.any() and alone.shape == (cube.bands, 0)
    assert spread_of_hot(alone, cube.dead.size).shape == (0, cube.bands)


def test_nothing_of_a_cube_outlives_its_answer():
    """Not the copy of it that is without its fire, either."""
    cube = fire(9)[0]
    gc.collect()
    before = {id(c) for c in gc.get_objects() if type(c) is HeatCube}
    decompose(cube, method="local")
    gc.collect()
    left = [c for c in gc.get_objects() if type(c) is HeatCube and id(c) not in before]
    assert split_hot(cube).hot.any() and not left


def test_one_wrong_band_makes_no_fire_and_hides_none():
    cube = traced("patterned", 24, (24, 36))[0]
    s = cube.radiance.copy()
    s[12, 3, 4] = planck(cube.wavelength_um[12], 420.0)
    s[:, 7, 8] = planck(cube.wavelength_um, 900.0)
    s[12, 7, 8] = planck(cube.wavelength_um[12], 300.0)
    hot = np.argwhere(far_hotter(replace(cube, radiance=s)))
    np.testing.assert_array_equal(hot, [[7, 8]])


def test_the_sky_is_found_above_a_foreground_that_burns():
    cube = traced("forest")[0]
    s, top = cube.radiance.copy(), int(0.6 * cube.shape[0])
    s[:, top:] = planck(cube.wavelength_um[:, None, None], 600.0)
    assert estimate_environment(replace(cube, radiance=s), LIBRARY).sky


@pytest.mark.parametrize("share", [0.01, 0.45])
def test_black_bodies_far_hotter_are_told_by_planck_alone(share):
    """Whatever surrounds them; up to half of the picture."""
    cube = traced("patterned", 24, (24, 36))[0]
    rng, s = np.random.default_rng(0), cube.radiance.copy()
    hot = rng.random(cube.shape) < share
    t = rng.uniform(450, 1500, np.count_nonzero(hot))
    s[:, hot] = planck(cube.wavelength_um[:, None], t)
    black = MaterialLibrary(("black", "half"), [7.0, 15.0], [[1.0, 1.0], [0.5, 0.5]])
    d = decompose(replace(cube, radiance=s), black, method="local", k=2)
    assert np.array_equal(d.hot, hot)
    assert (d.material[hot] == 0).mean() > 0.95
    of_black = np.abs(d.temperature_k[hot] - t)[d.material[hot] == 0]
    assert of_black.max() < 1


@pytest.mark.parametrize("name", ["steel", "aluminium", "rust", "concrete"])
@pytest.mark.parametrize("kelvin", [450.0, 600.0, 900.0, 1500.0])
def test_what_is_far_hotter_may_be_hundreds_of_kelvin_hotter_than_it_looks(name, kelvin):
    """Bare metal, by Eq. 1, under a sky and among what is as warm as the air."""
    cube = traced("forest")[0]
    around, rng = estimate_environment(cube, LIBRARY), np.random.default_rng(0)
    e = LIBRARY.of_bands(cube.nodes_um)[LIBRARY.index(name)]
    v = rng.dirichlet(np.ones(len(around)), 200)
    s = e * planck(cube.wavelength_um, kelvin) + (1 - e) * (v @ around.radiance)
    s += noise_sigma(cube.wavelength_um, cube.netd_k) * rng.normal(size=s.shape)
    maps = solve_hot(cube, s.T.astype(np.float32), LIBRARY, around)
    off, sigma = np.abs(maps["temperature_k"] - kelvin), maps["temperature_sigma_k"]
    assert (off <= 2 * sigma).mean() > 0.9
    if kelvin * e.mean() > 60:  # else what it sends is hardly more than what it mirrors
        assert np.median(off) < 0.02 * kelvin


def test_the_share_of_the_picture_is_what_a_fire_may_light():
    hot = np.full((3, 4), 100.0)
    assert spread_of_hot(hot, 400) == pytest.approx(np.ones((1, 3)))
    assert spread_of_hot(hot, 8) == pytest.approx(5 * np.ones((1, 3)))


def test_a_fire_is_known_to_a_share_of_its_light_and_to_the_camera_s_noise():
    w = np.linspace(8, 14, 20)
    cube = HeatCube(np.full((20, 1, 1), 8.0), w, netd_k=0.05)
    of = lambda k: netd_k(cube, noise_sigma(w, k)[:, None] / KNOWN)
    assert of(1e-6) == pytest.approx(0.05) and of(0.12) == pytest.approx(0.13)
    assert of(1e3) == MAX_NETD_K  # more is no camera's


def test_hot_pixels_are_those_far_above_half_of_the_picture_and_the_sun():
    w = np.array([9.0, 10.0, 11.0])
    t = np.full((10, 10), 300.0)
    t[0, :4], t[1, :4], t[2, 0] = 349.0, 352.0, 900.0
    dead = np.zeros(t.shape, bool)
    dead[2, 0] = True
    cube = HeatCube(planck(w[:, None, None], t), w, netd_k=0.05, dead=dead)
    assert np.array_equal(far_hotter(cube), t == 352.0)
    warm = HeatCube(planck(w[:, None, None], t + 20), w, netd_k=0.05, dead=dead)
    assert np.array_equal(far_hotter(warm), t == 352.0)  # 372 K, 52 above the others; not 369 K


def test_what_the_sun_heats_is_not_hot_though_the_scene_is_cold():
    w, t = np.array([9.0, 10.0, 11.0]), np.full((10, 10), 260.0)
    t[0, :4], t[1, :4] = 345.0, 355.0
    cube = HeatCube(planck(w[:, None, None], t), w, netd_k=0.05)
    assert np.array_equal(far_hotter(cube), t == 355.0)
