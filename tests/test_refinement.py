"""Gauss-Newton steps on Eq. 1 against a slow minimiser in all bands, the exact solver, and limits.

Spectra are of the k-object model (`World`): they test the solver, never accuracy.
"""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize
from test_evidence import World, dense, hypotheses
from traced import one_thread  # noqa: F401

from physics import MaterialLibrary
from physics.evidence import components, evidence, hermite, tensors
from physics.exact.local import solve_given, solve_local
from physics.exact.reduced import reduce_model
from physics.hypotheses import Blocks, blocks_of
from physics.known import TERMS
from physics.planck import planck, planck_derivative
from physics.refinement import STEPS, Refined, deviations, of_rows, one_hot, refine


def blocks(h, k, precision):
    """Blocks as tensors."""
    h = h._replace(precision=h.precision.numpy())
    return Blocks(**tensors(blocks_of(h, k, precision)._asdict()))


class Start:
    """All that refinement takes: hypotheses, x^ and a guess of V; flat where none is given.

    row (P,) or (P, C), guess (P, k); answers have their pixels first, too.
    """

    def __init__(self, world, row=None, guess=None, precision=1.0, spectra=None, width=1.0):
        self.world, self.known, self.width = world, world.known(), width
        self.s, self.precision = world.scaled(self.known, spectra), precision
        row = torch.as_tensor(world.material if row is None else row)
        self.row = row.reshape(len(self.s), -1).T
        usual = world.environment.usual_lighting
        guess = np.tile(usual, (len(self.s), 1)) if guess is None else guess
        self.guess = torch.as_tensor(guess).float()
        self.set(self.known)

    def set(self, known):
        self.usual = known.usual_lighting
        self.h, k = hypotheses(known), self.world.k
        s = self.s.T.float()
        (self.log_evidence, self.x), self.z = evidence(self.h, s), components(self.h, s)
        self.blocks = blocks(self.h, k, self.precision)
        at = self.row[:, None].expand(-1, k + TERMS, -1)
        self.x_row = self.x.gather(0, at).transpose(0, 1)

    def refine(self, steps=12, t=0.0):
        c = len(self.row)
        t = torch.zeros(len(self.s)) + torch.as_tensor(t, dtype=torch.float32)
        r = refine(
            self.blocks, self.x_row.flatten(1), self.row.flatten(), t.repeat(c),
            self.guess.T.repeat(1, c), self.usual, self.width, steps,
            self.precision,
        )  # fmt: skip
        assert all(a.dtype == torch.float32 for a in r)
        t, sigma, v, energy = (a.unflatten(-1, (c, -1)).double().numpy().T for a in r)
        return Refined(t, sigma, v, energy)

    def total(self, r, every):
        """(P, C) E over the evidence of `every` (`dense`), less what of it depends on h alone: the
        docstring's cost."""
        gauss = [one.occam() - one.log_density(self.s.numpy()) for one in every]
        least = torch.from_numpy(np.array(gauss)).gather(0, self.row)
        _, slope = hermite(torch.from_numpy(r.t.T))  # and of T's prior
        tt = of_rows(self.blocks.tt.double(), one_hot(self.row, len(self.blocks.tt)).double())
        known = ((tt * slope).sum(1) ** 2).sum(0) - (slope[1:] ** 2).sum(0)
        other = known - 1 + self.width**-2
        of_t = 0.5 * torch.log(other / known).T.numpy()
        return (least - self.blocks.determinant[self.row]).T.numpy() + r.energy - of_t


def cost(one, s, guess, precision, width=1.0):
    """Eq. 6 of one pixel and one hypothesis (`Dense`) by bands: a function of (t, V).

    width  standard deviation of the prior on t
    """
    root = np.linalg.cholesky(np.linalg.inv(one.C_d)).T

    def of(x):
        r = root @ (s - one.spectrum(x[0], x[1:]))
        of_t = (x[0] / width) ** 2
        return 0.5 * (r @ r + of_t + 3 * one.k * precision * ((x[1:] - guess) ** 2).sum())

    return of


def slow_minimum(of, k, *starts):
    one = {"type": "eq", "fun": lambda x: x[1:].sum() - 1}
    found = [
        minimize(of, x, method="SLSQP", bounds=[(-6, 6)] + [(0, 1)] * k, constraints=one,
                 options={"maxiter": 300, "ftol": 1e-12})
        for x in starts
    ]  # fmt: skip
    return min(found, key=lambda a: a.fun)


def one_sided(k, n, seed):
    """(n, k) lighting at the bounds: every second by one object alone, the others by few."""
    rng = np.random.default_rng(seed)
    alone = np.eye(k)[rng.integers(k, size=n)]
    return np.where(np.arange(n)[:, None] % 2, alone, rng.dirichlet(np.full(k, 0.2), n))


def slack(one, least, t):
    """What B's series lacks at t changes a cost of chi^2 / 2 by up to chi times that; the rest
    is for float32, in which E is a difference of squares: 1e-3 nats, and 4e-4 of chi."""
    lacks = np.sqrt((one.series_error(t) ** 2).sum())
    return lacks * np.sqrt(2 * least) + 0.5 * lacks**2 + 4e-4 * np.sqrt(2 * least) + 1e-3


@pytest.mark.parametrize(
    ("k", "precision", "width"), [(1, 1.0, 1.0), (2, 4.0, 0.6), (4, 1.0, 0.5), (6, 4.0, 1.0)]
)
@pytest.mark.parametrize("rich", [False, True])
def test_energy_is_the_constrained_cost_and_its_minimum(k, precision, width, rich):
    world = World(k=k, rich=rich, seed=k, shape=(2, 5))
    m, sky = world.material, world.library.sky_index
    rows = np.stack([m, m + 6, np.full(10, sky + 6), (m + 1) % 6], axis=1)  # right, and wrong
    guess = world.rng.dirichlet(np.ones(k), 10)
    start = Start(world, rows, guess, precision, width=width)
    r = start.refine()
    every = dense(start.known)
    total = start.total(r, every)
    for i, (p, c) in enumerate(np.ndindex(rows.shape)):
        x, one = np.r_[r.t[p, c], r.lighting[p, c]], every[rows[p, c]]
        of = cost(one, start.s[p].numpy(), start.guess[p].double().numpy(), precision, width)
        # E is that cost at (T, V) ...
        assert total[p, c] == pytest.approx(of(x), abs=slack(one, of(x), x[0]))
        if i % 2 == c % 2:
            continue
        # ... which is as low as anywhere on the simplex
        slow = slow_minimum(of, k, np.r_[0, np.full(k, 1 / k)], x)
        assert total[p, c] > slow.fun - slack(one, of(x), x[0])
    for p in range(10):  # for the right material
        x, one = np.r_[r.t[p, 0], r.lighting[p, 0]], every[m[p]]
        of = cost(one, start.s[p].numpy(), start.guess[p].double().numpy(), precision, width)
        slow = slow_minimum(of, k, np.r_[0, np.full(k, 1 / k)], x)
        assert total[p, 0] < slow.fun + slack(one, slow.fun, slow.x[0])
        assert x[0] == pytest.approx(slow.x[0], abs=0.05 * r.sigma[p, 0])


@pytest.mark.parametrize(("k", "precision"), [(1, 4.0), (4, 0.5), (6, 4.0)])
def test_determinant_is_that_of_the_moved_prior(k, precision):
    """V' ~ N(V'_0, 1 / kappa) instead of N(0, 1) changes C, whatever V_0; kappa^k is the same for
    all hypotheses and left out."""
    world = World(k=k, seed=k)
    known = world.known()
    ours = blocks(hypotheses(known), k, precision).determinant
    half_log_det = lambda c: 0.5 * np.linalg.slogdet(c)[1]
    for r, one in enumerate(dense(known)):
        of_v = one.F[one.d : one.d + k]
        moved = one.C + (1 / precision - 1) * of_v.T @ of_v
        exact = half_log_det(moved) - half_log_det(one.C) + 0.5 * k * np.log(precision)
        assert ours[r] == pytest.approx(exact, abs=1e-4)


@pytest.mark.parametrize("k", [1, 2, 5])
def test_agrees_with_the_exact_solver(k):
    """T, sigma and V against `solve_given`, which shares nothing of the algebra but the model."""
    world = World(k=k, seed=k, shape=(8, 12), lighting=one_sided(k, 96, k))
    model = reduce_model(world.cube, world.library, world.environment)
    zero = np.zeros(len(world.material))
    for share in (0.0, 0.25):
        theirs_row = np.array([
            np.flatnonzero((model.material == m) & (model.sky_share == share))[0]
            for m in world.material
        ])  # fmt: skip
        s = share * world.environment.sky_mean + (1 - share) * world.spectra
        _, t, v, sigma = solve_given(model, s, theirs_row, zero + model.prior_mean_k, zero, zero)
        prior = world.known().prior_k.tolist()
        assert prior == pytest.approx([model.prior_mean_k, model.prior_sigma_k])
        r = Start(world, world.material + 6 * (share > 0), spectra=s).refine()
        ours_t, ours_sigma = prior[0] + prior[1] * r.t[:, 0], prior[1] * r.sigma[:, 0]
        # the two series of B are exact to 0.005 and 0.002 of one band's noise, and sigma is
        # that of 24 bands: up to sqrt(24) 0.007 sigma if all err together
        assert (np.abs(ours_t - t) < 0.04 * sigma).all()
        np.testing.assert_allclose(r.lighting[:, 0], v, atol=0.01)
        inside = (v > 1e-3).all(axis=1)
        np.testing.assert_allclose(ours_sigma[inside], sigma[inside], rtol=0.01)
        assert inside.sum() > 3
        if k > 1:  # at a bound less is free, so more is known
            assert (~inside).any()
            np.testing.assert_allclose(ours_sigma, sigma, rtol=0.05)


def test_material_by_the_exact_solver_is_that_of_least_refined_energy():
    """Evidence and E together rank materials as -energy of `local` does."""
    world = World(seed=5, shape=(8, 10), depth=(0.05, 0.15))
    local = solve_local(
        reduce_model(world.cube, world.library, world.environment), world.cube.spectra
    )
    rows = np.tile(np.arange(12), (80, 1))
    start = Start(world, rows, spectra=world.cube.spectra)
    score = start.log_evidence.T - torch.from_numpy(start.refine().energy)
    best = torch.logsumexp(score.reshape(80, 2, 6), 1).argmax(1).numpy()
    gap = np.sort(local.energy, axis=1)
    clear = gap[:, 1] - gap[:, 0] > 2  # nats
    assert clear.mean() > 0.5
    assert (best == local.energy.argmin(axis=1))[clear].mean() > 0.95


@settings(max_examples=12)
@given(seed=st.integers(0, 2**31), k=st.integers(1, 10), far=st.floats(0, 5),
       precision=st.sampled_from([0.5, 1.0, 4.0]))  # fmt: skip
def test_lighting_stays_on_the_simplex_whatever_the_spectrum(seed, k, far, precision):
    world = World(k=k, seed=seed % 1000, shape=(3, 4), netd=0.02 if seed % 2 else 0.2)
    rng = np.random.default_rng(seed)
    rows = rng.permuted(np.tile(np.arange(12), (12, 1)), axis=1)[:, :4]
    wild = world.spectra * rng.uniform(0.9, 1.1, world.spectra.shape)
    start = Start(world, rows, rng.dirichlet(np.ones(k), 12), precision, wild)
    t = far * rng.normal(size=12)
    for steps in range(1, 7):
        r = start.refine(steps, t)
        v = r.lighting
        assert (v >= 0).all() and all(np.isfinite(a).all() for a in r) and (r.sigma > 0).all()
        assert (np.abs(r.t) <= 6).all()
        np.testing.assert_allclose(v.sum(axis=-1), 1, atol=1e-5)  # float32
        # never less is known than a priori; at t = 6 this 1 is a difference of 2.7e5, in float32
        assert (r.sigma < 1.02).all()


@pytest.mark.parametrize("off", [-6.0, 0.0, 6.0])
@pytest.mark.parametrize(("k", "at_bounds"), [(1, False), (4, False), (4, True), (10, True)])
@pytest.mark.parametrize(("curves", "sigmas"), [(False, 0.002), (True, 0.02)])
def test_the_usual_steps_are_enough_from_a_few_kelvin_away(off, k, at_bounds, curves, sigmas):
    """Where curves may be off less is known of T, and Eq. 1 farther from straight over that."""
    lighting = one_sided(k, 100, k) if at_bounds else None
    world = World(k=k, seed=2, shape=(10, 10), lighting=lighting, depth=(0.1, 0.6))
    if not curves:
        world.environment = replace(world.environment, curve_spread=None)
    s = Start(world, guess=np.random.default_rng(k).dirichlet(np.ones(k), 100), precision=4.0)
    start = (world.temperature + off - s.known.prior_k[0].item()) / s.known.prior_k[1].item()
    few, many = s.refine(STEPS, start), s.refine(40)
    assert (np.abs(few.t - many.t) < sigmas * many.sigma).all()
    # a five-hundredth of sigma costs 2e-6 nats; another V_j at zero a little more
    assert (few.energy - many.energy).max() < 2e-3
    # a step more changes nothing either way: it has converged
    more = s.refine(STEPS + 1, start)
    assert np.abs(more.energy - few.energy).max() < 2e-3


@pytest.mark.parametrize("k", [2, 4, 6, 8, 10])
@pytest.mark.parametrize("rich", [False, True])
def test_steps_end_at_the_minimum_where_much_of_lighting_is_zero(k, rich):
    """Right materials that reflect well, lit by few of k objects: E at V's bounds."""
    lighting = one_sided(k, 80, k)
    world = World(k=k, seed=k, shape=(8, 10), rich=rich, lighting=lighting, depth=(0.3, 0.9))
    guess = np.random.default_rng(k).dirichlet(np.ones(k), 80)
    start = Start(world, None, guess, 4.0)
    r, every, over = start.refine(STEPS), dense(start.known), []
    for p in range(0, 80, 4 if k > 6 else 2):
        one = every[world.material[p]]
        of = cost(one, start.s[p].numpy(), start.guess[p].double().numpy(), 4.0)
        x = np.r_[r.t[p, 0], r.lighting[p, 0]]
        slow = slow_minimum(of, k, np.r_[0, np.full(k, 1 / k)], x)
        over.append(of(x) - slow.fun)
    assert (r.lighting == 0).any()
    # the order in which V_j are put to zero is a guess, and none is let go again: with five of
    # them one pixel in 20 ended up to 0.98 nats too high
    assert np.mean(np.array(over) > 0.05) <= 0.05 and max(over) < 1.0


@pytest.mark.parametrize("rich", [False, True])
def test_whatever_might_win_comes_to_its_minimum(rich):
    """Rims and wrong materials too: all but what is hopeless anyway."""
    world = World(k=4, seed=4, rich=rich, shape=(4, 10), netd=0.1)
    m, sky = world.material, world.library.sky_index
    rows = np.stack([m + 6, (m + 1) % 6, (m + 2) % 6 + 6, np.full(40, sky + 6)], axis=1)
    start = Start(world, rows, world.rng.dirichlet(np.ones(4), 40), 4.0)
    r, every, over, least = start.refine(STEPS), dense(start.known), [], []
    for p, c in np.ndindex(rows.shape):
        x, one = np.r_[r.t[p, c], r.lighting[p, c]], every[rows[p, c]]
        of = cost(one, start.s[p].numpy(), start.guess[p].double().numpy(), 4.0)
        slow = slow_minimum(of, 4, np.r_[0, np.full(4, 0.25)], x)
        over.append(of(x) - slow.fun)
        least.append(slow.fun)
    over, least = np.array(over), np.array(least)
    hopeful = least < 55  # some 25 nats more than what is right costs: a chance of exp(-25)
    assert 40 < hopeful.sum() < 150
    assert over[hopeful].max() < 0.05
    # the others may be far from theirs where T runs into its bounds, but few are
    assert (over > 0.1 + 0.01 * least).mean() < 0.1


def test_what_stands_before_the_sky_is_found():
    """A quarter black, three quarters sky: T and sigma by the exact solver's model."""
    world = World(k=3, seed=7, shape=(5, 10))
    sky, e = world.library.sky_index, world.environment
    s = 0.75 * e.sky_mean + 0.25 * planck(world.nodes, world.temperature[:, None, None]).mean(-1)
    s = s + world.sigma * world.rng.normal(size=s.shape)
    r = (start := Start(world, np.full(50, sky + 6), spectra=s)).refine(STEPS)
    mean, prior = start.known.prior_k.tolist()
    one, least = dense(start.known)[sky + 6], []
    for p in range(50):
        of = cost(one, start.s[p].numpy(), np.full(3, 1 / 3), 1.0)
        slow = slow_minimum(of, 3, np.r_[0, np.full(3, 1 / 3)], np.r_[r.t[p, 0], 1, 0, 0])
        assert r.t[p, 0] == pytest.approx(slow.x[0], abs=0.05 * r.sigma[p, 0])
        least.append(slow.fun)
    assert np.median(least) < 20
    z = (mean + prior * r.t[:, 0] - world.temperature) / (prior * r.sigma[:, 0])
    assert np.abs(z).max() < 4


def black(n):
    w = np.array([7.0, 15.0])
    library = MaterialLibrary(["black", "mirror"], w, [[1.0, 1.0], [0.02, 0.02]])
    return World(library=library, sky=False, material=np.zeros(n, int), shape=(1, n), k=3)


def test_a_black_body_has_the_temperature_of_its_own_light():
    """e = 1: T by weighted least squares over the bands and the prior, sigma from B' alone."""
    world = black(300)
    start = Start(world, spectra=world.clean)
    r, (mean, prior) = start.refine(), start.known.prior_k.tolist()
    t = mean + prior * r.t[:, 0]
    slope = planck_derivative(world.nodes, world.temperature[:, None, None]).mean(-1)
    exact = ((slope / world.sigma) ** 2).sum(axis=1) ** -0.5
    # 1e-4 of the way to the prior's mean, 30 K away, and 0.002 noise units in each band
    assert np.abs(t - world.temperature).max() < 2e-3
    np.testing.assert_allclose(prior * r.sigma[:, 0], exact, rtol=2e-3)
    usual = np.broadcast_to(world.environment.usual_lighting, r.lighting.shape)
    np.testing.assert_allclose(r.lighting, usual, atol=1e-4)  # nothing else is known of V
    noisy = Start(world)
    z = (mean + prior * noisy.refine().t[:, 0] - world.temperature) / exact
    assert abs(z.mean()) < 5 / np.sqrt(300) and abs(z.std() - 1) < 5 / np.sqrt(600)


def test_what_is_typical_matters_where_the_pixel_does_not_know_better():
    """A black body keeps its T; a mirror, which shows nothing of its own, takes the scene's."""
    world = black(40)
    plain, pulled = Start(world).refine(), Start(world, width=0.5).refine()
    assert (np.abs(plain.t - pulled.t) < 0.01 * plain.sigma + 1e-4).all()
    w = np.array([7.0, 15.0])
    mirror = MaterialLibrary(["mirror", "black"], w, [[1e-5] * 2, [1.0] * 2])
    blank = World(library=mirror, sky=False, material=np.zeros(40, int), shape=(1, 40), k=3)
    r = Start(blank, width=0.5).refine(t=0.8)
    np.testing.assert_allclose(r.t, 0, atol=0.02)
    np.testing.assert_allclose(r.sigma, 0.5, rtol=0.02)


def test_errors_are_as_large_as_sigma_says():
    """Unbounded pixels of the right material: T's z-scores are standard normal."""
    n = 900
    world = World(rich=False, shape=(30, 30), lighting=np.full((n, 3), 1 / 3), netd=0.02, seed=6)
    start = Start(world)
    r, prior = start.refine(), start.known.prior_k.tolist()
    inside = (r.lighting[:, 0] > 0.02).all(axis=1)
    t, sigma = prior[0] + prior[1] * r.t[:, 0], prior[1] * r.sigma[:, 0]
    z = ((t - world.temperature) / sigma)[inside]
    assert inside.mean() > 0.9
    assert abs(z.mean()) < 5 / np.sqrt(len(z)) and abs(z.std() - 1) < 5 / np.sqrt(2 * len(z))


@pytest.mark.parametrize("k", [2, 3])
def test_one_hot_lighting_is_found_where_contrast_is_strong(k):
    """One object alone shines on a good reflector: V is that corner of the simplex."""
    n, w = 60, np.array([7.0, 15.0])
    foil = MaterialLibrary(["foil", "paint"], w, [[0.3, 0.4], [0.9, 0.95]])
    corner = np.arange(n) % k
    world = World(library=foil, sky=False, rich=False, k=k, shape=(6, 10), netd=0.01,
                  material=np.zeros(n, int), lighting=np.eye(k)[corner])  # fmt: skip
    v = Start(world).refine().lighting[:, 0]
    assert (v.argmax(axis=1) == corner).all()
    assert v.max(axis=1).min() > 0.9


def test_a_guess_matters_only_where_the_pixel_does_not_know_better():
    """A black pixel takes over the guess, a mirror the data; a precise guess binds more."""
    world = black(40)
    guess = np.tile([0.7, 0.2, 0.1], (40, 1))
    r = Start(world, guess=guess, precision=4.0).refine()
    np.testing.assert_allclose(r.lighting[:, 0], guess, atol=1e-3)
    mirror = World(library=world.library, sky=False, rich=False, material=np.ones(40, int),
                   shape=(1, 40), k=3, netd=0.02)  # fmt: skip
    v = [Start(mirror, guess=guess, precision=p).refine().lighting[:, 0]
         for p in (0.5, 4.0, 1e6)]  # fmt: skip
    far = [np.abs(a - guess).mean() for a in v]
    assert far[0] >= far[1] > 1.5 * far[2]
    assert np.abs(v[1] @ mirror.environment.radiance - mirror.texture).mean() < 0.05


def test_permuting_the_environment_permutes_lighting_alone():
    world = World(k=4, seed=8)
    start, order = Start(world), [2, 0, 3, 1]
    turned = Start(world)
    of = start.known
    turned.set(of._replace(
        environment=of.environment[order], light=of.light[order],
        usual_lighting=of.usual_lighting[order],
    ))  # fmt: skip
    turned.guess = turned.guess[:, order]
    a, b = start.refine(), turned.refine()
    np.testing.assert_allclose(a.lighting[..., order], b.lighting, atol=2e-3)
    np.testing.assert_allclose(a.t, b.t, atol=0.02 * a.sigma.min())
    np.testing.assert_allclose(a.energy, b.energy, atol=0.01)


def test_deviations_of_the_surroundings_are_found_where_they_show():
    """Known deviations on a mirror, noiseless, come back as their posterior mean does."""
    library = MaterialLibrary(["foil", "paint"], np.array([7.0, 15.0]), [[0.2] * 2, [0.9, 0.95]])
    world = World(library=library, sky=False, material=np.zeros(48, int), netd=0.01)
    z = world.rng.normal(size=(48, 2))
    s, _ = world.render(
        world.material, world.temperature, world.lighting, z @ world.environment.spread
    )
    start = Start(world, spectra=s)
    mean, prior = start.known.prior_k
    t = (torch.as_tensor(world.temperature).float() - mean) / prior
    lighting = torch.as_tensor(world.lighting).float().T
    usual = start.known.usual_lighting
    found = deviations(start.h, start.z, start.x_row[:, 0], start.row[0], t, lighting, usual).T
    one = dense(start.known)[0]
    f = one.F[: one.d] / np.sqrt(one.D)
    rest = start.s.numpy() - np.array(
        [one.spectrum(float(a), v) for a, v in zip(t, world.lighting, strict=True)]
    )
    exact = np.linalg.solve(np.eye(one.d) + f @ f.T, f @ (rest / np.sqrt(one.D)).T).T
    np.testing.assert_allclose(found, exact, atol=5e-3)
    assert np.abs(found[:, :2].numpy() - z).max() < 0.3  # error_k is 30 times this noise
