"""The noise that a cube's own pixels show, where the picture is a scene's."""

from dataclasses import replace

import numpy as np
import pytest
from traced import traced

from physics import HeatCube, InputError
from physics.planck import noise_sigma, radiance
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
    assert 0.11 < replace(cube, radiance=striped).with_netd().netd_k < 0.15


@pytest.mark.parametrize("shape", [(1, 60), (60, 1), (3, 40), (2, 2)])
def test_any_shape_of_enough_pixels_will_do(shape):
    w = np.linspace(8.5, 13.5, 2)
    s = np.full((2, *shape), radiance(w, 290.0)[:, None, None])
    s += noise_sigma(w, 0.1)[:, None, None] * np.random.default_rng(0).normal(size=s.shape)
    cube = HeatCube(s, w)
    if shape == (2, 2):
        with pytest.raises(InputError, match="twice as many measured pixels as bands"):
            HeatCube(s[:, :1], w).with_netd()
    else:
        assert cube.with_netd().netd_k == pytest.approx(0.1, rel=0.35)
