"""The reduced forward model: a pixel meets a hypothesis only through r inner products.

A hypothesis is one of `prior.Mixtures`: a material m, or m with a share alpha of the pixel looking
past it at the sky (the rim of a leaf; alpha = 0 for a pure pixel, 1 for the sky itself). Eq. 1 in
noise units (s = S / sigma) is then linear in V and nonlinear only in the scalar T:

    s~ = alpha S_sky / sigma + (1 - alpha) [e_m B(T) + (1 - e_m) sum_j V_j S_j] / sigma = A u
    u  = [C_0(tau), ..., C_{n-1}(tau), V_1, ..., V_k],   T = T_mid + T_half tau

(of wide bands e_m B(T) and (1 - e_m) S_j are the means of these products), because e_m B(T) / sigma
is, over the allowed range of T, a Chebyshev series in tau of n terms to 0.005 noise units (C_0 = 1
carries the sky's share): 6 to 20 for a scene of usual temperatures, 36 from 60 to 2200 K, and at
most 40, which err by 0.2 noise units up to 5000 K. The first n columns of A are the series'
coefficient spectra, the others the reflected environment.
With P the inverse noise covariance, the cost of a pixel is

    chi^2 = s' P s - 2 u' h + u' H u,     h = A' P s,     H = A' P A

so that all pixels meet all hypotheses in one matrix product (s -> h, s' P s), and
everything after that lives in r = n + k dimensions, with no work per band.

The noise is the sensor's (white after division by sigma) plus what the model cannot say:
true surroundings deviate from the k spectra along `Environment.spread` and
`skylight_spread`, and by `error_k` in every band, of which m reflects (1 - e_m); curves that may be
off move what is not sky along `curve_spread`; the sky's pixels scatter about their mean along
`Environment.sky_spread`; alpha is known to sigma_alpha, and mean B(T) is over T's prior:

    C = I + diag((1 - alpha)(1 - e_m) error / sigma)^2 + U U'
    U = [(1 - alpha)(1 - e_m) [spread', skylight_spread'], (1 - alpha) curve_spread',
         alpha sky_spread', sigma_alpha (S_sky - mean B(T))] / sigma

A mirror is predicted no better than its surroundings are known. Of U's principal axes those in
which it is less than a tenth of the noise are left out of P.

Hypotheses are compared by evidence, not by residual: with Gaussian priors on T and on V
of the scale of the scene, the Laplace evidence is

    log Z = -chi^2 / 2 - prior terms - occam
    occam = log det(I + Sigma_prior F) / 2 + log det(C) / 2 - log(prior share)

with F the Fisher information of (T, V) at the prior mean of T. A mirror with free V
reproduces any environment spectrum; occam is what it pays for having had to tune V. The
sky has nothing to tune. Of a camera with less noise than is allowed for, occam also holds what
chi^2 / 2 would be more in the mean with the noise that is missing, tr(C'^-1 diag(quiet)) / 2, C'
being C with what T and V are free in.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.polynomial import chebyshev

from ..cube.heat_cube import HeatCube
from ..environment import Environment
from ..errors import InputError
from ..hypotheses import planck_series
from ..library import MaterialLibrary
from ..machinery import scratch
from ..planck import brightness_temperature, noise_sigma, planck
from ..prior import (
    MIN_TEMPERATURE_SPREAD_K,
    V_PRECISION,
    Mixtures,
    SampledSpectra,
    deviations,
    lighting_scale,
    usual_temperature,
)
from . import faces

PIXELS_PER_GROUP = 4096
SERIES_TOLERANCE = 0.005  # noise units
NEGLIGIBLE = 0.01  # variance of what the model cannot say, beside the noise's


@dataclass(frozen=True, eq=False, kw_only=True)
class ReducedModel:
    """What of (library, environment, bands, noise) does not depend on the pixel.

    For R hypotheses:
    material       (R,) library index
    sky_share      (R,) alpha
    emissivity     (R, bands) band means
    forward        (R, r, bands) A'
    project        (bands, R, r) s -> h
    scale          (R, bands) square root of the diagonal part of C's inverse
    deflate        (bands, R, d) s' P s = |scale s|^2 - |deflate' s|^2
    deviation      (R, bands, q) U
    gram           (R, r, r) H, with the prior on V on its diagonal
    offset         (R, r) what that prior adds to h
    occam          (R,)
    terms          n, length of the Chebyshev series;   k, number of environment objects
    mid_k, half_k  centre and half width of the allowed T range, K
    prior_mean_k, prior_sigma_k   Gaussian prior on T
    """

    library: MaterialLibrary
    environment: Environment
    wavelength_um: np.ndarray
    sigma: np.ndarray
    material: np.ndarray
    sky_share: np.ndarray
    emissivity: np.ndarray
    forward: np.ndarray
    project: np.ndarray
    scale: np.ndarray
    deflate: np.ndarray
    deviation: np.ndarray
    gram: np.ndarray
    offset: np.ndarray
    occam: np.ndarray
    terms: int
    k: int
    mid_k: float
    half_k: float
    prior_mean_k: float
    prior_sigma_k: float

    def inner_products(self, s, row):
        """h (P, r) and the constant of J (P,) of one hypothesis for noise-scaled s (P, bands)."""
        h = s @ self.project[:, row] + self.offset[row]
        constant = 0.5 * (s * s) @ self.scale[row] ** 2 + self.of_usual
        return h, constant - 0.5 * ((s @ self.deflate[:, row]) ** 2).sum(axis=1)

    def rendered(self, row, temperature_k, lighting):
        """s~ (P, bands) in noise units, of one hypothesis at T (P,) and V (P, k)."""
        tau = (temperature_k - self.mid_k) / self.half_k
        u = np.concatenate([chebyshev.chebvander(tau, self.terms - 1), lighting], axis=1)
        return u @ self.forward[row]

    @cached_property
    def tables(self):
        """faces.Tables of all hypotheses, as a plain tuple."""
        return tuple(faces.tables(self.gram, self.terms, *self.of_t))

    @cached_property
    def to_deviation(self):
        """(R, bands, q) U (I + U'U)^-1: takes what is left of s to the likeliest deviations."""
        u, t = self.deviation, self.deviation.transpose(0, 2, 1)
        return np.linalg.solve(np.eye(u.shape[2]) + t @ u, t).transpose(0, 2, 1)

    @property
    def of_usual(self):
        """|V|^2 / (2 sigma_V^2) of the usual V: the constant of J that its prior adds."""
        return 0.5 * V_PRECISION * self.k * np.sum(self.environment.usual**2)

    @property
    def of_t(self):
        """half, weight and mean, as `simplex.solve` takes them."""
        return self.half_k, self.prior_sigma_k**-2.0, self.prior_mean_k - self.mid_k

    @cached_property
    def of_all(self):
        """What takes (s, 1) to h and deflate' s, (R, r + d, bands + 1), and (s * s, 1) to the
        rest of J's constant with occam, (R, bands + 1)."""
        linear = np.concatenate([self.project, self.deflate], axis=2).transpose(1, 2, 0)
        last = np.pad(self.offset, ((0, 0), (0, self.deflate.shape[2])))
        linear = np.concatenate([linear, last[..., None]], axis=2)
        square = np.pad(0.5 * self.scale**2, ((0, 0), (0, 1)), constant_values=self.of_usual)
        square[:, -1] += self.occam
        return np.ascontiguousarray(linear), square


def reduce_model(
    cube: HeatCube, library: MaterialLibrary, environment: Environment, temperatures=None
) -> ReducedModel:
    """Build the reduced model; of the cube, its bands, noise and, unless others are given, the
    Temperatures of its pixels.

    Raises InputError where library or environment are not for the cube's bands.
    """
    w, sigma, k = cube.wavelength_um, cube.sigma, len(environment)
    environment.check_bands(w)
    t, of = temperatures or _temperatures(cube, environment), _mixtures(library, environment)
    nodes = cube.nodes_um
    curves = library.at(nodes)
    curves[library.is_sky] = 1.0  # what glows before the sky is as good as black
    emissivity = curves.mean(axis=-1)[of.material]
    series = _planck_series(nodes, curves, sigma, t.mid, t.half)[of.material]  # (R, n, bands)
    terms = series.shape[1]
    light = environment.at_nodes(nodes)
    light = np.einsum("mbn,kbn->mkb", 1 - curves, light)[of.material] / nodes.shape[1]
    reflected = (1 - of.sky_share)[:, None] * (1 - emissivity)  # what of the surroundings shows
    sky_mean = 0.0 if environment.sky_mean is None else environment.sky_mean
    black = planck_series(nodes, (t.prior_mean, t.prior_sigma))[0].mean(axis=-1)
    alpha_step = of.share_sigma[:, None] * (sky_mean - black)
    a = _rows(of, series, light, sky_mean, sigma)
    u = deviations(of, reflected, environment, alpha_step, sigma)
    error = noise_sigma(w, environment.known_error_k) / sigma
    scale = 1 / np.sqrt(1 + (reflected * error) ** 2)
    au, uu = a * scale[:, None], u * scale[:, None]

    d, log_det = _deflation(uu)
    pa = au - (au @ d.transpose(0, 2, 1)) @ d
    gram = au @ pa.transpose(0, 2, 1)
    log_det = log_det - 2 * np.log(scale).sum(axis=1)
    free = _free(k, terms, t)
    one_and_fisher = np.eye(k) + free.T @ gram @ free
    occam = 0.5 * np.linalg.slogdet(one_and_fisher)[1] + 0.5 * log_det - np.log(of.prior)
    if cube.quiet.any():  # J would be more, in the mean, with the noise that is missing
        fitted = free.T @ (pa * scale[:, None])
        left = scale**2 * (1 - (d**2).sum(axis=1))
        left = left - (fitted * np.linalg.solve(one_and_fisher, fitted)).sum(axis=1)
        occam += 0.5 * left @ cube.quiet

    v = np.arange(terms, terms + k)
    gram[:, v, v] += V_PRECISION * k
    offset = np.zeros((len(of.material), terms + k))
    offset[:, v] = V_PRECISION * k * environment.usual
    by_band = lambda rows: np.ascontiguousarray(rows.transpose(2, 0, 1))
    return ReducedModel(
        library=library, environment=environment, wavelength_um=w, sigma=sigma,
        material=of.material, sky_share=of.sky_share, emissivity=emissivity, forward=a,
        project=by_band(pa * scale[:, None]), scale=scale, deflate=by_band(d * scale[:, None]),
        deviation=u.transpose(0, 2, 1), gram=gram, offset=offset, occam=occam, terms=terms, k=k,
        mid_k=t.mid, half_k=t.half, prior_mean_k=t.prior_mean, prior_sigma_k=t.prior_sigma,
    )  # fmt: skip


class Temperatures(NamedTuple):
    """K: centre and half width of the allowed range of T, and T's prior."""

    mid: float
    half: float
    prior_mean: float
    prior_sigma: float

    @staticmethod
    def of(darkest, brightest, usual, spread):
        """Those of pixels that look like darkest to brightest, usual and their spread, all K."""
        sigma = max(MIN_TEMPERATURE_SPREAD_K, spread)
        # a mirror may be far warmer, or colder, than anything looks: what it mirrors is neither
        low = max(min(darkest - 40.0, usual - 4 * sigma), 60.0)
        high = max(brightest + 60.0, usual + 4 * sigma)
        return Temperatures(0.5 * (high + low), 0.5 * (high - low), usual, sigma)


def _temperatures(cube, environment):
    pixels = SampledSpectra.of(cube)
    # the darkest and the brightest that every band saw: no pixel lies beyond
    ends = np.array([(s.min(), s.max()) for s in scratch.parts(cube.radiance)], np.float64)
    ends = brightness_temperature(cube.wavelength_um, ends.T).mean(axis=1)
    usual = usual_temperature(cube, environment, pixels)
    return Temperatures.of(*ends, usual, float(pixels.brightness_k.mean(axis=1).std()))


def _mixtures(library, environment):
    """The Mixtures of a library, without a sky that is not in view."""
    if library.is_sky.all():
        raise InputError("library: it holds no material but the sky; add materials.")
    in_view = environment.sky_mean is not None
    of = Mixtures.of(library.is_sky, in_view)
    there = in_view | ~library.is_sky[of.material]
    return Mixtures(*(a[there] for a in of))


def _rows(of, series, light, sky_mean, sigma):
    """A' (R, r, bands) of Mixtures; light (R, k, bands) is (1 - e_m) S_j."""
    share = of.sky_share[:, None, None]
    a = np.concatenate([(1 - share) * series, (1 - share) * light / sigma], axis=1)
    a[:, 0] += share[:, 0] * sky_mean / sigma
    return a


def _deflation(u):
    """D' (R, d, bands), with which P = scale (I - D D') scale (Woodbury), and log det(I + U'U) (R,)
    of scaled U' (R, q, bands), along its principal axes: the largest first, zeros for those that
    are NEGLIGIBLE."""
    variance, axes = np.linalg.eigh(u @ u.transpose(0, 2, 1))
    variance, axes = np.maximum(variance[:, ::-1], 0), axes[:, :, ::-1]
    kept = variance > NEGLIGIBLE
    rows = axes.transpose(0, 2, 1) @ u * (kept / np.sqrt(1 + variance))[..., None]
    return rows[:, : kept.sum(axis=1).max()], np.log1p(variance * kept).sum(axis=1)


def _free(k, terms, t):
    """(r, k) what T and V, along the k - 1 directions that keep its sum, are free in, one standard
    deviation of their priors long."""
    at = (t.prior_mean - t.mid) / t.half
    tangent = np.zeros((terms + k, k))
    tangent[:terms, 0] = [
        chebyshev.chebval(at, chebyshev.chebder(c)) / t.half for c in np.eye(terms)
    ]
    tangent[terms:, 1:] = np.linalg.svd(np.eye(k) - 1.0 / k)[0][:, : k - 1]
    return tangent * np.array([t.prior_sigma] + [lighting_scale(k)] * (k - 1))


def groups(row):
    """(hypothesis, indices of its pixels) of row (P,), at most PIXELS_PER_GROUP at once."""
    for r in np.unique(row):
        index = np.flatnonzero(row == r)
        for start in range(0, len(index), PIXELS_PER_GROUP):
            yield r, index[start : start + PIXELS_PER_GROUP]


def _planck_series(nodes, emissivity, sigma, mid, half):
    """Chebyshev coefficient spectra (materials, n, bands) of the band mean of e B(T) / sigma."""
    grid = np.cos(np.pi * (np.arange(64) + 0.5) / 64)
    b = planck(nodes, (mid + half * grid)[:, None, None])  # (T, bands, nodes)
    glow = np.einsum("mbn,tbn->tmb", emissivity, b) / nodes.shape[1] / sigma
    flat = glow.reshape(len(grid), -1)
    # at these points the polynomials are orthogonal: fewer terms are the same terms
    polynomials = chebyshev.chebvander(grid, 39)
    coefficients = polynomials.T @ flat * (2 / len(grid))
    coefficients[0] /= 2
    for degree in range(1, 40):
        fitted = polynomials[:, : degree + 1] @ coefficients[: degree + 1]
        if np.abs(fitted - flat).max() < SERIES_TOLERANCE:
            break
    return coefficients[: degree + 1].reshape(degree + 1, *glow.shape[1:]).transpose(1, 0, 2)
