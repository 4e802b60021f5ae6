"""Eq. 6 without V's bounds: fast, and nearly a lower bound of Eq. 6.

With V free on the plane sum V = 1, the best V for given T is linear in the inner products h of
`reduced`, and what is left is one polynomial in tau for each hypothesis. Let p = (C_i(tau)),
and let T and V index the blocks of H:

    J(tau) = p' M p / 2 - b' p + const                    M = H_TT - H_TV Z H_VT
    b = h_T - H_TV (Z h_V + u)                            V = Z (h_V - H_VT p) + u

with Z = G - G 1 1' G / (1' G 1) and u = G 1 / (1' G 1), G = H_VV^-1. Chebyshev polynomials
multiply by C_i C_j = (C_{i+j} + C_{|i-j|}) / 2, so p' M p is a series of 2 n - 1 terms that no
pixel changes.

Where no V_j is negative this is the answer. Elsewhere it is a lower bound; and since V_j >= 0
alone raises the J of a Gaussian (T, V) by V_j^2 / (2 var V_j), the largest of these makes the
bound a good deal tighter, where T moves so little (NEAR_K) that (T, V) is nearly Gaussian.
"""

from typing import NamedTuple

import numba
import numpy as np

STEPS = 12  # of Newton's method
TOLERANCE = 1e-4  # of the last step in tau: the next would be about its square
NEAR_K = 3.0
LANES = 64  # pixels worked on together
_FUSED = numba.njit(cache=True, fastmath={"contract"})  # a * b + c may be rounded once


class Tables(NamedTuple):
    """What no pixel changes: u (R, k), Z (R, k, k), Z H_VT (R, k, n), H_TV u (R, n), M
    (R, n, n) and the series (R, 2 n - 1) of p' M p / 2."""

    u: np.ndarray
    z: np.ndarray
    lean: np.ndarray
    shift: np.ndarray
    m: np.ndarray
    series: np.ndarray


def tables(gram, n) -> Tables:
    """Tables of H (R, n + k, n + k)."""
    tt, vt, vv = gram[:, :n, :n], gram[:, n:, :n], gram[:, n:, n:]
    inverse = np.linalg.inv(vv)
    ones = inverse.sum(axis=2)
    u = ones / ones.sum(axis=1, keepdims=True)
    z = inverse - u[:, :, None] * ones[:, None]
    lean = z @ vt
    m = tt - vt.transpose(0, 2, 1) @ lean
    series = np.zeros((len(gram), 2 * n - 1))
    for i in range(n):
        for j in range(n):
            series[:, i + j] += 0.25 * m[:, i, j]
            series[:, abs(i - j)] += 0.25 * m[:, i, j]
    shift = np.einsum("rki,rk->ri", vt, u)
    return Tables(u, z, lean, shift, m, series)


@_FUSED
def times(a, s, out):
    """out (m, LANES) = a (m, n) @ s (n, LANES), two by four; zero rows cost nothing."""
    m, n = a.shape
    for i in range(m):
        for p in range(LANES):
            out[i, p] = 0.0
    whole = n - n % 4
    for i in range(0, m - 1, 2):
        if a[i].any() or a[i + 1].any():
            for j in range(0, whole, 4):
                a0, a1, a2, a3 = a[i, j], a[i, j + 1], a[i, j + 2], a[i, j + 3]
                b0, b1, b2, b3 = a[i + 1, j], a[i + 1, j + 1], a[i + 1, j + 2], a[i + 1, j + 3]
                for p in range(LANES):
                    s0, s1, s2, s3 = s[j, p], s[j + 1, p], s[j + 2, p], s[j + 3, p]
                    out[i, p] += a0 * s0 + a1 * s1 + a2 * s2 + a3 * s3
                    out[i + 1, p] += b0 * s0 + b1 * s1 + b2 * s2 + b3 * s3
            for j in range(whole, n):
                for p in range(LANES):
                    out[i, p] += a[i, j] * s[j, p]
                    out[i + 1, p] += a[i + 1, j] * s[j, p]
    if m % 2:
        for j in range(n):
            for p in range(LANES):
                out[m - 1, p] += a[m - 1, j] * s[j, p]


@_FUSED
def solve_unbounded(
    h, gram, tables, r, n, k, half, weight, mean, x, work, value, bound, curvature, v
):
    """Minimise J over T and free V for LANES pixels and hypothesis r.

    h          (n + k, LANES);  gram  (n + k, n + k) H of this hypothesis
    tables     Tables as a plain tuple
    weight, mean, half   as for `local._solve`
    x          (LANES,) tau to start from; in place, tau
    work       (2 n + k + 10, LANES) scratch
    value      (LANES,) the constant of J; in place, J, or -inf where Newton's method has not
               converged
    bound      (LANES,) out: about the least J for V >= 0, at least value
    curvature  (LANES,) out, 1/K^2, as `local._solve`
    v          (k, LANES) out: V, which may be negative
    """
    c = LANES
    u, z, lean, shift, m, series = tables
    b, zh, cheb = work[10 : 10 + n], work[10 + n : 10 + n + k], work[10 + n + k :]
    for i in range(n):
        for p in range(c):
            b[i, p] = h[i, p] - shift[r, i]
        for j in range(k):
            a = lean[r, j, i]
            for p in range(c):
                b[i, p] -= a * h[n + j, p]
    g, s, step = work[0], work[1], work[2]
    p0, p1, d0, d1, e0, e1 = work[3], work[4], work[5], work[6], work[7], work[8]
    for p in range(c):
        x[p] = min(max(x[p], -0.95), 0.95)
    for _ in range(STEPS):
        for p in range(c):
            g[p] = weight * half * (half * x[p] - mean)
            s[p] = weight * half * half
            p0[p], d0[p], e0[p] = 1.0, 0.0, 0.0
            p1[p], d1[p], e1[p] = x[p], 1.0, 0.0
        for i in range(1, 2 * n - 1):
            a = series[r, i]
            if i < n:
                for p in range(c):
                    q = a - b[i, p]
                    g[p] += q * d1[p]
                    s[p] += q * e1[p]
            else:
                for p in range(c):
                    g[p] += a * d1[p]
                    s[p] += a * e1[p]
            for p in range(c):
                t2 = 2.0 * x[p]
                pn = t2 * p1[p] - p0[p]
                dn = 2.0 * p1[p] + t2 * d1[p] - d0[p]
                en = 4.0 * d1[p] + t2 * e1[p] - e0[p]
                p0[p], d0[p], e0[p] = p1[p], d1[p], e1[p]
                p1[p], d1[p], e1[p] = pn, dn, en
        largest = 0.0
        for p in range(c):
            # where J bends down: a step that says "not converged"
            move = -g[p] / s[p] if s[p] > 0.0 else (0.2 if g[p] < 0.0 else -0.2)
            move = min(max(move, -1.0 - x[p]), 1.0 - x[p])
            step[p] = move
            x[p] += move
            largest = max(largest, abs(move))
        if largest < TOLERANCE:
            break
    slope, of_v = b, zh  # dp / dtau and -dV / dtau, once b and Z h_V have served
    for j in range(k):
        for p in range(c):
            zh[j, p] = 0.0
        for i in range(k):
            a = z[r, j, i]
            for p in range(c):
                zh[j, p] += a * h[n + i, p]
        for p in range(c):
            v[j, p] = zh[j, p] + u[r, j]
            of_v[j, p] = 0.0
    for i in range(n):
        for p in range(c):
            if i == 0:
                p0[p], d0[p] = 1.0, 0.0
                p1[p], d1[p] = x[p], 1.0
            cheb[i, p], slope[i, p] = p0[p], d0[p]
        for j in range(k):
            a = lean[r, j, i]
            for p in range(c):
                v[j, p] -= a * p0[p]
                of_v[j, p] += a * d0[p]
        for p in range(c):
            t2 = 2.0 * x[p]
            pn = t2 * p1[p] - p0[p]
            dn = 2.0 * p1[p] + t2 * d1[p] - d0[p]
            p0[p], d0[p] = p1[p], d1[p]
            p1[p], d1[p] = pn, dn
    # J from H itself, because what V has been eliminated from cancels
    for p in range(c):
        deviation = half * x[p] - mean
        value[p] += 0.5 * weight * deviation * deviation
        curvature[p] = weight * half * half
    pull = e0
    for i in range(n + k):
        for p in range(c):
            pull[p] = -h[i, p]
        for j in range(n):
            a = (0.5 if i < n else 1.0) * gram[i, j]
            for p in range(c):
                pull[p] += a * cheb[j, p]
        if i < n:
            for p in range(c):
                value[p] += cheb[i, p] * pull[p]
        else:
            for j in range(k):
                a = 0.5 * gram[i, n + j]
                for p in range(c):
                    pull[p] += a * v[j, p]
            for p in range(c):
                value[p] += v[i - n, p] * pull[p]
    for i in range(1, n):
        for j in range(1, n):
            a = m[r, i, j]
            for p in range(c):
                curvature[p] += a * slope[i, p] * slope[j, p]
    for p in range(c):
        bound[p] = 0.0
    for j in range(k):
        for p in range(c):
            below = min(v[j, p], 0.0)
            bend = min(curvature[p], s[p]) if s[p] > 0.0 else curvature[p]
            shared = of_v[j, p] / bend  # covariance of V_j and tau
            variance = max(z[r, j, j], 0.0) + of_v[j, p] * shared + 1e-30
            if abs(below * shared) * half < NEAR_K * variance:
                bound[p] = max(bound[p], 0.5 * below * below / variance)
    for p in range(c):
        if abs(step[p]) >= TOLERANCE:
            value[p] = -np.inf
        bound[p] += value[p]
        curvature[p] /= half * half
