"""Eq. 6 where it is known which V_j are zero: on a face of the simplex, one polynomial in T.

With the free V_j on the plane sum V = 1 and the others zero, the best V for given T is linear in
the inner products h of `reduced`, and what is left is one polynomial in tau for each hypothesis.
Let p = (C_i(tau)), and let T and V index the blocks of H:

    J(tau) = p' M p / 2 - b' p + const                    M = H_TT - H_TV Z H_VT
    b = h_T - H_TV (Z h_V + u)                            V = Z (h_V - H_VT p) + u

with Z = G - G 1 1' G / (1' G 1) and u = G 1 / (1' G 1), G the inverse of H_VV's free block. Of
the 2 n - 2 coefficients of J' in powers of tau a pixel changes the first n - 1, by what is linear
in h, so that a step of Newton's method takes a few multiplications.

Where no V_j is negative, and none that is zero would lower J (Karush, Kuhn, Tucker), this is the
answer. On the face of all V it is a lower bound at least; and since V_j >= 0 alone raises the J of
a Gaussian (T, V) by V_j^2 / (2 var V_j), the largest of these makes the bound a good deal tighter,
where T moves so little (NEAR_K) that (T, V) is nearly Gaussian.
"""

from itertools import combinations
from typing import NamedTuple

import numba
import numpy as np
from numpy.polynomial import chebyshev

STEPS = 12  # of Newton's method
TOLERANCE = 1e-4  # of the last step in tau: the next would be about its square
NEAR_K = 3.0
LANES = 64  # pixels worked on together
MOST_ZERO = 3  # V_j, of a face that has tables
_UNROLLED = 4  # coefficients in a pass of Horner's rule
# a * b + c may be rounded once, and 1 / 0 is infinite: else pixels would not share instructions
_FUSED = numba.njit(cache=True, fastmath={"contract"}, error_model="numpy")


class Tables(NamedTuple):
    """What no pixel changes, of R hypotheses on F faces, the first that of all V.

    free    (F, k) bool, which V_j may differ from zero
    number  (2^k,) the face of a set of free V_j, sum of 2^j; -1 if it has no tables
    onto    (R, F, n - 1, n + k), takes h to what it adds to J', in powers of tau
    slope   (R, F, S) J' but for that, zeros at the end
    bend    (R, F, S) likewise, the curvature p' M p in tau (Gauss-Newton) with the prior's
    u, z    (R, F, k), (R, F, k, k)
    lean    (R, F, k, n) Z H_VT
    glow    (R, S) Chebyshev series of p' H_TT p / 2, zeros at the end
    vt, vv  (R, k, n), (R, k, k) H_VT and H_VV
    """

    free: np.ndarray
    number: np.ndarray
    onto: np.ndarray
    slope: np.ndarray
    bend: np.ndarray
    u: np.ndarray
    z: np.ndarray
    lean: np.ndarray
    glow: np.ndarray
    vt: np.ndarray
    vv: np.ndarray


def tables(gram, n, half, weight, mean) -> Tables:
    """Tables of H (R, n + k, n + k); half, weight and mean as for `simplex.solve`."""
    rows, k = len(gram), gram.shape[1] - n
    free = np.array([
        [j not in zero for j in range(k)]
        for count in range(min(k, MOST_ZERO + 1)) for zero in combinations(range(k), count)
    ])  # fmt: skip
    number = np.full(1 << k, -1)
    number[free @ (1 << np.arange(k))] = np.arange(len(free))
    z, u = np.zeros((rows, len(free), k, k)), np.zeros((rows, len(free), k))
    for face, index in enumerate(map(np.flatnonzero, free)):
        inverse = np.linalg.inv(gram[:, n + index[:, None], n + index])
        ones = inverse.sum(axis=2)
        u[:, face, index] = own = ones / ones.sum(axis=1, keepdims=True)
        z[:, face, index[:, None], index] = inverse - own[:, :, None] * ones[:, None]
    tt, vt, vv = (np.ascontiguousarray(gram[:, a, b]) for a, b in (
        (slice(n), slice(n)), (slice(n, None), slice(n)), (slice(n, None), slice(n, None))
    ))  # fmt: skip
    lean = z @ vt[:, None]
    m = tt[:, None] - vt[:, None].transpose(0, 1, 3, 2) @ lean
    shift = (u[:, :, None] @ vt[:, None])[:, :, 0]

    powers = np.zeros((n, n))  # C_i = sum_d powers[i, d] tau^d
    for i, c in enumerate(np.eye(n)):
        powers[i, : i + 1] = chebyshev.cheb2poly(c[: i + 1])
    m = powers.T @ m @ powers
    size = -(-(2 * n - 1) // _UNROLLED) * _UNROLLED
    slope, bend = np.zeros((2, rows, len(free), size))
    glow = np.zeros((rows, size))
    for i in range(n):
        for j in range(n):
            glow[:, i + j] += 0.25 * tt[:, i, j]  # C_i C_j = (C_{i+j} + C_{|i-j|}) / 2
            glow[:, abs(i - j)] += 0.25 * tt[:, i, j]
            if i + j:
                slope[..., i + j - 1] += 0.5 * (i + j) * m[..., i, j]
            if i and j:
                bend[..., i + j - 2] += i * j * m[..., i, j]
    bend[..., 0] += weight * half**2
    slope[..., 1] += weight * half**2
    slope[..., 0] -= weight * half * mean
    to_slope = -(powers.T * np.arange(n)[:, None])[1:]
    slope[..., : n - 1] -= shift @ to_slope.T
    of_t = np.broadcast_to(to_slope, (rows, len(free), n - 1, n))
    onto = np.concatenate([of_t, -to_slope @ lean.transpose(0, 1, 3, 2)], axis=3)
    return Tables(free, number, onto, slope, bend, u, z, lean, glow, vt, vv)


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
    h, constant, c, tables, r, face, half, weight, mean, x, work, value, curvature, v, pull
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
    pull       (k, LANES) out: by what V_j would raise J, per unit taken from the others
    """
    _, _, onto, slopes, bends, u, z, _, glow, vt, vv = tables
    k, n, size = vt.shape[1], vt.shape[2], slopes.shape[2]
    step, bend, cheb = work[0], work[1], work[2 : n + 2]
    light, series = work[n + 2 : n + k + 2], work[n + k + 2 : n + k + 2 + size]
    times(onto[r, face], h, series, c)
    for i in range(size):
        a = slopes[r, face, i]
        if i < n - 1:
            for p in range(c):
                series[i, p] += a
        else:
            for p in range(c):
                series[i, p] = a
    for p in range(c):
        x[p] = min(max(x[p], -0.95), 0.95)
    _newton(series, x, step, bend, c)
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
    b1, b2, mean_pull = series[0], series[1], series[2]
    for p in range(c):
        b1[p], b2[p], curvature[p], mean_pull[p] = 0.0, 0.0, 0.0, 0.0
    for i in range(size - 4, -1, -4):
        a0, a1, a2, a3 = glow[r, i], glow[r, i + 1], glow[r, i + 2], glow[r, i + 3]
        for p in range(c):  # Clenshaw's rule
            t, b, d = 2.0 * x[p], b1[p], b2[p]
            d = a3 + (t * b - d)
            b = a2 + (t * d - b)
            d = a1 + (t * b - d)
            b1[p], b2[p] = a0 + (t * d - b), d
        a0, a1 = bends[r, face, i], bends[r, face, i + 1]
        a2, a3 = bends[r, face, i + 2], bends[r, face, i + 3]
        for p in range(c):
            t = x[p]
            curvature[p] = (((curvature[p] * t + a3) * t + a2) * t + a1) * t + a0
    for p in range(c):
        deviation = half * x[p] - mean
        value[p] = constant[p] + (b1[p] - x[p] * b2[p]) + 0.5 * weight * deviation * deviation
        curvature[p] /= half * half
    for i in range(n):
        for p in range(c):
            value[p] -= cheb[i, p] * h[i, p]
    for j in range(k):
        a = u[r, face, j]
        for p in range(c):
            v[j, p] += a
    times(vv[r], v, pull, c)
    for j in range(k):
        for p in range(c):
            value[p] += v[j, p] * (0.5 * pull[j, p] - light[j, p])
            pull[j, p] -= light[j, p]
            mean_pull[p] += v[j, p] * pull[j, p]
    for j in range(k):
        for p in range(c):
            pull[j, p] -= mean_pull[p]
    for p in range(c):
        value[p] = -np.inf if abs(step[p]) >= TOLERANCE else value[p]


@_FUSED
def _newton(series, x, step, bend, c):
    """Zero of J', whose coefficients are series (S, LANES), from x (LANES,), in place; the last
    step, and J'' before it. A pixel stays where it has converged, whatever the others do."""
    slope, flat = np.empty(LANES), np.empty(LANES)
    for p in range(c):
        step[p] = np.inf
    for _ in range(STEPS):
        for p in range(c):
            slope[p], flat[p] = 0.0, 0.0
        for i in range(len(series) - 4, -1, -4):  # Horner's rule, of J' and J''
            for p in range(c):
                a, b, t = slope[p], flat[p], x[p]
                b = b * t + a
                a = a * t + series[i + 3, p]
                b = b * t + a
                a = a * t + series[i + 2, p]
                b = b * t + a
                a = a * t + series[i + 1, p]
                flat[p] = b * t + a
                slope[p] = a * t + series[i, p]
        moving = 0
        for p in range(c):
            # where J bends down: a step that says "not converged"
            move = -slope[p] / flat[p] if flat[p] > 0.0 else (0.2 if slope[p] < 0.0 else -0.2)
            move = min(max(move, -1.0 - x[p]), 1.0 - x[p])
            there = abs(step[p]) < TOLERANCE
            bend[p] = bend[p] if there else flat[p]
            x[p] = x[p] if there else x[p] + move
            step[p] = step[p] if there else move
            moving += abs(step[p]) >= TOLERANCE
        if moving == 0:
            break


@_FUSED
def lower_bound(tables, r, half, x, work, value, curvature, v, bound):
    """About the least J for V >= 0, at least value, from what `solve_on_face` left of face 0 and
    LANES pixels.

    bound  (LANES,) out; inf where that is done: no V_j is negative
    """
    z, lean = tables[6][r, 0], tables[7][r, 0]
    k, n = lean.shape
    bend, cheb, of_v, slope = work[1], work[2 : n + 2], work[n + 2 : n + k + 2], work[n + k + 2 :]
    for p in range(LANES):
        slope[0, p], slope[1, p] = 0.0, 1.0
    for i in range(2, n):
        for p in range(LANES):
            slope[i, p] = 2.0 * (cheb[i - 1, p] + x[p] * slope[i - 1, p]) - slope[i - 2, p]
    times(lean, slope[:n], of_v, LANES)  # -dV / dtau
    spread, least = slope[0], slope[1]  # have served: the variance of tau, the least V_j
    for p in range(LANES):
        flat = curvature[p] * half * half
        spread[p] = 1.0 / (min(flat, bend[p]) if bend[p] > 0.0 else flat)
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
