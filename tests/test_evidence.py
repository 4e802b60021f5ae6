"""Every material's evidence in one matrix product, against dense Gaussians written out in full.

`World` makes spectra from the k-object model, with all that an Environment can hold; they test
the algebra, never accuracy. The tests of refinement, network and model use it too.
"""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial import hermite_e
from scipy.stats import Covariance, multivariate_normal
from traced import one_thread  # noqa: F401

from physics import Environment, HeatCube, MaterialLibrary
from physics.bands import quadrature
from physics.evidence import (
    MAX_COLUMNS,
    TERMS,
    Known,
    _planck_series,
    cholesky,
    evidence,
    hermite,
    hypotheses,
)
from physics.planck import noise_sigma, radiance
from texnet.inputs import known_arrays

FWHM_UM = 0.2


def curves(materials, depth, sky, seed):
    """Smooth random emissivities; the sky, if any, stands second."""
    rng = np.random.default_rng(seed)
    x, w = np.linspace(-1, 1, 141), np.linspace(7.5, 14.5, 141)
    c = np.array([np.polynomial.chebyshev.chebval(x, rng.normal(size=8)) for _ in range(materials)])
    e = 0.98 - rng.uniform(*depth, (materials, 1)) * np.abs(c) / np.abs(c).max(axis=1)[:, None]
    names = [f"m{i}" for i in range(materials)]
    if sky:
        names[1], e[1] = "sky", np.clip(0.1 + np.abs(w - 10.8) / 3.5, 0, 1)
    return MaterialLibrary(names, w, e)


def surroundings(w, k, rich, sky):
    """A cold object and warm ones; rich: with every kind of deviation."""
    cold = np.clip(0.25 + np.abs(w - 10.8) / 3.5, 0, 1) * radiance(w, 285.0)
    warm = [radiance(w, t) * (1 + 0.01 * np.sin(i + w)) for i, t in
            enumerate(np.linspace(280, 310, k - 1))]  # fmt: skip
    more = {}
    if rich:
        more["spread"] = np.stack([0.02 * radiance(w, 290.0) * np.sin(w), 0.01 * cold])
        more["error_k"] = 0.3
    if sky:
        more["sky"] = (0,)
        more["sky_mean"] = 0.6 * cold + 0.4 * radiance(w, 285.0)
        if rich:
            more["skylight_spread"] = 0.03 * cold[None] * np.cos(w)
            more["sky_spread"] = 0.03 * np.stack([cold * np.cos(2 * w), cold])
    return Environment(np.stack([cold, *warm]), w, **more)


class World:
    """A library, an environment and pixels of Eq. 4 with noise: what made them, and Known."""

    def __init__(self, bands=30, k=3, materials=6, sky=True, rich=True, netd=0.05, seed=0,
                 shape=(6, 8), depth=(0.1, 0.3), library=None, material=None, temperature=None,
                 lighting=None, fwhm=FWHM_UM):  # fmt: skip
        rng = np.random.default_rng(seed)
        self.bands, self.k, self.netd, self.shape = bands, k, netd, shape
        self.wavelength = np.linspace(8.15, 13.85, bands)
        self.width = np.full(bands, fwhm)
        self.nodes = quadrature(self.wavelength, self.width)
        self.sigma = noise_sigma(self.wavelength, netd)
        self.library = curves(materials, depth, sky, seed) if library is None else library
        self.environment = surroundings(self.wavelength, k, rich, sky)
        n = shape[0] * shape[1]
        of = lambda given, drawn: drawn if given is None else given  # noqa: E731
        ground = np.setdiff1d(np.arange(len(self.library)), [of(self.library.sky_index, -1)])
        self.material = of(material, rng.choice(ground, n))
        self.temperature = of(temperature, rng.uniform(275, 305, n))
        self.lighting = of(lighting, rng.dirichlet(np.ones(k), n))
        self.clean, self.texture = self.render(self.material, self.temperature, self.lighting)
        self.spectra = self.clean + self.sigma * rng.normal(size=(n, bands))
        self.rng = rng
        self.cube = self.cube_of(self.spectra)

    def render(self, material, temperature, lighting, deviation=0.0):
        """Eq. 1 by band means -> S and X (P, bands)."""
        e = self.library.at(self.nodes.ravel()).reshape(len(self.library), *self.nodes.shape)
        glow = (e[material] * radiance(self.nodes, temperature[:, None, None])).mean(axis=-1)
        texture = lighting @ self.environment.radiance + deviation
        return glow + (1 - e.mean(axis=-1)[material]) * texture, texture

    def cube_of(self, spectra, shape=None):
        s = spectra.T.reshape(self.bands, *(shape or self.shape))
        return HeatCube(s, self.wavelength, self.width, self.netd)

    def known(self, cube=None, library=None, environment=None):
        arrays = known_arrays(
            cube or self.cube, library or self.library, environment or self.environment
        )
        return Known(**{name: torch.from_numpy(a) for name, a in arrays.items()})

    def scaled(self, known, spectra=None):
        """Noise-scaled spectra (P, bands), float64."""
        s = self.spectra if spectra is None else spectra
        return torch.from_numpy(np.asarray(s, np.float64)) / known.sigma.double()


class Dense:
    """One hypothesis in full, from the docstring of `evidence`, band by band in float64.

    mu (bands,), D (bands,) the diagonal part, F (q, bands), log_prior; noise units.
    """

    def __init__(self, known, material, mixed):
        x = Known(*(a.double().numpy() for a in known))
        k, sky, in_view = len(x.environment), bool(x.is_sky[material]), x.sky_mean.max() > 0
        alpha, alpha_sigma = (0.75, 0.15) if sky else (0.25, 0.15)
        if not mixed:
            alpha, alpha_sigma = float(sky), 0.0
        nodes_e = np.ones_like(x.emissivity[0]) if sky else x.emissivity[material]
        e = nodes_e.mean(axis=-1)
        g = (1 - alpha) * (1 - e)
        # Fourier coefficients of B against Hermite polynomials, by brute force
        t = np.linspace(-12, 12, 6001)
        density = np.exp(-0.5 * t * t) / math.sqrt(2 * math.pi) * (t[1] - t[0])
        b = radiance(x.nodes_um, np.maximum(x.prior_k[0] + x.prior_k[1] * t, 30)[:, None, None])
        he = [hermite_e.hermeval(t, np.eye(6)[n]) / math.sqrt(math.factorial(n)) for n in range(6)]
        series = [np.tensordot(density * he[n], b, 1) for n in range(TERMS + 1)]
        glow = [(1 - alpha) * (nodes_e * c).mean(axis=-1) / x.sigma for c in series]
        centre, black = x.environment.mean(axis=0), series[0].mean(axis=-1)
        self.black = black
        self.mu = glow[0] + (g * centre + alpha * x.sky_mean) / x.sigma
        self.D = 1 + (g * x.error / x.sigma) ** 2
        self.d = len(x.spread) + len(x.skylight_spread) + len(x.sky_spread) + 1
        self.F = np.array(
            [g * row / x.sigma for row in x.spread]
            + [g * row / x.sigma for row in x.skylight_spread]
            + [alpha * row / x.sigma for row in x.sky_spread]
            + [alpha_sigma * (x.sky_mean - black) / x.sigma]
            + [g * (s - centre) / math.sqrt(3 * k) / x.sigma for s in x.environment]
            + glow[1:]
        )
        self.series = series
        self.known, self.k, self.g, self.alpha, self.nodes_e = x, k, g, alpha, nodes_e
        self.C = np.diag(self.D) + self.F.T @ self.F
        # of the deviations alone
        self.C_d = np.diag(self.D) + self.F[: self.d].T @ self.F[: self.d]
        if in_view:
            self.log_prior = math.log(0.1 if mixed else 0.9)
        else:
            self.log_prior = -math.inf if mixed or sky else 0.0

    def series_error(self, t):
        """(bands,) what the first terms of B's series lack at t, in noise units."""
        he = [hermite_e.hermeval(t, np.eye(6)[n]) / math.sqrt(math.factorial(n)) for n in range(6)]
        x = self.known
        b = radiance(x.nodes_um, x.prior_k[0] + x.prior_k[1] * t) - np.tensordot(he, self.series, 1)
        return (1 - self.alpha) * (self.nodes_e * b).mean(axis=-1) / x.sigma

    def spectrum(self, t, lighting):
        """Eq. 4 with Planck's law itself, in noise units, t in prior deviations."""
        x = self.known
        b = radiance(x.nodes_um, x.prior_k[0] + x.prior_k[1] * t)
        glow = (1 - self.alpha) * (self.nodes_e * b).mean(axis=-1)
        return (glow + self.g * (lighting @ x.environment) + self.alpha * x.sky_mean) / x.sigma

    def log_density(self, s):
        """(P,) log N(s; mu, C) + log prior, less the constant of 2 pi."""
        normal = multivariate_normal(self.mu, Covariance.from_cholesky(np.linalg.cholesky(self.C)))
        return normal.logpdf(s) + 0.5 * len(self.mu) * math.log(2 * math.pi) + self.log_prior


def dense(known):
    """All hypotheses, in the order of `Hypotheses`."""
    return [Dense(known, m, mixed) for mixed in (False, True) for m in range(len(known.is_sky))]


# --- the density -------------------------------------------------------------------------------


@pytest.mark.parametrize("sky", [False, True])
@pytest.mark.parametrize("k", [1, 3, 10])
@pytest.mark.parametrize("rich", [False, True])
def test_evidence_is_a_dense_gaussian_log_density(sky, k, rich):
    world = World(k=k, sky=sky, rich=rich, materials=4, seed=k)
    known = world.known()
    # spectra of the model, and what no material explains
    wild = world.spectra * world.rng.uniform(0.7, 1.4, world.spectra.shape)
    s = world.scaled(known, np.concatenate([world.spectra[:20], wild[:20]]))
    ours, _ = evidence(hypotheses(known), s)
    for r, one in enumerate(dense(known)):
        if np.isfinite(one.log_prior):
            slow = one.log_density(s.numpy())
            # 1e-8 nats is what is left of s' s ~ 1e8 in float64
            np.testing.assert_allclose(ours[:, r], slow, rtol=1e-6, atol=1e-6)
        else:  # no sky in view: nothing is sky or partly sky, however little else fits
            possible = [i for i, h in enumerate(dense(known)) if np.isfinite(h.log_prior)]
            assert (ours[:, r] < ours[:, possible].amax(dim=1) - 1000).all()


def test_temperature_prior_is_that_of_the_nonlinear_spectrum():
    """The series' outer products add up to the covariance of B(T) itself, by sampling T."""
    known = World().known()
    series = _planck_series(known.nodes_um.double(), known.prior_k.double())[1:, :, 0].numpy()
    mean, deviation = known.prior_k.double().tolist()
    n = 200_000
    t = np.random.default_rng(0).normal(size=n)
    b = radiance(known.nodes_um.double().numpy()[:, 0], mean + deviation * t[:, None])
    sampled, ours = np.cov(b.T), series.T @ series
    # of n samples' covariance the relative standard error is sqrt(2 / n), 0.3 %
    np.testing.assert_allclose(ours, sampled, rtol=5 * math.sqrt(2 / n))


@pytest.mark.parametrize("netd", [0.05, 0.2])
def test_series_of_planck_is_exact_to_a_small_part_of_the_noise(netd):
    known = World(netd=netd).known()
    series = _planck_series(known.nodes_um.double(), known.prior_k.double())
    mean, deviation = known.prior_k.double()
    t = torch.linspace(-2, 2, 81, dtype=torch.float64)
    h = torch.cat([torch.ones(81, 1, dtype=torch.float64), hermite(t)[0]], dim=1)
    b = torch.einsum("tn,nbq->tb", h, series) / series.shape[2]
    exact = radiance(known.nodes_um.double(), (mean + deviation * t)[:, None, None]).mean(-1)
    error = ((b - exact) / known.sigma).abs().max()
    # the first term left out, of order 6 of a prior of 15 K: 2e-3 of 50 mK
    assert error < 0.005 * 0.05 / netd
    assert known.prior_k[1] == 15


def test_hermite_polynomials_are_orthonormal_and_their_slopes_are_their_derivatives():
    x, w = hermite_e.hermegauss(30)
    value, slope = hermite(torch.from_numpy(x))
    gram = (value * torch.from_numpy(w / w.sum())[:, None]).T @ value
    np.testing.assert_allclose(gram, np.eye(TERMS), atol=1e-12)
    for n in range(1, TERMS + 1):
        unit = np.eye(TERMS + 1)[n] / math.sqrt(math.factorial(n))
        np.testing.assert_allclose(value[:, n - 1], hermite_e.hermeval(x, unit), rtol=1e-9)
        np.testing.assert_allclose(
            slope[:, n - 1], hermite_e.hermeval(x, hermite_e.hermeder(unit)), rtol=1e-9
        )


def test_what_other_coefficients_cost():
    """log p(s, z | h) = log p(s | h) - |y - L' z|^2 / 2, up to what does not depend on z."""
    world = World(k=4)
    known = world.known()
    h, s = hypotheses(known), world.scaled(known)[:10]
    _, y = evidence(h, s)
    z, s = np.random.default_rng(1).normal(size=y.shape[2]), s.numpy()
    for r, one in enumerate(dense(known)):
        joint = lambda z: ((s - one.mu - z @ one.F) ** 2 / one.D).sum(1) / 2 + z @ z / 2  # noqa: B023, E731
        # C^-1 F', the posterior mean of z, is where the joint density is largest
        best = (s - one.mu) @ np.linalg.solve(one.C, one.F.T)
        least = np.array([joint(b)[i] for i, b in enumerate(best)])
        factor = h.factor[r].numpy()
        np.testing.assert_allclose(y[:, r], best @ factor.T, rtol=1e-6, atol=1e-5)
        ours = 0.5 * ((y[:, r].numpy() - factor @ z) ** 2).sum(axis=1)
        np.testing.assert_allclose(joint(z) - least, ours, rtol=1e-6)
        # L' is triangular, T needs no V
        assert np.abs(np.tril(factor, -1)).max() < 1e-13 * np.abs(factor).max()


def test_slope_of_the_evidence_is_the_weighted_misfit():
    """d log p / d s = -C^-1 (s - mu): what autograd, differences and algebra say."""
    world = World(bands=8, materials=3)
    known = world.known()
    h = hypotheses(known)
    s = world.scaled(known)[:3].requires_grad_()
    slope = torch.autograd.grad(evidence(h, s)[0][:, 0].sum(), s)[0]
    one = Dense(known, 0, False)
    slow = -np.linalg.solve(one.C, (s.detach().numpy() - one.mu).T).T
    np.testing.assert_allclose(slope, slow, rtol=1e-5, atol=1e-5 * np.abs(slow).max())
    # in units of 1000 noise deviations, so that steps of 1e-6 are not lost in s
    assert torch.autograd.gradcheck(lambda x: evidence(h, 1000 * x)[0] / 1e3, s.detach().div(1000)
                                    .requires_grad_(), rtol=1e-4, atol=1e-3)  # fmt: skip


def test_nothing_is_lost_to_rounding_where_noise_is_least():
    """At 10 mK and 100 bands C spans 1e9; its evidence in extended precision."""
    world = World(bands=100, k=8, netd=0.01, materials=3)
    known = world.known()
    s = world.scaled(known)[:6]
    ours, _ = evidence(hypotheses(known), s)
    for r, one in enumerate(dense(known)):
        x = lambda a: np.asarray(a, np.longdouble)  # noqa: E731
        c = np.diag(x(one.D)) + x(one.F).T @ x(one.F)
        low = np.zeros_like(c)
        for i in range(len(c)):
            low[i, i] = np.sqrt(c[i, i] - low[i, :i] @ low[i, :i])
            low[i + 1 :, i] = (c[i + 1 :, i] - low[i + 1 :, :i] @ low[i, :i]) / low[i, i]
        rest = (x(s.numpy()) - x(one.mu)).T
        for i in range(len(c)):
            rest[i] = (rest[i] - low[i, :i] @ rest[:i]) / low[i, i]
        exact = -0.5 * (rest**2).sum(axis=0) - np.log(np.diagonal(low)).sum() + one.log_prior
        assert np.isfinite(exact).all()
        # 1e-3 nats change no decision
        np.testing.assert_allclose(ours[:, r], exact.astype(float), rtol=1e-6, atol=1e-3)


# --- the factorisation -------------------------------------------------------------------------


@settings(max_examples=40, deadline=None)
@given(q=st.integers(1, MAX_COLUMNS), seed=st.integers(0, 2**31), decades=st.floats(-2, 4))
def test_factorisation_agrees_with_lapack(q, seed, decades):
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(3, q, rng.integers(1, 40))) * 10 ** rng.uniform(-2, decades, (3, q, 1))
    gram = rows @ rows.transpose(0, 2, 1)
    lower, inverse = (x.numpy() for x in cholesky(torch.from_numpy(gram)))
    exact = np.linalg.cholesky(np.eye(q) + gram)
    assert lower.shape == inverse.shape == gram.shape
    # both are backward stable: rounding enters through the condition, of which L has the root
    slack = 1e-15 * q * np.linalg.cond(np.eye(q) + gram).max() + 1e-13
    scale = np.abs(exact).max(axis=(1, 2), keepdims=True)
    assert (np.abs(lower - exact) < slack * scale).all()
    assert (np.abs(lower @ lower.transpose(0, 2, 1) - gram - np.eye(q)) < 1e-13 * scale**2).all()
    assert np.abs(inverse @ lower - np.eye(q)).max() < slack


def test_factorisation_at_every_size():
    for q in range(1, MAX_COLUMNS + 1):
        rows = np.random.default_rng(q).normal(size=(2, q, q + 3)) * 30
        gram = rows @ rows.transpose(0, 2, 1)
        lower, inverse = (x.numpy() for x in cholesky(torch.from_numpy(gram)))
        exact = np.linalg.cholesky(np.eye(q) + gram)
        np.testing.assert_allclose(lower, exact, atol=1e-11 * np.abs(exact).max())
        np.testing.assert_allclose(inverse @ exact, np.eye(q)[None].repeat(2, 0), atol=1e-9)


# --- what it decides ---------------------------------------------------------------------------


def test_rows_that_say_nothing_change_nothing():
    """Deviations of length zero are no deviations, at any number of columns."""
    world = World(k=3)
    known = world.known()
    wider = known._replace(
        spread=torch.cat([known.spread, torch.zeros(3, world.bands)]),
        sky_spread=torch.cat([torch.zeros(2, world.bands), known.sky_spread]),
    )
    s = world.scaled(known)
    np.testing.assert_allclose(
        evidence(hypotheses(wider), s)[0], evidence(hypotheses(known), s)[0], rtol=1e-10, atol=1e-7
    )


def test_permutations():
    world = World(k=4)
    known, s = world.known(), world.scaled(world.known())
    ours, _ = evidence(hypotheses(known), s)
    order = np.random.default_rng(2).permutation(6)
    shuffled = known._replace(emissivity=known.emissivity[order], is_sky=known.is_sky[order])
    both = np.concatenate([order, 6 + order])
    np.testing.assert_allclose(evidence(hypotheses(shuffled), s)[0], ours[:, both], rtol=1e-9)
    turned = known._replace(environment=known.environment[[2, 0, 3, 1]])
    np.testing.assert_allclose(evidence(hypotheses(turned), s)[0], ours, rtol=1e-9, atol=1e-6)


def test_ranks_the_true_material_first_where_materials_are_well_apart():
    world = World(shape=(20, 20), bands=50, depth=(0.3, 0.6), seed=3)
    known = world.known()
    log_p, _ = evidence(hypotheses(known), world.scaled(known))
    assert (log_p.argmax(dim=1).numpy() == world.material).mean() > 0.99
    assert len(set(world.material)) == 5


def test_probabilities_are_those_of_the_model_itself():
    """Of spectra drawn from the hypotheses with their prior shares, as many are right as the
    posterior probabilities promise: determinants and priors are those of one distribution."""
    world = World(bands=12, netd=0.5, materials=5, depth=(0.02, 0.1))
    known, rng = world.known(), np.random.default_rng(0)
    every, n = dense(known), 4000
    prior = np.exp([one.log_prior for one in every])
    truth = rng.choice(len(every), n, p=prior / prior.sum())
    s = np.empty((n, world.bands))
    for r, one in enumerate(every):
        of = truth == r
        s[of] = one.mu + rng.normal(size=(of.sum(), world.bands)) @ np.linalg.cholesky(one.C).T
    p = torch.softmax(evidence(hypotheses(known), torch.from_numpy(s))[0], dim=1).numpy()
    right = p.argmax(axis=1) == truth
    assert 0.2 < right.mean() < 0.9  # confusable
    claimed = p.max(axis=1)
    error = math.sqrt((claimed * (1 - claimed)).sum()) / n
    assert abs(right.mean() - claimed.mean()) < 4 * error
    for r in range(len(every)):
        error = math.sqrt((p[:, r] * (1 - p[:, r])).sum()) / n
        assert abs((truth == r).mean() - p[:, r].mean()) < 4 * error


def sky_pixels(world, n, rng):
    e = world.environment
    s = e.sky_mean + rng.normal(size=(n, len(e.sky_spread))) @ e.sky_spread
    return s + world.sigma * rng.normal(size=s.shape)


def test_a_sky_pixel_is_sky_and_a_rim_is_partly_sky():
    world, rng = World(bands=50), np.random.default_rng(4)
    known, sky = world.known(), world.library.sky_index
    h = hypotheses(known)
    log_p, _ = evidence(h, world.scaled(known, sky_pixels(world, 100, rng)))
    assert (log_p.argmax(dim=1) == sky).float().mean() > 0.95  # else a little before it
    assert (log_p.argmax(dim=1) % 6 == sky).float().mean() > 0.95
    share = rng.normal(0.25, 0.1, (48, 1)).clip(0.1, 0.4)
    rim = (1 - share) * world.spectra + share * sky_pixels(world, 48, rng)
    log_p, _ = evidence(h, world.scaled(known, rim))
    best = log_p.argmax(dim=1).numpy()
    assert (best >= 6).all()
    assert (best % 6 == world.material).mean() > 0.9
    np.testing.assert_allclose(h.share, [0, 1, 0, 0, 0, 0, 0.25, 0.75, 0.25, 0.25, 0.25, 0.25])


def test_nothing_is_sky_where_no_sky_is_in_view():
    """Not even what nothing else in the library explains: a grey pixel at the least noise."""
    world = World(bands=60, netd=0.01, k=2)
    blind = Environment(
        world.environment.radiance, world.wavelength, spread=world.environment.spread
    )
    known = world.known(environment=blind)
    grey = 0.7 * world.spectra + 0.3 * world.spectra.mean(axis=1, keepdims=True)
    cold = sky_pixels(world, 20, np.random.default_rng(0))
    s = world.scaled(known, np.concatenate([world.spectra, grey, cold]))
    log_p, _ = evidence(hypotheses(known), s)
    best = log_p.argmax(dim=1)
    assert (best < 6).all() and (best != world.library.sky_index).all()


def test_a_mirror_pays_for_what_it_can_imitate():
    """What black explains at once, a mirror explains by tuning V: Occam decides for black."""
    world = World(sky=False, rich=False, materials=2, library=MaterialLibrary(
        ["mirror", "black"], np.array([7.0, 15.0]), np.array([[0.02] * 2, [0.999] * 2])
    ), material=np.ones(48, int))  # fmt: skip
    known = world.known()
    log_p, _ = evidence(hypotheses(known), world.scaled(known))
    assert (log_p[:, 1] > log_p[:, 0]).all()
