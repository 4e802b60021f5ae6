"""Eq. 6 where it is known which V_j are zero: on a face of the simplex, one polynomial in T.

With the free V_j on the plane sum V = 1 and the others zero, the best V for given T is linear in
the inner products h of `reduced`, and what is left is one polynomial in tau for each hypothesis.
Let p = (C_i(tau)), and let T and V index the blocks of H:

    J(tau) = p' M p / 2 - b' p + const                    M = H_TT - H_TV Z H_VT
    b = h_T - H_TV (Z h_V + u)                            V = Z (h_V - H_VT p) + u

with Z = G - G 1 1' G / (1' G 1) and u = G 1 / (1' G 1), G the inverse of H_VV's free block. J' is
a Chebyshev series of 2 n - 2 terms, of which a pixel changes the first n - 1, by what is linear in
h, so that a step of Newton's method takes a few multiplications.

Where no V_j is negative, and none that is zero would lower J (Karush, Kuhn, Tucker), this is the
answer. On the face of all V it is a lower bound at least; and since V_j >= 0 alone raises the J of
a Gaussian (T, V) by V_j^2 / (2 var V_j), the largest of these makes the bound a good deal tighter,
where T moves so little (NEAR_K) that (T, V) is nearly Gaussian.
"""

import math
from itertools import combinations
from typing import NamedTuple

import numpy as np
from numpy.polynomial import chebyshev

from ..machinery.compiled import compiled

STEPS = 12  # of Newton's method
# of the last step in tau, and of the last in float32: the next would be about its square
TOLERANCE, COARSE = 1e-4, np.float32(3e-4)
ONE, TWO, UPHILL = np.float32([1.0, 2.0, 0.2])
NEAR_K = 3.0
LANES = 64  # pixels worked on together
MOST_ZERO, MOST_NUMBERS = 3, 1e7  # V_j, of a face that has tables; in those tables, about
UNROLLED = 4  # coefficients in a pass of Clenshaw's rule, which is written for so many
# a * b + c may be rounded once, and 1 / 0 is infinite: else pixels would not share instructions.
_FUSED = compiled(fastmath={"contract"}, error_model="numpy")


class Tables(NamedTuple):
    """What no pixel changes, of R hypotheses on F faces, the first that of all V.

    free         (F, k) bool, which V_j may differ from zero;  sets (F,) their sum of 2^j
    onto         (R, F, n - 1, n + k), takes h to what it adds to J'
    gradient     (R, F, S) J' but for that: this and hessian are Chebyshev series, zeros at the end
    hessian      (R, F, S) the curvature p' M p in tau (Gauss-Newton) with the prior's
    glow         (R, S) p' H_TT p / 2
    u, z         (R, F, k), (R, F, k, k)
    sensitivity  (R, k, n) Z H_VT of all V
    vt, vv       (R, k, n), (R, k, k) H_VT and H_VV
    """

    free: np.ndarray
    sets: np.ndarray
    onto: np.ndarray
    gradient: np.ndarray
    hessian: np.ndarray
    u: np.ndarray
    z: np.ndarray
    sensitivity: np.ndarray
    glow: np.ndarray
    vt: np.ndarray
    vv: np.ndarray


def tables(gram, n, half, weight, mean) -> Tables:
    """Tables of H (R, n + k, n + k); half, weight and mean as for `simplex.solve`."""
    rows, k = len(gram), gram.shape[1] - n
    most = MOST_ZERO
    while most and rows * math.comb(k + 1, most) * (n + k) ** 2 > MOST_NUMBERS:
        most -= 1
    free = np.array([
        [j not in zero for j in range(k)]
        for count in range(min(k, most + 1)) for zero in combinations(range(k), count)
    ])  # fmt: skip
    sets = free @ (1 << np.arange(k))
    z, u = np.zeros((rows, len(free), k, k)), np.zeros((rows, len(free), k))
    for face, index in enumerate(map(np.flatnonzero, free)):
        inverse = np.linalg.inv(gram[:, n + index[:, None], n + index])
        ones = inverse.sum(axis=2)
        u[:, face, index] = own = ones / ones.sum(axis=1, keepdims=True)
        z[:, face, index[:, None], index] = inverse - own[:, :, None] * ones[:, None]
    tt, vt, vv = (np.ascontiguousarray(gram[:, a, b]) for a, b in (
        (slice(n), slice(n)), (slice(n, None), slice(n)), (slice(n, None), slice(n, None))
    ))  # fmt: skip
    sensitivity = z @ vt[:, None]
    m = tt[:, None] - vt[:, None].transpose(0, 1, 3, 2) @ sensitivity
    shift = (u[:, :, None] @ vt[:, None])[:, :, 0]

    derive = chebyshev.chebder(np.eye(n))  # (n - 1, n) coefficients -> of the derivative
    size = -(-(2 * n - 1) // UNROLLED) * UNROLLED
    glow = _products(0.5 * tt, size)
    gradient = np.zeros((rows, len(free), size))
    gradient[..., : size - 1] = chebyshev.chebder(_products(0.5 * m, size), axis=2)
    gradient[..., : n - 1] += shift @ derive.T
    gradient[..., 0] -= weight * half * mean
    gradient[..., 1] += weight * half**2
    hessian = _products(derive @ m @ derive.T, size)
    hessian[..., 0] += weight * half**2
    of_t = np.broadcast_to(-derive, (rows, len(free), n - 1, n))
    onto = np.concatenate([of_t, derive @ sensitivity.transpose(0, 1, 3, 2)], axis=3)
    sensitivity = np.ascontiguousarray(sensitivity[:, 0])
    return Tables(free, sets, onto, gradient, hessian, u, z, sensitivity, glow, vt, vv)


def _products(m, size):
    """Chebyshev series (.., size) of p' m p, m (.., i, i): C_i C_j = (C_{i+j} + C_{|i-j|}) / 2."""
    series = np.zeros((*m.shape[:-2], size))
    for i in range(m.shape[-1]):
        for j in range(m.shape[-1]):
            series[..., i + j] += 0.5 * m[..., i, j]
            series[..., abs(i - j)] += 0.5 * m[..., i, j]
    return series


@_FUSED
def times(a, s, out, c):
    """out (m, :c) = a (m, n) @ s (n, :c), two by four; zero rows cost nothing."""
    m, n = a.shape
    whole = n - n % 4
    for i in range(m):
        for p in range(c):
            out[i, p] = 0.0
    for i in range(0, m - 1, 2):
        if a[i].any() or a[i + 1].any():
            for j in range(0, whole, 4):
                a0, a1, a2, a3 = a[i, j], a[i, j + 1], a[i, j + 2], a[i, j + 3]
                b0, b1, b2, b3 = a[i + 1, j], a[i + 1, j + 1], a[i + 1, j + 2], a[i + 1, j + 3]
                for p in range(c):
                    s0, s1, s2, s3 = s[j, p], s[j + 1, p], s[j + 2, p], s[j + 3, p]
                    out[i, p] += a0 * s0 + a1 * s1 + a2 * s2 + a3 * s3
                    out[i + 1, p] += b0 * s0 + b1 * s1 + b2 * s2 + b3 * s3
            for j in range(whole, n):
                for p in range(c):
                    out[i, p] += a[i, j] * s[j, p]
                    out[i + 1, p] += a[i + 1, j] * s[j, p]
    if m % 2 and a[m - 1].any():
        for j in range(n):
            for p in range(c):
                out[m - 1, p] += a[m - 1, j] * s[j, p]


@_FUSED
def less_half_squares(a, out):
    """out (LANES,) less |a|^2 / 2 of a (m, LANES)."""
    for i in range(len(a)):
        for p in range(LANES):
            out[p] -= 0.5 * a[i, p] * a[i, p]


@_FUSED
def solve_on_face(
    h, constant, c, tables, r, face, half, weight, mean, x, work, value, curvature, v, v_gradient
):
    """Minimise J over T and over V on a face, for c <= LANES pixels and hypothesis r.

    h          (n + k, LANES);  constant (LANES,) of J
    tables     Tables as a plain tuple
    half, weight, mean   as for `simplex.solve`
    x          (LANES,) tau to start from; in place, tau
    work       (4 n + 2 k + 6, LANES) scratch
    value      (LANES,) out: J, or -inf where Newton's method has not converged
    curvature  (LANES,) out, 1/K^2, as `simplex.solve`
    v          (k, LANES) out: V, which may be negative
    v_gradient (k, LANES) out: by what V_j would raise J, per unit taken from the others
    """
    _, _, onto, gradients, hessians, u, z, _, glows, vt, vv = tables
    k, n, size = vt.shape[1], vt.shape[2], gradients.shape[2]
    step, hessian, cheb = work[0], work[1], work[2 : n + 2]
    light, rest = work[n + 2 : n + k + 2], work[n + k + 2 :]
    series = rest[:size]
    times(onto[r, face], h, series, c)
    for i in range(size):
        a = gradients[r, face, i]
        if i < n - 1:
            for p in range(c):
                series[i, p] += a
        else:
            for p in range(c):
                series[i, p] = a
    for p in range(c):
        x[p] = min(max(x[p], -0.95), 0.95)
    _newton(series, x, step, hessian, c)
    for p in range(c):
        cheb[0, p], cheb[1, p] = 1.0, x[p]
    for i in range(2, n):
        for p in range(c):
            cheb[i, p] = 2.0 * x[p] * cheb[i - 1, p] - cheb[i - 2, p]
    times(vt[r], cheb, light, c)
    for j in range(k):
        for p in range(c):
            light[j, p] = h[n + j, p] - light[j, p]
    times(z[r, face], light, v, c)
    # J from H itself, because what V has been eliminated from cancels
    glow, second, mean_gradient = rest[:2], rest[2:4], rest[4]  # the series has served
    _clenshaw(glows[r], x, glow, c)
    _clenshaw(hessians[r, face], x, second, c)
    for p in range(c):
        deviation = half * x[p] - mean
        value[p] = constant[p] + 0.5 * weight * deviation * deviation
        value[p] += glow[0, p] - x[p] * glow[1, p]
        curvature[p] = (second[0, p] - x[p] * second[1, p]) / (half * half)
        mean_gradient[p] = 0.0
    for i in range(n):
        for p in range(c):
            value[p] -= cheb[i, p] * h[i, p]
    for j in range(k):
        a = u[r, face, j]
        for p in range(c):
            v[j, p] += a
    times(vv[r], v, v_gradient, c)
    for j in range(k):
        for p in range(c):
            value[p] += v[j, p] * (0.5 * v_gradient[j, p] - light[j, p])
            v_gradient[j, p] -= light[j, p]
            mean_gradient[p] += v[j, p] * v_gradient[j, p]
    for j in range(k):
        for p in range(c):
            v_gradient[j, p] -= mean_gradient[p]
    for p in range(c):
        value[p] = -np.inf if abs(step[p]) >= TOLERANCE else value[p]


@_FUSED
def _clenshaw(series, x, b, c):
    """b (2, LANES): Clenshaw's b_0 and b_1 of a series (S,) at x, which is b_0 - x b_1."""
    for p in range(c):
        b[0, p], b[1, p] = 0.0, 0.0
    for i in range(len(series) - UNROLLED, -1, -UNROLLED):
        a0, a1, a2, a3 = series[i], series[i + 1], series[i + 2], series[i + 3]
        for p in range(c):
            t, b0, b1 = 2.0 * x[p], b[0, p], b[1, p]
            b1 = a3 + (t * b0 - b1)
            b0 = a2 + (t * b1 - b0)
            b1 = a1 + (t * b0 - b1)
            b[0, p], b[1, p] = a0 + (t * b1 - b0), b1


@_FUSED
def _newton(series, x, step, hessian, c):
    """Zero of J', a series (S, LANES), from x (LANES,), in place; the last step, and J'' before it.
    All steps but the last are in float32, in which a pixel stays where it has converged, whatever
    the others do."""
    coarse, at = np.empty((len(series), LANES), np.float32), np.empty((2, LANES), np.float32)
    b, d = np.empty((2, LANES), np.float32), np.empty((2, LANES), np.float32)
    own_b, own_d = np.empty((2, LANES)), np.empty((2, LANES))
    for i in range(len(series)):
        for p in range(c):
            coarse[i, p] = series[i, p]
    for p in range(c):
        at[0, p], at[1, p] = x[p], np.inf
    for _ in range(STEPS):
        _derivatives(coarse, at[0], b, d, TWO, c)
        moving = 0
        for p in range(c):
            move, _ = _move(b[0, p], b[1, p], d[0, p], d[1, p], at[0, p], ONE, UPHILL)
            there = abs(at[1, p]) < COARSE
            at[0, p] = at[0, p] if there else at[0, p] + move
            at[1, p] = at[1, p] if there else move
            moving += abs(at[1, p]) >= COARSE
        if moving == 0:
            break
    for p in range(c):
        x[p] = at[0, p]
    _derivatives(series, x, own_b, own_d, 2.0, c)
    for p in range(c):
        step[p], hessian[p] = _move(
            own_b[0, p], own_b[1, p], own_d[0, p], own_d[1, p], x[p], 1.0, 0.2
        )
        x[p] += step[p]


@_FUSED
def _derivatives(series, x, b, d, two, c):
    """In b (2, LANES) Clenshaw's b_0 and b_1 of a series (S, LANES) at x, and in d their
    derivatives; two is 2, of the same precision."""
    for p in range(c):
        b[0, p], b[1, p], d[0, p], d[1, p] = 0.0, 0.0, 0.0, 0.0
    for i in range(len(series) - UNROLLED, -1, -UNROLLED):
        for p in range(c):
            t, b0, b1, d0, d1 = two * x[p], b[0, p], b[1, p], d[0, p], d[1, p]
            d1 = two * b0 + (t * d0 - d1)
            b1 = series[i + 3, p] + (t * b0 - b1)
            d0 = two * b1 + (t * d1 - d0)
            b0 = series[i + 2, p] + (t * b1 - b0)
            d1 = two * b0 + (t * d0 - d1)
            b1 = series[i + 1, p] + (t * b0 - b1)
            d[0, p], d[1, p] = two * b1 + (t * d1 - d0), d1
            b[0, p], b[1, p] = series[i, p] + (t * b1 - b0), b1


@_FUSED
def _move(b0, b1, d0, d1, x, one, uphill):
    """Newton's step from x within -1..1, and J'' there; one is 1, of the same precision, and so is
    uphill, how far to go where J bends down."""
    gradient, flat = b0 - x * b1, d0 - x * d1 - b1
    # where J bends down: a step that says "not converged"
    move = -gradient / flat if flat > 0.0 else (uphill if gradient < 0.0 else -uphill)
    return min(max(move, -one - x), one - x), flat


@_FUSED
def lower_bound(tables, r, half, x, work, value, curvature, v, bound):
    """About the least J for V >= 0, at least value, from what `solve_on_face` has just left of face
    0 and LANES pixels, in work too.

    bound  (LANES,) out; inf where that is done: no V_j is negative
    """
    z, sensitivity = tables[6][r, 0], tables[7][r]
    k, n = sensitivity.shape
    hessian, cheb = work[1], work[2 : n + 2]
    of_v, derivative = work[n + 2 : n + k + 2], work[n + k + 2 :]
    for p in range(LANES):
        derivative[0, p], derivative[1, p] = 0.0, 1.0
    for i in range(2, n):
        for p in range(LANES):
            derivative[i, p] = (
                2.0 * (cheb[i - 1, p] + x[p] * derivative[i - 1, p]) - derivative[i - 2, p]
            )
    times(sensitivity, derivative[:n], of_v, LANES)  # -dV / dtau
    spread, least = derivative[0], derivative[1]  # have served: the variance of tau, the least V_j
    for p in range(LANES):
        flat = curvature[p] * half * half
        spread[p] = 1.0 / (min(flat, hessian[p]) if hessian[p] > 0.0 else flat)
        bound[p], least[p] = 0.0, 0.0
    for j in range(k):
        for p in range(LANES):
            below = min(v[j, p], 0.0)
            least[p] = min(least[p], below)
            shared = of_v[j, p] * spread[p]  # covariance of V_j and tau
            variance = max(z[j, j], 0.0) + of_v[j, p] * shared + 1e-30
            near = abs(below * shared) * half < NEAR_K * variance
            bound[p] = max(bound[p], 0.5 * below * below / variance if near else 0.0)
    for p in range(LANES):
        done = least[p] == 0.0 and value[p] > -np.inf
        bound[p] = np.inf if done else value[p] + bound[p]
