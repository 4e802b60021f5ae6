"""The noise that a cube's own pixels show, where the picture is a scene's."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter1d
from traced import scene_of, traced

from physics import HeatCube, InputError
from physics.bands import equidistant_bands
from physics.cube.netd import estimated_netd, noise_of_bands
from physics.planck import noise_sigma, planck
from physics.simulator import simulate
from physics.simulator.sensor import add_noise


def noisy(name, bands, netd_k, seed=0):
    cube = traced(name, bands, (72, 96))[0]
    clean = cube.radiance.astype(np.float64)
    # its own noise of 50 mK stays; what is added makes it netd_k
    more = np.sqrt(netd_k**2 - cube.netd_k**2)
    s = add_noise(clean, cube.wavelength_um, more, np.random.default_rng(seed))
    return HeatCube(s, cube.wavelength_um, cube.fwhm_um)


@pytest.mark.parametrize("name", ["forest", "street", "room"])
@pytest.mark.parametrize("bands, most", [(3, 2.0), (4, 1.4), (8, 1.15), (12, 1.1), (54, 1.05)])
def test_texture_does_not_pass_for_noise(name, bands, most):
    assert 0.95 < noisy(name, bands, 0.1).with_netd().netd_k / 0.1 < most


@pytest.mark.parametrize("bands", [8, 54])
def test_bands_of_other_noise_count_by_their_median(bands):
    cube = noisy("forest", bands, 0.1)
    rng, off = np.random.default_rng(1), np.zeros(bands)
    off[::4] = 0.3
    sigma = noise_sigma(cube.wavelength_um, off)[:, None, None]
    worse = cube.radiance + sigma * rng.standard_normal(cube.radiance.shape)
    netd_k = replace(cube, radiance=worse).with_netd().netd_k
    assert netd_k == pytest.approx(0.1, rel=0.2)


def test_stripes_count_as_noise():
    """Columns that are off by as much as the noise, each band by itself."""
    cube = noisy("patterned", 36, 0.1)
    off = np.random.default_rng(1).normal(size=(36, 1, cube.shape[1]))
    striped = cube.radiance + off * noise_sigma(cube.wavelength_um, 0.1)[:, None, None]
    assert 0.11 < replace(cube, radiance=striped).with_netd().netd_k < 0.16


def black(shape, bands, seed=0):
    """A cube of noise of 0.1 K alone."""
    w = np.linspace(8.5, 13.5, bands)
    s = np.full((bands, *shape), planck(w, 290.0)[:, None, None])
    s += noise_sigma(w, 0.1)[:, None, None] * np.random.default_rng(seed).normal(size=s.shape)
    return HeatCube(s, w)


@pytest.mark.parametrize("bands", [2, 9, 54])
@pytest.mark.parametrize("shape", [(1, 1200), (1200, 1), (2, 600), (30, 40)])
def test_any_shape_will_do(shape, bands):
    assert black(shape, bands).with_netd().netd_k == pytest.approx(0.1, rel=0.1)


def test_of_one_band_it_is_how_a_pixel_differs_from_those_above_and_below():
    assert black((150, 100), 1).with_netd().netd_k == pytest.approx(0.1, rel=0.05)


def test_too_few_pixels_are_refused():
    with pytest.raises(InputError, match="twice as many measured pixels as bands"):
        black((1, 3), 2).with_netd()


@pytest.mark.parametrize("bands", [9, 54])
@pytest.mark.parametrize("times", [1.4, 2])
def test_pixels_that_stand_twice_are_not_calm(bands, times):
    """As in a picture that was orthorectified by the nearest neighbour."""
    cube = noisy("forest", bands, 0.1)
    row, column = (np.arange(int(times * n)) / times for n in cube.shape)
    s = cube.radiance[:, row.astype(int)][:, :, column.astype(int)]
    assert HeatCube(s, cube.wavelength_um).with_netd().netd_k == pytest.approx(0.1, rel=0.2)


@pytest.mark.parametrize("width", [0.7, 1.0, 1.5])
@pytest.mark.parametrize("netd", [0.05, 0.2])
@pytest.mark.parametrize("name", ["forest", "patches"])
def test_noise_that_neighbouring_bands_share_is_noise(name, netd, width):
    """An interferometer's spectra, apodised, or with more bands than it resolves."""
    w, fwhm = equidistant_bands(54)
    clean = simulate(
        scene_of(name), wavelength_um=w, fwhm_um=fwhm, size=(72, 96), spp=8, netd_k=0.0
    )[0]
    alone = np.random.default_rng(0).standard_normal(clean.radiance.shape)
    shared = gaussian_filter1d(alone, width, axis=0, mode="wrap")
    shared *= noise_sigma(w, netd)[:, None, None] / shared.std()
    apodised = HeatCube(clean.radiance + shared, w, fwhm)
    assert apodised.with_netd().netd_k == pytest.approx(netd, rel=0.15)


def test_a_picture_that_is_mostly_holes_will_do():
    cube = noisy("forest", 54, 0.1)
    s = cube.radiance.copy()
    s[:, np.random.default_rng(0).random(cube.shape) < 0.75] = 0
    assert HeatCube(s, cube.wavelength_um).with_netd().netd_k == pytest.approx(0.1, rel=0.1)


@pytest.mark.parametrize("step", [2, 3])
@pytest.mark.parametrize("bands", [9, 36])
def test_a_picture_without_whole_squares_will_do(bands, step):
    """As of a mosaic, of which one pixel in each cell sees these bands."""
    cube = noisy("forest", bands, 0.1)
    dead = np.ones(cube.shape, bool)
    dead[::step, ::step] = False
    mosaic = HeatCube(cube.radiance, cube.wavelength_um, cube.fwhm_um, dead=dead)
    assert mosaic.with_netd().netd_k == pytest.approx(0.1, rel=0.1)


@pytest.mark.parametrize("share, of_values", [(0.003, False), (0.0005, True)])
def test_defective_pixels_are_not_the_noise(share, of_values):
    """Each may be anything in each band, or now and then be twice what it should in one."""
    cube, rng = noisy("forest", 36, 0.06), np.random.default_rng(2)
    s = cube.radiance.copy()
    if of_values:
        s[rng.random(s.shape) < share] *= 2
    else:
        defective = rng.random(cube.shape) < share
        s[:, defective] = rng.uniform(0.1, 30, (36, np.count_nonzero(defective)))
    assert replace(cube, radiance=s).with_netd().netd_k == pytest.approx(0.06, rel=0.25)


@pytest.mark.parametrize(("shape", "bands"), [((9, 12), 54), ((10, 20), 100)])
def test_two_pixels_a_band_will_do(shape, bands):
    w = np.linspace(8, 14, bands)
    s = np.broadcast_to(planck(w, 290.0)[:, None, None], (bands, *shape))
    noise = noise_sigma(w, 0.05)[:, None, None]
    s = s + noise * np.random.default_rng(0).normal(size=s.shape)
    assert HeatCube(s, w).with_netd().netd_k == pytest.approx(0.05, rel=0.15)


@pytest.mark.parametrize("alike", [False, True])
@pytest.mark.parametrize("pixels", [120, 300, 1500])
def test_noise_of_few_pixels_is_not_overstated(pixels, alike):
    d = np.random.default_rng(0).normal(size=(pixels, 54)) * np.sqrt(2)
    noise = np.median(noise_of_bands(d, np.zeros(pixels), alike))
    assert noise == pytest.approx(1.0, rel=0.05)


@pytest.mark.parametrize("netd_k", [0.05, 0.5])
def test_noise_of_one_band_over_an_even_picture(netd_k):
    s = np.full((1, 150, 150), planck(10.0, 290.0))
    s = add_noise(s, [10.0], netd_k, np.random.default_rng(0))
    assert estimated_netd(HeatCube(s, [10.0])) == pytest.approx(netd_k, rel=0.04)
