"""Eq. 6 for one pixel and one hypothesis: V on the simplex by active set, T by Newton's method.

Variable projection (Golub & Pereyra 1973): V for given T is a k x k quadratic programme on the
simplex, solved exactly, and what is left is a function of one scalar, T. This takes whatever comes;
where it is known which V_j are zero, `faces` does it for many pixels at once.
"""

import numpy as np

from ..machinery.compiled import compiled

STEPS = 40  # of Newton's method
NATS = 1e-7  # it ends where the next step would lower J by less


@compiled()
def solve(h, gram, n, k, half, weight, mean, tau, v, free, work):
    """T (as tau) and V of one pixel and one material; returns J less its constant, tau, J''.

    h, gram        (n + k,), (n + k, n + k) h and H of `reduced`;  half, K for one of tau
    weight, mean   quadratic on T: weight (T - mean)^2 / 2, with mean measured from mid_k
    v, free        V to start from, on the simplex, and which V_j are not held at zero
    J''            curvature in T with V eliminated, 1/K^2: 1 / sigma_T^2
    """
    p, dp, ddp, a = work[0], work[1], work[2], work[3]
    g, z, x, y = work[4], work[5], work[6], work[7]
    chol = work[8:]
    best = np.inf
    curvature = 0.0
    step = 0.0
    for _ in range(STEPS):
        p[0], dp[0], ddp[0] = 1.0, 0.0, 0.0
        if n > 1:
            p[1], dp[1], ddp[1] = tau, 1.0, 0.0
        for i in range(2, n):
            p[i] = 2 * tau * p[i - 1] - p[i - 2]
            dp[i] = 2 * p[i - 1] + 2 * tau * dp[i - 1] - dp[i - 2]
            ddp[i] = 4 * dp[i - 1] + 2 * tau * ddp[i - 1] - ddp[i - 2]
        for i in range(k):
            acc, accz = h[n + i], 0.0
            for j in range(n):
                acc -= gram[n + i, j] * p[j]
                accz += gram[n + i, j] * dp[j]
            g[i], z[i] = acc, accz
        count = _lighting(gram, n, k, g, v, free, chol, x, y)
        deviation = half * tau - mean
        value = 0.5 * weight * deviation * deviation
        gradient = weight * half * deviation
        gauss = weight * half * half
        second = gauss
        for i in range(n):
            acc, accd = 0.0, 0.0
            for j in range(n):
                acc += gram[i, j] * p[j]
                accd += gram[i, j] * dp[j]
            value += p[i] * (0.5 * acc - h[i])
            gauss += dp[i] * accd
            a[i] = acc - h[i]
            for j in range(k):
                a[i] += gram[i, n + j] * v[j]
            gradient += dp[i] * a[i]
            second += ddp[i] * a[i]
        for i in range(k):
            acc = 0.0
            for j in range(k):
                acc += gram[n + i, n + j] * v[j]
            value += v[i] * (0.5 * acc - g[i])
        # curvature that V gives back: z' (projected inverse of the free block) z
        c = 0
        for i in range(k):
            if free[i]:
                acc, ones = z[i], 1.0
                for j in range(c):
                    acc -= chol[c, j] * x[j]
                    ones -= chol[c, j] * y[j]
                x[c] = acc / chol[c, c]
                y[c] = ones / chol[c, c]
                c += 1
        zz, zo, oo = 0.0, 0.0, 0.0
        for i in range(count):
            zz += x[i] * x[i]
            zo += x[i] * y[i]
            oo += y[i] * y[i]
        gauss -= zz - zo * zo / oo
        second += gauss - weight * half * half
        if value > best + 1e-12 * abs(best):
            step *= 0.5  # Newton overshot: halve the step from the last good point
            tau -= step
            continue
        best = value
        curvature = gauss
        hessian = second if second > 0.5 * gauss else gauss
        step = min(max(-gradient / hessian, -1.0 - tau), 1.0 - tau)
        if -step * (gradient + 0.5 * hessian * step) < NATS:
            break
        tau += step
    else:
        tau -= step  # the last good point
    return best, tau, curvature / (half * half)


@compiled()
def _lighting(gram, n, k, g, v, free, chol, x, y):
    """Minimise v'Gv/2 - g'v on the simplex, G = gram[n:, n:], from a feasible v (in place).

    Primal active set (Nocedal & Wright, alg. 16.3) with G v = g + lambda on the free set. Leaves
    the free block's Cholesky factor in chol and returns its size; x and y are for substitutions.
    """
    for _ in range(4 * k + 8):
        count = 0
        for i in range(k):
            if free[i]:
                # Cholesky row of the free block, with forward substitution alongside
                col = 0
                for j in range(i + 1):
                    if free[j]:
                        acc = gram[n + i, n + j]
                        for c in range(col):
                            acc -= chol[count, c] * chol[col, c]
                        if j == i:
                            chol[count, count] = np.sqrt(max(acc, 1e-300))
                        else:
                            chol[count, col] = acc / chol[col, col]
                        col += 1
                ax, ay = g[i], 1.0
                for c in range(count):
                    ax -= chol[count, c] * x[c]
                    ay -= chol[count, c] * y[c]
                x[count] = ax / chol[count, count]
                y[count] = ay / chol[count, count]
                count += 1
        sx, sy = 0.0, 0.0
        for i in range(count - 1, -1, -1):
            for c in range(i + 1, count):
                x[i] -= chol[c, i] * x[c]
                y[i] -= chol[c, i] * y[c]
            x[i] /= chol[i, i]
            y[i] /= chol[i, i]
            sx += x[i]
            sy += y[i]
        multiplier = (1.0 - sx) / sy
        step, blocking, c = 1.0, -1, 0
        for i in range(k):
            if free[i]:
                target = x[c] + multiplier * y[c]
                if target < 0.0:
                    ratio = v[i] / max(v[i] - target, 1e-300)
                    if ratio < step:
                        step, blocking = ratio, i
                c += 1
        c = 0
        for i in range(k):
            if free[i]:
                v[i] += step * (x[c] + multiplier * y[c] - v[i])
                c += 1
        if blocking >= 0:
            v[blocking] = 0.0
            free[blocking] = False
            continue
        worst, enter = -1e-9 * (1.0 + abs(multiplier)), -1
        for i in range(k):
            if not free[i]:
                slack = -g[i] - multiplier
                for j in range(k):
                    slack += gram[n + i, n + j] * v[j]
                if slack < worst:
                    worst, enter = slack, i
        if enter < 0:
            return count
        free[enter] = True
    return count
