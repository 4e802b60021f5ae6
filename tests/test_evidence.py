"""Every material's evidence in one matrix product, against dense Gaussians written out in full.

`World` makes spectra from the k-object model, with all that an Environment can hold; they test
the algebra, never accuracy. The tests of refinement, network and model use it too.
"""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.polynomial import hermite_e
from scipy.stats import Covariance, multivariate_normal
from traced import one_thread  # noqa: F401

from physics import Environment, HeatCube, InputError, MaterialLibrary
from physics.bands import quadrature
from physics.evidence import components, evidence, hermite, tensors
from physics.expected import only
from physics.hypotheses import (
    Hypotheses,
    _cholesky,
    hypotheses_of,
    of_materials,
    part_of,
    planck_series,
    set_up,
)  # fmt: skip
from physics.known import MAX_COMPONENTS, MAX_T, TERMS, Known, known_arrays
from physics.planck import noise_sigma, planck

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


def surroundings(w, nodes, k, rich, sky):
    """A cold object and warm ones; rich: with every kind of deviation, and the sky uneven within
    bands."""
    cold = np.clip(0.25 + np.abs(w - 10.8) / 3.5, 0, 1) * planck(w, 285.0)
    warm = [planck(w, t) * (1 + 0.01 * np.sin(i + w)) for i, t in
            enumerate(np.linspace(280, 310, k - 1))]  # fmt: skip
    more = {"usual_lighting": np.arange(1, k + 1) / np.arange(1, k + 1).sum()}
    if rich:
        more["spread"] = np.stack([0.02 * planck(w, 290.0) * np.sin(w), 0.01 * cold])
        more["error_k"] = 0.3
    if sky:
        more["sky"] = (0,)
        more["sky_mean"] = 0.6 * cold + 0.4 * planck(w, 285.0)
        if rich:
            more["skylight_spread"] = 0.03 * cold[None] * np.cos(w)
            more["curve_spread"] = 0.01 * np.stack([cold, np.cos(3 * w), np.sin(w)])
            more["sky_spread"] = 0.03 * np.stack([cold * np.cos(2 * w), cold])
            more["within"] = 1 + 0.3 * np.sin(30 * nodes)[None]
    return Environment(np.stack([cold, *warm]), w, **more)


class World:
    """A library, an environment and pixels of Eq. 1 with noise: what made them, and Known."""

    def __init__(self, bands=MAX_COMPONENTS, k=3, materials=6, sky=True, rich=True, netd=0.05,
                 seed=0, shape=(6, 8), depth=(0.1, 0.3), library=None, material=None,
                 temperature=None, lighting=None, fwhm=FWHM_UM):  # fmt: skip
        rng = np.random.default_rng(seed)
        self.bands, self.k, self.netd, self.shape = bands, k, netd, shape
        self.wavelength = np.linspace(8.15, 13.85, bands)
        self.width = np.full(bands, fwhm)
        self.nodes = quadrature(self.wavelength, self.width)
        self.sigma = noise_sigma(self.wavelength, netd)
        self.library = curves(materials, depth, sky, seed) if library is None else library
        self.environment = surroundings(self.wavelength, self.nodes, k, rich, sky)
        n = shape[0] * shape[1]
        of = lambda given, drawn: drawn if given is None else given
        ground = np.setdiff1d(np.arange(len(self.library)), [of(self.library.sky_index, -1)])
        self.material = of(material, rng.choice(ground, n))
        self.temperature = of(temperature, rng.uniform(275, 305, n))
        self.lighting = of(lighting, rng.dirichlet(np.ones(k), n))
        self.clean, self.texture = self.render(self.material, self.temperature, self.lighting)
        self.spectra = self.clean + self.sigma * rng.normal(size=(n, bands))
        self.rng = rng
        self.cube = self.cube_of(self.spectra)

    def render(self, material, temperature, lighting, deviation=0.0):
        """Eq. 1 within bands -> means of S and X (P, bands)."""
        e = self.library.at(self.nodes.ravel()).reshape(len(self.library), *self.nodes.shape)
        e = e[material]
        glow = e * planck(self.nodes, temperature[:, None, None])
        texture = np.tensordot(lighting, self.environment.at_nodes(self.nodes), 1)
        texture = texture + np.asarray(deviation)[..., None]
        return (glow + (1 - e) * texture).mean(axis=-1), texture.mean(axis=-1)

    def cube_of(self, spectra, shape=None):
        s = spectra.T.reshape(self.bands, *(shape or self.shape))
        return HeatCube(s, self.wavelength, self.width, self.netd)

    def known(self, cube=None, library=None, environment=None):
        arrays = known_arrays(
            cube or self.cube, library or self.library, environment or self.environment
        )
        return Known(**tensors(arrays))

    def scaled(self, known, spectra=None):
        """Noise-scaled spectra (P, bands), float64."""
        s = self.spectra if spectra is None else spectra
        return torch.from_numpy(np.asarray(s, np.float64)) / known.sigma.double()

    def pixels(self, known, spectra=None):
        """The same as `evidence` takes them: (bands, P), float32."""
        return self.scaled(known, spectra).T.float()


def arrays_of(known):
    """A Known of tensors as a dict of arrays."""
    return {name: a.numpy() for name, a in known._asdict().items()}


def hypotheses(known):
    """Hypotheses as tensors."""
    return Hypotheses(**tensors(hypotheses_of(arrays_of(known))._asdict()))


def scene(known):
    """What a model is told, as tensors."""
    return tensors(set_up(arrays_of(known)))


def directions(known):
    """U (d, bands): the basis's rows at length one, float64."""
    u = known.basis.double().numpy()
    return u / np.linalg.norm(u, axis=1, keepdims=True)


class Dense:
    """One hypothesis in full, from the docstring of `hypotheses`, band by band in float64.

    mu (bands,), D (bands,) the diagonal part, F (q, bands), C and C_d (bands, bands), log_prior;
    noise units. Of all bands, whatever the basis.
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
        b = planck(x.nodes_um, np.maximum(x.prior_k[0] + x.prior_k[1] * t, 30)[:, None, None])
        he = [hermite_e.hermeval(t, np.eye(6)[n]) / math.sqrt(math.factorial(n)) for n in range(6)]
        series = [np.tensordot(density * he[n], b, 1) for n in range(TERMS + 1)]
        glow = [(1 - alpha) * (nodes_e * c).mean(axis=-1) / x.sigma for c in series]
        light = [((1 - alpha) * (1 - nodes_e) * s).mean(axis=-1) for s in x.light]
        usual, centre = x.usual_lighting @ np.array(light), np.mean(light, axis=0)
        black = series[0].mean(axis=-1)
        self.black, self.light = black, np.array(light)
        self.mu = glow[0] + (usual + alpha * x.sky_mean) / x.sigma
        self.D = 1 + (g * x.error / x.sigma) ** 2
        self.d = len(x.spread) + len(x.skylight_spread)
        self.d += len(x.curve_spread) + len(x.sky_spread) + 1
        self.F = np.array(
            [g * row / x.sigma for row in x.spread]
            + [g * row / x.sigma for row in x.skylight_spread]
            + [(1 - alpha) * row / x.sigma for row in x.curve_spread]
            + [alpha * row / x.sigma for row in x.sky_spread]
            + [alpha_sigma * (x.sky_mean - black) / x.sigma]
            + [(s - centre) / math.sqrt(3 * k) / x.sigma for s in light]
            + glow[1:]
        )
        self.series = series
        self.U = directions(known)
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
        b = planck(x.nodes_um, x.prior_k[0] + x.prior_k[1] * t) - np.tensordot(he, self.series, 1)
        return (1 - self.alpha) * (self.nodes_e * b).mean(axis=-1) / x.sigma

    def spectrum(self, t, lighting):
        """Eq. 1 with Planck's law itself, in noise units, t in prior deviations."""
        x = self.known
        b = planck(x.nodes_um, x.prior_k[0] + x.prior_k[1] * t)
        glow = (1 - self.alpha) * (self.nodes_e * b).mean(axis=-1)
        return (glow + lighting @ self.light + self.alpha * x.sky_mean) / x.sigma

    def log_density(self, s):
        """(P,) log N(s; mu, C) + log prior, less the constant of 2 pi."""
        normal = multivariate_normal(self.mu, Covariance.from_cholesky(np.linalg.cholesky(self.C)))
        return normal.logpdf(s) + 0.5 * len(self.mu) * math.log(2 * math.pi) + self.log_prior

    def occam(self):
        """What does not depend on s, of the density of z: of s too, where the basis is complete."""
        u = self.U
        return self.log_prior - 0.5 * np.linalg.slogdet(u @ self.C @ u.T)[1]

    def seen_log_density(self, s):
        """(P,) log N(U s; U mu, U C U') + log prior, in extended precision."""
        u, diagonal, f, mu, s = (
            np.asarray(a, np.longdouble) for a in (self.U, self.D, self.F, self.mu, s)
        )
        # U is orthogonal to float32; `hypotheses` takes the noise of z to be white
        c = np.eye(len(u)) + (u * (diagonal - 1)) @ u.T + (f @ u.T).T @ (f @ u.T)
        low, rest = np.zeros_like(c), u @ (s - mu).T
        for i in range(len(c)):
            low[i, i] = np.sqrt(c[i, i] - low[i, :i] @ low[i, :i])
            low[i + 1 :, i] = (c[i + 1 :, i] - low[i + 1 :, :i] @ low[i, :i]) / low[i, i]
        for i in range(len(c)):
            rest[i] = (rest[i] - low[i, :i] @ rest[:i]) / low[i, i]
        log_density = -0.5 * (rest**2).sum(axis=0) - np.log(np.diagonal(low)).sum()
        assert np.isfinite(log_density).all()
        return (log_density + self.log_prior).astype(float)


def dense(known):
    """All hypotheses, in the order of `Hypotheses`: mixed where there is sky to mix with."""
    kinds = (False, True) if known.sky_mean.any() and known.is_sky.any() else (False,)
    return [Dense(known, m, mixed) for mixed in kinds for m in range(len(known.is_sky))]


# float32 at 50 mK: 7e-3 nats at most for what fits (0.025 where surroundings are one spectrum,
# known exactly), and 2e-5 of a misfit
ATOL, ATOL_ALL_KNOWN, RTOL = 0.01, 0.05, 4e-5


def close(ours, slow, atol=ATOL, rtol=RTOL):
    np.testing.assert_allclose(ours, slow, rtol=rtol, atol=atol)


# --- the density -------------------------------------------------------------------------------


@pytest.mark.parametrize("sky", [False, True])
@pytest.mark.parametrize("k", [1, 3, 10])
@pytest.mark.parametrize("rich", [False, True])
def test_evidence_is_a_dense_gaussian_log_density(sky, k, rich):
    """Of all bands, where they are not more than the components."""
    world = World(k=k, sky=sky, rich=rich, materials=4, seed=k)
    known = world.known()
    # spectra of the model, and what no material explains
    wild = world.spectra * world.rng.uniform(0.7, 1.4, world.spectra.shape)
    spectra = np.concatenate([world.spectra[:20], wild[:20]])
    ours, _ = evidence(hypotheses(known), world.pixels(known, spectra))
    assert ours.dtype == torch.float32
    every = dense(known)
    assert len(ours) == len(every) == (8 if sky else 4)
    possible = [r for r, one in enumerate(every) if np.isfinite(one.log_prior)]
    for r, one in enumerate(every):
        if r in possible:
            atol = ATOL_ALL_KNOWN if k == 1 and not rich else ATOL
            close(ours[r], one.log_density(world.scaled(known, spectra).numpy()), atol)
        else:  # no sky in view: nothing is sky or partly sky, however little else fits
            assert (ours[r] < ours[possible].amax(dim=0) - 1000).all()


@pytest.mark.parametrize("bands", [MAX_COMPONENTS, 60])
def test_of_a_quiet_camera_it_is_what_it_would_be_in_the_mean_with_the_noise_that_is_missing(bands):
    """Which two draws in each band, of opposite sign, give exactly: it is quadratic in spectra."""
    world = World(bands, seed=3)
    quiet = world.rng.uniform(0, 1, bands)
    known = world.known()
    h, pixels = hypotheses(known), world.pixels(known)
    step = torch.from_numpy(np.diag(np.sqrt(bands * quiet))).float()
    draws = [evidence(h, pixels + sign * b[:, None])[0] for b in step for sign in (-1, 1)]
    ours, _ = evidence(hypotheses(known._replace(quiet=torch.from_numpy(quiet).float())), pixels)
    close(ours, torch.stack(draws).double().mean(0), atol=0.02)
    missing = evidence(h, pixels)[0] - ours
    assert (missing > 1).all() and np.ptp(missing[:, 0].numpy()) > 0.5  # of some materials less


@pytest.mark.parametrize("bands", [25, 60])
def test_of_many_bands_it_is_the_density_of_the_components(bands):
    world = World(bands, k=5, seed=2)
    known = world.known()
    assert known.basis.shape == (MAX_COMPONENTS, bands)
    wild = world.spectra * world.rng.uniform(0.7, 1.4, world.spectra.shape)
    spectra = np.concatenate([world.spectra[:20], wild[:20]])
    h, s = hypotheses(known), world.pixels(known, spectra)
    (ours, x), z = evidence(h, s), components(h, s)
    assert ours.shape == (12, 40) and x.shape == (12, 5 + TERMS, 40) and z.shape == (24, 40)
    for r, one in enumerate(dense(known)):
        close(ours[r], one.seen_log_density(world.scaled(known, spectra).numpy()))


@pytest.mark.parametrize("bands", [1, 4, 24, 25, 100])
@pytest.mark.parametrize("rich", [False, True])
def test_basis_is_orthogonal_and_of_few_bands_complete(bands, rich):
    world = World(bands, rich=rich, k=5, netd=0.02, shape=(40, 50))
    known = world.known()
    u = directions(known)
    assert u.shape == (min(bands, MAX_COMPONENTS), bands)
    np.testing.assert_allclose(u @ u.T, np.eye(len(u)), atol=1e-6)
    if bands <= MAX_COMPONENTS:
        np.testing.assert_allclose(u.T @ u, np.eye(bands), atol=1e-6)
    # what is not looked at differs by less than noise
    s = world.scaled(known, world.clean).numpy()
    s = s - s.mean(axis=0)
    assert np.sqrt(((s - s @ u.T @ u) ** 2).mean()) < 0.1


@pytest.mark.parametrize("bands", [24, 60])
def test_components_have_about_unit_variance(bands):
    """So that nothing but what does not fit is large in float32."""
    world = World(bands, k=5, shape=(30, 40))
    known = world.known()
    h = hypotheses(known)
    mean = np.mean([one.mu for one in dense(known)], axis=0)
    np.testing.assert_allclose(h.centre, mean, rtol=1e-5)
    z = components(h, world.pixels(known))
    exact = h.basis.double().numpy() @ (world.scaled(known).numpy() - mean).T
    # s and the mean are numbers of 1e3 in float32: 1e-4 each
    np.testing.assert_allclose(z, exact, atol=3e-4)
    assert 0.2 < z.std(dim=1).min() and z.std(dim=1).max() < 1.01 and z.mean(dim=1).abs().max() < 3


def test_temperature_prior_is_that_of_the_nonlinear_spectrum():
    """The series' outer products add up to the covariance of B(T) itself, by sampling T."""
    known = World().known()
    series = planck_series(*(a.double().numpy() for a in (known.nodes_um, known.prior_k)))[1:, :, 0]
    mean, deviation = known.prior_k.double().tolist()
    n = 200_000
    t = np.random.default_rng(0).normal(size=n)
    b = planck(known.nodes_um.double().numpy()[:, 0], mean + deviation * t[:, None])
    sampled, ours = np.cov(b.T), series.T @ series
    # of n samples' covariance the relative standard error is sqrt(2 / n), 0.3 %
    np.testing.assert_allclose(ours, sampled, rtol=5 * math.sqrt(2 / n))


@pytest.mark.parametrize("netd", [0.05, 0.2])
def test_series_of_planck_is_exact_to_a_small_part_of_the_noise(netd):
    known = World(netd=netd).known()
    series = planck_series(*(a.double().numpy() for a in (known.nodes_um, known.prior_k)))
    mean, deviation = known.prior_k.double()
    t = torch.linspace(-2, 2, 81, dtype=torch.float64)
    h = torch.cat([torch.ones(1, 81, dtype=torch.float64), hermite(t)[0]])
    b = torch.einsum("nt,nbq->tb", h, torch.from_numpy(series)) / series.shape[2]
    exact = planck(known.nodes_um.double(), (mean + deviation * t)[:, None, None]).mean(-1)
    error = ((b - exact) / known.sigma).abs().max()
    # the first term left out, of order 6 of a prior of 15 K: 2e-3 of 50 mK
    assert error < 0.005 * 0.05 / netd
    assert known.prior_k[1] == 15


def test_hermite_polynomials_are_orthonormal_and_their_slopes_are_their_derivatives():
    x, w = hermite_e.hermegauss(30)
    value, slope = hermite(torch.from_numpy(x))
    gram = (value * torch.from_numpy(w / w.sum())) @ value.T
    np.testing.assert_allclose(gram, np.eye(TERMS), atol=1e-12)
    for n in range(1, TERMS + 1):
        unit = np.eye(TERMS + 1)[n] / math.sqrt(math.factorial(n))
        np.testing.assert_allclose(value[n - 1], hermite_e.hermeval(x, unit), rtol=1e-9)
        derivative = hermite_e.hermeval(x, hermite_e.hermeder(unit))
        np.testing.assert_allclose(slope[n - 1], derivative, rtol=1e-9)


def test_what_other_unknowns_cost():
    """log p(z, x | h), deviations being free, is log p(z | h) less (x - x^)' S^-1 (x - x^) / 2, up
    to what does not depend on x; and the likeliest deviations are those at x."""
    world = World(k=4)
    known = world.known()
    h, s = hypotheses(known), world.scaled(known)[:10].numpy()
    _, x_hat = evidence(h, world.pixels(known)[:, :10])
    z = components(h, world.pixels(known)[:, :10])
    rng = np.random.default_rng(1)
    for r, one in enumerate(dense(known)):
        f_d, f_x = one.F[: one.d], one.F[one.d :]
        weight = np.linalg.inv(one.C_d)

        def joint(x, mu=one.mu, f_x=f_x, weight=weight):
            rest = s - mu - x @ f_x
            return 0.5 * ((rest @ weight) * rest).sum(1) + 0.5 * (x * x).sum(1)

        # C^-1 F', the posterior mean of x, is where the joint density is largest
        best = (s - one.mu) @ np.linalg.solve(one.C, f_x.T)
        precision = h.precision[r].numpy()
        off = x_hat[r].T.double().numpy() - best
        # float32's x^ is as good as exact in any direction: measured in standard deviations
        assert (np.einsum("pi,ij,pj->p", off, precision, off) < 0.01**2).all()
        x = best + rng.normal(size=best.shape) * rng.choice([0.1, 1.0], (10, 1))
        ours = 0.5 * np.einsum("pi,ij,pj->p", x - best, precision, x - best)
        np.testing.assert_allclose(joint(x) - joint(best), ours, rtol=1e-6, atol=1e-6)
        likeliest = (s - one.mu - x @ f_x) @ weight @ f_d.T
        at = torch.from_numpy(x).T - x_hat[r]
        found = h.to_deviation[r] @ z + h.deviation_0[r][:, None] - h.sensitivity[r] @ at.float()
        np.testing.assert_allclose(found.T, likeliest, rtol=1e-5, atol=1e-3)


def test_slope_of_the_evidence_is_the_weighted_misfit():
    """d log p / d s = -C^-1 (s - mu): what autograd, differences and algebra say."""
    world = World(bands=8, materials=3)
    known = world.known()
    h = hypotheses(known)
    s = world.pixels(known)[:, :3].requires_grad_()
    slope = torch.autograd.grad(evidence(h, s)[0][0].sum(), s)[0]
    one = Dense(known, 0, False)
    slow = -np.linalg.solve(one.C, (s.detach().double().numpy() - one.mu[:, None]))
    np.testing.assert_allclose(slope, slow, rtol=1e-4, atol=1e-4 * np.abs(slow).max())
    # in units of 1000 noise deviations, so that steps of 1e-6 are not lost in s
    h = Hypotheses(*(a.double() for a in h))
    assert torch.autograd.gradcheck(lambda x: evidence(h, 1000 * x)[0] / 1e3,
                                    s.detach().double().div(1000).requires_grad_(),
                                    rtol=1e-4, atol=1e-3)  # fmt: skip


@pytest.mark.parametrize("k", [1, 8])
@pytest.mark.parametrize(("bands", "rich"), [(24, True), (24, False), (100, True), (100, False)])
def test_little_is_lost_to_rounding_where_noise_is_least(bands, rich, k):
    """At 10 mK and 100 bands C spans 1e9; its evidence in extended precision."""
    world = World(bands=bands, k=k, netd=0.01, materials=3, rich=rich)
    known = world.known()
    ours, _ = evidence(hypotheses(known), world.pixels(known))
    fitting = 0
    for r, one in enumerate(dense(known)):
        exact = one.seen_log_density(world.scaled(known).numpy())
        fits = one.occam() - exact < 200  # half of chi^2; half of 24 components if it is right
        fitting += fits.sum()
        # 0.05 nats change no decision
        close(ours[r][fits], exact[fits], atol=0.05, rtol=0)
        close(ours[r], exact, atol=0.05, rtol=3e-4)
    assert fitting >= len(world.spectra)


# --- the factorisation -------------------------------------------------------------------------


@settings(max_examples=40)
@given(q=st.integers(1, MAX_COMPONENTS), seed=st.integers(0, 2**31), decades=st.floats(-2, 4))
def test_the_inverse_of_a_root_is_as_good_as_its_condition_lets_it_be(q, seed, decades):
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(3, q, rng.integers(1, 40))) * 10 ** rng.uniform(-2, decades, (3, q, 1))
    gram = np.eye(q) + rows @ rows.transpose(0, 2, 1)
    lower, inverse = _cholesky(gram)
    # backward stable: rounding enters through the condition, of which L has the root
    slack = 1e-15 * q * np.linalg.cond(gram).max() + 1e-13
    assert (np.triu(lower, 1) == 0).all() and np.abs(inverse @ lower - np.eye(q)).max() < slack


@pytest.mark.parametrize("decades", [0, 4, 8])
def test_factorisation_of_what_is_almost_known(decades):
    """S of unknowns that the pixel tells to 1e-4 of the prior: its inverse is good."""
    q, rng = 15, np.random.default_rng(decades)
    turn = np.linalg.qr(rng.normal(size=(q, q)))[0]
    of_s = 10.0 ** -rng.uniform(0, decades, q)
    inverse = _cholesky((turn * of_s) @ turn.T[None])[1][0]
    precision = inverse.T @ inverse
    # along every axis; rounding of S itself is 1e-16 of of_s = 1e-8
    along = ((precision @ turn) * turn).sum(axis=0)
    np.testing.assert_allclose(along * of_s, 1, rtol=1e-15 * 10.0**decades * q)


# --- what it decides ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "by", "said"),
    [("sigma", 1e-12, "sigma is too small"), ("environment", np.nan, "environment holds NaN")],
)
def test_what_is_no_number_or_all_but_noiseless_is_said(name, by, said):
    known = arrays_of(World().known())
    with pytest.raises(InputError, match=said):
        set_up(known | {name: known[name] * np.float32(by)})


def test_rows_that_say_nothing_change_nothing():
    """Deviations of length zero are no deviations, at any number of them."""
    world = World(k=3)
    known = world.known()
    wider = known._replace(
        spread=torch.cat([known.spread, torch.zeros(30, world.bands)]),
        sky_spread=torch.cat([torch.zeros(2, world.bands), known.sky_spread]),
    )
    s = world.pixels(known)
    a, b = hypotheses(known), hypotheses(wider)
    close(evidence(b, s)[0], evidence(a, s)[0])
    np.testing.assert_allclose(b.precision, a.precision, rtol=1e-6, atol=1e-6)


def same(ours, theirs, h):
    """Evidence and x^ of two answers; x^ to a small part of its standard deviation."""
    close(ours[0], theirs[0])
    off = (ours[1] - theirs[1]).double()
    assert torch.einsum("rip,rij,rjp->rp", off, h.precision, off).max() < 0.02**2


def test_permutations():
    world = World(k=4)
    known, s = world.known(), world.pixels(world.known())
    h = hypotheses(known)
    ours = evidence(h, s)
    order = np.random.default_rng(2).permutation(6)
    shuffled = known._replace(emissivity=known.emissivity[order], is_sky=known.is_sky[order])
    both = np.concatenate([order, 6 + order])
    of_both = h._replace(precision=h.precision[both])
    same(evidence(hypotheses(shuffled), s), [a[both] for a in ours], of_both)
    order = [2, 0, 3, 1]
    turned = known._replace(
        environment=known.environment[order], light=known.light[order],
        usual_lighting=known.usual_lighting[order],
    )  # fmt: skip
    theirs = evidence(hypotheses(turned), s)
    back = [1, 3, 0, 2, *range(4, 4 + TERMS)]
    same((theirs[0], theirs[1][:, back]), ours, h)


@pytest.mark.parametrize("bands", [24, 60])
def test_permuting_the_library_permutes_the_evidence_whatever_the_basis(bands):
    """The basis is of eigenvectors, whose sign, or order where they are equal, is an accident."""
    world = World(bands, k=4, seed=9)
    known, s = world.known(), world.pixels(world.known())
    h = hypotheses(known)
    ours, library = evidence(h, s), world.library
    order = np.random.default_rng(3).permutation(6)
    both = np.concatenate([order, 6 + order])
    shuffled = world.known(library=MaterialLibrary(
        [library.names[i] for i in order], library.wavelength_um, library.emissivity[order]
    ))  # fmt: skip
    of_both = h._replace(precision=h.precision[both])
    same(evidence(hypotheses(shuffled), s), [a[both] for a in ours], of_both)
    rng = np.random.default_rng(4)
    sign = torch.from_numpy(rng.choice([-1.0, 1.0], (MAX_COMPONENTS, 1))).float()
    longer = torch.from_numpy(rng.uniform(0.5, 2, (MAX_COMPONENTS, 1))).float()
    for basis in (sign * known.basis, known.basis.flip(0), longer * known.basis):
        same(evidence(hypotheses(known._replace(basis=basis)), s), ours, h)


@pytest.mark.parametrize(
    ("ground", "sky", "hypotheses_held"), [(3, True, 8), (3, False, 3), (2, False, 4)]
)
def test_some_of_the_materials_say_what_they_say_among_all(ground, sky, hypotheses_held):
    """A scene is set up once; in a part of it those are taken that are looked for there, partly sky
    where it is one of them. Of too few there are others that cannot be."""
    world = World(k=4, seed=5)
    known, s = arrays_of(world.known()), world.pixels(world.known())
    held = known["is_sky"] > 0 if sky else np.zeros(6, bool)
    held[np.flatnonzero(known["is_sky"] == 0)[[0, 2, 3][:ground]]] = True
    some, alone = of_materials(set_up(known), held), set_up(only(known, held))
    assert some.keys() == alone.keys() and len(some["offset"]) == hypotheses_held
    assert (some["offset"] < -1e14).sum() == (2 if ground == 2 else 0)
    for name in alone.keys() - {"centre", "to_w", "to_x", "deviation_0"}:  # which follow the centre
        np.testing.assert_allclose(some[name], alone[name], rtol=1e-6, err_msg=name)
    ours, theirs = (evidence(part_of(tensors(a), Hypotheses), s) for a in (some, alone))
    h = hypotheses(world.known()._replace(**tensors(only(known, held))))
    same([a[: len(h.offset)] for a in ours], [a[: len(h.offset)] for a in theirs], h)


def test_ranks_the_true_material_first_where_materials_are_well_apart():
    world = World(shape=(20, 20), bands=50, depth=(0.3, 0.6), seed=3)
    known = world.known()
    log_p, _ = evidence(hypotheses(known), world.pixels(known))
    assert (log_p.argmax(dim=0).numpy() == world.material).mean() > 0.99
    assert len(set(world.material)) == 5


@pytest.mark.parametrize("bands", [60, 100])
@pytest.mark.parametrize("rich", [False, True])
def test_components_rank_materials_as_well_as_all_bands(bands, rich):
    """Where many pixels are doubtful: weak contrast, and noise."""
    world = World(bands, rich=rich, shape=(40, 50), depth=(0.01, 0.04), netd=0.15, k=4,
                  materials=8, seed=bands)  # fmt: skip
    known = world.known()
    ours, _ = evidence(hypotheses(known), world.pixels(known))
    theirs = np.stack([one.log_density(world.scaled(known).numpy()) for one in dense(known)])
    by_material = lambda a: np.logaddexp(a[:8], a[8:])
    ours, theirs = by_material(ours.double().numpy()), by_material(theirs)
    right, full = (a.argmax(axis=0) == world.material for a in (ours, theirs))
    assert 0.3 < full.mean() < 0.95
    # of 2000 pixels
    assert right.mean() > full.mean() - 0.02
    probability = lambda a: np.exp(a - np.logaddexp.reduce(a))
    at = world.material, np.arange(2000)
    gap = np.log(probability(theirs)[at]) - np.log(probability(ours)[at])
    assert gap.mean() < 0.05  # nats per pixel that the bands left out would have told


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
    p = torch.softmax(evidence(hypotheses(known), torch.from_numpy(s.T).float())[0], dim=0)
    p = p.double().numpy().T
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
    log_p, _ = evidence(h, world.pixels(known, sky_pixels(world, 100, rng)))
    assert (log_p.argmax(dim=0) == sky).float().mean() > 0.95  # else a little before it
    assert (log_p.argmax(dim=0) % 6 == sky).float().mean() > 0.95
    share = rng.normal(0.25, 0.1, (48, 1)).clip(0.1, 0.4)
    rim = (1 - share) * world.spectra + share * sky_pixels(world, 48, rng)
    log_p, _ = evidence(h, world.pixels(known, rim))
    best = log_p.argmax(dim=0).numpy()
    assert (best >= 6).all()
    assert (best % 6 == world.material).mean() > 0.9
    np.testing.assert_allclose(h.sky_share, [0, 1, 0, 0, 0, 0, 0.25, 0.75, 0.25, 0.25, 0.25, 0.25])


def test_nothing_is_sky_where_no_sky_is_in_view():
    """Not even what nothing else in the library explains: a grey pixel at the least noise."""
    world = World(bands=60, netd=0.01, k=2)
    blind = Environment(
        world.environment.radiance, world.wavelength, spread=world.environment.spread
    )
    known = world.known(environment=blind)
    grey = 0.7 * world.spectra + 0.3 * world.spectra.mean(axis=1, keepdims=True)
    cold = sky_pixels(world, 20, np.random.default_rng(0))
    s = world.pixels(known, np.concatenate([world.spectra, grey, cold]))
    log_p, _ = evidence(hypotheses(known), s)
    assert len(log_p) == 6 and (log_p.argmax(dim=0) != world.library.sky_index).all()


def test_a_mirror_pays_for_what_it_can_imitate():
    """What black explains at once, a mirror explains by tuning V: Occam decides for black."""
    world = World(sky=False, rich=False, materials=2, library=MaterialLibrary(
        ["mirror", "black"], np.array([7.0, 15.0]), np.array([[0.02] * 2, [0.999] * 2])
    ), material=np.ones(48, int))  # fmt: skip
    known = world.known()
    log_p, _ = evidence(hypotheses(known), world.pixels(known))
    assert (log_p[1] > log_p[0]).all()


def test_the_usual_temperature_is_that_of_most_pixels_whatever_they_are_made_of():
    """Seen in its most opaque band, where e is near 1 and the surroundings are not hot."""
    t = np.where(np.arange(400) < 390, 290.0, 400.0)
    world = World(shape=(20, 20), temperature=t, depth=(0.3, 0.6))
    assert world.known().prior_k[0].item() == pytest.approx(290, abs=1)


@pytest.mark.parametrize(("hot", "deviation"), [(0, 15), (1, 15), (18, 20)])
def test_the_prior_spans_what_is_hot_but_for_a_pixel_or_two(hot, deviation):
    """A fifth of 100 K, so that the hottest is five deviations away; what one shows is left out."""
    temperature = np.where(np.arange(1200) < hot, 390.0, np.linspace(275, 305, 1200))
    world = World(temperature=temperature, shape=(30, 40), depth=(0.01, 0.02), rich=False)
    assert world.known().prior_k[1].item() == pytest.approx(deviation, rel=0.05)


@pytest.mark.parametrize("kelvin", [112.0, 290.0])
def test_no_t_that_may_be_answered_is_as_cold_as_absolute_zero(kelvin):
    world = World(rich=False)
    cube = HeatCube(planck(world.wavelength, kelvin)[:, None, None] * np.ones((6, 8)),
                    world.wavelength, world.width, world.netd)  # fmt: skip
    sky_mean = planck(world.wavelength, 70.0)
    known = world.known(cube, environment=replace(world.environment, sky_mean=sky_mean))
    mean, deviation = known.prior_k.tolist()
    assert mean == pytest.approx(kelvin, abs=1) and mean - MAX_T * deviation > 29.9


@pytest.mark.parametrize(("netd", "hot"), [(1e-3, 300.0), (0.01, 1500.0), (0.05, 2500.0)])
def test_no_noise_and_one_fire_leave_numbers(netd, hot):
    """T is known to a millionth of its prior then; and the prior reaches below absolute zero."""
    temperature = np.where(np.arange(48) == 20, hot, 290.0)
    world = World(bands=100, netd=netd, temperature=temperature)
    known = world.known()
    h = hypotheses(known)
    log_p, x = evidence(h, world.pixels(known))
    assert all(torch.isfinite(a).all() for a in (*h, log_p, x))
    usual = np.arange(48) != 20
    right = (torch.logsumexp(log_p.reshape(2, 6, -1), 0).argmax(0).numpy() == world.material)[usual]
    assert right.mean() > 0.9
