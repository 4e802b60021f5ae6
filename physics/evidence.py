"""Every material's evidence for every pixel, in a matrix product.

Let T and V of Eq. 1 have Gaussian priors instead of bounds, and write B(T) as a series in
Hermite polynomials of t = (T - T_0) / tau, whose coefficients are uncorrelated with unit
variance when t is a standard normal number. The spectrum of a pixel of hypothesis h (a
material, pure or partly sky, as in `exact.reduced`) is then Gaussian too. In noise units,

    s ~ N(mu_h, C_h),     C_h = 1 + diag(g_h^2 error^2) + F_h' F_h

with, in the rows of F_h, what the pixel is free in, one standard deviation long:

    g_h spread, g_h skylight_spread, alpha sky_spread, alpha's own step       (deviations)
    g_h (S_j - mean S) / sqrt(3 k)                                         (lighting, x_V)
    (1 - alpha) e_m B_1 .. B_n                      B's series             (temperature, x_T)

g_h = (1 - alpha)(1 - e_m). Of s only z = U s is looked at, the few components (`basis`) in
which the scene's spectra differ by more than noise. With U C_h U' = L L',

    w = L^-1 (z - U mu),         log p(z | h) = -|w|^2 / 2 - log det(L) + log prior,
    x^ = (L^-1 U F_x')' w,       S = 1 - (L^-1 U F_x')' (L^-1 U F_x')

are the evidence, and mean and covariance of x = (x_V, x_T) given z: any other x costs
(x - x^)' S^-1 (x - x^) / 2 nats, from which `refinement` goes on. w and x^ of all hypotheses are
one product of a matrix with a pixel's z and 1. Components are scaled by how far spectra differ in
them, which makes z of order one, and |w|^2 is a sum of squares: float32 is enough for the pixels.

This is what `exact.local` computes exactly and far more slowly; it ranks materials almost as well,
and a network can start from it. Plain torch operations of static shape in everything but sizes:
the whole of it goes into an ONNX file.
"""

from typing import NamedTuple

import numpy as np
import torch

from .cholesky import cholesky, eye, log_det
from .exact.reduced import MIXED_MATERIAL, MIXED_SHARE, MIXED_SKY
from .known import COLDEST_PRIOR_K, MAX_COMPONENTS, MAX_UNKNOWNS, TERMS
from .planck import planck
from .prior import lighting_scale

QUADRATURE = 16


class Known(NamedTuple):
    """What is known of a scene beside its pixels: float32 tensors.

    nodes_um (bands, n) um, quadrature nodes of every band; sigma (bands,) its noise;
    emissivity (materials, bands, n) at the nodes; is_sky (materials,) 1 for the sky, else 0;
    environment (k, bands); sky_object (k,) 1 for the objects that stand for the sky;
    spread, skylight_spread, sky_spread (d, bands) and error (bands,) as in Environment;
    sky_mean (bands,), or zeros where no sky is in view;
    prior_k (2,) K: mean and standard deviation of T's prior: what is usual in the scene, and
    wide enough for all but a few in a hundred pixels;
    basis (d, bands) orthogonal directions of noise-scaled spectra, each divided by about the
    standard deviation that spectra have along it.
    All other spectra in W m-2 sr-1 um-1. `known` makes one from a cube, a library and an
    environment.
    """

    nodes_um: torch.Tensor
    sigma: torch.Tensor
    emissivity: torch.Tensor
    is_sky: torch.Tensor
    environment: torch.Tensor
    sky_object: torch.Tensor
    spread: torch.Tensor
    skylight_spread: torch.Tensor
    sky_spread: torch.Tensor
    error: torch.Tensor
    sky_mean: torch.Tensor
    prior_k: torch.Tensor
    basis: torch.Tensor

    @staticmethod
    def of(arrays, device="cpu"):
        """The Known of a dict of arrays, as `known.known_arrays` makes it."""
        return Known(**{name: torch.from_numpy(a).to(device) for name, a in arrays.items()})


class Hypotheses(NamedTuple):
    """What of the evidence does not depend on the pixel. R = 2 materials hypotheses (all
    pure, then all mixed with sky), q rows of F of which the last r = k + n are x.

    sky_share (R,) alpha; emissivity (materials, bands) band means; alpha_step (R, bands) what one
    standard deviation of alpha changes, W m-2 sr-1 um-1; centre (bands,) and projection (d,
    bands): z = projection (s - centre); to_w (R d, d + 1) and to_x (R r, d + 1): w and x^ in z
    and 1; offset (R,) log p(z | h) where w is 0; precision (R, r, r) S^-1 and half its log_det
    (R,); to_deviation (R, q - r, d), deviation_0 (R, q - r) and sensitivity (R, q - r, r): the
    likeliest deviations are to_deviation z + deviation_0 - sensitivity (x - x^). precision and
    log_det are float64, all else float32.
    """

    sky_share: torch.Tensor
    emissivity: torch.Tensor
    alpha_step: torch.Tensor
    centre: torch.Tensor
    projection: torch.Tensor
    to_w: torch.Tensor
    to_x: torch.Tensor
    offset: torch.Tensor
    precision: torch.Tensor
    log_det: torch.Tensor
    to_deviation: torch.Tensor
    deviation_0: torch.Tensor
    sensitivity: torch.Tensor


def hypotheses(known: Known) -> Hypotheses:
    """Set up all hypotheses of a scene."""
    # the basis as it came: ONNX Runtime loses a cast and its reverse that only a Scan's body uses
    projection, known = known.basis, Known(*(x.double() for x in known))
    sky, sigma, k = known.is_sky, known.sigma, known.environment.shape[0]
    in_view = (known.sky_mean.max() > 0).double()
    sky_share = torch.cat([sky, sky * MIXED_SKY[0] + (1 - sky) * MIXED_MATERIAL[0]])
    share_sigma = torch.cat([0 * sky, sky * MIXED_SKY[1] + (1 - sky) * MIXED_MATERIAL[1]])
    prior = torch.cat(
        [
            torch.log(1 - MIXED_SHARE * in_view + 0 * sky) - _NEVER * sky * (1 - in_view),
            float(np.log(MIXED_SHARE)) - _NEVER * (1 - in_view) + 0 * sky,
        ]
    )
    # what glows before the sky is as good as black
    e = known.emissivity + (1 - known.emissivity) * sky[:, None, None]
    series = _planck_series(known.nodes_um, known.prior_k)  # (n + 1, bands, nodes)
    glow = (e[:, None] * series).mean(dim=-1).repeat(2, 1, 1) / sigma  # (R, n + 1, bands)
    glow = glow * (1 - sky_share)[:, None, None]
    emissivity = e.mean(dim=-1)
    reflected = (1 - sky_share)[:, None] * (1 - emissivity.repeat(2, 1))
    usual = known.environment.mean(dim=0)
    black = series[0].mean(dim=-1)
    of_reflected = (reflected / sigma)[:, None]
    alpha_step = share_sigma[:, None] * (known.sky_mean - black)
    rows = torch.cat(
        [
            of_reflected * known.spread,
            of_reflected * known.skylight_spread,
            sky_share[:, None, None] * (known.sky_spread / sigma),
            (alpha_step / sigma)[:, None],
            of_reflected * ((known.environment - usual) * lighting_scale(k)),
            glow[:, 1:],
        ],
        dim=1,
    )
    mean = glow[:, 0] + of_reflected[:, 0] * usual + sky_share[:, None] * known.sky_mean / sigma
    r, scale = k + TERMS, (known.basis**2).sum(dim=1).sqrt()
    basis = known.basis / scale[:, None]
    rows, error = rows @ basis.T, (reflected * known.error / sigma) ** 2
    of_d, of_x = rows[:, :-r], rows[:, -r:]
    gram = of_d.transpose(1, 2) @ of_d + (basis * error[:, None]) @ basis.T
    # S^-1 without the difference in S, which would cancel
    free = cholesky(gram, MAX_COMPONENTS)[1] @ of_x.transpose(1, 2)
    precision = free.transpose(1, 2) @ free
    root, _ = cholesky(precision, MAX_UNKNOWNS)
    precision = precision + eye(r, r, rows)
    lower, inverse = cholesky(gram + of_x.transpose(1, 2) @ of_x, MAX_COMPONENTS)
    of_d, of_x = of_d @ inverse.transpose(1, 2), of_x @ inverse.transpose(1, 2)  # (L^-1 U F')'
    centre = mean.mean(dim=0)
    means = (mean - centre) @ basis.T
    w_0 = -(inverse @ means[..., None])
    to_w = torch.cat([inverse / scale, w_0], dim=2)
    return Hypotheses(
        sky_share=sky_share.float(),
        emissivity=emissivity.float(),
        alpha_step=alpha_step.float(),
        centre=centre.float(),
        projection=projection,
        to_w=to_w.flatten(0, 1).float(),
        to_x=(of_x @ to_w).flatten(0, 1).float(),
        offset=(prior - log_det(lower)).float(),
        precision=precision,
        log_det=log_det(root),
        to_deviation=(of_d @ to_w[..., :-1]).float(),
        deviation_0=(of_d @ w_0)[..., 0].float(),
        sensitivity=(of_d @ of_x.transpose(1, 2) @ precision).float(),
    )


_NEVER = 1e15  # nats; misfits reach 1e12


def evidence(h: Hypotheses, s):
    """log p(z | h) (R, P) and x^ (R, r, P) of noise-scaled spectra s (bands, P)."""
    z = components(h, s)
    # by halves: w of all hypotheses would be the most that a pixel takes
    halves = [_squares(rows, z) for rows in h.to_w.unflatten(0, (2, -1))]
    return h.offset[:, None] - 0.5 * torch.cat(halves), likeliest(h, z)


def components(h: Hypotheses, s):
    """z (d, P) of noise-scaled spectra s (bands, P)."""
    return h.projection @ (s - h.centre[:, None])


def likeliest(h: Hypotheses, z):
    """x^ (R, r, P) of z (d, P)."""
    return _affine(h.to_x, z).unflatten(0, (h.offset.shape[0], -1))


def _squares(to_w, z):
    """(R, P) |w|^2."""
    w = _affine(to_w, z).unflatten(0, (-1, z.shape[0]))
    return (w * w).sum(1)


def _affine(a, z):
    return a @ torch.cat([z, torch.ones_like(z[:1])])


def hermite(t):
    """(n, ...) orthonormal Hermite polynomials 1..n of t (...), and their derivatives."""
    value = [torch.ones_like(t), t]
    for d in range(1, TERMS):
        value.append((t * value[d] - d**0.5 * value[d - 1]) / (d + 1) ** 0.5)
    slope = [d**0.5 * value[d - 1] for d in range(1, TERMS + 1)]
    return torch.stack(value[1:]), torch.stack(slope)


def _planck_series(nodes_um, prior_k):
    """(n + 1, bands, nodes) coefficients of B(T_0 + tau t) in orthonormal Hermite polynomials."""
    t, w = np.polynomial.hermite_e.hermegauss(QUADRATURE)
    t, w = (torch.from_numpy(a).to(prior_k.device) for a in (t, w / w.sum()))
    value = torch.cat([torch.ones_like(t)[None], hermite(t)[0]])
    temperature = torch.clamp(prior_k[0] + prior_k[1] * t, min=COLDEST_PRIOR_K)
    b = planck(nodes_um, temperature[:, None, None])
    return torch.einsum("di,ibn->dbn", w * value, b)
