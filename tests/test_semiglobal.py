"""The semi-global objective E against a slow one, its descent from any start, its symmetries.

Pixels here come from the k-object model (Eq. 1); they test the solver, never accuracy.
"""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from traced import one_thread  # noqa: F401

import physics.exact.semiglobal as semiglobal
from physics import Environment, HeatCube, MaterialLibrary
from physics.eq1 import render
from physics.exact.local import solve_local
from physics.exact.reduced import reduce_model
from physics.exact.semiglobal import Objective, State, smoothed, unsmoothed
from physics.planck import noise_sigma, planck, planck_derivative
from physics.prior import MIXED_MATERIAL, MIXED_SHARE, MIXED_SKY, V_PRECISION


def smooth_map(rng, shape, scale):
    """A (height, width) map of standard normal values, smooth over `scale` pixels."""
    y, x = np.indices(shape)
    total = np.zeros(shape)
    for _ in range(6):
        a, b = rng.normal(size=2) * 2 * np.pi / scale
        total += np.cos(a * y + b * x + rng.uniform(0, 2 * np.pi))
    return total / np.sqrt(3)


class Scene:
    """Regions of one material each, T and V smooth within them, by Eq. 1 with noise."""

    def __init__(self, library, environment, shape=(14, 18), netd=0.05, seed=0):
        rng = np.random.default_rng(seed)
        self.library, self.environment, self.shape = library, environment, shape
        w, k = environment.wavelength_um, len(environment)
        ground = [m for m in range(len(library)) if m != library.sky_index]
        band = np.digitize(smooth_map(rng, shape, 12), [-0.5, 0.5])
        self.material = np.array(rng.permutation(ground)[:3])[band].ravel()
        self.temperature = 292 + 3 * band.ravel() + smooth_map(rng, shape, 15).ravel()
        weight = np.exp([smooth_map(rng, shape, 8).ravel() for _ in range(k)]).T
        self.lighting = weight / weight.sum(axis=1, keepdims=True)
        e = library.at(w)[self.material]
        s, _ = render(self.temperature, e, self.lighting, environment.radiance, w)
        s = s + rng.normal(size=s.shape) * noise_sigma(w, netd)
        self.cube = HeatCube(s.T.reshape(len(w), *shape), w, netd_k=netd)

    def objective(self, cube=None, library=None):
        cube = cube or self.cube
        model = reduce_model(cube, library or self.library, self.environment)
        return Objective(model, cube, solve_local(model, cube.spectra))


def wavelengths(bands=24):
    return np.linspace(8.05, 13.95, bands)


def surroundings(k=3, spread=False, sky=False):
    """A cold object, warm ones, and on request all that an Environment can hold."""
    w = wavelengths()
    cold = np.clip(0.25 + np.abs(w - 10.8) / 3.5, 0, 1) * planck(w, 285.0)
    warm = [planck(w, t) for t in np.linspace(280, 310, k - 1)]
    more = {}
    if spread:
        more["spread"] = np.stack([0.03 * cold * np.sin(w), 0.02 * planck(w, 290.0)])
        more["error_k"] = 0.4
    if sky:
        more["sky"] = (0,)
        more["sky_mean"] = 0.5 * (cold + planck(w, 285.0))
        more["curve_spread"] = 0.02 * np.stack([cold, np.cos(3 * w)])
        more["sky_spread"] = 0.04 * more["sky_mean"][None] * np.cos(w)
    return Environment(np.stack([cold, *warm]), w, **more)


def curves(materials=6, seed=0, depth=(0.03, 0.15), sky=False):
    """Smooth random emissivities, alike enough to be confused; the last may be the sky."""
    rng = np.random.default_rng(seed)
    x, w = np.linspace(-1, 1, 141), np.linspace(7.5, 14.5, 141)
    c = np.array([np.polynomial.chebyshev.chebval(x, rng.normal(size=8)) for _ in range(materials)])
    e = 0.98 - rng.uniform(*depth, (materials, 1)) * np.abs(c) / np.abs(c).max(axis=1)[:, None]
    names = [f"m{i}" for i in range(materials - sky)] + ["sky"] * sky
    return MaterialLibrary(names, w, e)


def random_state(objective, rng, low_k, high_k):
    n, k = len(objective.spectra), objective.model.k
    energy = objective.local.energy
    possible = np.flatnonzero(np.isfinite(energy).all(axis=0))
    return objective.state(
        rng.uniform(low_k, high_k, n), rng.choice(possible, n), rng.dirichlet(np.ones(k), n)
    )


# --- descent ----------------------------------------------------------------------------------


def starts(objective, rng):
    n, k, model = len(objective.spectra), objective.model.k, objective.model
    low, high = model.mid_k - model.half_k, model.mid_k + model.half_k
    yield "random", random_state(objective, rng, low, high)
    yield "local", objective.local_state()
    yield (
        "constant",
        objective.state(
            np.full(n, rng.uniform(low, high)), np.full(n, rng.integers(3)), np.full((n, k), 1 / k)
        ),
    )
    corner = np.eye(k)[rng.integers(0, k, n)]
    yield "corner", objective.state(np.full(n, low), rng.integers(0, 3, n), corner)


@settings(max_examples=6)
@given(seed=st.integers(0, 2**31), k=st.integers(1, 4), rich=st.booleans())
def test_refining_never_increases_the_objective(seed, k, rich):
    """From anywhere, every recorded step of E goes down, and the record is of E itself."""
    rng = np.random.default_rng(seed)
    rich &= k > 1
    environment = surroundings(max(k, 2), rich, rich) if k > 1 else surroundings(1)
    netd = 10 ** rng.uniform(-2, 0)
    scene = Scene(curves(5, seed, sky=rich), environment, (8, 9), netd, seed)
    objective = scene.objective()
    for name, start in starts(objective, rng):
        answer = smoothed(objective, start)
        trace = np.array(answer.objective)
        # chi^2 is a small difference of sums as large as |s|^2 / 2
        rounding = 1e-15 * 0.5 * ((objective.spectra / objective.model.sigma) ** 2).sum()
        rounding = max(rounding, 1e-9 * np.abs(trace).max())
        assert np.isfinite(trace).all()
        assert (np.diff(trace) <= rounding).all(), (name, trace)
        assert trace[0] == pytest.approx(objective.value(start), rel=1e-9, abs=1e-6)
        assert trace[-1] == pytest.approx(objective.value(answer.state), rel=1e-9, abs=1e-4)
        v = answer.state.thermal_lighting
        assert (v >= 0).all()
        np.testing.assert_allclose(v.sum(axis=1), 1, atol=1e-9)
        np.testing.assert_allclose(answer.probability.sum(axis=1), 1, atol=1e-5)


@settings(max_examples=6)
@given(seed=st.integers(0, 2**31))
def test_each_kind_of_step_never_increases_the_objective(seed):
    """T and V alone, then m alone, from random states: not only after they are combined."""
    rng = np.random.default_rng(seed)
    objective = Scene(curves(5, seed), surroundings(3), (9, 11), 0.1, seed).objective()
    state = random_state(objective, rng, 240, 340)
    for _ in range(3):
        before = objective.value(state)
        state, unary, _ = objective.descend_tv(state)
        middle = objective.value(state)
        np.testing.assert_allclose(unary, objective.unaries(state), rtol=1e-9, atol=1e-4)
        assert middle <= before + 1e-9 * abs(before)
        moved = objective.descend_tv(objective.descend_m(state, unary))[0]
        assert objective.value(moved) <= middle + 1e-9 * abs(middle)
        state = moved


def free_energy(objective, q):
    """Of independent pixels of probabilities q (P, L): the mean of E's Potts part, less entropy."""
    q = q.astype(float)
    maps = q.reshape(*objective.shape, -1)
    agree = (objective.edges[1][:-1] * (maps[:-1] * maps[1:]).sum(axis=2)).sum()
    agree += (objective.edges[3][:, :-1] * (maps[:, :-1] * maps[:, 1:]).sum(axis=2)).sum()
    return (q * objective.unary).sum() + (q * np.log(np.maximum(q, 1e-300))).sum() - agree


@pytest.mark.parametrize("netd", [0.05, 0.4])
def test_mean_field_lowers_the_free_energy_and_comes_to_rest(netd, monkeypatch):
    library = curves(materials=5, seed=3, depth=(0.03, 0.06))
    objective = Scene(library, surroundings(), (20, 26), netd, seed=3).objective()
    found = []
    for sweeps in (0, 1, 2, 5, 10, 11, 40):
        monkeypatch.setattr(semiglobal, "MEAN_FIELD_SWEEPS", sweeps)
        found.append(objective.mean_field())
        assert found[-1].sum(axis=1) == pytest.approx(1, abs=1e-5)
    energy = np.array([free_energy(objective, q) for q in found])
    assert (np.diff(energy) < 1e-3).all() and energy[0] - energy[4] > 10
    ten, eleven, forty = found[-3:]
    assert np.abs(ten - eleven).max(axis=1).mean() < 0.002
    assert (ten.argmax(axis=1) == forty.argmax(axis=1)).mean() > 0.98


def test_refining_an_answer_again_never_makes_it_worse():
    """The mean-field labelling, tried on the way, is dropped where it is no better."""
    for seed in range(4):
        objective = Scene(curves(6, seed), surroundings(3), (10, 12), 0.4, seed).objective()
        start = objective.local_state()
        for _ in range(4):
            answer = smoothed(objective, start)
            assert (np.diff(answer.objective) <= 1e-9 * abs(answer.objective[0])).all()
            start = answer.state


def test_no_single_change_of_material_is_left_that_lowers_the_objective():
    """Iterated conditional modes end where every pixel, given the others, is at its best."""
    objective = Scene(curves(5, 3), surroundings(3), (6, 7), 0.3, 4).objective()
    state = random_state(objective, np.random.default_rng(0), 285, 300)
    unary, p = objective.unaries(state), np.arange(42)
    for _ in range(20):
        before = state
        state = objective.descend_m(state, unary)
        moved = (state.material != before.material) | (state.temperature_k != before.temperature_k)
        unary = np.where(moved, objective.unary[p, state.material], unary)
        if not moved.any():
            break
    now = unary.sum() + objective.smoothness(state)
    for i in p:
        for m in range(5):
            t, material = state.temperature_k.ravel().copy(), state.material.copy()
            t[i], material[i] = objective.local.temperature_k[i, m], m
            other = objective.state(t, material, state.thermal_lighting)
            changed = unary.sum() - unary[i] + objective.unary[i, m] + objective.smoothness(other)
            assert changed > now - 0.01


# --- the objective is what its docstring says ---------------------------------------------------


def slow_unaries(scene, objective, state):
    """E's first sum, by pixel, from the docstrings of `semiglobal` and `reduced`, band by band."""
    cube, library, environment = scene.cube, scene.library, scene.environment
    w, k, sigma = cube.wavelength_um, len(environment), noise_sigma(cube.wavelength_um, 0.1)
    model = objective.model
    t0, t_sigma = model.prior_mean_k, model.prior_sigma_k
    v_variance = 1 / (V_PRECISION * k)
    has_sky = environment.sky_mean is not None and library.sky_index is not None
    sky_mean = environment.sky_mean if has_sky else np.zeros(w.size)
    # the mean of B(T) over T's prior, by a sum
    z = np.linspace(-6, 6, 2001)
    glow = np.average(planck(w, t0 + t_sigma * z[:, None]), axis=0, weights=np.exp(-(z**2) / 2))

    def hypothesis(p):
        m, alpha = state.material[p], model.sky_share[state.row[p]]
        e = np.ones(w.size) if m == library.sky_index else library.at(w)[m]
        for share, share_sigma in (MIXED_MATERIAL, MIXED_SKY):
            if alpha == share:
                return e, alpha, share_sigma, MIXED_SHARE
        assert alpha == (m == library.sky_index)
        return e, alpha, 0.0, 1 - MIXED_SHARE if environment.sky_mean is not None else 1.0

    def covariance(e, alpha, share_sigma):
        reflected = (1 - alpha) * (1 - e)
        c = np.eye(w.size) + np.diag((reflected * (environment.error_k or 0.0) / 0.1) ** 2)
        rows = [reflected * d / sigma for d in environment.spread]
        rows += [(1 - alpha) * d / sigma for d in environment.curve_spread]
        rows += [alpha * d / sigma for d in environment.sky_spread]
        rows += [share_sigma * (sky_mean - glow) / sigma]
        return c + sum(np.outer(u, u) for u in rows)

    def occam(e, alpha, c, prior):
        sum_zero = np.linalg.qr(np.c_[np.ones(k), np.eye(k)[:, : k - 1]])[0][:, 1:]
        jacobian = np.c_[
            (1 - alpha) * e * planck_derivative(w, t0),
            (1 - alpha) * (1 - e)[:, None] * (environment.radiance.T @ sum_zero),
        ] / sigma[:, None]  # fmt: skip
        fisher = jacobian.T @ np.linalg.solve(c, jacobian)
        variance = np.diag([t_sigma**2] + [v_variance] * (k - 1))
        det = np.linalg.slogdet
        return 0.5 * det(np.eye(k) + variance @ fisher)[1] + 0.5 * det(c)[1] - math.log(prior)

    def shares():
        u = objective.local.energy.astype(float)
        pi = np.full(len(library), 1 / len(library))
        for _ in range(30):
            new = np.zeros(len(library))
            for row in u:
                z = [p * math.exp(row.min() - x) for p, x in zip(pi, row, strict=True)]
                new += np.array(z) / sum(z)
            pi = new / len(u)
        return np.maximum(pi, 1 / u.size)

    pi, out = shares(), []
    for p, spectrum in enumerate(cube.spectra.astype(float)):
        e, alpha, share_sigma, prior = hypothesis(p)
        t, v = state.temperature_k[p], state.thermal_lighting[p]
        ground = e * planck(w, t) + (1 - e) * (v @ environment.radiance)
        r = (spectrum - alpha * sky_mean - (1 - alpha) * ground) / sigma
        c = covariance(e, alpha, share_sigma)
        total = 0.5 * r @ np.linalg.solve(c, r) + occam(e, alpha, c, prior)
        total += (t - t0) ** 2 / (2 * t_sigma**2) + ((v - environment.usual) ** 2).sum() / (
            2 * v_variance
        )
        out.append(total - math.log(pi[state.material[p]]))
    return np.array(out)


def slow_smoothness(scene, state):
    """E's second sum, by double loops."""
    cube, library, sigma = scene.cube, scene.library, noise_sigma(scene.cube.wavelength_um, 0.1)
    (height, width), total = cube.shape, 0.0
    s = cube.radiance.astype(float) / sigma[:, None, None]
    pairs = [
        ((i, j), (i + a, j + b))
        for i in range(height) for j in range(width) for a, b in ((0, 1), (1, 0))
        if i + a < height and j + b < width
    ]  # fmt: skip
    d2 = {(p, q): ((s[:, *p] - s[:, *q]) ** 2).sum() for p, q in pairs}
    typical = semiglobal.EDGE_SCALE * float(np.median(list(d2.values())))
    m, t = state.material.reshape(height, width), state.temperature_k.reshape(height, width)
    for p, q in pairs:
        if m[p] != m[q]:
            d = 1.0
        elif m[p] == library.sky_index:
            d = 0.0
        else:
            d = (t[p] - t[q]) ** 2 / ((t[p] - t[q]) ** 2 + semiglobal.DELTA_K**2)
        total += semiglobal.BETA * math.exp(-d2[p, q] / (2 * typical)) * d
    return total


@pytest.mark.parametrize("spread", [False, True])
@pytest.mark.parametrize("sky", [False, True])
def test_agrees_with_the_formula(spread, sky):
    scene = Scene(curves(4, 1, sky=sky), surroundings(3, spread, sky), (5, 6), 0.1, 3)
    objective = scene.objective()
    rng = np.random.default_rng(0)
    # every hypothesis in turn: each material, with and without a share of sky
    row = rng.permutation(np.arange(30) % len(objective.model.material))
    scattered = State(
        rng.uniform(285, 300, 30), objective.model.material[row], rng.dirichlet(np.ones(3), 30), row
    )
    assert len(set(objective.model.sky_share[row])) == (4 if sky else 1)
    fitted = objective.descend_tv(scattered)[0]
    local = objective.local_state()
    for state in (scattered, fitted, local, smoothed(objective, local).state):
        ours, slow = objective.unaries(state), slow_unaries(scene, objective, state)
        # the Chebyshev series is exact to 0.005 noise units in each band
        slack = 0.02 + 0.005 * np.sqrt(24) * np.sqrt(2 * ours.clip(1))
        assert (np.abs(ours - slow) < slack).all()
        edges = slow_smoothness(scene, state)
        assert objective.smoothness(state) == pytest.approx(edges, rel=1e-6)
        assert objective.value(state) == pytest.approx(ours.sum() + edges, rel=1e-9)


# --- gradients ----------------------------------------------------------------------------------


def test_temperature_is_stationary_where_nothing_smooths_it():
    """Envelope theorem: dE/dT at fixed V is dE/dT with V eliminated, and zero at the answer.

    On a chess board of two materials no neighbours agree, so no term of E couples T.
    """
    scene = Scene(curves(5, 2), surroundings(3), (8, 8), 0.1, 5)
    objective = scene.objective()
    board = np.indices((8, 8)).sum(axis=0).ravel() % 2
    state = objective.state(np.full(64, 290.0), board, np.full((64, 3), 1 / 3))
    state, _, sigma = objective.descend_tv(state)
    inside = np.abs(state.temperature_k - objective.model.mid_k) < objective.model.half_k - 1
    assert inside.mean() > 0.9
    for p in np.flatnonzero(inside):
        step = 0.01 * sigma[p]
        energy = [
            objective.value(
                objective.state(
                    state.temperature_k + sign * step * (np.arange(64) == p),
                    board,
                    state.thermal_lighting,
                )  # fmt: skip
            )
            for sign in (1, -1)
        ]
        # in nats per sigma; away from the answer by one sigma it is about 1
        assert abs(energy[0] - energy[1]) / 0.02 < 2e-3


def test_temperature_is_stationary_where_neighbours_pull():
    """Majorise-minimise comes to rest where data, prior and smoothness balance, not elsewhere."""
    scene = Scene(curves(5, 2), surroundings(3), (6, 6), 0.5, 5)
    objective = scene.objective()
    state = objective.state(np.full(36, 290.0), np.zeros(36, int), np.full((36, 3), 1 / 3))
    for _ in range(200):
        state, _, sigma = objective.descend_tv(state)
    t, slopes, pulls = state.temperature_k.ravel(), [], []
    for p in range(36):
        step = 0.01 * sigma[p] * (np.arange(36) == p)
        sides = [
            objective.state(t + sign * step, state.material, state.thermal_lighting)
            for sign in (1, -1)
        ]
        slopes.append((objective.value(sides[0]) - objective.value(sides[1])) / 0.02)
        pulls.append((objective.smoothness(sides[0]) - objective.smoothness(sides[1])) / 0.02)
    assert np.abs(pulls).max() > 0.1  # nats per sigma: neighbours did pull
    assert np.abs(slopes).max() < 0.01


def torch_objective(scene, objective, temperature_k, material, lighting):
    """The terms of E that depend on T and V, through Eq. 1, differentiable; C = I only."""
    model, k = objective.model, objective.model.k
    as_tensor = lambda a: torch.as_tensor(np.array(a, dtype=np.float64))
    w = as_tensor(scene.cube.wavelength_um)
    e = as_tensor(scene.library.at(scene.cube.wavelength_um)[material])
    s, _ = render(temperature_k, e, lighting, as_tensor(scene.environment.radiance), w)
    chi2 = (((s - as_tensor(scene.cube.spectra)) / as_tensor(model.sigma)) ** 2).sum()
    prior = ((temperature_k - model.prior_mean_k) ** 2).sum() / model.prior_sigma_k**2
    usual = as_tensor(scene.environment.usual)
    prior = prior + V_PRECISION * k * ((lighting - usual) ** 2).sum()
    t, same = temperature_k.reshape(scene.shape), material.reshape(scene.shape)
    smooth = 0.0
    weights = semiglobal.edge_weights(scene.cube.radiance, model.sigma, scene.cube.dead)
    for axis, weight in enumerate(weights):
        d2 = torch.diff(t, dim=axis) ** 2
        agree = as_tensor(np.diff(same, axis=axis) == 0)
        smooth = smooth + (as_tensor(weight) * agree * d2 / (d2 + semiglobal.DELTA_K**2)).sum()
    return 0.5 * chi2 + 0.5 * prior + semiglobal.BETA * smooth


@pytest.mark.parametrize("k", [2, 4])
def test_gradient_through_eq1_is_that_of_the_objective(k):
    """Autograd of the band-by-band E against central differences of `Objective.value`."""
    scene = Scene(curves(5, 4), surroundings(k), (6, 7), 0.1, 6)
    objective = scene.objective()
    rng = np.random.default_rng(1)
    n, start = 42, smoothed(objective, objective.local_state()).state
    t = start.temperature_k.ravel() + rng.normal(size=n) * 0.3
    v = 0.9 * start.thermal_lighting + 0.1 / k
    tensors = [torch.tensor(a, dtype=torch.float64, requires_grad=True) for a in (t, v)]
    torch_objective(scene, objective, tensors[0], start.material, tensors[1]).backward()
    dt, dv = (a.grad.numpy() for a in tensors)

    def along(step_t, step_v):
        plus, minus = (
            objective.value(objective.state(t + s * step_t, start.material, v + s * step_v))
            for s in (1, -1)
        )
        return 0.5 * (plus - minus)

    for _ in range(10):
        ut, uv = rng.normal(size=n), rng.normal(size=(n, k))
        uv -= uv.mean(axis=1, keepdims=True)
        h = 1e-4  # E is 1e3-1e5, so a difference is rounded at 1e-11 / 1e-4
        scale = h * np.sqrt((dt**2).sum()), h * np.sqrt((dv**2).sum())
        # the series' slope is exact to some 0.005 x 36 / 60 K noise units, B' / sigma is 10 / K
        assert along(h * ut, 0 * uv) == pytest.approx(h * (ut @ dt), abs=5e-3 * scale[0])
        assert along(0 * ut, h * uv) == pytest.approx(h * (uv * dv).sum(), abs=5e-3 * scale[1])


# --- what smoothness is for ---------------------------------------------------------------------


def test_beats_the_local_answer_on_piecewise_constant_scenes():
    """Neighbours decide where one pixel's bands cannot: material and T both get better."""
    scores = []
    for seed in range(6):
        rng, environment, shape = np.random.default_rng(seed), surroundings(3), (24, 30)
        library, w = curves(8, 5 + seed, depth=(0.1, 0.25)), environment.wavelength_um
        block = (np.indices(shape)[0] // 8) * 3 + np.indices(shape)[1] // 10
        material = rng.permutation(9)[block] % 8
        temperature = rng.uniform(285, 300, 9)[block]
        lighting = rng.dirichlet(np.ones(3), 9)[block]
        s, _ = render(temperature, library.at(w)[material], lighting, environment.radiance, w)
        s = s + rng.normal(size=s.shape) * noise_sigma(w, 0.2)
        objective, smooth = solve(library, environment, s, 0.2)
        local = unsmoothed(objective.local).state
        scores.append(
            [
                ((a.material != material.ravel()).mean(),
                 ((a.temperature_k.ravel() - temperature.ravel()) ** 2).mean())
                for a in (local, smooth)
            ]
        )  # fmt: skip
    (wrong_before, error_before), (wrong, error) = np.mean(scores, axis=0)
    assert wrong_before > 0.03  # there was something to correct
    assert wrong < 0.6 * wrong_before
    assert np.median(scores, axis=0)[1, 0] < 0.005
    assert np.sqrt(error) < 0.8 * np.sqrt(error_before)


@pytest.fixture(scope="module")
def plain():
    """A field of m0 at 290 K with noise: library, environment, spectra (9, 11, bands), rng."""
    rng = np.random.default_rng(7)
    library, environment = curves(6, 8), surroundings(3)
    w = environment.wavelength_um
    lighting = np.broadcast_to([0.3, 0.4, 0.3], (9, 11, 3))
    e = np.broadcast_to(library.at(w)[0], (9, 11, w.size))
    s, _ = render(np.full((9, 11), 290.0), e, lighting, environment.radiance, w)
    return library, environment, s, rng


def solve(library, environment, s, netd):
    cube = HeatCube(s.transpose(2, 0, 1), environment.wavelength_um, netd_k=netd)
    model = reduce_model(cube, library, environment)
    objective = Objective(model, cube, solve_local(model, cube.spectra))
    return objective, smoothed(objective, objective.local_state()).state


def test_an_isolated_wrong_pixel_is_corrected(plain):
    """A pixel that noise alone made look slightly like another material follows its region."""
    library, environment, s, rng = plain
    w, netd, centre = environment.wavelength_um, 0.05, 4 * 11 + 5
    other = solve_of(library, environment, 1, 290.0)
    clean = solve_of(library, environment, 0, 290.0)
    noise = rng.normal(size=s.shape) * noise_sigma(w, netd)
    for share in np.linspace(0.3, 1.5, 13):  # the least push that fools the local solver
        noisy = s + noise
        noisy[4, 5] = clean + share * (other - clean)
        objective, smooth = solve(library, environment, noisy, netd)
        local = objective.local_state().material
        if local[centre] != 0:
            break
    excess = objective.local.energy[centre, 0] - objective.local.energy[centre].min()
    assert local[centre] != 0 and excess < 3  # fooled, but not by much
    assert smooth.material[centre] == 0
    assert abs(smooth.temperature_k.ravel()[centre] - 290) < 1


def solve_of(library, environment, m, t):
    """Noiseless spectrum of material m at t in the plain scene's light."""
    w = environment.wavelength_um
    s, _ = render(np.array(t), library.at(w)[m], np.array([0.3, 0.4, 0.3]), environment.radiance, w)
    return s


@pytest.mark.parametrize("thing", ["pixel", "wire"])
def test_a_true_thin_object_survives_at_low_noise(plain, thing):
    """Evidence of many nats is not smoothed away: another material, 6 K warmer, one pixel wide."""
    library, environment, s, rng = plain
    w, netd = environment.wavelength_um, 0.02
    there = np.zeros((9, 11), bool)
    there[4, 5 if thing == "pixel" else slice(None)] = True
    s = np.where(there[..., None], solve_of(library, environment, 2, 296.0), s)
    s = s + rng.normal(size=s.shape) * noise_sigma(w, netd)
    _, smooth = solve(library, environment, s, netd)
    np.testing.assert_array_equal(smooth.material.reshape(9, 11), np.where(there, 2, 0))
    truth = np.where(there, 296.0, 290.0)
    assert np.abs(smooth.temperature_k.reshape(9, 11) - truth).max() < 0.3


# --- symmetries ---------------------------------------------------------------------------------


def same_answer(a, b, objective_a, objective_b, pixels, materials):
    """b's pixel i is a's pixel pixels[i], its material j is a's materials[j]."""
    ea, eb = objective_a.value(a.state), objective_b.value(b.state)
    assert ea == pytest.approx(eb, abs=2e-3 * len(pixels))
    agree = materials[b.state.material] == a.state.material[pixels]
    assert agree.mean() > 0.99
    t = a.state.temperature_k.ravel()[pixels] - b.state.temperature_k.ravel()
    assert np.median(np.abs(t)) < 1e-3 and (np.abs(t) < 0.02).mean() > 0.97
    off = np.abs(b.probability - a.probability[pixels][:, materials])
    assert off.max() < 1e-2


@pytest.fixture(scope="module")
def scene():
    return Scene(curves(6, 3, sky=True), surroundings(3, True, True), (20, 26), 0.2, 11)


def test_permuting_the_library_permutes_the_answer(scene):
    order = np.random.default_rng(2).permutation(6)
    a = scene.objective()
    b = scene.objective(library=scene.library.subset([scene.library.names[i] for i in order]))
    pixels = np.arange(20 * 26)
    value = [o.value(o.local_state()) for o in (a, b)]
    assert value[0] == pytest.approx(value[1], abs=1e-3 * len(pixels))
    answers = [smoothed(o, o.local_state()) for o in (a, b)]
    same_answer(*answers, a, b, pixels, order)


@pytest.mark.parametrize("flip", [(slice(None), slice(None, None, -1)), (slice(None, None, -1),)])
def test_flipping_the_picture_flips_the_answer(scene, flip):
    pixels = np.arange(20 * 26).reshape(20, 26)[flip].ravel()
    c = scene.cube
    flipped = HeatCube(c.radiance[:, *flip], c.wavelength_um, netd_k=c.netd_k)
    a, b = scene.objective(), scene.objective(flipped)
    value = [o.value(o.local_state()) for o in (a, b)]
    assert value[0] == pytest.approx(value[1], abs=1e-3 * len(pixels))
    answers = [smoothed(o, o.local_state()) for o in (a, b)]
    same_answer(*answers, a, b, pixels, np.arange(6))


def test_progress_is_reported(scene):
    objective, seen = scene.objective(), []
    smoothed(objective, objective.local_state(), lambda *a: seen.append(a))
    assert seen and all(0 < done <= total for done, total in seen)
    assert [done for done, _ in seen] == sorted({done for done, _ in seen})


@pytest.mark.parametrize("times", [2, 3])
def test_copies_of_pixels_say_nothing_new(times):
    """A resampled picture's edges are those of the original, and between copies there is none."""
    rng = np.random.default_rng(0)
    s = planck(np.linspace(8, 14, 5)[:, None, None], rng.uniform(280, 300, (6, 7)))
    sigma, dead = np.full(5, 0.01), np.zeros((6, 7), bool)
    finer = lambda a: a.repeat(times, axis=-2).repeat(times, axis=-1)
    once = semiglobal.edge_weights(s, sigma, dead)
    below, right = semiglobal.edge_weights(finer(s), sigma, finer(dead))
    between = below[times - 1 :: times], right[:, times - 1 :: times]
    for weight, of_copies, original in zip((below, right), between, once, strict=True):
        axis = int(weight is right)
        np.testing.assert_allclose(of_copies, original.repeat(times, axis=1 - axis))
        assert np.count_nonzero(weight) == np.count_nonzero(of_copies)


def test_nothing_is_smoothed_towards_a_dead_pixel():
    s = planck(
        np.linspace(8, 14, 5)[:, None, None], 290.0 + np.random.default_rng(0).random((6, 7))
    )
    dead = np.zeros((6, 7), bool)
    dead[2, 3] = True
    below, right = semiglobal.edge_weights(s, np.full(5, 0.01), dead)
    assert np.argwhere(below == 0).tolist() == [[1, 3], [2, 3]]
    assert np.argwhere(right == 0).tolist() == [[2, 2], [2, 3]]
