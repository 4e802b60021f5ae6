"""Pixels without a measurement: found, filled from beside them, kept on disk, called unknown."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from traced import names_of, one_thread, said, traced  # noqa: F401

from physics import HeatCube
from physics.cube.bad_bands import NO_RADIANCE, without_bad_bands
from physics.cube.dead_pixels import FEW, gaps, lifted
from physics.errors import InputError
from physics.planck import planck
from texnet.cli import main
from texnet.files.cube_io import read_cube, write_cube
from texnet.pipeline import decompose
from texnet.vision import tex_vision

W = np.array([8.5, 10.0, 11.5])
VALUES = st.sampled_from([np.nan, np.inf, -np.inf, 0.0, -1.0, 65535.0])


def a_cube(shape, seed=0):
    """(bands, height, width) of a scene in which no two pixels are alike."""
    return planck(W[:, None, None], np.random.default_rng(seed).uniform(280, 300, shape))


def with_dead(cube, share):
    """A HeatCube some of whose pixels, in one band each, are NaN; and which."""
    rng = np.random.default_rng(0)
    dead = rng.random(cube.shape) < share
    s = cube.radiance.copy()
    s[rng.integers(cube.bands, size=dead.sum()), *np.nonzero(dead)] = np.nan
    return HeatCube(s, cube.wavelength_um, cube.fwhm_um, cube.netd_k), dead


@given(st.data(), st.integers(8, 12), st.integers(8, 12))
def test_each_holds_the_spectrum_of_a_nearest_sound_pixel(data, height, width):
    s = a_cube((height, width))
    index = st.tuples(st.integers(0, 2), st.integers(0, height - 1), st.integers(0, width - 1))
    spoilt = data.draw(st.dictionaries(index, VALUES, max_size=int(FEW * height * width)))
    broken, dead = s.copy(), np.zeros((height, width), bool)
    for (band, row, column), value in spoilt.items():
        broken[band, row, column] = value
        dead[row, column] = True
    cube = HeatCube(broken, W)
    np.testing.assert_array_equal(cube.dead, dead)
    np.testing.assert_array_equal(cube.radiance[:, ~dead], s.astype(np.float32)[:, ~dead])
    sound = np.argwhere(~dead)
    for row, column in np.argwhere(dead):
        square = ((sound - (row, column)) ** 2).sum(axis=1)
        near = cube.radiance[:, *sound[square == square.min()].T]
        assert (near == cube.radiance[:, row, column, None]).all(axis=0).any()


def test_a_dead_band_kills_no_pixel():
    for value in (np.nan, 0, 65535):
        s = a_cube((4, 5))
        s[1] = value
        assert not HeatCube(s, W).dead.any()
        s[0, 2, 3] = value
        assert np.argwhere(HeatCube(s, W).dead).tolist() == [[2, 3]]


def test_a_band_that_is_dead_in_most_pixels_is_left_out():
    """Be it a detector's noise around zero, or one that a single pixel outlives."""
    cube = traced("forest", 54)[0]
    whole = cube.only(np.arange(54) != 20)
    rng = np.random.default_rng(0)
    noise = rng.normal(0, 0.005, cube.shape)
    for band in (noise, 6e4 + noise, (np.arange(48 * 72) == 7).reshape(48, 72)):
        s = cube.radiance.copy()
        s[20] = band
        spoilt = HeatCube(s, cube.wavelength_um, cube.fwhm_um, cube.netd_k)
        assert not spoilt.dead.any()
        left, why = without_bad_bands(spoilt)
        assert why == {cube.wavelength_um[20]: NO_RADIANCE}
        np.testing.assert_array_equal(left.radiance, whole.radiance)


def test_more_than_a_few_are_refused_by_name():
    s = a_cube((10, 10))
    s[1, 4, :5] = np.nan
    assert HeatCube(s, W).dead.sum() == 5
    s[2, 9, 9] = 0
    with pytest.raises(InputError, match=r"6% .* at 10 um, row 4, column 0 \(nan\), .* most 5%"):
        HeatCube(s, W)


@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, np.nan, -np.inf]))
def test_what_holds_nothing_in_any_band_may_be_most_of_a_picture(seed, nothing):
    """And does not count where the dead among the others are counted."""
    rng = np.random.default_rng(seed)
    s = a_cube((12, 13))
    blank = rng.random((12, 13)) < rng.uniform(0.1, 0.95)
    blank[6, 6] = False
    s[:, blank] = nothing
    cube = HeatCube(s, W)
    np.testing.assert_array_equal(cube.dead, blank)
    assert cube.measured_count == np.count_nonzero(~blank)
    there = {tuple(x) for x in s[:, ~blank].T.astype(np.float32)}
    assert {tuple(x) for x in cube.spectra} == there
    for picked in (cube.sample(10**6), cube.pixels(cube.random_pixels(rng, 10**6))):
        assert len(picked) == len(there)
    s[1, ~blank] = np.where(np.arange(len(there)) < 0.4 * len(there), np.nan, s[1, ~blank])
    s[2, 6, 6] = np.nan
    if len(there) < 20:
        with pytest.raises(InputError, match="are dead"):
            HeatCube(s, W)
    with pytest.raises(InputError, match="all of its pixels"):
        HeatCube(np.full_like(s, nothing), W)


def test_gaps_are_areas_and_no_single_pixels():
    dead = np.zeros((20, 30), bool)
    dead[4, 7], dead[10, :20], dead[12:14, 3:9] = True, True, True
    assert not gaps(dead).any() and not gaps(np.zeros_like(dead)).any()
    area = np.zeros_like(dead)
    area[:, 25:], area[15:18, 4:7], area[:2, :6] = True, True, True  # two at the edge: more beyond
    np.testing.assert_array_equal(gaps(dead | area), area)


def test_a_map_of_the_camera_s_own_is_taken():
    s, stated = a_cube((10, 10)), np.zeros((10, 10), bool)
    stated[3, 4] = True
    s[0, 7, 7] = np.nan
    s[:, 3, 4] = 99.0  # is no source for others
    s[:, 3, 5] = np.nan
    cube = HeatCube(s, W, dead=stated)
    assert np.argwhere(cube.dead).tolist() == [[3, 4], [3, 5], [7, 7]]
    assert cube.radiance.max() < 99
    again = HeatCube(cube.radiance, W, dead=cube.dead)
    assert np.shares_memory(again.radiance, cube.radiance)
    for wrong in (stated[1:], stated.astype(float), np.ones_like(stated)):
        with pytest.raises(InputError, match="dead"):
            HeatCube(s, W, dead=wrong)


@pytest.mark.parametrize("kind", ["exr", "npz"])
def test_files_and_parts_keep_them(tmp_path, kind):
    cube, dead = with_dead(traced("forest", 54)[0], 0.02)
    write_cube(cube.with_netd(), tmp_path / f"a.{kind}")
    read = read_cube(tmp_path / f"a.{kind}")
    np.testing.assert_array_equal(read.dead, dead)
    np.testing.assert_array_equal(read.radiance, cube.radiance)
    np.testing.assert_array_equal(read.only(np.arange(54) % 2 > 0).dead, dead)
    part = ["--rows", "10:30", "--columns", "5:40", "--out", str(tmp_path / "part.npz")]
    assert main(["import", str(tmp_path / f"a.{kind}"), *part]) == 0
    np.testing.assert_array_equal(read_cube(tmp_path / "part.npz").dead, dead[10:30, 5:40])


@pytest.mark.parametrize("method", ["local", "net+sgd"])
def test_they_are_unknown_and_the_others_as_right_as_they_were(method):
    cube, truth = traced("forest", 54)
    spoilt, dead = with_dead(cube, 0.02)
    there, whole = (decompose(c, method=method, k=3) for c in (spoilt, cube))
    np.testing.assert_array_equal(there.dead, dead)
    assert there.unknown[dead].all() and there.temperature_sigma_k[dead].min() > 15
    right, before = ((names_of(d) == names_of(truth))[~dead].mean() for d in (there, whole))
    assert right > before - 0.02
    moved = np.abs(there.temperature_k - whole.temperature_k)[~dead]
    assert np.median(moved) < cube.netd_k / 2  # and few by more than they may be off
    assert (moved < 2 * whole.temperature_sigma_k[~dead]).mean() > 0.98
    assert abs(there.unknown[~dead].mean() - whole.unknown[~dead].mean()) < 0.05


@pytest.mark.parametrize("method", ["local", "sgd", "net+sgd"])
def test_an_orthorectified_picture_is_answered_like_what_it_shows(method):
    """Each column moved down by so many rows, as a strip is that is flown askew."""
    cube, _ = traced("forest", 54)
    height, width = cube.shape
    row = np.arange(height)[:, None] + 2 * np.arange(width)[None, :] // 3
    s = np.zeros((cube.bands, row.max() + 1, width), np.float32)
    s[:, row, np.arange(width)] = cube.radiance
    askew = HeatCube(s, cube.wavelength_um, cube.fwhm_um, cube.netd_k)
    assert askew.dead.mean() > 0.4
    there, plain = (decompose(c, method=method, k=3) for c in (askew, cube))
    np.testing.assert_array_equal(there.dead, askew.dead)
    assert there.unknown[there.dead].all()
    assert (there.netd_k, there.noise_raised) == (plain.netd_k, plain.noise_raised)
    t, sigma, material = (
        np.take_along_axis(m, row, 0)
        for m in (there.temperature_k, there.temperature_sigma_k, there.material)
    )
    assert (material == plain.material).mean() > 0.85
    moved = np.abs(t - plain.temperature_k)
    assert np.median(moved) < cube.netd_k
    assert (moved < 2 * np.maximum(sigma, plain.temperature_sigma_k)).mean() > 0.97
    picture = tex_vision(there)
    assert not picture[gaps(there.dead)].any() and picture[~there.dead].any(axis=-1).all()


def test_nothing_is_learnt_from_copies():
    """Not by the glance, the noise or the prior, when a wall of 350 K at the edge is copied."""
    cube, truth = traced("forest", 54)
    height, width = cube.shape
    s = np.zeros((cube.bands, height, 4 * width), np.float32)
    s[:, :, :width] = cube.radiance
    s[:, :, width - 1] = planck(cube.wavelength_um, 350.0)[:, None]
    wide = HeatCube(s, cube.wavelength_um, cube.fwhm_um, cube.netd_k)
    alone = HeatCube(s[:, :, :width], cube.wavelength_um, cube.fwhm_um, cube.netd_k)
    there, plain = (decompose(c, k=3) for c in (wide, alone))
    assert (there.material[:, :width] == plain.material).mean() > 0.95
    assert abs(there.unknown[:, :width].mean() - plain.unknown.mean()) < 0.01
    assert f"{there.unknown[:, :width].mean():.1%} unknown" in repr(there)


@pytest.mark.parametrize("shape, dead", [((480, 201), 0), ((480, 201), 1), ((9000, 1), 0)])
def test_a_sample_is_large_enough_however_regularly_they_lie(shape, dead):
    pattern = np.add.outer(*map(np.arange, shape)) % 2 == dead
    s = np.where(pattern, 9.0, 8.0) + np.zeros((3, 1, 1))
    sample = HeatCube(s, np.array([9.0, 10.0, 11.0]), dead=pattern).sample(6000)
    assert 2 * len(sample) >= min(6000, (~pattern).sum()) and (sample == 8.0).all()


def test_noise_is_not_estimated_from_copies():
    cube = traced("forest", 54)[0]
    for part in (cube, cube.only(np.arange(54) % 9 == 4)):
        s = np.zeros((part.bands, part.shape[0], 5 * part.shape[1]), np.float32)
        s[:, :, : part.shape[1]] = part.radiance
        wide = HeatCube(s, part.wavelength_um, part.fwhm_um)
        alone = HeatCube(part.radiance, part.wavelength_um, part.fwhm_um)
        assert wide.with_netd().netd_k == pytest.approx(alone.with_netd().netd_k, rel=0.02)


@pytest.mark.parametrize("bands", [36, 6])
def test_noise_is_that_of_the_bands_that_show_the_scene(bands):
    """Whether or not a pixel is dead besides."""
    cube = traced("forest", 54)[0]
    cube = cube.only(np.isin(np.arange(54), np.linspace(0, 53, bands).round()))
    s = cube.radiance.copy()
    s[2] = 0
    one = HeatCube(s, cube.wavelength_um, cube.fwhm_um).with_netd().netd_k
    s[4, 7, 7] = 0
    other = HeatCube(s, cube.wavelength_um, cube.fwhm_um).with_netd().netd_k
    rest = cube.only(np.arange(bands) != 2)
    alone = HeatCube(rest.radiance, rest.wavelength_um, rest.fwhm_um).with_netd().netd_k
    assert one == pytest.approx(alone, rel=1e-6) and other == pytest.approx(alone, rel=0.01)


def test_stated_ones_may_be_many_and_come_back(tmp_path):
    cube, _ = traced("forest", 54)
    stated = np.random.default_rng(0).random(cube.shape) < 0.3
    s = np.where(stated & (np.arange(54) == 7)[:, None, None], -1, cube.radiance)
    of = HeatCube(s, cube.wavelength_um, cube.fwhm_um, 0.05, dead=stated)
    np.testing.assert_array_equal(of.dead, stated)
    write_cube(of, tmp_path / "a.npz")
    np.testing.assert_array_equal(read_cube(tmp_path / "a.npz").dead, stated)


def test_the_commands_say_how_many(tmp_path, capsys):
    cube, dead = with_dead(traced("forest", 54)[0], 0.01)
    np.savez(tmp_path / "a.npz", radiance=cube.measured(), wav=cube.wavelength_um)
    out = tmp_path / "cube.exr"
    words = ["import", tmp_path / "a.npz", "--unit", "W/m2/sr/um", "--out", out]
    assert main([str(word) for word in words]) == 0
    assert f"{dead.sum()} pixels (1%) without a measurement" in capsys.readouterr().out
    text, result, npz = said(capsys, out, tmp_path / "b", "--method", "local")
    assert f"Dead         {100 * dead.mean():.2g} % of the pixels" in text
    assert result["dead"] == pytest.approx(dead.mean())
    np.testing.assert_array_equal(npz["dead"], dead)


def test_noise_around_no_light_is_a_measurement():
    """A dry polar sky shows its opaque bands alone; half of the others fall below zero."""
    rng, s = np.random.default_rng(0), a_cube((12, 20))
    s[:2, :6] = 0.002 * rng.standard_normal((2, 6, 20))
    below = s < 0
    s[:, 11, 3], s[:, :, 18:] = np.nan, 0.0  # what holds no measurement tells nothing of the rest
    cube = HeatCube(s, W, netd_k=0.05)
    below &= ~cube.dead
    assert below.sum() > 50 and np.count_nonzero(cube.dead) == 12 * 2 + 1
    assert (cube.radiance > 0).all() and cube.radiance[below].max() < 0.01
    same = ~below & ~cube.dead
    np.testing.assert_array_equal(cube.radiance[same], s[same].astype(np.float32))


def test_a_pixel_that_shows_no_band_is_dead_and_so_is_what_is_far_below_zero():
    s = a_cube((12, 20))
    s[:, 3, 4] = 0.002, -0.002, -0.001  # nothing but noise
    s[1, 5, 6], s[2, 7, 8] = -3.0, -0.3  # no noise; alone, as a detector that is stuck
    dead = np.argwhere(HeatCube(s, W, netd_k=0.05).dead)
    np.testing.assert_array_equal(dead, [[3, 4], [5, 6], [7, 8]])


def test_without_such_noise_nothing_is_copied():
    s = a_cube((4, 5)).astype(np.float32)
    assert lifted(s) is s
