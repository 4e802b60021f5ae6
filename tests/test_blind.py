"""A library from a cube alone, on cubes of Eq. 1 whose sky and curves are known.

The curves' largest emissivity is the assumed one: their level cannot be found, their shape can.
"""

import numpy as np
import pytest

from physics import HeatCube, InputError
from physics.blind import EMISSIVITY_MAX, library_from_cube
from physics.planck import noise_sigma, planck
from physics.sky import Atmosphere, sky_radiance, zenith_optical_depth

W = np.linspace(8.1, 13.9, 40)
AIR = Atmosphere(285.0, 1.0)


def dips(*places):
    """A smooth curve that falls by 0.15 at each place (um), 1 um wide."""
    falls = sum(np.exp(-0.5 * ((W - p) / 0.6) ** 2) for p in places)
    return EMISSIVITY_MAX - 0.15 * falls / max(falls.max(), 1)


CURVES = np.stack([dips(9.0), dips(11.3), dips(8.2, 12.8)])


def make(curves=CURVES, netd_k=None, height=36, width=60, seed=0, surround=288.0, shares=None):
    """HeatCube and the material of its ground: a third of it sky, then stripes of materials,
    each under more or less of the sky overhead."""
    rng = np.random.default_rng(seed)
    top = height // 3
    heights = np.linspace(0.35, 0.1, top).repeat(width) * rng.uniform(0.97, 1.03, top * width)
    sky = sky_radiance(W, heights, AIR)
    overhead = sky_radiance(W, np.array([0.9, 0.6, 0.35]), AIR).mean(axis=0)
    n = (height - top) * width
    shares = np.ones(len(curves)) if shares is None else np.array(shares)
    ends = np.cumsum(shares) / shares.sum()
    material = np.searchsorted(ends, np.arange(n) % width / width, side="right")
    t = rng.uniform(281.0, 296.0, n)[:, None]
    v = rng.uniform(0.3, 1.0, n)[:, None]
    e = curves[material]
    x = v * overhead + (1 - v) * planck(W, surround)
    s = np.concatenate([sky, e * planck(W, t) + (1 - e) * x])
    if netd_k is not None:
        s = s + noise_sigma(W, netd_k) * rng.standard_normal(s.shape)
    cube = HeatCube(s.T.reshape(len(W), height, width), W, netd_k=netd_k)
    return cube, material


def matched(library, curves=CURVES):
    """(materials,) RMS difference of each curve to the nearest of the library."""
    found = library.at(W)[1:]
    return np.sqrt(((found[:, None] - curves) ** 2).mean(axis=2)).min(axis=0)


@pytest.mark.parametrize("netd_k", [None, 0.02, 0.05])
def test_curves_come_back_and_their_number(netd_k):
    library, note = library_from_cube(make(netd_k=netd_k)[0])
    assert library.names == ("sky", "material_1", "material_2", "material_3")
    assert "3 materials" in note and "cannot be told" not in note
    assert (matched(library) < 0.03).all()  # as the falls are 0.15 deep


@pytest.mark.parametrize("share", [0.1, 0.2])
def test_saturated_pixels_are_no_materials(share):
    cube = make(netd_k=0.03)[0]
    ceiling = np.quantile(cube.radiance, 1 - share, axis=(1, 2))[:, None, None]
    full = HeatCube(np.minimum(cube.radiance, ceiling), W, netd_k=0.03)
    library, note = library_from_cube(full)
    assert len(library) <= 5 and matched(library).max() < 0.02  # the sky, and one too many at most
    assert "of the pixels are saturated" in note


def test_the_commonest_comes_first():
    library, _ = library_from_cube(make(netd_k=0.02, shares=(1, 2, 4))[0], 3)
    off = ((library.at(W)[1:, None] - CURVES) ** 2).mean(axis=2)
    assert off.argmin(axis=1).tolist() == [2, 1, 0]
    said = [float(text.split(":")[1].split("%")[0]) for text in library.descriptions[1:]]
    assert said == sorted(said, reverse=True) and said[0] > 1.5 * said[1]


def test_a_gap_between_bands_invents_nothing_beyond_them():
    seen = np.abs(W - 10.5) > 1
    library, _ = library_from_cube(make()[0].only(seen))
    ends = library.wavelength_um[[0, -1]]
    np.testing.assert_allclose(ends, W[[0, -1]], atol=0.51 * (W[1] - W[0]))


def test_the_order_of_the_pixels_does_not_matter():
    cube, _ = make()
    ground = np.arange(12 * 60, cube.radiance[0].size)  # the sky stays above
    order = np.concatenate([np.arange(12 * 60), np.random.default_rng(1).permutation(ground)])
    mixed = cube.radiance.reshape(cube.bands, -1)[:, order].reshape(cube.radiance.shape)
    mixed = HeatCube(mixed, cube.wavelength_um, cube.fwhm_um)
    a, b = library_from_cube(cube)[0], library_from_cube(mixed)[0]
    np.testing.assert_allclose(a.emissivity, b.emissivity, rtol=1e-6)


def test_the_same_seed_gives_the_same_library():
    cube, _ = make()
    a, b = library_from_cube(cube, seed=3)[0], library_from_cube(cube, seed=3)[0]
    np.testing.assert_array_equal(a.emissivity, b.emissivity)


def test_the_sky_is_as_opaque_as_the_air_above():
    found = library_from_cube(make()[0])[0].at(W)[0]
    true = -np.expm1(-zenith_optical_depth(W, AIR))
    low = (W < 9.2) | (W > 10.1)  # ozone is high and cold: its slant path says less than others
    assert np.corrcoef(found[low], true[low])[0, 1] > 0.98
    assert np.abs(found - true)[low].max() < 0.15


def test_materials_asked_for_but_not_there_are_said_to_be_doubtful():
    library, note = library_from_cube(make()[0], materials=6)
    assert len(library) == 7
    assert "cannot be told from the others" in note
    library, _ = library_from_cube(make()[0], materials=2)
    assert len(library) == 3


@pytest.mark.parametrize("materials", [0, -1, 2.5, 3.0, "3"])
def test_what_is_no_number_of_materials_is_refused(materials):
    with pytest.raises(InputError, match="materials must be a whole number >= 1, got"):
        library_from_cube(make()[0], materials)


def test_what_the_cube_finds_decomposes_it():
    from texnet import decompose

    cube, material = make(netd_k=0.05)
    library, _ = library_from_cube(cube)
    assert library.level_sigma[0] == 0 and (library.level_sigma[1:] > 0).all()
    answer = decompose(cube, library, method="local")
    found = answer.material[12:].ravel()
    # each stripe is of one found material, a different one each
    names = [np.bincount(found[material == m]).argmax() for m in range(len(CURVES))]
    assert len(set(names)) == len(CURVES) and 0 not in names
    assert np.mean(np.array(names)[material] == found) > 0.95


def test_where_nothing_can_be_known_it_says_so():
    n = 40
    shape = (len(W), n, n)
    inside = HeatCube(np.broadcast_to(planck(W, 293.0)[:, None, None], shape), W, netd_k=0.05)
    with pytest.raises(InputError, match="cannot be told from temperature"):
        library_from_cube(inside)
    few = HeatCube(inside.radiance[:8], W[:8], netd_k=0.05)
    with pytest.raises(InputError, match="8 bands"):
        library_from_cube(few)
    with pytest.raises(InputError, match="fewer than 200 pixels"):
        library_from_cube(make(height=15, width=15)[0])
