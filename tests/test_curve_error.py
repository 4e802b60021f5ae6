"""Curves of a library that are off are allowed for, where half of a scene's materials say so."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from traced import names_of, one_thread, right, traced  # noqa: F401

import texnet.camera.calibration
from physics import HeatCube, InputError, MaterialLibrary
from physics.bands import equidistant_bands
from physics.environment import SMOOTH_UM, Environment
from physics.planck import planck, planck_derivative
from physics.prior import MIN_TEMPERATURE_SPREAD_K, lighting_scale
from physics.simulator import simulate
from physics.simulator.presets import preset
from texnet.camera.correction import RIGHT
from texnet.camera.curve_error import (
    ERRORS,
    NEARLY,
    WORTH,
    asked_by_half,
    likeliest_curves,
    what_noise_leaves,
)
from texnet.metrics import evaluate
from texnet.pipeline import decompose

LIBRARY = MaterialLibrary.starter()
W = np.linspace(8, 14, 25)
COLD = np.clip(0.3 + np.abs(W - 10.8) / 3, 0, 1) * planck(W, 285.0)
AROUND = Environment(np.stack([COLD, planck(W, 285.0), planck(W, 295.0)]), W, (0,))


def with_errors(error, seed=0):
    """The library with e off by so much (one standard deviation), smoothly."""
    rng, w = np.random.default_rng(seed), LIBRARY.wavelength_um
    turns = np.arange(1, 9)[:, None] * np.pi * (w - 8) / 6
    a, b = rng.normal(size=(2, len(LIBRARY), 8)) / np.sqrt(8)
    off = error * (a @ np.cos(turns) + b @ np.sin(turns))
    off[LIBRARY.sky_index] = 0
    return replace(LIBRARY, emissivity=np.clip(LIBRARY.emissivity + off, 0.01, 1))


@settings(max_examples=10)
@given(st.integers(0, 99), st.floats(0.001, 0.05))
def test_it_moves_spectra_as_random_errors_of_curves_do_by_eq_1(seed, error):
    """Against a sample of de (B(T) - X), of smooth de and of T and V as they are a priori."""
    rng, n = np.random.default_rng(seed), 100_000
    alike = np.exp(-0.5 * ((W[:, None] - W) / SMOOTH_UM) ** 2)
    de = error * rng.multivariate_normal(np.zeros(W.size), alike, n, method="eigh")
    v = 1 / 3 + lighting_scale(3) * rng.normal(size=(n, 3))
    s = AROUND.radiance
    light = s.mean(axis=0) + (v - 1 / 3) @ (s - s.mean(axis=0))
    t = MIN_TEMPERATURE_SPREAD_K * rng.normal(size=(n, 1))
    glow = planck(W, 285.0) + t * planck_derivative(W, 285.0)  # the air's, and all but the warm's
    off = de * (glow - light)
    rows = AROUND.with_curves_off_by(error).curve_spread
    np.testing.assert_allclose(rows.T @ rows, off.T @ off / n, atol=0.05 * (off**2).mean(0).max())


def test_no_error_moves_nothing_and_a_larger_one_in_proportion():
    assert len(AROUND.with_curves_off_by(0).curve_spread) == 0
    one, two = (AROUND.with_curves_off_by(e).curve_spread for e in (0.01, 0.02))
    np.testing.assert_allclose(two.T @ two, 4 * one.T @ one, rtol=1e-9, atol=1e-15)
    for wrong in (-0.1, 1.5, np.nan, [0.1, 0.2], "0.1"):
        with pytest.raises(InputError):
            AROUND.with_curves_off_by(wrong)


@given(st.lists(st.tuples(st.integers(0, 4), st.integers(-20, 20)), min_size=1, max_size=40))
@example([(m, g) for m, g in ((0, 20), (1, -1)) for _ in range(8)])
@example([(m, g) for m, g in ((0, 9), (1, 8), (2, -1)) for _ in range(8)])
def test_half_of_the_materials_ask_whatever_they_are_called_and_in_whatever_order(pixels):
    material, gained = (np.array(a) for a in zip(*pixels, strict=True))
    asked = asked_by_half(gained, material)
    assert asked == asked_by_half(gained[::-1], 9 - material[::-1])
    enough = [m for m in range(5) if (material == m).sum() >= 8]
    gain = [m for m in enough if gained[material == m].sum() > 0]
    assert asked == (len(gain) > 1 and 2 * len(gain) >= len(enough))


def test_a_material_that_is_missing_asks_in_vain_however_much_it_gains():
    material = np.repeat([0, 1, 2], [200, 20, 20])
    gained = np.where(material == 0, 20.0, -0.5)
    assert gained.mean() > 10 and not asked_by_half(gained, material)
    assert asked_by_half(np.where(material == 2, -0.5, 1.0), material)


@given(st.integers(2, 40), st.floats(0.001, 0.05), st.integers(0, 99))
def test_noise_leaves_what_a_sample_of_it_leaves(bands, error, seed):
    w = np.linspace(8, 14, bands)
    s = np.stack([0.6 * planck(w, 285.0), planck(w, 285.0), planck(w, 295.0)])
    around = Environment(s, w, (0,)).with_curves_off_by(error)
    cube = HeatCube(np.ones((bands, 1, 1)) * planck(w, 290.0)[:, None, None], w, netd_k=0.05)
    u = (around.curve_spread / cube.sigma).T
    n = np.random.default_rng(seed).normal(size=(bands, 20_000))
    left = np.linalg.solve(np.eye(bands) + u @ u.T, n)
    assert what_noise_leaves(cube, around) == pytest.approx(np.sqrt((left**2).mean()), rel=0.03)


@pytest.mark.parametrize(
    ("name", "method", "error"),
    [("forest", "net+sgd", 0.005), ("street", "net+sgd", 0.01), ("forest", "local", 0.005)],
)
def test_curves_that_are_off_are_allowed_for_and_more_is_right(name, method, error, monkeypatch):
    cube, truth = traced(name, 54)
    same = right(name, 54, method)
    assert same.curve_error == 0
    d = decompose(cube, with_errors(error), method=method)
    assert error / 4 <= d.curve_error <= 2 * error and d.noise_raised == 1
    found = evaluate(d, truth)
    assert found["within_2_sigma"] > 0.93 and found["accuracy_answered"] > 0.85
    monkeypatch.setattr(texnet.camera.calibration, "likeliest_curves", lambda *_: None)
    noisy = decompose(cube, with_errors(error), method=method)
    assert noisy.curve_error == 0 and noisy.noise_raised > 1
    known = lambda a: ((names_of(a) == names_of(truth)) & ~a.unknown).mean()
    assert known(d) > known(noisy) + 0.1


@pytest.mark.parametrize("seed", [5_000_003, 5_000_007])  # hardly any but soil; a room of one light
def test_one_material_and_one_object_are_enough_where_nothing_else_is_left(seed, monkeypatch):
    w, fwhm = equidistant_bands(54)
    scene = preset("random", seed)
    cube, truth = simulate(scene, wavelength_um=w, fwhm_um=fwhm, size=(48, 72), spp=16)
    d = decompose(cube, with_errors(0.01))
    assert 0 < d.curve_error <= 0.02 and d.noise_raised == 1
    assert evaluate(d, truth)["accuracy_answered"] > 0.9
    monkeypatch.setattr(texnet.camera.calibration, "likeliest_curves", lambda *_: None)
    without = decompose(cube, with_errors(0.01))
    known = lambda a: ((names_of(a) == names_of(truth)) & ~a.unknown).mean()
    assert known(d) > known(without) + 0.1


class Nats:
    """Of four pixels by the error of curves: the k-th is worth nats[k] more than none."""

    def __init__(self, nats):
        self.nats = dict(zip(ERRORS, nats, strict=True))

    def each(self, calibrations):
        return {c: np.full(4, 5.0 - self.nats.get(c.curves, 0.0)) for c in calibrations}


@given(st.lists(st.integers(-16, 16), min_size=len(ERRORS), max_size=len(ERRORS)))
@example([4, 3, 1, 2, -4, -16])
def test_the_largest_error_that_is_nearly_the_likeliest_is_taken(quarters):
    nats = [n / 4 for n in quarters]
    off = likeliest_curves(Nats(nats), RIGHT)
    taken = max(nats[0], nats[2]) > 0 and max(nats[:-1]) >= max(WORTH, nats[-1])
    assert (off is not None) == taken
    if taken:
        near = [e for e, n in zip(ERRORS[:-1], nats, strict=False) if n >= max(nats) - NEARLY]
        assert off.found.curves == near[-1]
        np.testing.assert_allclose(off.gained, max(nats))


def test_a_gain_that_is_far_less_likely_than_curves_is_not_suspected():
    d = decompose(traced("street", 54)[0], with_errors(0.01), method="local")
    assert d.curve_error > 0 and d.suspected_error_k == 0


def test_a_material_that_the_library_lacks_is_no_error_of_all_curves():
    cube, truth = traced("forest", 54)
    names, count = np.unique(names_of(truth), return_counts=True)
    commonest = max((c, n) for n, c in zip(names, count, strict=True) if n != "sky")[1]
    left = LIBRARY.subset([n for n in LIBRARY.names if n != commonest])
    assert decompose(cube, left).curve_error == 0


@pytest.mark.parametrize(("k", "bands"), [(1, 54), (2, 54), (None, 18)])
def test_bands_off_among_each_other_are_no_error_of_curves(k, bands):
    cube, truth = traced("forest", bands)
    gains = 1 + 0.03 * np.random.default_rng(1).normal(size=bands)
    off = replace(cube, radiance=(cube.radiance.T * gains.astype(np.float32)).T)
    d = decompose(off, k=k)
    assert d.curve_error == 0
    assert evaluate(d, truth)["within_2_sigma"] > 0.95
