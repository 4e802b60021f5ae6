"""Under a cloud: the light it throws, and what is said of a scene below it."""

import functools
import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.ndimage import binary_dilation, binary_erosion
from traced import names_of, one_thread, scene_of  # noqa: F401

from physics import HeatCube, MaterialLibrary
from physics.bands import band_means, equidistant_bands, quadrature
from physics.blind import library_from_cube
from physics.errors import InputError
from physics.estimate import Sample
from physics.planck import noise_sigma, planck, planck_derivative
from physics.simulator import trace_scene
from physics.sky import LAPSE_K_KM, Atmosphere, level_transmittance, sky_radiance
from texnet.pipeline import decompose

LIBRARY = MaterialLibrary.starter()
W = np.linspace(7.5, 14.5, 71)
COSINES = np.linspace(0, 1, 11)


@pytest.mark.parametrize("air", [Atmosphere(262.0, 0.3), Atmosphere(), Atmosphere(300.0, 4.0)])
def test_a_cloud_on_the_ground_is_a_black_body_as_warm_as_the_air(air):
    sky = sky_radiance(W, COSINES, replace(air, cloud_base_km=0.0))
    expected = planck(W, air.air_temperature_k)
    np.testing.assert_allclose(sky, np.broadcast_to(expected, sky.shape), rtol=1e-12)


def test_the_lower_a_cloud_the_more_light_and_all_more_than_of_the_clear_sky():
    heights = [*np.linspace(0, 11, 23), math.inf]
    skies = [sky_radiance(W, COSINES, Atmosphere(cloud_base_km=h)) for h in heights]
    for lower, higher in zip(skies, skies[1:], strict=False):
        assert (lower >= higher * (1 - 1e-12)).all()
    window = (W > 10.2) & (W < 12.2)
    assert all((a[:, window] > b[:, window]).all() for a, b in zip(skies, skies[1:], strict=False))


@pytest.mark.parametrize("km", [0.7, 3.0, 9.0])
def test_through_no_air_the_cloud_itself_is_seen(km):
    """Where methane and nitrous oxide, which stay, hardly absorb."""
    w = np.linspace(9.7, 10.2, 11)
    air = Atmosphere(288.0, water_cm=0.0, ozone_du=0.0, co2_ppm=0.0, cloud_base_km=km)
    seen = sky_radiance(w, [1.0, 0.3], air)
    np.testing.assert_allclose(seen, planck(w, 288.0 - LAPSE_K_KM * km)[None].repeat(2, 0), 1e-4)


def test_an_isothermal_layer_below_it_adds_its_share():
    """S = B(T) (1 - t) + B(T_cloud) t for air so low that it is of one temperature."""
    metres, air = 10.0, Atmosphere(288.0, 2.0)
    t = level_transmittance(W, metres, air)
    expected = planck(W, 288.0) * (1 - t) + planck(W, 288.0 - LAPSE_K_KM * metres / 1e3) * t
    low = replace(air, cloud_base_km=metres / 1e3)
    # depth is taken to grow evenly within the lowest 30 m
    np.testing.assert_allclose(sky_radiance(W, [1.0], low)[0], expected, rtol=1e-3)


@functools.cache
def overcast(name, base_km, bands=54):
    """(HeatCube, names, T) of a path-traced preset under a cloud so high."""
    traced = _traced(name)
    air = replace(traced.atmosphere, cloud_base_km=base_km)
    cube, truth = replace(traced, atmosphere=air).shade(LIBRARY, *equidistant_bands(bands), 0.05)
    return cube, names_of(truth), truth.temperature_k


@functools.cache
def _traced(name):
    return trace_scene(scene_of(name), (48, 72), 16, 0, LIBRARY)


@pytest.mark.parametrize("name", ["forest", "street", "patches"])
@pytest.mark.parametrize("bands", [9, 54])
@pytest.mark.parametrize("base_km", [3.0, 4.0, 7.0])
def test_an_overcast_sky_is_found(name, bands, base_km):
    cube, names, _ = overcast(name, base_km, bands)
    d = decompose(cube, method="local")
    found, sky = names_of(d) == "sky", names == "sky"
    inner, outer = binary_erosion(sky, np.ones((3, 3))), ~binary_dilation(sky, np.ones((3, 3)))
    assert inner.sum() > 50
    assert found[inner].mean() > 0.75 and found[outer].mean() < 0.05
    assert len(d.sky) > 0 and not d.sky_assumed


@pytest.mark.parametrize("name", ["forest", "street"])
@pytest.mark.parametrize(
    ("base_km", "bands"),
    [*product((2.0, 4.0, math.inf), (9, 54)), (7.0, 54)],
)
def test_the_sky_overhead_is_that_of_the_cloud(name, base_km, bands):
    cube, *_ = overcast(name, base_km, bands)
    sample = Sample(cube, LIBRARY)
    assert sample.overcast == (base_km < math.inf)
    zenith = sample.environment(5).radiance[0]
    air = replace(_traced(name).atmosphere, cloud_base_km=base_km)
    nodes = quadrature(cube.wavelength_um, cube.fwhm_um)
    (true,) = band_means(lambda w: sky_radiance(w, [1.0], air), nodes)
    off = (zenith - true) / planck_derivative(cube.wavelength_um, 300.0)
    assert np.sqrt(np.mean(off**2)) < 4  # 15 K and more with a clear sky's air


@pytest.mark.parametrize("name", ["forest", "street"])
@pytest.mark.parametrize("base_km", [0.5, 1.5, 3.0, 7.0])
@pytest.mark.parametrize("method", ["net+sgd", "local"])
def test_below_a_cloud_temperature_and_its_sigma_are_right(name, base_km, method):
    """Though a low cloud looks like a cold wall, and is called something else."""
    cube, names, t = overcast(name, base_km)
    d = decompose(cube, method=method)
    ground = names != "sky"
    off = np.abs(d.temperature_k - t)[ground]
    assert off.mean() < 0.7
    assert (off < 2 * d.temperature_sigma_k[ground]).mean() > 0.9


def test_lines_of_the_sky_do_not_hide_it():
    """In bands of 6 cm-1, as an interferometer has them, a sky shows lines that no model here
    has; all else is as smooth as ever."""
    rng, rows, wide = np.random.default_rng(0), 40, 50
    nu = np.linspace(775, 1250, 84)[::-1]
    w = 1e4 / nu
    fwhm = 7 * w**2 / 1e4
    height, air = np.sin(np.radians(np.linspace(35, 2, 12))), Atmosphere(288.0, 1.4)
    glow = planck(w, 288.0)
    depth = -np.log1p(-sky_radiance(w, height, air) / glow)
    lines = np.exp(rng.normal(-0.03, 0.25, len(w)))  # of each band's optical depth
    sky = glow * -np.expm1(-depth * lines)
    e = LIBRARY.at(w)[[LIBRARY.index(n) for n in ("grass", "soil", "concrete", "bark")]]
    of = e[rng.integers(4, size=(7, 10))].repeat(4, axis=0).repeat(5, axis=1)
    t = rng.normal(287, 2, (28, wide, 1))
    v = rng.uniform(0.3, 1, t.shape)
    overhead = glow * -np.expm1(-depth[0] * lines)
    ground = of * planck(w, t) + (1 - of) * (v * overhead + (1 - v) * planck(w, 287.0))
    s = np.concatenate([sky[:, None].repeat(wide, axis=1), ground])
    s += 0.1 * (planck(w, 300.5) - planck(w, 299.5)) * rng.normal(size=s.shape)
    found = Sample(HeatCube(np.moveaxis(s, -1, 0), w, fwhm, 0.1), LIBRARY)
    above = found.row * (rows - 1) < 12 - 0.5
    assert found.sky[above].mean() > 0.8 and found.sky[~above].mean() < 0.02


@pytest.mark.parametrize("bands", [1, 2, 3, 5, 9, 10, 16, 40])
@pytest.mark.parametrize("apart_cm", [1.0, 4.0])
def test_few_narrow_bands_of_grey_ground_are_no_sky(bands, apart_cm):
    w = 1e4 / (1000 - apart_cm * np.arange(bands))
    rng = np.random.default_rng(0)
    e, t = rng.uniform(0.85, 1, (30, 40, 1)), rng.normal(288, 3, (30, 40, 1))
    s = e * planck(w, t) + noise_sigma(w, 0.05) * rng.normal(size=(30, 40, bands))
    cube = HeatCube(np.moveaxis(s, -1, 0), w, apart_cm * w**2 / 1e4, 0.05)
    assert not Sample(cube, LIBRARY).sky.any()


def test_no_library_is_made_below_a_cloud():
    with pytest.raises(InputError, match="the sky in the cube is overcast"):
        library_from_cube(overcast("forest", 3.0)[0])
