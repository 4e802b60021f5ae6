"""What evidence and refinement need of every hypothesis, independent of the pixel: computed by
numpy, once a scene.

A hypothesis is one of `prior.Mixtures`: a material that fills the pixel, or shares it with sky.
Give T and V of Eq. 1 Gaussian priors instead of bounds, and expand B(T) in Hermite polynomials of
t = (T - T_0) / tau, whose values are uncorrelated with unit variance if t is standard normal. If
each of them is treated as a free unknown (which lowers the evidence of all hypotheses, by nearly
the same amount), the spectrum of a pixel under hypothesis h is Gaussian, too. In noise units,

    s ~ N(mu_h, C_h),     C_h = 1 + diag(g_h^2 error^2) + F_h' F_h

where the rows of F_h are the directions in which the pixel may vary, one standard deviation long:

    g_h spread, g_h skylight_spread, (1 - alpha) curve_spread,
    alpha sky_spread, alpha's own step                                     (deviations)
    (1 - alpha)(1 - e_m)(S_j - mean S) / sqrt(3 k)                         (lighting, x_V)
    (1 - alpha) e_m B_1 .. B_n                      B's series             (temperature, x_T)

and mu_h is the spectrum at the usual T and V. Here g_h = (1 - alpha)(1 - e_m); in wide bands e_m B
and (1 - e_m) S_j are means of products. Only z = U s is used, the few components (`basis`) in which
the scene's spectra differ by more than noise. With U C_h U' = L L',

    w = L^-1 (z - U mu),         log p(z | h) = -|w|^2 / 2 - log det(L) + log prior,
    x^ = (L^-1 U F_x')' w,       S = 1 - (L^-1 U F_x')' (L^-1 U F_x')

are the evidence, and the mean and covariance of x = (x_V, x_T) given z: any other x costs
(x - x^)' S^-1 (x - x^) / 2 nats. If the camera has less noise than is assumed (`HeatCube.quiet`),
the evidence is what it would be in the mean with the missing noise, lower by
tr(L^-1 U diag(quiet) U' L'^-1) / 2; otherwise the hypotheses with least freedom, the blackest
materials, would win by far. `refinement` replaces V's prior by one about a guess, with kappa times
the precision, and for that uses S_2^-1 = S^-1 + (kappa - 1) 1_V = L_2 L'_2. Components are scaled
by how far spectra differ in them, so that z is of order one, and |w|^2 is a sum of squares: float32
is precise enough for the pixels.
"""

from typing import NamedTuple

import numpy as np

from .errors import InputError
from .expected import only
from .known import COLDEST_PRIOR_K, TERMS, Known
from .planck import planck
from .prior import Mixtures, among, deviations, lighting_scale

QUADRATURE = np.polynomial.hermite_e.hermegauss(16)
GUESS_PRECISION = 4.0  # kappa: of a guessed V over that of knowing nothing
NEVER = 1e15  # nats; misfits reach 1e12


class Hypotheses(NamedTuple):
    """R hypotheses (`prior.Mixtures`; for a scene, see `_enough`), with q rows of F, the last
    r = k + n of which belong to x; float32 arrays or tensors.

    sky_share (R,) alpha; alpha_step (R, bands) the effect of one standard deviation of alpha,
    W m-2 sr-1 um-1; centre (bands,) and basis (d, bands), as in `known`: z = basis (s - centre);
    to_w (R, d, d + 1) and to_x (R, r, d + 1) give w and x^ from (z, 1); offset (R,) log p(z | h) at
    w = 0; to_deviation (R, q - r, d), deviation_0 (R, q - r) and sensitivity (R, q - r, r): the
    likeliest deviations are to_deviation z + deviation_0 - sensitivity (x - x^); precision
    (R, r, r) S^-1, float64, for `blocks_of` only.
    """

    sky_share: np.ndarray
    alpha_step: np.ndarray
    centre: np.ndarray
    basis: np.ndarray
    to_w: np.ndarray
    to_x: np.ndarray
    offset: np.ndarray
    to_deviation: np.ndarray
    deviation_0: np.ndarray
    sensitivity: np.ndarray
    precision: np.ndarray


class Blocks(NamedTuple):
    """What the steps of refinement need of every hypothesis, float32 arrays or tensors.

    determinant (R,) the change of the evidence by the other prior on V, nats; pulled (R, r, k) the
    columns of S_2 by which a guess of V moves x^; vv (R, k, k), vt (R, k, n), tt (R, n, n) the
    blocks of L'_2, for V minus the usual V; solve (R, k, k) the inverse of vv; covariance (R, k, k)
    of V given T.
    """

    determinant: np.ndarray
    pulled: np.ndarray
    vv: np.ndarray
    vt: np.ndarray
    tt: np.ndarray
    solve: np.ndarray
    covariance: np.ndarray


COMPARED = 3  # hypotheses of a pixel that a model looks at more closely, and has at least
COMMON = "centre", "basis"  # to all hypotheses
INTERNAL = "error", "quiet", "precision"  # what only this file takes
ONE_BY_ONE = {*Hypotheses._fields, *Blocks._fields} - {*COMMON, *INTERNAL}  # of each hypothesis


def set_up(known):
    """All that a model is told about a scene, as float32 arrays by name: those of
    `known.known_arrays`, Hypotheses and Blocks, except INTERNAL.

    Raises InputError if they are not finite, or the noise is too small relative to the spectra.
    """
    for name, a in known.items():
        if not np.isfinite(a).all():
            raise InputError(f"known: {name} holds NaN or infinity.")
    try:
        h = hypotheses_of(known)
        b = blocks_of(h, len(known["environment"]))
    except np.linalg.LinAlgError as e:
        raise InputError("known: sigma is too small beside the spectra; check its unit.") from e
    scene = known | h._asdict() | b._asdict()
    return _enough({name: a for name, a in scene.items() if name not in INTERNAL})


def of_materials(scene, held):
    """A scene from `set_up`, restricted to the materials that are held, a mask over all."""
    material = np.arange(len(scene["offset"])) % len(held)
    rows = among(material, scene["sky_share"], scene["is_sky"] > 0, held)
    return _enough(only(scene, held) | {name: scene[name][rows] for name in ONE_BY_ONE})


def _enough(scene):
    """A scene with at least COMPARED hypotheses; if it has fewer, all are repeated with zero
    probability."""
    if len(scene["offset"]) >= COMPARED:
        return scene
    twice = {name: np.concatenate([scene[name]] * 2) for name in ONE_BY_ONE}
    never = np.repeat(np.float32([0, NEVER]), len(scene["offset"]))
    return scene | twice | {"offset": twice["offset"] - never}


def part_of(scene, kind):
    """A scene's Known, Hypotheses or Blocks, of arrays or tensors; None for what is INTERNAL."""
    return kind(*(None if name in INTERNAL else scene[name] for name in kind._fields))


def hypotheses_of(known) -> Hypotheses:
    """Set up all hypotheses of a scene, described by known_arrays (`known`)."""
    x = {name: np.asarray(a, np.float64) for name, a in known.items()}
    sky, sigma, k = x["is_sky"], x["sigma"], len(x["environment"])
    in_view = bool(x["sky_mean"].max() > 0)
    of = Mixtures.of(sky, in_view)
    material, sky_share = of.material, of.sky_share
    prior = np.log(of.prior) - (0 if in_view else NEVER * sky)
    # what glows before the sky is as good as black
    e = x["emissivity"] + (1 - x["emissivity"]) * sky[:, None, None]
    series = planck_series(x["nodes_um"], x["prior_k"])  # (n + 1, bands, nodes)
    glow = (e[:, None] * series).mean(axis=-1)[material] / sigma  # (R, n + 1, bands)
    glow = glow * (1 - sky_share)[:, None, None]
    reflected = (1 - sky_share)[:, None] * (1 - e.mean(axis=-1)[material])
    light = np.einsum("mbn,kbn->mkb", 1 - e, x["light"])[material] / e.shape[-1]
    light = light * (1 - sky_share)[:, None, None] / sigma  # (R, k, bands)
    usual = np.einsum("k,rkb->rb", x["usual_lighting"], light)
    black = series[0].mean(axis=-1)
    alpha_step = of.share_sigma[:, None] * (x["sky_mean"] - black)
    rows = np.concatenate([
        deviations(of, reflected, Known(**x), alpha_step, sigma),
        (light - light.mean(axis=1, keepdims=True)) * lighting_scale(k),
        glow[:, 1:],
    ], axis=1)  # fmt: skip
    mean = glow[:, 0] + usual + sky_share[:, None] * x["sky_mean"] / sigma
    r, scale = k + TERMS, np.sqrt((x["basis"] ** 2).sum(axis=1))
    basis = x["basis"] / scale[:, None]
    rows, error = rows @ basis.T, (reflected * x["error"] / sigma) ** 2
    of_d, of_x = rows[:, :-r], rows[:, -r:]
    gram = np.eye(len(basis)) + _t(of_d) @ of_d + (basis * error[:, None]) @ basis.T
    # S^-1 without the difference in S, which would cancel
    precision = np.eye(r) + of_x @ np.linalg.solve(gram, _t(of_x))
    lower, inverse = _cholesky(gram + _t(of_x) @ of_x)
    of_d, of_x = of_d @ _t(inverse), of_x @ _t(inverse)  # (L^-1 U F')'
    missing = 0.5 * ((inverse @ basis) ** 2 @ x["quiet"]).sum(axis=1)
    centre = mean.mean(axis=0)
    w_0 = -(inverse @ ((mean - centre) @ basis.T)[..., None])
    to_w = np.concatenate([inverse / scale, w_0], axis=2)
    return Hypotheses(
        precision=precision,
        **_float32(
            sky_share=sky_share, alpha_step=alpha_step, centre=centre, basis=x["basis"],
            to_w=to_w, to_x=of_x @ to_w, offset=prior - _log_det(lower) - missing,
            to_deviation=of_d @ to_w[..., :-1], deviation_0=(of_d @ w_0)[..., 0],
            sensitivity=of_d @ _t(of_x) @ precision,
        ),
    )  # fmt: skip


def blocks_of(h: Hypotheses, k, precision=GUESS_PRECISION) -> Blocks:
    """The parts of L'_2 for a precision kappa."""
    scale, r = lighting_scale(k), h.precision.shape[1]
    of_v = np.diag((np.arange(r) < k) * (precision - 1.0))
    lower, inverse = _cholesky(h.precision + of_v)
    factor, back = _t(lower), _t(inverse)
    solve = back[:, :k, :k] * scale
    centred = solve - solve.mean(axis=1, keepdims=True)  # V's sum is known
    return Blocks(**_float32(
        determinant=_log_det(lower) - 0.5 * np.linalg.slogdet(h.precision)[1],
        pulled=(back @ inverse)[:, :, :k], vv=factor[:, :k, :k] / scale, vt=factor[:, :k, k:],
        tt=factor[:, k:, k:], solve=solve,
        covariance=centred @ _t(centred),
    ))  # fmt: skip


def planck_series(nodes_um, prior_k):
    """(n + 1, bands, nodes) coefficients of B(T_0 + tau t) in orthonormal Hermite polynomials."""
    t, w = QUADRATURE
    value = np.polynomial.hermite_e.hermevander(t, TERMS)
    value[:, 1:] /= np.sqrt(np.cumprod(np.arange(1, TERMS + 1)))
    temperature = np.maximum(prior_k[0] + prior_k[1] * t, COLDEST_PRIOR_K)
    b = planck(nodes_um, temperature[:, None, None])
    return np.tensordot(value.T * w / w.sum(), b, 1)


def _cholesky(gram):
    """L and L^-1 of gram (R, q, q) = L L'."""
    lower = np.linalg.cholesky(gram)
    return lower, np.linalg.inv(lower)


def _log_det(lower):
    """(R,) log determinants of triangular matrices (R, q, q)."""
    return np.log(np.diagonal(lower, axis1=1, axis2=2)).sum(axis=1)


def _t(a):
    return a.transpose(0, 2, 1)


def _float32(**arrays):
    return {name: np.ascontiguousarray(a, np.float32) for name, a in arrays.items()}
