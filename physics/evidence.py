"""Every material's evidence for every pixel, in a matrix product.

For each hypothesis, as set up by `hypotheses`, the whitened misfit w and the likeliest unknowns x^
are affine functions of a pixel's components z (a projection of its noise-scaled spectrum s). For
all hypotheses and pixels together they are thus the product of one matrix with (z, 1), and

    log p(z | h) = -|w|^2 / 2 - log det(L) + log prior.

`exact.local` computes this exactly, but far more slowly; the closed form ranks materials almost as
well, and serves as the network's input. It uses plain torch operations, so that it can be exported
to ONNX.
"""

import torch

from .hypotheses import Hypotheses
from .known import TERMS


def tensors(arrays, device="cpu"):
    """Arrays by name (`known`, `hypotheses`) as tensors."""
    return {name: torch.from_numpy(a).to(device) for name, a in arrays.items()}


def evidence(h: Hypotheses, s):
    """log p(z | h) (R, P) and x^ (R, r, P) of noise-scaled spectra s (bands, P)."""
    z, half = components(h, s), h.to_w.shape[0] // 2
    # by halves: w of all hypotheses would be the most that a pixel takes
    halves = [_squares(rows, z) for rows in (h.to_w[:half], h.to_w[half:])]
    return h.offset[:, None] - 0.5 * torch.cat(halves), likeliest(h, z)


def components(h: Hypotheses, s):
    """z (d, P) of noise-scaled spectra s (bands, P)."""
    return h.basis @ (s - h.centre[:, None])


def likeliest(h: Hypotheses, z):
    """x^ (R, r, P) of z (d, P)."""
    return _affine(h.to_x, z)


def _squares(to_w, z):
    """(R, P) |w|^2."""
    w = _affine(to_w, z)
    return (w * w).sum(1)


def _affine(a, z):
    """a (R, m, d + 1) times z (d, P) and 1, (R, m, P)."""
    product = a.flatten(0, 1) @ torch.cat([z, torch.ones_like(z[:1])])
    return product.unflatten(0, a.shape[:2])


def hermite(t):
    """(n, ...) orthonormal Hermite polynomials 1..n of t (...), and their derivatives."""
    value = [torch.ones_like(t), t]
    for d in range(1, TERMS):
        value.append((t * value[d] - d**0.5 * value[d - 1]) / (d + 1) ** 0.5)
    slope = [d**0.5 * value[d - 1] for d in range(1, TERMS + 1)]
    return torch.stack(value[1:]), torch.stack(slope)
