"""Every material's evidence for every pixel, in one matrix product.

Let T and V of Eq. 4 have Gaussian priors instead of bounds, and write B(T) as a series in
Hermite polynomials of t = (T - T_0) / tau, whose coefficients are uncorrelated with unit
variance when t is a standard normal number. The spectrum of a pixel of hypothesis h (a
material, pure or partly sky, as in `reduced`) is then Gaussian too. In noise units,

    s ~ N(mu_h, C_h),     C_h = diag(1 + g_h^2 error^2) + F_h' F_h

with, in the rows of F_h, what the pixel is free in, one standard deviation long:

    g_h spread, g_h skylight_spread, alpha sky_spread, the sky's share     (deviations)
    g_h (S_j - mean S) / sqrt(3 k)                                         (lighting)
    (1 - alpha) e_m B_1 .. B_n                      B's series             (temperature)

g_h = (1 - alpha)(1 - e_m). With I + F D^-1 F' = L L' (D the diagonal part) and
y = L^-1 F D^-1 (s - mu), the evidence is closed-form (Woodbury),

    log p(s | h) = -(|s - mu|^2_D^-1 - |y|^2) / 2 - log det(L) - log det(D) / 2 + log prior,

and so is what a simplex, or B's true nonlinearity, cost beyond it: any coefficients z (of
the rows of F) are worse than the best ones by |y - L' z|^2 / 2. The deviations come first,
so the last k + n components of y alone decide on V and T: `refinement` works with them.

This is what `local` computes exactly and five times more slowly; it ranks materials almost as
well (88 % right instead of 89 %), and a network can start from it. Plain torch operations
of static shape in everything but sizes: the whole of it goes into an ONNX file.
"""

from typing import NamedTuple

import numpy as np
import torch

from .planck import radiance
from .reduced import MIXED_MATERIAL, MIXED_SHARE, MIXED_SKY, V_PRECISION

TERMS = 5  # of B's series
QUADRATURE = 16
BLOCK = 6  # of the factorisation
MAX_COLUMNS = 36  # of F: 6 + 6 + 6 deviations, the share, 5 terms, 10 environment objects


class Known(NamedTuple):
    """What is known of a scene beside its pixels: float32 tensors.

    nodes_um (bands, n) um, quadrature nodes of every band; sigma (bands,) its noise;
    emissivity (materials, bands, n) at the nodes; is_sky (materials,) 1 for the sky, else 0;
    environment (k, bands); sky_object (k,) 1 for the objects that stand for the sky;
    spread, skylight_spread, sky_spread (d, bands) and error (bands,) as in Environment;
    sky_mean (bands,), or zeros where no sky is in view;
    prior_k (2,) mean and standard deviation of the scene's temperatures in K.
    All spectra in W m-2 sr-1 um-1. `texnet.inputs` makes one from a cube, a library and an
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


class Hypotheses(NamedTuple):
    """What of the evidence does not depend on the pixel. R = 2 materials hypotheses (all
    pure, then all mixed with sky), q rows of F of which the last k + n are V and T.

    share (R,) alpha; emissivity (materials, bands) band means; rim (R, bands) what one standard
    deviation of alpha changes, W m-2 sr-1 um-1; mean (R, bands) mu; weight (R, bands) D^-1;
    project (R, q, bands) L^-1 F D^-1; factor (R, q, q) L'; inverse (R, q, q) its inverse;
    offset (R,) what is left of the evidence: determinants, prior.
    float64 but for share, emissivity and rim.
    """

    share: torch.Tensor
    emissivity: torch.Tensor
    rim: torch.Tensor
    mean: torch.Tensor
    weight: torch.Tensor
    project: torch.Tensor
    factor: torch.Tensor
    inverse: torch.Tensor
    offset: torch.Tensor


def hypotheses(known: Known) -> Hypotheses:
    """Set up all hypotheses of a scene."""
    known = Known(*(x.double() for x in known))
    sky, sigma, k = known.is_sky, known.sigma, known.environment.shape[0]
    in_view = (known.sky_mean.max() > 0).double()
    share = torch.cat([sky, sky * MIXED_SKY[0] + (1 - sky) * MIXED_MATERIAL[0]])
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
    glow = glow * (1 - share)[:, None, None]
    emissivity = e.mean(dim=-1)
    glass = (1 - share)[:, None] * (1 - emissivity.repeat(2, 1))
    centre = known.environment.mean(dim=0)
    black = series[0].mean(dim=-1)
    over = (glass / sigma)[:, None]
    rim = share_sigma[:, None] * (known.sky_mean - black)
    rows = torch.cat(
        [
            over * known.spread,
            over * known.skylight_spread,
            share[:, None, None] * (known.sky_spread / sigma),
            (rim / sigma)[:, None],
            over * ((known.environment - centre) * lighting_scale(k)),
            glow[:, 1:],
        ],
        dim=1,
    )
    mean = glow[:, 0] + over[:, 0] * centre + share[:, None] * known.sky_mean / sigma
    weight = 1 / (1 + (glass * known.error / sigma) ** 2)
    weighted = rows * weight[:, None]
    lower, inverse = cholesky(rows @ weighted.transpose(1, 2))
    log_det = torch.log(torch.diagonal(lower, dim1=1, dim2=2)).sum(dim=1)
    offset = prior - log_det + 0.5 * torch.log(weight).sum(dim=1)
    return Hypotheses(
        share.float(), emissivity.float(), rim.float(), mean, weight, inverse @ weighted,
        lower.transpose(1, 2), inverse.transpose(1, 2), offset,
    )  # fmt: skip


def lighting_scale(k):
    """Standard deviation of each of k lighting factors, a priori."""
    return (V_PRECISION * k) ** -0.5


_NEVER = 1e15  # nats; misfits reach 1e12


def evidence(h: Hypotheses, s):
    """log p(s | h) (P, R) and y (P, R, q) of noise-scaled spectra s (P, bands), float64.

    float64 because a pixel 10 K from the mean is worth 10^6 nats before T explains it.
    """
    r, q, bands = h.project.shape
    y = s @ h.project.reshape(r * q, bands).T
    y = (y - torch.einsum("rqb,rb->rq", h.project, h.mean).reshape(-1)).reshape(-1, r, q)
    chi2 = (s * s) @ h.weight.T - 2 * s @ (h.weight * h.mean).T + (h.weight * h.mean**2).sum(-1)
    return h.offset - 0.5 * (chi2 - (y * y).sum(dim=-1)), y


def hermite(t):
    """(..., n) orthonormal Hermite polynomials 1..n of t and (..., n) their derivatives."""
    value, slope = [torch.ones_like(t), t], []
    for d in range(1, TERMS):
        value.append((t * value[d] - d**0.5 * value[d - 1]) / (d + 1) ** 0.5)
    slope = [d**0.5 * value[d - 1] for d in range(1, TERMS + 1)]
    return torch.stack(value[1:], dim=-1), torch.stack(slope, dim=-1)


def _planck_series(nodes_um, prior_k):
    """(n + 1, bands, nodes) coefficients of B(T_0 + tau t) in orthonormal Hermite polynomials."""
    t, w = np.polynomial.hermite_e.hermegauss(QUADRATURE)
    t, w = torch.from_numpy(t), torch.from_numpy(w / w.sum())
    value = torch.cat([torch.ones(QUADRATURE, 1, dtype=t.dtype), hermite(t)[0]], dim=1)
    temperature = torch.clamp(prior_k[0] + prior_k[1] * t, min=30.0)
    b = radiance(nodes_um, temperature[:, None, None])
    return torch.einsum("id,ibn->dbn", w[:, None] * value, b)


def cholesky(gram, most=MAX_COLUMNS):
    """L and L^-1 of I + gram (R, q, q) = L L', from operations that ONNX has.

    Padded with the identity to `most` >= q, a multiple of BLOCK; block by block, within a block
    by elimination.
    """
    pad = torch.eye(most, gram.shape[1], dtype=gram.dtype)
    a = pad @ gram @ pad.T + torch.eye(most, dtype=gram.dtype)
    inverse = torch.eye(most, dtype=gram.dtype).expand_as(a)
    lower, rows = [], []
    for start in range(0, most, BLOCK):
        # a and inverse hold the rows and columns not yet eliminated
        root_inverse = _root_inverse(a[:, :BLOCK, :BLOCK])
        row = root_inverse @ inverse[:, :BLOCK]  # of L^-1
        upper = root_inverse @ a[:, :BLOCK]  # of L'
        rest = upper[:, :, BLOCK:].transpose(1, 2)
        rows.append(row)
        lower.append(torch.cat([torch.zeros_like(row[:, :, :start]), upper], dim=2))
        a = a[:, BLOCK:, BLOCK:] - rest @ upper[:, :, BLOCK:]
        inverse = inverse[:, BLOCK:] - rest @ row
    return (
        pad.T @ torch.cat(lower, dim=1).transpose(1, 2) @ pad,
        pad.T @ torch.cat(rows, dim=1) @ pad,
    )


def _root_inverse(a):
    """l^-1 of a (R, BLOCK, BLOCK) = l l', by Gauss's elimination of [a, I]."""
    eye = torch.eye(BLOCK, dtype=a.dtype)
    both = torch.cat([a, eye.expand_as(a)], dim=2)
    for i in range(BLOCK - 1):
        row, column = both[:, i : i + 1], both[:, :, i : i + 1]
        below = (torch.arange(BLOCK)[:, None] > i).to(a.dtype)
        both = both - (below * column / row[:, :, i : i + 1]) * row
    pivots = (both[:, :, :BLOCK] * eye).sum(2, keepdim=True)
    return both[:, :, BLOCK:] * torch.rsqrt(pivots)
