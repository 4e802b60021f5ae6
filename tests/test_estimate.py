"""The environment from path-traced cubes, whose light no k objects made; and distillation."""

import functools
import gc
import json
import weakref
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.ndimage import binary_dilation, binary_erosion
from traced import names_of, one_thread, traced  # noqa: F401

from physics import Environment, HeatCube, InputError, MaterialLibrary
from physics.bands import band_means, equidistant_bands, quadrature
from physics.estimate import Sample, _principal, _row, completed, estimate_environment
from physics.exact.distill import distill
from physics.exact.reduced import SERIES_TOLERANCE, reduce_model
from physics.planck import brightness_temperature, noise_sigma, planck, planck_derivative
from physics.simulator import simulate, trace_scene
from physics.simulator.presets import preset
from physics.simulator.scene_file import load_scene
from physics.sky import Atmosphere, sky_along, sky_radiance, usual_atmosphere
from texnet.pipeline import decompose

LIBRARY = MaterialLibrary.starter()
OUTDOORS = ("forest", "street", "patterned", "patches")
METALS = ("aluminium", "steel", "copper")


def without_sky():
    return LIBRARY.subset([n for n in LIBRARY.names if n != "sky"])


def noise_units(a, b, cube):
    """(len(a), len(b)) root mean square differences of spectra, in the sensor's noise."""
    return np.sqrt((((a[:, None] - b[None]) / cube.sigma) ** 2).mean(axis=-1))


def apart(a, b, cube):
    """How far two spectra are apart, over how far b is from what is not cold in the picture; of the
    bands in which that is much."""
    warm = np.quantile(cube.spectra, 0.7, axis=0)[: len(b)]
    much = warm - b > 0.3 * (warm - b).max()
    return (np.abs(a - b) / (warm - b))[much].max()


# --- is there a sky? ------------------------------------------------------------------------


@pytest.mark.parametrize("name", OUTDOORS)
def test_the_sky_is_found_outdoors(name):
    """Its mean is that of sky pixels among sky pixels; its objects are colder than all others."""
    cube, truth = traced(name)
    e = estimate_environment(cube, LIBRARY)
    assert e.sky and e.sky_mean is not None
    sky = binary_erosion(names_of(truth) == "sky", np.ones((3, 3)), border_value=1)
    assert sky.sum() > 50
    seen = cube.spectra[sky.ravel()].astype(float)
    assert apart(e.sky_mean, seen.mean(axis=0), cube) < 0.15
    level = brightness_temperature(cube.wavelength_um, e.radiance).mean(axis=1)
    others = [j for j in range(len(e)) if j not in e.sky]
    assert level[list(e.sky)].max() < level[others].min()


@pytest.mark.parametrize("bands", [18, 54])
def test_all_of_a_sky_that_fills_most_of_the_picture_is_found(bands):
    """Below its middle, too: the camera looks up."""
    scene = preset("random", 14)
    at, to = np.array(scene.camera.position), np.array(scene.camera.target)
    ahead = (to - at) * (1, 1, 0)
    up = at + ahead + [0, 0, np.linalg.norm(ahead) * np.tan(np.radians(20))]
    scene = replace(scene, camera=replace(scene.camera, target=tuple(up)))
    w, fwhm = equidistant_bands(bands)
    cube, truth = simulate(scene, wavelength_um=w, fwhm_um=fwhm, size=(48, 64), spp=16, seed=14)
    sky = names_of(truth) == "sky"
    assert sky.mean() > 0.75
    found = names_of(decompose(cube)) == "sky"
    assert found[sky].mean() > 0.97 and found[~sky].mean() < 0.05


@pytest.mark.parametrize("name", OUTDOORS)
@pytest.mark.parametrize("last_um", [11.8, 12.4, 13.0])
def test_the_sky_is_found_by_cameras_that_see_no_opaque_band(name, last_um):
    cube, truth = traced(name, 54)
    e = estimate_environment(cube.only(cube.wavelength_um < last_um), LIBRARY)
    whole = estimate_environment(cube, LIBRARY)
    assert len(e.sky) == len(whole.sky)
    assert apart(e.sky_mean, whole.sky_mean[: e.wavelength_um.size], cube) < 0.15


@pytest.mark.parametrize("name", ["forest", "street", "patches"])
def test_a_sky_of_another_shape_is_found(name):
    """30 % brighter and darker, in turns, than any that the model of gases makes."""
    cube, truth = traced(name, 54)
    sky, s = names_of(truth) == "sky", cube.radiance.copy()
    s[:, sky] *= 1 + 0.3 * np.sin(2 * np.pi * (cube.wavelength_um - 8) / 3)[:, None]
    found = Sample(replace(cube, radiance=s), LIBRARY)
    assert found.sky.mean() > 0.1 * sky.mean()


def test_what_is_like_sky_is_none_where_it_lies_among_the_rest():
    """As snow does from straight above; a picture upside down has none either."""
    cube, truth = traced("forest")
    e = estimate_environment(cube, LIBRARY)
    rows = np.random.default_rng(0).permutation(cube.shape[0])
    for order in (rows, np.arange(cube.shape[0])[::-1]):
        turned = replace(cube, radiance=cube.radiance[:, order])
        assert e.sky and not estimate_environment(turned, LIBRARY).sky


@pytest.mark.parametrize("name", OUTDOORS)
@pytest.mark.parametrize("stuck", [False, True])
def test_a_few_pixels_that_are_far_too_hot_light_nothing(name, stuck):
    """A detector's defects; whether they share one value, which then is a ceiling, or not."""
    cube, _ = traced(name)
    rng = np.random.default_rng(0)
    bad, s = rng.random(cube.shape) < 0.01, cube.radiance.copy()
    s[:, bad] = 30.0 if stuck else rng.uniform(27, 33, (cube.bands, np.count_nonzero(bad)))
    a, b = (estimate_environment(c, LIBRARY) for c in (cube, replace(cube, radiance=s)))
    assert a.sky == b.sky
    t, without = (brightness_temperature(cube.wavelength_um, e.radiance) for e in (b, a))
    assert t.max() < without.max() + 2
    # with none left out there is no sky at all
    assert apart(b.sky_mean, a.sky_mean, cube) < 0.08


@pytest.mark.parametrize("centres", [(9.4, 10.4, 13.0), (9.0, 11.0, 13.0), (9.6, 11.0, 13.0)])
def test_the_sky_is_found_through_wide_filters_with_a_strong_line_in_them(centres):
    """Ozone, at 9.6 um, is opaque in its middle; a filter of 2 um around it is nearly clear."""
    centre, width = np.array(centres), np.full(3, 2.0)
    rng = np.random.default_rng(0)
    height = rng.uniform(0.3, 0.9, 600)  # cosines of zenith angles
    warm, grey = rng.normal(297, 2, (600, 1)), rng.uniform(0.9, 1, 600)
    s = np.empty((1200, 3))
    for band, fine in enumerate(quadrature(centre, width)):
        s[:600, band] = sky_radiance(fine, height, Atmosphere(295.0, 3.0)).mean(axis=1)
        s[600:, band] = grey * planck(fine, warm).mean(axis=1)
    s += noise_sigma(centre, 0.025) * rng.normal(size=s.shape)
    cube = HeatCube(s.T.reshape(3, 40, 30), centre, width, 0.025)
    e = estimate_environment(cube, LIBRARY)
    assert e.sky
    np.testing.assert_allclose(e.sky_mean, s[:600].mean(axis=0), rtol=0.05)


def low_sky(atmosphere, low, high):
    """Cube of 24 bands whose upper quarter is sky at these cosines of zenith angles, over grey
    ground about as warm as the air."""
    w, fwhm = equidistant_bands(24)
    rng = np.random.default_rng(0)
    height = rng.uniform(low, high, 300)
    warm = rng.normal(atmosphere.air_temperature_k + 1, 2, (900, 1))
    grey = np.linspace(0.9, 1, 900)
    s = np.empty((1200, len(w)))
    for band, fine in enumerate(quadrature(w, fwhm)):
        s[:300, band] = sky_radiance(fine, height, atmosphere).mean(axis=1)
        s[300:, band] = grey * planck(fine, warm).mean(axis=1)
    s += noise_sigma(w, 0.05) * rng.normal(size=s.shape)
    return HeatCube(s.T.reshape(len(w), 40, 30), w, fwhm, 0.05)


@pytest.mark.parametrize(
    "air_k, water_cm, low, high",
    [(298, 2.5, 0.06, 0.1), (298, 3.0, 0.08, 0.13), (298, 3.5, 0.1, 0.2), (303, 6.0, 0.2, 0.4)],
)
def test_a_humid_sky_low_above_the_horizon_is_found(air_k, water_cm, low, high):
    """Little of B(T_air) is missing in it even where it is clearest; a black wall as warm as the
    air is none."""
    cube = low_sky(Atmosphere(air_k, water_cm), low, high)
    e = estimate_environment(cube, LIBRARY)
    assert e.sky
    np.testing.assert_allclose(e.sky_mean, cube.spectra[:300].mean(axis=0), rtol=0.05)
    wall = np.random.default_rng(1).normal(0, cube.sigma, (10, 30, cube.bands)).T.swapaxes(1, 2)
    wall += planck(cube.wavelength_um, air_k)[:, None, None]
    scene = np.concatenate([wall, cube.radiance[:, 10:]], axis=1)
    assert not estimate_environment(replace(cube, radiance=scene), LIBRARY).sky


@pytest.mark.parametrize("air_k, water_cm", [(265.0, 0.35), (283.0, 1.0), (295.0, 2.0)])
@pytest.mark.parametrize("low, high", [(0.05, 0.1), (0.08, 0.15), (0.2, 0.4)])
def test_the_skies_reach_overhead_from_the_sky_in_view(air_k, water_cm, low, high):
    """However low that lies: in the windows the clearest is clearer than the sky overhead, if not
    by much."""
    atmosphere = Atmosphere(air_k, water_cm)
    cube = low_sky(atmosphere, low, high)
    e = estimate_environment(cube, LIBRARY)
    clearest = e.radiance[list(e.sky)].min(axis=0)
    window = (cube.wavelength_um > 10.2) & (cube.wavelength_um < 12.2)
    overhead = sky_radiance(cube.wavelength_um, np.array([0.6]), atmosphere)[0]
    share = (clearest / overhead)[window].mean()
    assert 0.2 < share < 1, share


@pytest.mark.parametrize("air_k, water_cm", [(275, 0.4), (292, 1.4), (303, 5.0)])
@pytest.mark.parametrize(
    "name, bands",
    [*product(["granite", "sandstone", "brick", "sand", "limestone"], [3, 4, 24]), ("glass", 24)],
)
def test_a_facade_is_no_sky(name, bands, air_k, water_cm):
    """Though it reflects some, and its emissivity has bands as the sky has. (Through four filters
    glass that mirrors nothing but a humid sky looks like one.)"""
    w, fwhm = equidistant_bands(bands)
    rng = np.random.default_rng(0)
    nodes = quadrature(w, fwhm)
    fine, at = np.unique(nodes, return_inverse=True)
    air = Atmosphere(air_k, water_cm)
    x = sky_radiance(fine, np.array([0.5]), air)[0][at].reshape(nodes.shape)
    s = []
    for material in [name, "grass"]:
        e = LIBRARY.subset([material]).at(nodes.ravel())[0].reshape(nodes.shape)
        t_k = rng.normal(air_k + 3, 3, (600, 1, 1))
        s.append((e * planck(nodes, t_k) + (1 - e) * x).mean(axis=2))
    s = np.concatenate(s) + noise_sigma(w, 0.05) * rng.normal(size=(1200, bands))
    cube = HeatCube(s.T.reshape(bands, 40, 30), w, fwhm, 0.05)
    assert not estimate_environment(cube, LIBRARY).sky


@functools.cache
def traced_patches():
    return trace_scene(preset("patches"), (48, 72), 16, 0, LIBRARY)


@pytest.mark.parametrize("bands", [1, 2, 3, 9, 24])
def test_no_sky_indoors(bands):
    cube, _ = traced("room", bands, spp=8)
    for k in (1, 2, 5, 10):
        e = estimate_environment(cube, LIBRARY, k)
        assert e.sky == () and e.sky_mean is None and len(e) == k


def test_no_sky_without_one_in_the_library():
    e = estimate_environment(traced("forest")[0], without_sky(), 5)
    assert e.sky == () and e.sky_mean is None and len(e) == 5


@pytest.mark.parametrize(
    "name, bands",
    [("forest", 24), ("forest", 4), ("street", 9), ("patches", 9), ("patterned", 4),
     ("patterned", 3), ("patterned", 2)],
)  # fmt: skip
def test_no_sky_below_the_horizon(name, bands):
    """A picture of the ground alone has none, though wet ground and bare metal mirror it."""
    cube, truth = traced(name, bands)
    rows = (names_of(truth) == "sky").any(axis=1)
    below = cube.radiance[:, np.flatnonzero(rows).max() + 1 :]
    assert below.shape[1] >= 12
    e = estimate_environment(
        HeatCube(below, cube.wavelength_um, cube.fwhm_um, cube.netd_k), LIBRARY
    )
    assert e.sky == () and e.sky_mean is None


def test_what_mirrors_the_sky_below_is_no_sky():
    """A spectrum of sky in the lower part of the picture is a puddle or a bonnet."""
    cube, _ = traced("forest")
    upside_down = cube.radiance[:, ::-1]
    e = estimate_environment(
        HeatCube(upside_down, cube.wavelength_um, cube.fwhm_um, cube.netd_k), LIBRARY
    )
    assert e.sky == () and e.sky_mean is None


@pytest.mark.parametrize("bands", [4, 9, 54])
def test_sky_between_leaves_is_told_by_how_it_warms_downwards(bands):
    """No ground lies below it; upside down, or in rows of any order, it might be metal."""
    cube, truth = traced("forest", bands, (72, 108))
    leaves, sky = cube.radiance[:, :24], names_of(truth)[:24] == "sky"
    assert 0.2 < sky.mean() < 0.6 and 0.3 < np.argwhere(sky)[:, 0].mean() / 24 < 0.5
    shuffled = np.random.default_rng(0).permutation(24)
    for rows, found in (np.arange(24), 0.8), (np.arange(24)[::-1], 0), (shuffled, 0):
        part = HeatCube(leaves[:, rows], cube.wavelength_um, cube.fwhm_um, cube.netd_k)
        sample = Sample(part, LIBRARY)
        assert sample.sky.sum() >= found * sky.sum() and sample.sky.any() == bool(found)
        e = sample.environment(5)
        if found:
            clear, true = e.sky_mean, leaves[:, sky].mean(axis=1)
            per_kelvin = planck_derivative(cube.wavelength_um, 300.0)
            np.testing.assert_allclose(clear / per_kelvin, true / per_kelvin, atol=4)
        assert bool(e.sky) == bool(found)


@pytest.mark.parametrize("high_um", [12, 13])
def test_sky_may_fill_most_of_the_picture(high_um):
    """Where no band shows how warm its air is: the little below it does."""
    (w, fwhm), rng, wide = equidistant_bands(54, 8, high_um), np.random.default_rng(0), 40
    nodes, air = quadrature(w, fwhm), usual_atmosphere(288.0)
    mass = 1 / np.sin(np.radians(np.linspace(45, 14, 42)))
    sky = band_means(lambda x: sky_along(x, mass, air), nodes)
    e = LIBRARY.of_bands(nodes)[LIBRARY.index("brick")]
    t, v = rng.normal(288, 2, (18 * wide, 1)), rng.uniform(0.2, 0.6, (18 * wide, 1))
    wall = e * planck(w, t) + (1 - e) * (v * sky[0] + (1 - v) * planck(w, 287))
    s = np.concatenate([np.repeat(sky, wide, axis=0), wall])
    s += noise_sigma(w, 0.05) * rng.standard_normal(s.shape)
    found = Sample(HeatCube(s.T.reshape(54, 60, wide), w, fwhm, 0.05), LIBRARY)
    is_sky = found.row < 42 / 60
    assert found.sky[is_sky].mean() > 0.9 and not found.sky[~is_sky].any()


@pytest.mark.parametrize("metal", METALS)
@pytest.mark.parametrize("bands", [4, 9, 54])
def test_plates_of_metal_on_the_ground_are_no_sky(bands, metal):
    """Though they mirror it, and lie rather in the picture's upper half."""
    scene, (w, fwhm) = traced_patches(), equidistant_bands(bands)
    names = names_of(scene.shade(LIBRARY, w, fwhm)[1])
    ground = np.flatnonzero((names == "sky").any(axis=1)).max() + 1
    kinds, count = np.unique(names[ground:], return_counts=True)
    common = str(kinds[count.argmax()])
    materials = {name: metal if name == common else name for name in scene.materials}
    cube, truth = scene.shade(LIBRARY, w, fwhm, 0.05, materials=materials)
    plates = np.argwhere(names_of(truth)[ground:] == metal)[:, 0] / (48 - ground)
    assert len(plates) > 500 and plates.mean() < 0.45
    e = estimate_environment(HeatCube(cube.radiance[:, ground:], w, fwhm, 0.05), LIBRARY)
    assert e.sky == () and e.sky_mean is None


@pytest.mark.parametrize("row", [10, 14, 18])
def test_a_row_of_metal_is_no_sky(row):
    """What differs along a row says nothing of how it warms downwards."""
    scene, (w, fwhm) = traced_patches(), equidistant_bands(9)
    cube, truth = scene.shade(LIBRARY, w, fwhm, 0.05)
    top = np.flatnonzero((names_of(truth) == "sky").any(axis=1)).max() + 1
    ground = cube.radiance[:, top:].copy()
    v = np.linspace(0.5, 1, cube.shape[1])
    sky = cube.radiance[:, names_of(truth) == "sky"].min(axis=1)
    ground[:, row] = sky[:, None] * v + planck(w, 285)[:, None] * (1 - v)
    assert not Sample(HeatCube(ground, w, fwhm, 0.05), LIBRARY).sky.any()


def plain(shape, material, kelvin, **more):
    return dict(mesh=shape, material=material, temperature_k=kelvin, **more)


def seen_across(folder, ground, *objects, bands=20):
    """Cube and truth of a flat ground under the sky, with a rock and other objects on it."""
    flat = plain({"shape": "plane", "size": [1e4, 1e4]}, ground, 287)
    rock = plain({"shape": "box", "size": [2, 2, 2]}, "granite", 290, translate=[-3, 0, 1])
    camera = dict(position=[0, -20, 3], target=[0, 0, 1], fov_deg=30)
    scene = {"camera": camera, "atmosphere": {}, "objects": [flat, rock, *objects]}
    file = folder / "scene.json"
    file.write_text(json.dumps(scene))
    w, fwhm = equidistant_bands(bands)
    return simulate(load_scene(file), wavelength_um=w, fwhm_um=fwhm, size=(48, 64), spp=16)


@pytest.mark.parametrize("mirror", [0, 0.5, 1])
def test_a_clearer_sky_that_metal_mirrors_is_not_in_view(tmp_path, mirror):
    """Though it lies in the upper half of the picture."""
    ball = plain({"shape": "sphere", "radius": 1}, "aluminium", 290, translate=[3, 0, 1])
    skies = []
    for ball_or_none in ([], [ball | {"mirror": mirror}]):
        cube, _ = seen_across(tmp_path, "soil", *ball_or_none)
        sky = estimate_environment(cube, LIBRARY, 5).radiance[:3]
        skies.append(brightness_temperature(cube.wavelength_um, sky))
    np.testing.assert_allclose(*skies, atol=0.3)


@pytest.mark.parametrize("metal", METALS)
@pytest.mark.parametrize("bands", [4, 9, 54])
def test_metal_that_fills_the_ground_is_no_sky(tmp_path, metal, bands):
    """What is below the horizon, and yet clearer than the sky above it, mirrors the sky overhead;
    the sky itself is found as over soil."""
    lawn = plain({"shape": "box", "size": [99, 8, 0.1]}, "grass", 287, translate=[0, -13, 0.05])
    skies, found_above = [], []
    for ground in ("soil", metal):
        cube, truth = seen_across(tmp_path, ground, lawn, bands=bands)
        found = Sample(cube, LIBRARY)
        below = found.row > (names_of(truth) == "sky").any(axis=1).mean()
        assert found.sky[below].mean() < 0.02
        found_above.append(found.sky[~below].mean())
        sky = found.environment(5).radiance[0]
        skies.append(brightness_temperature(cube.wavelength_um, sky))
    assert found_above[1] > 0.8 * found_above[0] > 0.4
    np.testing.assert_allclose(*skies, atol=5)


@pytest.mark.parametrize("bands", [9, 54])
def test_clear_sky_below_a_thin_cloud_is_sky(bands):
    """Though colder than what is above it; the sky overhead is what it is without the cloud."""
    (w, fwhm), rng, rows, wide = equidistant_bands(bands), np.random.default_rng(0), 60, 40
    half = rows * wide // 2
    height = np.repeat(np.sin(np.radians(np.linspace(25, 1, rows // 2))), wide)
    warm, grey = rng.normal(284, 2, (half, 1)), np.linspace(0.9, 1, half)
    s = np.empty((2 * half, bands))
    for band, fine in enumerate(quadrature(w, fwhm)):
        s[:half, band] = sky_radiance(fine, height, Atmosphere(283.0, 1.0)).mean(axis=1)
        s[half:, band] = grey * planck(fine, warm).mean(axis=1)
    noise, overhead = noise_sigma(w, 0.05) * rng.normal(size=s.shape), []
    for cover in (0.0, 0.3):
        shown, cloud = s.copy(), np.s_[: 8 * wide]
        shown[cloud] = (1 - cover) * s[cloud] + cover * planck(w, 270.0)
        found = Sample(
            HeatCube((shown + noise).T.reshape(bands, rows, wide), w, fwhm, 0.05), LIBRARY
        )
        assert found.sky[found.row < 0.5].mean() > 0.85 and not found.sky[found.row > 0.5].any()
        overhead.append(brightness_temperature(w, found.environment(5).radiance[0]))
    np.testing.assert_allclose(*overhead, atol=2)


@pytest.mark.parametrize("air_k, water_cm", [(265.0, 0.35), (283.0, 1.0)])
def test_leaves_before_the_sky_do_not_change_the_sky_overhead(air_k, water_cm):
    """Pixels of sky that are partly something else lie beside what is no sky at all."""
    cube = low_sky(Atmosphere(air_k, water_cm), 0.1, 0.4)
    edge = cube.radiance.copy()
    share = np.random.default_rng(2).uniform(0.05, 0.3, 30)
    edge[:, 9] = (1 - share) * edge[:, 9] + share * edge[:, 20]
    without, leaves = (
        brightness_temperature(cube.wavelength_um, estimate_environment(c, LIBRARY).radiance[0])
        for c in (cube, replace(cube, radiance=edge))
    )
    assert np.abs(leaves - without).max() < 2


def test_true_sky_comes_out_as_sky():
    """With 29 other materials to mistake it for, a mirror (metal) first of all."""
    mirrors = []
    for name in OUTDOORS:
        cube, truth = traced(name)
        answer = names_of(decompose(cube, LIBRARY, method="local"))
        sky = names_of(truth) == "sky"
        assert sky.sum() > 50
        assert (answer[sky] == "sky").mean() >= 0.8
        # at its edge, and through gaps in a canopy, a pixel may be half sky; elsewhere none is
        inner = binary_erosion(sky, np.ones((3, 3)), border_value=1)
        mirrors.append(np.isin(answer[inner], METALS))
        ground = ~binary_dilation(sky, np.ones((3, 3)))
        assert (answer[ground] == "sky").mean() < 0.05
    assert np.concatenate(mirrors).mean() < 0.02


def test_how_far_down_a_pixel_lies_is_told_of_what_was_measured_of_its_column():
    dead = np.arange(12)[:, None] < np.array([0, 4, 8])  # as of a strip that is askew
    top, bottom = np.array([0, 4 * 3 + 1, 8 * 3 + 2]), 11 * 3 + np.arange(3)
    np.testing.assert_allclose(_row(dead, top), 0)
    np.testing.assert_allclose(_row(dead, bottom), 1 - 1 / np.array([12, 8, 4]))


def test_principal_deviations_have_the_covariance_of_all_but_noise():
    rng = np.random.default_rng(0)
    skies = rng.normal(size=(4000, 3)) * (7, 4, 2) @ np.linalg.qr(rng.normal(size=(12, 3)))[0].T
    found = _principal(skies, 0.0)
    np.testing.assert_allclose(found.T @ found, skies.T @ skies / len(skies), atol=1e-9)
    noisy = _principal(skies + rng.normal(size=skies.shape), 1.0)
    np.testing.assert_allclose(noisy.T @ noisy, found.T @ found, atol=1)


# --- the objects ------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["forest", "room"])
@pytest.mark.parametrize("k", range(1, 11))
def test_as_many_objects_as_asked(name, k):
    cube, _ = traced(name)
    e = estimate_environment(cube, LIBRARY, k)
    assert e.radiance.shape == (k, cube.bands)
    assert (e.radiance > 0).all() and np.isfinite(e.spread).all()
    assert len(e.sky) < k  # what is not sky lights every scene too
    distance = noise_units(e.radiance, e.radiance, cube) + 1e9 * np.eye(k)
    assert distance.min() > 1  # no object twice
    seen_k = brightness_temperature(cube.wavelength_um, cube.spectra).mean(axis=1)
    hottest = planck(cube.wavelength_um, seen_k.max() + 20)
    assert (e.radiance < hottest).all()


def test_the_seed_decides():
    cube, _ = traced("street")
    a, b = (estimate_environment(cube, LIBRARY, 6, seed=3) for _ in range(2))
    for field in ("radiance", "spread", "sky_mean", "sky_spread"):
        np.testing.assert_array_equal(getattr(a, field), getattr(b, field))
    large = HeatCube(np.tile(cube.radiance, (2, 2)), cube.wavelength_um, netd_k=cube.netd_k)
    sample, other = (Sample(large, LIBRARY, seed) for seed in (3, 4))
    assert not np.array_equal(sample.spectra, other.spectra)


@pytest.mark.parametrize("name", OUTDOORS)
def test_the_order_of_pixels_does_not_matter_to_what_is_sky(name):
    """Shuffled columns: the same set of spectra. (The sky overhead asks for neighbours.)"""
    cube, _ = traced(name)
    order = np.random.default_rng(0).permutation(cube.shape[1])
    shuffled = replace(cube, radiance=cube.radiance[:, :, order])
    a, b = (estimate_environment(c, LIBRARY, 5) for c in (cube, shuffled))
    assert a.sky == b.sky
    for field in ("sky_mean", "sky_spread", "spread"):
        np.testing.assert_allclose(getattr(a, field), getattr(b, field), rtol=1e-5, atol=1e-7)
    ground = len(a.sky)
    np.testing.assert_allclose(a.radiance[ground:], b.radiance[ground:], rtol=1e-6)


@pytest.mark.parametrize("name", OUTDOORS)
def test_a_mirror_image_has_the_same_environment(name):
    cube, _ = traced(name)
    mirrored = replace(cube, radiance=cube.radiance[:, :, ::-1])
    a, b = (estimate_environment(c, LIBRARY, 5) for c in (cube, mirrored))
    assert a.sky == b.sky
    np.testing.assert_allclose(a.radiance, b.radiance, rtol=1e-6)


@pytest.mark.parametrize(
    "fields, word",
    [
        (dict(k=0), "at least 1"),
        (dict(k=2.0), "whole number"),
    ],
)
def test_wrong_k(fields, word):
    with pytest.raises(InputError, match=word):
        estimate_environment(traced("forest")[0], LIBRARY, **fields)


def test_dead_bands_are_refused():
    cube, _ = traced("forest")
    dead = HeatCube(np.where(np.arange(cube.bands)[:, None, None] == 3, np.nan, cube.radiance),
                    cube.wavelength_um, cube.fwhm_um, 0.05)  # fmt: skip
    with pytest.raises(InputError, match="without_bad_bands"):
        estimate_environment(dead, LIBRARY, 2)


def test_more_objects_than_pixels():
    cube, _ = traced("forest")
    crop = HeatCube(cube.radiance[:, :2, :3], cube.wavelength_um, cube.fwhm_um, 0.05)
    assert len(estimate_environment(crop, without_sky(), 6)) == 6
    with pytest.raises(InputError, match="k = 7 .* 7 pixels"):
        estimate_environment(crop, LIBRARY, 7)
    s = crop.radiance.copy()
    s[:, 0, 0] = planck(crop.wavelength_um, 900.0)  # a fire is a pixel, too
    assert 2 <= len(estimate_environment(replace(crop, radiance=s), without_sky(), 6)) <= 6


def test_a_sky_that_was_measured_suits_a_single_pixel():
    cube, _ = traced("forest")
    one = HeatCube(cube.radiance[:, -1:, :1], cube.wavelength_um, cube.fwhm_um, 0.05)
    sky = estimate_environment(cube, LIBRARY).radiance[:1]
    e = completed(Environment(sky, cube.wavelength_um, sky=(0,)), one, LIBRARY)
    np.testing.assert_array_equal(e.radiance[0], sky[0])
    assert len(e) == 2 and e.sky == (0,) and e.sky_mean is None


@pytest.mark.parametrize("name", ["forest", "room"])
def test_spectra_alone_get_the_scatter_of_the_cubes_own_pixels(name):
    cube, _ = traced(name)
    own = estimate_environment(cube, LIBRARY, 3)
    spectra = Environment(own.radiance, own.wavelength_um, own.sky)
    e = completed(spectra, cube, LIBRARY)
    np.testing.assert_array_equal(e.radiance, own.radiance)
    np.testing.assert_allclose(e.spread, own.spread)
    assert len(e.spread) and e.error_k == own.error_k > 0
    assert (e.sky_mean is None) == (name == "room")


def test_what_is_said_to_be_exact_or_off_is_believed():
    cube, _ = traced("room")
    own = estimate_environment(cube, LIBRARY, 3)
    exact = Environment(own.radiance, own.wavelength_um, error_k=0.0)
    assert completed(exact, cube, LIBRARY) is exact
    assert completed(own, cube, LIBRARY) is own
    off = Environment(own.radiance, own.wavelength_um).off_by(3.0)
    assert len(completed(off, cube, LIBRARY).spread) == len(off.spread) + len(own.spread)


# --- distillation -----------------------------------------------------------------------------


class Distilled:
    """Pixels of grass and metal by Eq. 1 under k = 3 objects, the first two being sky."""

    def __init__(self, sky=(0, 1), spread=None, off=None, netd=0.05, noise=False, skylight=None):
        rng = np.random.default_rng(0)
        self.w = w = np.linspace(8.2, 13.8, 20)
        s = np.stack([0.4 * planck(w, 250.0), 0.6 * planck(w, 265.0), planck(w, 288.0)])
        in_view = s[list(sky)].mean(axis=0) if sky else None
        self.environment = Environment(s, w, sky, spread, skylight, sky_mean=in_view)
        self.library = LIBRARY.subset(["grass", "aluminium", "sky"])
        cube = HeatCube(np.broadcast_to(s[2][:, None, None], (20, 4, 5)), w, netd_k=netd)
        self.model = reduce_model(cube, self.library, self.environment)
        material = np.r_[np.zeros(10, int), np.ones(10, int)]
        pure = self.model.sky_share == 0
        self.row = np.array(
            [np.flatnonzero(pure & (self.model.material == m))[0] for m in material]
        )
        self.t = rng.uniform(280, 300, 20)
        self.v = rng.dirichlet(np.ones(3), 20)
        self.texture = self.v @ s + (0 if off is None else off)
        e = self.model.emissivity[self.row]
        self.spectra = e * planck(w, self.t[:, None]) + (1 - e) * self.texture
        if noise:
            self.spectra = self.spectra + rng.normal(size=(20, 20)) * noise_sigma(w, netd)

    def __call__(self, lighting=None, row=None):
        lighting = self.v if lighting is None else np.broadcast_to(lighting, (20, 3))
        row = self.row if row is None else row
        return distill(self.model, self.spectra, row, self.t, lighting, threads=1)


def test_only_the_sky_is_left_to_shine():
    """X_sky is V_j S_j of the sky's objects, as a band mean; the ground's light is switched off."""
    d = Distilled()
    means = d.environment.radiance.mean(axis=1)
    for lighting, expected in [
        ([1, 0, 0], means[0]), ([0, 1, 0], means[1]), ([0, 0, 1], 0), ([0, 0, 0], 0),
        ([0.3, 0.2, 0.5], 0.3 * means[0] + 0.2 * means[1]),
    ]:  # fmt: skip
        np.testing.assert_allclose(d(lighting)[1], expected, rtol=1e-6, atol=1e-9)


def test_where_no_sky_shines_its_deviation_does_not_either():
    direction = 0.1 * planck(np.linspace(8.2, 13.8, 20), 250.0)
    d = Distilled(skylight=direction[None], off=direction)
    np.testing.assert_array_equal(d([0, 0, 1])[1], 0)
    assert (np.abs(d([0.5, 0, 0.5])[1] - 0.5 * d.environment.radiance[0].mean()) > 1e-3).any()


def test_sky_pixels_have_no_texture():
    d = Distilled()
    row = d.row.copy()
    row[::2] = np.flatnonzero(d.model.sky_share == 1.0)[0]
    texture, lit, _ = d(row=row)
    assert (texture[::2] == 0).all() and (lit[::2] == 0).all()
    assert (texture[1::2] > 0).all() and (lit[1::2] > 0).all()


def test_the_truth_leaves_no_residual():
    d = Distilled()
    texture, _, residual = d()
    np.testing.assert_allclose(texture, d.texture, rtol=1e-6)
    # Planck's law is a series there
    np.testing.assert_allclose(residual, 0, atol=SERIES_TOLERANCE)
    noisy = Distilled(noise=True)()[2]
    assert np.sqrt((noisy**2).mean()) == pytest.approx(1, abs=5 / np.sqrt(2 * 400))


def test_without_sky_the_residual_is_the_texture():
    d = Distilled(sky=(), noise=True)
    _, shown, residual = d()
    np.testing.assert_array_equal(shown, residual)


def test_true_surroundings_off_the_spectra_return_to_the_texture():
    """A deviation along `spread` is put back into X where the pixel reflects enough to see it."""
    w = np.linspace(8.2, 13.8, 20)
    direction = 0.1 * planck(w, 288.0) * np.sin(2 * w)
    d = Distilled(spread=direction[None], off=direction)
    texture, _, residual = d()
    mirrors = slice(10, 20)
    off = np.abs(texture - d.texture).max(axis=1) / np.abs(direction).max()
    assert off[mirrors].max() < 0.05
    assert residual[mirrors].max() < 0.3
    blind = Distilled(off=direction)()
    assert (np.abs(blind[0] - d.texture).max(axis=1)[mirrors] > 0.9 * np.abs(direction).max()).all()
    assert (blind[2][mirrors] > 3).all()


def test_an_estimate_keeps_no_cube():
    """A large one lies in a file, which goes with it."""
    cube = replace(traced("forest")[0])
    gc.disable()
    try:
        alive = weakref.ref(cube)
        estimate_environment(cube, LIBRARY, 3)
        del cube
        assert alive() is None
    finally:
        gc.enable()
