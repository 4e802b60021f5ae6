"""TeX-SGD unrolled: Gauss-Newton steps on Eq. 1 for the few likeliest hypotheses of a pixel.

From `evidence` a pixel and a hypothesis come as y and the triangular L'. Its rows of V and T
(V' = (V - 1/k) / v with v the prior standard deviation; c(T) the Hermite polynomials of
t = (T - T_0) / tau) say in noise units what Eq. 4 costs:

    E(T, V) = |y - L' [V', c(T)]|^2 / 2                   Eq. 4, and the priors of `evidence`
              - |V'|^2 / 2 + kappa |V' - V'_0|^2 / 2      V's prior is moved to a guess V_0
              + (t^2 - |c(T)|^2) / 2,   V on the simplex  T's prior is on t, not on c

V's part is quadratic, so a second factorisation L'_2 per hypothesis turns the first two lines
into |y_2 - L'_2 [V', c]|^2 / 2 + a constant. One step:

1. linearise c at the present T. L'_2 is triangular, so T comes from its own rows, then V;
   their covariance, the inverse Fisher information, comes with them;
2. while some V_j < 0, condition this Gaussian on the most doubtful being zero (a rank-one
   update of mean and covariance);
3. keep the new T and V where they lower E; elsewhere the next step starts half way.
"""

from typing import NamedTuple

import torch

from .evidence import TERMS, Hypotheses, cholesky, hermite, lighting_scale

STEPS = 3
GUESS_PRECISION = 4.0  # kappa: of a guessed V over that of knowing nothing
MAX_AT_ZERO = 5  # of V_j
MAX_STEP, MAX_T = 1.5, 6.0  # prior deviations
TINY = 1e-12
MAX_UNKNOWNS = 18  # V and T's series: 10 objects, 5 terms, padded to whole blocks


class Blocks(NamedTuple):
    """What the steps need of every hypothesis; float32, but for the first three.

    from_y (R, r, r) and from_guess (R, r, k): y_2 = from_y y + from_guess (V_0 - 1/k);
    determinant (R,) what the other prior on V changes of the evidence, nats;
    vv (R, k, k), vt (R, k, n), tt (R, n, n) the blocks of L'_2, V being V - 1/k here;
    solve (R, k, k) and tt_solve (R, n, n) the inverses of vv and tt; covariance (R, k, k) of V
    given T; dx (R, d, k + n) and d_solve (R, d, d): the deviations' rows, for `deviations`.
    """

    from_y: torch.Tensor
    from_guess: torch.Tensor
    determinant: torch.Tensor
    vv: torch.Tensor
    vt: torch.Tensor
    tt: torch.Tensor
    solve: torch.Tensor
    tt_solve: torch.Tensor
    covariance: torch.Tensor
    dx: torch.Tensor
    d_solve: torch.Tensor


class Refined(NamedTuple):
    """t (P, C) in prior deviations and its standard deviation sigma, V (P, C, k) on the simplex
    and E (P, C) in nats, of P pixels with C hypotheses each."""

    t: torch.Tensor
    sigma: torch.Tensor
    lighting: torch.Tensor
    energy: torch.Tensor


def blocks(h: Hypotheses, k, precision=GUESS_PRECISION) -> Blocks:
    """L'_2 of a precision kappa, by what its parts mean."""
    scale, n = lighting_scale(k), k + TERMS
    upper = h.factor[:, -n:, -n:]
    eye = torch.eye(n, dtype=upper.dtype)
    is_v = (torch.arange(n) < k).to(upper.dtype)
    more = torch.diag(is_v * (precision - 1.0))
    lower, inverse = cholesky(upper.transpose(1, 2) @ upper + more - eye, MAX_UNKNOWNS)
    factor, back = lower.transpose(1, 2), inverse.transpose(1, 2)
    solve = back[:, :k, :k] * scale
    centred = solve - solve.mean(dim=1, keepdim=True)  # V's sum is known
    dx = h.factor[:, :-n, -n:]
    parts = (
        factor[:, :k, :k] / scale, factor[:, :k, k:], factor[:, k:, k:],
        solve, back[:, k:, k:], centred @ centred.transpose(1, 2),
        torch.cat([dx[:, :, :k] / scale, dx[:, :, k:]], dim=2), h.inverse[:, :-n, :-n],
    )  # fmt: skip
    log_diagonal = lambda a: torch.log(torch.diagonal(a, dim1=1, dim2=2)).sum(1)  # noqa: E731
    return Blocks(
        inverse @ upper.transpose(1, 2), inverse[:, :, :k] * (precision / scale),
        log_diagonal(lower) - log_diagonal(upper), *(x.float() for x in parts),
    )  # fmt: skip


def refine(b: Blocks, y, row, t, guess, steps=STEPS, precision=GUESS_PRECISION) -> Refined:
    """Minimise E from t (P,) and guess (P, k) for the hypotheses row (P, C).

    y (P, C, k + n), float64, are the last components of `evidence` for these hypotheses.
    """
    k = guess.shape[1]
    vv, vt, tt, solve, covariance = (
        of_rows(x, row) for x in (b.vv, b.vt, b.tt, b.solve, b.covariance)
    )
    off = guess.double() - 1 / k
    y_2 = _times(of_rows(b.from_y, row), y) + _times(of_rows(b.from_guess, row), off[:, None])
    known = 0.5 * ((y * y).sum(-1) - (y_2 * y_2).sum(-1)) + of_rows(b.determinant, row)
    known = known + 0.5 * precision * ((off / lighting_scale(k)) ** 2).sum(-1, keepdim=True)
    known, y_v, y_t = known.float(), y_2[..., :k].float(), y_2[..., k:].float()

    def energy(t, v, c):
        in_v = y_v - _times(vv, v - 1 / k) - _times(vt, c)
        in_t = y_t - _times(tt, c)
        fit = (in_v**2).sum(-1) + (in_t**2).sum(-1) - (c[..., 1:] ** 2).sum(-1)
        return 0.5 * fit + known

    at = t[:, None].expand(row.shape).clamp(-MAX_T, MAX_T)
    best = None
    for _ in range(steps):
        c, slope = hermite(at)
        rest = y_t - _times(tt, c)
        j = _times(tt, slope)
        curvature = (j * j).sum(-1) - (slope[..., 1:] ** 2).sum(-1)
        pull = (j * rest).sum(-1) + (c[..., 1:] * slope[..., 1:]).sum(-1)
        step = (pull / curvature).clamp(-MAX_STEP, MAX_STEP)
        v = 1 / k + _times(solve, y_v - _times(vt, c + slope * step[..., None]))
        lean = -_times(solve, _times(vt, slope))  # dV / dt
        step, v, sigma = _bounded(step, v, covariance, lean, 1 / curvature)
        new = (at + step).clamp(-MAX_T, MAX_T)
        value = energy(new, v, hermite(new)[0])
        if best is None:
            best = Refined(new, sigma, v, value)
            at = new
        else:
            lower = value < best.energy
            at = torch.where(lower, new, 0.5 * (best.t + new))
            best = Refined(
                torch.where(lower, new, best.t), torch.where(lower, sigma, best.sigma),
                torch.where(lower[..., None], v, best.lighting),
                torch.where(lower, value, best.energy),
            )  # fmt: skip
    return best


def deviations(b: Blocks, y, row, t, lighting):
    """(P, d) likeliest coefficients of the deviations, in the order of the rows of F.

    y (P, q) of the hypotheses row (P,), at t (P,) and lighting (P, k).
    """
    d, k = b.dx.shape[1], lighting.shape[1]
    x = torch.cat([lighting - 1 / k, hermite(t)[0]], dim=1)
    return _times(of_rows(b.d_solve, row), y[:, :d] - _times(of_rows(b.dx, row), x))


def _bounded(step, v, covariance, lean, variance):
    """Condition the Gaussian of (step, V) on V >= 0, the V_j most sigmas below first."""
    cov_t = variance[..., None] * lean  # of V with t
    cov = covariance + cov_t[..., None] * lean[..., None, :]
    eye = torch.eye(v.shape[-1])
    for _ in range(MAX_AT_ZERO):
        own = torch.diagonal(cov, dim1=-2, dim2=-1)
        doubt = torch.where(own > TINY, v * own.clamp(min=TINY).rsqrt(), 0.0)
        lowest, j = doubt.min(dim=-1, keepdim=True)
        pick = eye[j[..., 0]]
        column = (cov * pick[..., None, :]).sum(-1)
        with_t = (cov_t * pick).sum(-1, keepdim=True)
        variance_of_it = (own * pick).sum(-1, keepdim=True).clamp(min=TINY)
        scale = torch.where(lowest < -1e-6, 1 / variance_of_it, 0.0)
        moved = (v * pick).sum(-1, keepdim=True) * scale
        v = v - column * moved
        step = step - (with_t * moved)[..., 0]
        variance = variance - (with_t * with_t * scale)[..., 0]
        cov_t = cov_t - column * scale * with_t
        cov = cov - column[..., None] * (column * scale)[..., None, :]
    v = v.clamp(min=0)
    return step, v / v.sum(-1, keepdim=True), variance.clamp(min=TINY).sqrt()


def _times(a, x):
    """Matrices (..., m, n) times vectors (..., n), where both are small."""
    return (a * x[..., None, :]).sum(-1)


def of_rows(x, row):
    """x (R, ...) of the hypotheses row (...) -> (*row, ...)."""
    return x.index_select(0, row.reshape(-1)).reshape(*row.shape, *x.shape[1:])
