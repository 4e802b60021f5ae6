"""TeX-SGD unrolled: Gauss-Newton steps on Eq. 1 for the few likeliest hypotheses of a pixel.

`hypotheses` and `evidence` describe a pixel and a hypothesis by x^ and S^-1. Let x = (V', c(T)),
with V' = (V - V_usual) / v, v the prior standard deviation, and c(T) the Hermite polynomials of
t = (T - T_0) / tau. With V on the simplex, the cost of T and V in nats, beyond the evidence, is

    E(T, V) = (x - x^)' S^-1 (x - x^) / 2                 Eq. 1, and the priors of `hypotheses`
              - |V'|^2 / 2 + kappa |V' - V'_0|^2 / 2      V's prior is moved to a guess V_0
              + (T - T_0)^2 / (2 tau_1^2) - |c(T)|^2 / 2  T's is made narrower

(tau must cover nearly every pixel, so that the series holds; T of a mirror is better constrained
than that.) V's part is quadratic: with S_2^-1 = S^-1 + (kappa - 1) 1_V = L_2 L'_2 and the pull
p = kappa V'_0 - (kappa - 1) V'^, the first two lines are |L'_2 (x - x^ - S_2 p)|^2 / 2 plus a
constant. E also includes the change of the evidence's determinant by the other priors. It does not
correct for the series' coefficients being treated as free, which makes materials that reflect
little up to some 3 nats less likely, compared with metals, than they should be; the network was
trained with that. L'_2 is triangular, so its last rows give E as a function of T alone, with V
free: FREE_STEPS of Newton's method on these cost little. Then follow one or more steps of T and V
together:

1. linearise c at the present T: mean and covariance (the inverse Fisher information) of (T, V);
2. while some V_j < 0, condition this Gaussian on the V_j that is most sigmas below zero being zero
   (a rank-one update of mean and covariance), five times at most: with ten objects, E of one pixel
   in twenty is then up to 1 nat too high, and its T off by some hundredths of a kelvin.

In all arrays pixels are the last axis, so that many pixels are processed at once.
"""

from typing import NamedTuple

import torch
from torch.nn import functional

from .evidence import hermite
from .hypotheses import GUESS_PRECISION, Blocks, Hypotheses
from .known import MAX_T
from .prior import lighting_scale

FREE_STEPS, STEPS = 2, 1
TYPICAL_K = 10.0  # tau_1: how far T is from what is usual in a scene
MAX_AT_ZERO = 5  # of V_j
MAX_STEP = 1.5  # prior deviations
TINY = 1e-12
ZERO = 1e-6  # V_j above -ZERO, and as many sigmas, are not negative


class Refined(NamedTuple):
    """t (P,) in prior deviations and its standard deviation sigma, V (k, P) on the simplex and
    E (P,) in nats, of P pixels with a hypothesis each."""

    t: torch.Tensor
    sigma: torch.Tensor
    lighting: torch.Tensor
    energy: torch.Tensor


def refine(
    b: Blocks, x, row, t, guess, usual, width=1.0, steps=STEPS, precision=GUESS_PRECISION
) -> Refined:
    """Minimise E from t (P,) and guess (k, P) for the hypotheses row (P,) and the usual V (k,).

    x (k + n, P) are the x^ of `evidence` for these hypotheses; width is tau_1 / tau, at most 1;
    steps, at least 1, is the number of steps of T and V; precision is the kappa of b.
    """
    k = guess.shape[0]
    scale = lighting_scale(k)
    hot = one_hot(row, b.determinant.shape[0])
    vv, vt, tt, solve = (of_rows(a, hot) for a in (b.vv, b.vt, b.tt, b.solve))
    narrow = width**-2
    v_hat, v_0 = x[:k], (guess - usual[:, None]) / scale
    pull = precision * v_0 - (precision - 1) * v_hat
    pulled = _times(of_rows(b.pulled, hot), pull)
    c_2, v_2 = (x + pulled)[k:], (x + pulled)[:k] * scale + usual[:, None]

    def newton(t):
        """A step of T alone, 1 / its variance, c and its slope at t."""
        c, slope = hermite(t)
        j = _times(tt, slope)
        curvature = (j * j - slope**2).sum(0) + narrow
        force = (j * _times(tt, c_2 - c) + c * slope).sum(0) - narrow * t
        return (force / curvature).clamp(-MAX_STEP, MAX_STEP), curvature, c, slope

    t = t.clamp(-MAX_T, MAX_T)
    for _ in range(FREE_STEPS):
        t = (t + newton(t)[0]).clamp(-MAX_T, MAX_T)
    for _ in range(steps):
        step, curvature, c, slope = newton(t)
        v = v_2 - _times(solve, _times(vt, c + slope * step - c_2))
        sensitivity = -_times(solve, _times(vt, slope))  # dV / dt
        step, v, sigma = _bounded(b, row, step, v, sensitivity, 1 / curvature)
        t = (t + step).clamp(-MAX_T, MAX_T)
    _, curvature, c, _ = newton(t)
    off = c - c_2
    in_v, in_t = _times(vv, v - v_2) + _times(vt, off), _times(tt, off)
    energy = (in_v**2).sum(0) + (in_t**2).sum(0) - (c**2).sum(0)
    energy = energy + narrow * t**2
    energy = energy + precision * ((v_hat - v_0) ** 2).sum(0)
    energy = energy - (v_hat**2).sum(0) - (pull * pulled[:k]).sum(0)
    # what T's other prior changes of the evidence, as determinant says it of V's
    energy = energy + torch.log(curvature / (curvature - narrow + 1))
    energy = 0.5 * energy + of_rows(b.determinant, hot)
    return Refined(t=t, sigma=sigma, lighting=v, energy=energy)


def deviations(h: Hypotheses, z, x, row, t, lighting, usual):
    """(q - r, P) likeliest coefficients of the deviations, in the order of the rows of F.

    z (d, P) from `components` and x (r, P) from `likeliest` for the hypotheses row (P,), at t (P,)
    and lighting (k, P); usual (k,) is the usual V.
    """
    v = (lighting - usual[:, None]) / lighting_scale(lighting.shape[0])
    at = torch.cat([v, hermite(t)[0]])
    of = torch.cat([h.to_deviation, h.deviation_0[..., None], -h.sensitivity], dim=2)
    terms = torch.cat([z, torch.ones_like(t[None]), at - x])
    # each pixel's own matrix: here several times faster than to pick its numbers by `of_rows`
    return (of[row] @ terms.t()[..., None])[..., 0].t()


def _bounded(b, row, step, v, sensitivity, variance):
    """Condition the Gaussian of (step, V) on V >= 0 -> step, V on the simplex, sigma of step.

    variance is that of the step (P,), sensitivity (k, P) is dV / d step. Many pixels need it not at
    all, few more than once: only those that still do are looked at.
    """
    out = _outside(v)
    sensitivity = torch.cat([torch.ones_like(step)[None], sensitivity])[:, out]
    covariance = of_rows(b.covariance, one_hot(row[out], b.covariance.shape[0]))
    covariance = functional.pad(covariance, (0, 0, 1, 0, 1, 0))
    covariance = covariance + variance[out] * sensitivity[:, None] * sensitivity
    u = torch.cat([step[None], v])
    inside, of_inside = _conditioned(u[:, out], covariance, MAX_AT_ZERO)
    u, variance = u.index_copy(1, out, inside), variance.index_copy(0, out, of_inside)
    v = u[1:].clamp(min=0)
    return u[0], v / v.sum(0), variance.clamp(min=TINY).sqrt()


def _conditioned(u, covariance, times):
    """Mean (1 + k, P) and the first's variance (P,) after conditioning on zero the V_j that is
    most sigmas below, at most so many times."""
    own = torch.diagonal(covariance).movedim(-1, 0)[1:]
    doubt = torch.where(own > TINY, u[1:] * own.clamp(min=TINY).rsqrt(), 0.0)
    lowest, j = doubt.min(dim=0, keepdim=True)
    column = covariance.gather(1, 1 + j[None].expand(u.shape[0], -1, -1))[:, 0]
    scale = torch.where(lowest < -ZERO, 1 / own.gather(0, j).clamp(min=TINY), 0.0)
    scaled = column * scale
    u = u - scaled * u.gather(0, 1 + j)
    if times == 1:
        return u, covariance[0, 0] - column[0] * scaled[0]
    covariance = covariance - column[:, None] * scaled
    out = _outside(u[1:])
    inside, of_inside = _conditioned(u[:, out], covariance[:, :, out], times - 1)
    return u.index_copy(1, out, inside), covariance[0, 0].index_copy(0, out, of_inside)


def _outside(v):
    """Indices of the pixels where some V_j is negative."""
    return (v.amin(0) < -ZERO).nonzero()[:, 0]


def _times(a, x):
    """Matrices (m, n, ...) times vectors (n, ...), where both are small."""
    return (a * x).sum(1)


def one_hot(row, n):
    """(n, ...) float32 1 where row (...) is that index, else 0."""
    return (torch.arange(n, device=row.device).reshape(-1, *(1,) * row.ndim) == row).float()


def of_rows(x, hot):
    """Finite x (R, *size) of the hypotheses that are hot (R, ...) -> (*size, ...).

    A matrix product, several times faster than indexing; exact.
    """
    picked = x.reshape(x.shape[0], -1).T @ hot.flatten(1)
    return picked.reshape(*x.shape[1:], *hot.shape[1:])
