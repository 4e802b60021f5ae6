"""Saturated pixels are found, said to be unknown, and no other pixel is."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from traced import one_thread, said, traced  # noqa: F401

from physics import HeatCube
from physics.cube.bad_bands import without_bad_bands
from physics.cube.netd import estimated_netd
from physics.cube.saturation import saturated
from physics.planck import noise_sigma, planck
from physics.simulator.sensor import add_noise
from texnet.files.cube_io import write_cube
from texnet.pipeline import decompose


def clipped(cube, share, bands=slice(None)):
    """A cube whose bands show no more than what so large a share of the pixels exceeds."""
    s = cube.radiance.copy()
    most = np.quantile(s[bands], 1 - share, axis=(1, 2), keepdims=True).astype(np.float32)
    beyond = (s[bands] >= most).any(axis=0)
    s[bands] = np.minimum(s[bands], most)
    return HeatCube(s, cube.wavelength_um, cube.fwhm_um, cube.netd_k), beyond


@pytest.mark.parametrize("share", [0.01, 0.1, 0.6])
@pytest.mark.parametrize("bands", [slice(None), slice(20, 23)])
def test_they_and_no_other_are_found(share, bands):
    cube = traced("forest", 54)[0]
    assert not saturated(cube).any()
    spoilt, beyond = clipped(cube, share, bands)
    np.testing.assert_array_equal(saturated(spoilt), beyond)


def test_a_small_hot_target_is_found():
    cube = traced("forest", 54)[0]
    s = cube.radiance.copy()
    rng = np.random.default_rng(0)
    s[:, 30:34, 30:33] = planck(cube.wavelength_um[:, None, None], rng.uniform(500, 600, (4, 3)))
    most = planck(cube.wavelength_um, 340.0)[:, None, None]
    spoilt = HeatCube(np.minimum(s, most), cube.wavelength_um, cube.fwhm_um, cube.netd_k)
    found = saturated(spoilt)
    assert found[30:34, 30:33].all() and found.sum() == 12


@settings(max_examples=30)
@given(st.integers(0, 999), st.integers(8, 16), st.floats(0.02, 20.0))
def test_a_camera_of_few_digits_is_not_saturated(seed, bits, spread_k):
    """Whose values repeat, the brightest among them, but do not pile up at the top."""
    w = np.linspace(8, 14, 5)
    rng = np.random.default_rng(seed)
    t = 290 + spread_k * rng.standard_normal((60, 80))
    s = planck(w[:, None, None], t)
    s = s + rng.standard_normal(s.shape) * noise_sigma(w, 0.05)[:, None, None]
    step = 20 / 2**bits
    assert not saturated(HeatCube(np.round(s / step) * step, w, np.zeros(5), 0.05)).any()


def test_values_that_are_all_as_frequent_are_no_pile():
    s = np.repeat(np.linspace(7, 8, 40), 12).reshape(1, 20, 24)
    assert not saturated(HeatCube(s, [10.0], None, 0.05)).any()
    s[s > 7.85] = s.max()
    assert saturated(HeatCube(s, [10.0], None, 0.05)).sum() == np.count_nonzero(s == s.max())


def test_what_has_few_values_is_not_saturated():
    """Two plates without noise: no camera's picture."""
    w = np.linspace(8, 14, 5)
    t = np.full((40, 50), 300.0)
    t[:5] = 280.0
    assert not saturated(HeatCube(planck(w[:, None, None], t), w, np.zeros(5), 0.05)).any()


def test_what_is_dead_is_not_saturated():
    """Though it holds what its neighbours do, which are."""
    spoilt, beyond = clipped(traced("forest", 54)[0], 0.1)
    dead = beyond & (np.arange(beyond.shape[1]) % 4 == 0)
    some_dead = HeatCube(spoilt.radiance, spoilt.wavelength_um, spoilt.fwhm_um, 0.05, dead)
    assert dead.any()
    np.testing.assert_array_equal(saturated(some_dead), beyond & ~dead)


@pytest.mark.parametrize("method", ["local", "net+sgd"])
def test_their_temperature_is_called_unknown(method):
    cube = traced("forest", 54)[0]
    spoilt, beyond = clipped(cube, 0.1)
    d = decompose(spoilt, method=method, k=3)
    assert d.unknown[beyond].all()
    np.testing.assert_array_equal(d.saturated, beyond)
    assert d.temperature_sigma_k[beyond].min() > 15
    assert d.unknown[~beyond].mean() < 0.5
    assert np.median(d.temperature_sigma_k[~beyond]) < 2


def test_the_command_says_how_many(tmp_path, capsys):
    cube, beyond = clipped(traced("forest", 54)[0], 0.1)
    write_cube(cube, tmp_path / "cube.npz")
    text, result, npz = said(capsys, tmp_path / "cube.npz", tmp_path / "out", "--method", "local")
    assert f"Saturated    {100 * beyond.mean():.1f} % of the pixels" in text
    assert result["saturated"] == pytest.approx(beyond.mean())
    np.testing.assert_array_equal(npz["saturated"], beyond)


@pytest.mark.parametrize("bands", [24, 1])
def test_a_ceiling_is_not_taken_for_a_calm_picture(bands):
    """Where half of the pixels of each band show one value, none is as noisy as it is calm."""
    cube = traced("forest", 24)[0]
    noisy = add_noise(cube.radiance, cube.wavelength_um, 0.2, np.random.default_rng(0))
    noisy = HeatCube(noisy[:bands], cube.wavelength_um[:bands], cube.fwhm_um[:bands])
    spoilt, _ = clipped(noisy, 0.5)
    # of one band the picture's own unrest passes for noise, the calmer half or not
    assert 0.18 < estimated_netd(spoilt) < (0.26 if bands > 1 else 2.0)
    assert not without_bad_bands(spoilt)[1]
