"""The paper's figures with numbers: the peer, the bounds, the mosaic, and that they repeat."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from benchmarks.paper_method import halves_environment, kmeans_environment, paper_decompose
from benchmarks.reproduce import mosaic
from benchmarks.reproduce.curves import FINE_BANDS, publish, subset, summarised, sweep
from benchmarks.reproduce.errors import ERRORS, NETD_K, OURS, PAPER, best_lighting, bounds, seen
from benchmarks.reproduce.errors import verdict as verdict_on
from physics import HeatCube
from physics.bands import equidistant_bands
from physics.eq1 import render
from physics.planck import brightness_temperature, noise_sigma, planck

W4, FWHM4 = equidistant_bands(4)


def eq1(p, temperature_k, material, lighting):
    """S and X (P, bands) of Eq. 1 with the library and environment of some `Pixels`."""
    e = p.library.at(p.wavelength)[material]
    return render(temperature_k, e, lighting, p.environment.radiance, p.wavelength)


def truth_of(p, shape):
    """A Truth, as far as `bounds` looks, of Pixels."""
    e = p.library.at(p.wavelength)[p.material].T
    maps = lambda a: a.reshape(*a.shape[:-1], *shape)
    return SimpleNamespace(
        temperature_k=maps(p.temperature), material=maps(p.material), emissivity=maps(e),
        material_names=p.library.names, texture=maps(p.texture.T),
    )  # fmt: skip


# --- the paper's method ------------------------------------------------------------------


def test_the_papers_method_is_exact_where_its_model_is(make_pixels):
    """No noise, the true environment, V on the simplex; one material goes by the name of sky."""
    p = make_pixels(k=3, shape=(12, 16))
    names = ["sky" if n == "m2" else n for n in p.library.names]
    material = np.repeat([2, 5, 0, 7], 4)[None].repeat(12, axis=0)
    t = np.repeat([285.0, 291.0, 300.0, 296.0], 4)[None].repeat(12, axis=0)
    s, x = eq1(p, t.ravel(), material.ravel(), p.lighting)
    cube = HeatCube(s.T.reshape(-1, 12, 16), p.wavelength, netd_k=0.05)
    d = paper_decompose(cube, replace(p.library, names=names), p.environment)
    assert (d.material == material).all()
    assert d.material_names[2] == "sky"
    assert d.temperature_k == pytest.approx(t, abs=0.005)
    assert d.thermal_lighting.reshape(3, -1).T == pytest.approx(p.lighting, abs=0.01)
    assert d.texture.reshape(len(p.wavelength), -1).T == pytest.approx(x, rel=2e-3)
    assert d.residual.max() < 0.02


def test_the_papers_method_takes_its_misfit_for_noise(make_pixels):
    """Where k centres leave one, its answer is as sure as if that had been stated."""
    p = make_pixels(k=3, shape=(12, 16))
    s, _ = eq1(p, p.temperature[:192], p.material[:192], p.lighting[:192])
    rough = np.where(np.arange(len(p.wavelength)) % 2, 1.0, -1.0)
    s = s + noise_sigma(p.wavelength, 0.3) * rough  # that no material explains
    sure = []
    for netd_k in (0.05, 0.1):
        cube = HeatCube(s.T.reshape(-1, 12, 16), p.wavelength, netd_k=netd_k)
        sure.append(paper_decompose(cube, p.library, p.environment).material_probability)
    np.testing.assert_allclose(sure[0], sure[1], atol=0.02)
    assert np.median(sure[0].max(axis=0)) < 0.999


def test_no_unbiased_fit_beats_the_bound(make_pixels):
    """The peer with V far from its bounds and neighbours too different to be smoothed."""
    p = make_pixels(k=2, shape=(40, 50), seed=3)
    p.material = np.full(2000, 1)
    p.lighting = np.full((2000, 2), 0.5)
    s, p.texture = eq1(p, p.temperature, p.material, p.lighting)
    s = s + np.random.default_rng(0).normal(size=s.shape) * noise_sigma(p.wavelength, 0.05)
    cube = HeatCube(s.T.reshape(-1, 40, 50), p.wavelength, netd_k=0.05)
    d = paper_decompose(cube, p.library.subset(["m1"]), p.environment)
    bound = bounds(cube, truth_of(p, (40, 50)), p.environment)["temperature_mse_k2"]
    mse = ((d.temperature_k.ravel() - p.temperature) ** 2).mean()
    assert mse == pytest.approx(bound, rel=4 * np.sqrt(2 / 2000))
    # T and one V are fitted to the noise
    free = cube.bands - 2
    chi2 = (d.residual**2).mean() * cube.bands
    assert chi2 == pytest.approx(free, abs=4 * np.sqrt(2 * free / 2000) + 0.1)


def test_environments_of_the_paper_are_means_of_pixels():
    rng = np.random.default_rng(0)
    top, bottom = planck(W4, 250.0), planck(W4, 290.0)
    s = np.where(np.arange(10)[:, None, None] < 5, top, bottom)
    s = s * rng.uniform(0.99, 1.01, (10, 8, 1))
    cube = HeatCube(np.moveaxis(s, 2, 0), W4, FWHM4, 0.05)
    halves, centres = halves_environment(cube), kmeans_environment(cube, 2)
    assert halves.radiance[0] == pytest.approx(cube.radiance[:, :5].mean(axis=(1, 2)), rel=1e-5)
    assert halves.sky == (0,) and centres.sky == ()
    # two clusters that are the halves have their means for centres
    assert np.sort(centres.radiance, axis=0) == pytest.approx(halves.radiance, rel=1e-5)


# --- bounds ------------------------------------------------------------------------------


def test_x_in_the_hull_has_no_bound_but_zero(make_pixels):
    p = make_pixels(k=3, shape=(6, 8))
    assert best_lighting(p.texture, p.environment.radiance) == pytest.approx(p.lighting, abs=1e-5)
    least = bounds(p.cube, truth_of(p, (6, 8)), p.environment)["texture_mse_per_band"]
    assert least < 1e-10 * (p.texture**2).mean()


@settings(max_examples=25)
@given(seed=st.integers(0, 2**32 - 1), k=st.integers(1, 6), bands=st.integers(2, 9))
def test_more_objects_never_raise_what_v_must_leave(seed, k, bands):
    rng = np.random.default_rng(seed)
    radiance_, x = rng.uniform(1, 9, (k + 1, bands)), rng.uniform(1, 9, (5, bands))
    left = [((best_lighting(x, r) @ r - x) ** 2).sum(1) for r in (radiance_[:k], radiance_)]
    v = best_lighting(x, radiance_)
    assert (v >= 0).all() and v.sum(axis=1) == pytest.approx(1)
    assert (left[1] <= left[0] + 1e-6).all()


@pytest.mark.parametrize("k", [2, 4])
def test_the_best_v_is_what_a_general_minimiser_finds(k):
    rng = np.random.default_rng(k)
    s, x = rng.uniform(1, 9, (k, 7)), rng.uniform(1, 9, (4, 7))
    found = best_lighting(x, s)
    for i in range(4):
        slow = minimize(
            lambda v, x=x[i]: ((v @ s - x) ** 2).sum(), np.full(k, 1 / k), bounds=[(0, 1)] * k,
            constraints={"type": "eq", "fun": lambda v: v.sum() - 1}, options={"ftol": 1e-14},
        )  # fmt: skip
        assert ((found[i] @ s - x[i]) ** 2).sum() == pytest.approx(slow.fun, rel=1e-5)


# --- the mosaic --------------------------------------------------------------------------


def four_bands(t):
    """HeatCube of black bodies whose bands differ by an emissivity; t (height, width) K."""
    e = np.array([0.9, 0.95, 1.0, 0.92])[:, None, None]
    return HeatCube(e * planck(W4[:, None, None], t), W4, FWHM4, 0.05)


@pytest.mark.parametrize("way", [mosaic.bilinear, mosaic.edge_aware])
def test_a_constant_cube_comes_back_from_its_mosaic(way):
    cube = four_bands(np.full((12, 14), 290.0))
    raw = mosaic.sample(cube)
    assert mosaic.demosaic(raw, cube, way).radiance == pytest.approx(cube.radiance, rel=1e-6)
    small = mosaic.cells(raw, cube)
    assert small.shape == (6, 7)
    assert small.radiance == pytest.approx(cube.radiance[:, ::2, ::2], rel=1e-6)


def test_a_mosaic_holds_every_band_a_fourth_of_the_time():
    own = mosaic.measures((8, 10))
    assert (own.sum(axis=0) == 1).all() and (own.mean(axis=(1, 2)) == 0.25).all()


def test_bilinear_keeps_the_mean_of_every_bands_samples():
    raw = np.full((16, 18), 290.0)
    raw[4:-4, 4:-4] += np.random.default_rng(0).normal(0, 5, (8, 10))
    for band, own in zip(mosaic.bilinear(raw), mosaic.measures(raw.shape), strict=True):
        assert band.mean() == pytest.approx(raw[own].mean(), rel=1e-12)
        assert band[own] == pytest.approx(raw[own], rel=1e-12)


def test_only_the_edge_aware_way_keeps_an_edge_sharp():
    t = np.where(np.arange(20) < 9, 255.0, 290.0) * np.ones((18, 1))
    cube = four_bands(t)
    error = {}
    for way in (mosaic.bilinear, mosaic.edge_aware):
        found = mosaic.demosaic(mosaic.sample(cube), cube, way)
        error[way] = np.abs(
            brightness_temperature(W4[:, None, None], found.radiance)
            - brightness_temperature(W4[:, None, None], cube.radiance)
        ).max()
    assert error[mosaic.edge_aware] < 0.5
    assert error[mosaic.bilinear] > 10


def test_the_noise_of_a_bilinear_cube_is_three_quarters_of_the_sensors():
    """Of the four pixels of a cell one is a sample, two are means of two, one is a mean of four."""
    cube = four_bands(np.full((8, 8), 290.0))
    found = mosaic.demosaic(mosaic.sample(cube), cube, mosaic.bilinear)
    expected = np.sqrt((1 + 2 / 2 + 1 / 4) / 4)
    assert found.netd_k / cube.netd_k == pytest.approx(expected, rel=4 / np.sqrt(2 * 4 * 32 * 32))


# --- the curves --------------------------------------------------------------------------


@pytest.mark.parametrize("n", [2, 3, 9, 33, 100])
def test_a_subset_of_bands_is_equidistant(n):
    at = subset(n)
    assert len(at) == n and at[0] >= 0 and at[-1] < FINE_BANDS
    assert np.ptp(np.diff(at)) <= 1
    assert at.mean() == pytest.approx((FINE_BANDS - 1) / 2, abs=0.5)  # centred in 8-14 um


def test_every_band_has_the_sensors_noise():
    cube = four_bands(np.full((60, 80), 290.0))
    truth = truth_like(cube)
    noisy, of_bands = seen(cube, truth, np.array([1, 3]), seed=0)
    sigma = noise_sigma(W4[[1, 3]], NETD_K)[:, None]
    z = (noisy.radiance - cube.radiance[[1, 3]]).reshape(2, -1) / sigma
    assert z.std(axis=1) == pytest.approx([1, 1], abs=4 / np.sqrt(2 * 4800))
    assert of_bands.texture.shape == noisy.radiance.shape
    again = seen(cube, truth, np.array([1, 3]), seed=0)[0]
    assert (again.radiance == noisy.radiance).all()
    assert (seen(cube, truth, np.array([1, 3]), seed=1)[0].radiance != noisy.radiance).any()


def truth_like(cube):
    import made_up

    t = made_up.truth()
    return replace(t, texture=cube.radiance, emissivity=cube.radiance, wavelength_um=W4)


def row(method, value, k=2, scene=7):
    at = dict(group="patterned", scene=scene, seed=0, method=method, bands=54, k=k)
    return at | dict.fromkeys(ERRORS, value)


def test_the_verdict_names_what_is_worse_and_nothing_else():
    better = [row(OURS, 1.0), row(PAPER, 2.0)]
    assert "nowhere more than 5% above the paper's method" in verdict_on(better, "k")
    assert "nowhere" not in verdict_on([row(OURS, 1.06), row(PAPER, 1.0)], "k")
    worse = better + [row(OURS, 3.0, k=5), row(PAPER, 2.0, k=5)]
    said = verdict_on(worse, "k")
    assert "k = 5 (by 50%)" in said and "k = 2" not in said


def test_mean_and_spread_are_those_of_a_groups_scenes():
    rows = [row(OURS, 1.0), row(OURS, 3.0, scene=8), row(PAPER, np.inf)]
    summary = {(r["method"], r["seed"]): r["temperature_mse_k2"] for r in summarised(rows)}
    assert summary[OURS, "mean"] == 2.0 and summary[OURS, "spread"] == 1.0
    assert np.isnan(summary[PAPER, "mean"])


def test_the_same_seed_makes_the_same_curves(tmp_path):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        rows = sweep([(4, 2)], False, None, size=((24, 36), 4, 1, 0))
        text, result = publish(rows, "k", "k", tmp_path / name, "curves")
        assert "patterned" in text and len(result["rows"]) == 5
        assert (tmp_path / name / "curves.png").stat().st_size > 1000
    csv = [(tmp_path / name / "curves.csv").read_bytes() for name in ("a", "b")]
    assert csv[0] == csv[1]
