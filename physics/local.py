"""The exact local solver of Eq. 6: every pixel, every material, no smoothness.

For one pixel and one material, minimise over T and over V on the simplex

    J = chi^2 / 2 + (T - T_prior)^2 / (2 sigma_T^2) + |V - 1/k|^2 / (2 sigma_V^2)

in the r dimensions of `reduced` (variable projection, Golub & Pereyra 1973): V for
given T is a k x k quadratic programme on the simplex, solved exactly by active set;
T is Newton's method on what is left, a function of one scalar. The priors are as wide
as the scene and matter only where the data say nothing: there the answer's sigma is
the prior's, which is how the solver says that it cannot know.

    energy_m = J + occam_m = -log evidence of material m

The answer is the material of least energy, with its T and V. `unbounded` solves every
hypothesis first as if V might be negative. Where none is, that is the answer; elsewhere it gives
about a lower bound, and hypotheses whose bound is HOPELESS nats above the pixel's best are left at
it.
"""

from dataclasses import dataclass

import numba
import numpy as np
from numpy.polynomial import chebyshev

from . import unbounded
from .planck import brightness_temperature
from .reduced import ReducedModel, groups

PIXELS_PER_BLOCK = 4096
# More than neighbours (at most 4 BETA = 12) and the materials' shares in a scene (log of some
# 40,000 pixels times the materials, 18 for 1500) can make up for in `semiglobal`
HOPELESS = 30.0  # nats
_NEWTON_STEPS = 40
_NATS = 1e-7  # Newton's method ends where the next step would lower J by less


@dataclass(frozen=True, eq=False)
class LocalSolution:
    """Every material's answer, for P pixels and L materials (library order, sky included).

    energy         (P, L) float32, -log evidence up to one constant; +inf for the sky where
                   there is none in view; beyond `hopeless` nats above the least it may be about a
                   lower bound, with the T that V without bounds would give, but never for the
                   best of the materials that are not sky
    temperature_k  (P, L) float32, K; of the sky, the prior's
    sigma_k        (P, L) float32, one standard deviation of T given m, K
    row            (P, L) int16, which hypothesis of the reduced model stands for m: the pure
                   pixel or the one at the sky's edge, whichever has more evidence
    lighting       (P, k) float32, V of the material of least energy
    """

    energy: np.ndarray
    temperature_k: np.ndarray
    sigma_k: np.ndarray
    row: np.ndarray
    lighting: np.ndarray


def solve_local(
    model: ReducedModel, spectra, progress=None, hopeless=HOPELESS
) -> LocalSolution:
    """Solve Eq. 6 for every pixel and material of spectra (P, bands), W m-2 sr-1 um-1.

    progress, if given, is called as progress(pixels done, pixels); hopeless is in nats, see
    LocalSolution: less is faster, and enough where nothing but the evidence decides.
    """
    pixels, shape = len(spectra), (len(spectra), len(model.library))
    energy = np.full(shape, np.inf, np.float32)
    temperature = np.full(shape, model.prior_mean_k, np.float32)
    sigma = np.full(shape, model.prior_sigma_k, np.float32)
    row = np.zeros(shape, np.int16)
    lighting = np.empty((pixels, model.k), np.float32)
    prior = model.prior_sigma_k**-2.0, model.prior_mean_k - model.mid_k
    of_t = model.terms, model.k, model.half_k, *prior
    linear, square = model.of_all()
    tables = tuple(unbounded.tables(model.gram, model.terms))
    middle = len(model.sigma) // 2
    seen = np.maximum(spectra[:, middle].astype(np.float64), 1e-9)
    start_k = brightness_temperature(model.wavelength_um[middle], seen)
    for start in range(0, pixels, PIXELS_PER_BLOCK):
        block = slice(start, min(start + PIXELS_PER_BLOCK, pixels))
        _solve_all(
            spectra[block], start_k[block], model.sigma, linear, square, model.gram, tables, *of_t,
            model.material, model.material == model.library.sky_index, model.mid_k, hopeless,
            energy[block], temperature[block], sigma[block], row[block], lighting[block],
        )  # fmt: skip
        if progress:
            progress(block.stop, pixels)
    return LocalSolution(energy, temperature, sigma, row, lighting)


def solve_given(model: ReducedModel, spectra, row, temperature_k, weight, mean_k):
    """T and V of every pixel for a given hypothesis each, from a given start.

    spectra (P, bands); row (P,) hypotheses; temperature_k (P,) the start, K;
    weight (P,) 1/K^2 and mean_k (P,) K add weight (T - mean_k)^2 / 2 to what is minimised.

    Returns J + occam (P,) without that parabola, T (P,) K, V (P, k) and sigma of T (P,) K
    from the data and the prior alone.
    """
    pixels = len(spectra)
    energy, t, sigma = np.empty(pixels), np.empty(pixels), np.empty(pixels)
    v = np.empty((pixels, model.k))
    prior, prior_mean = model.prior_sigma_k**-2.0, model.prior_mean_k
    for r, index in groups(row):
        h, constant = model.inner_products(spectra[index] / model.sigma, r)
        total = weight[index] + prior
        mean = (weight[index] * mean_k[index] + prior * prior_mean) / total - model.mid_k
        value, curvature = np.empty(len(index)), np.empty(len(index))
        tau = (temperature_k[index] - model.mid_k) / model.half_k
        lighting = np.empty((len(index), model.k))
        _solve_given(
            h, model.gram[r], model.terms, model.k, model.half_k, total, mean,
            value, tau, curvature, lighting,
        )  # fmt: skip
        deviation = model.half_k * tau
        t[index], v[index] = model.mid_k + deviation, lighting
        value += 0.5 * prior * (t[index] - prior_mean) ** 2 - 0.5 * total * (deviation - mean) ** 2
        energy[index] = value + constant + model.occam[r]
        sigma[index] = (curvature - weight[index]) ** -0.5
    return energy, t, v, sigma


def energy_given(model: ReducedModel, spectra, row, temperature_k, lighting):
    """(P,) J + occam at any hypothesis, T and V; arguments as in `solve_given`, V (P, k)."""
    energy = np.empty(len(spectra))
    for r, index in groups(row):
        h, constant = model.inner_products(spectra[index] / model.sigma, r)
        tau = (temperature_k[index] - model.mid_k) / model.half_k
        u = np.concatenate([chebyshev.chebvander(tau, model.terms - 1), lighting[index]], axis=1)
        energy[index] = (
            constant + model.occam[r] + (u * (0.5 * u @ model.gram[r] - h)).sum(axis=1)
            + 0.5 * ((temperature_k[index] - model.prior_mean_k) / model.prior_sigma_k) ** 2
        )  # fmt: skip
    return energy


@numba.njit(cache=True, fastmath=False)
def _lighting(gram, n, k, g, v, free, chol, x, y):
    """Minimise v'Gv/2 - g'v on the simplex, G = gram[n:, n:], from a feasible v (in place).

    Primal active set (Nocedal & Wright, alg. 16.3) with G v = g + lambda on the free set.
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


@numba.njit(cache=True, fastmath=False)
def _solve(h, gram, n, k, half, weight, mean, tau, v, free, work):
    """T (as tau) and V of one pixel and one material; returns J less its constant, tau, J''.

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
    for _ in range(_NEWTON_STEPS):
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
        bend = second if second > 0.5 * gauss else gauss
        step = min(max(-gradient / bend, -1.0 - tau), 1.0 - tau)
        if -step * (gradient + 0.5 * bend * step) < _NATS:
            break
        tau += step
    else:
        tau -= step  # the last good point
    return best, tau, curvature / (half * half)


@numba.njit(cache=True, parallel=True, fastmath=False)
def _solve_all(
    spectra, start_k, noise, linear, square, gram, tables, n, k, half, weight, mean, material,
    is_sky, mid, hopeless, energy, temperature, sigma, row, lighting,
):  # fmt: skip
    """All hypotheses of P pixels, LANES at a time: `solve_local` from plain arrays."""
    pixels, bands, rows, lanes = len(spectra), len(noise), len(gram), unbounded.LANES
    for chunk in numba.prange((pixels + lanes - 1) // lanes):
        s, squared = np.ones((bands + 1, lanes)), np.ones((bands + 1, lanes))
        count = min(lanes, pixels - chunk * lanes)
        for j in range(bands):
            for p in range(count):
                s[j, p] = spectra[chunk * lanes + p, j] / noise[j]
                squared[j, p] = s[j, p] ** 2
        deflated = np.empty((linear.shape[1], lanes))
        scratch, start, x = np.empty((2 * n + k + 10, lanes)), np.zeros(lanes), np.empty(lanes)
        for p in range(count):
            start[p] = (start_k[chunk * lanes + p] - mid) / half
        h, v = np.empty((rows, n + k, lanes)), np.empty((rows, k, lanes))
        constant, value, bound, tau, curvature = np.empty((5, rows, lanes))
        for r in range(rows):
            unbounded.times(linear[r], s, deflated)
            unbounded.times(square[r : r + 1], squared, constant[r : r + 1])
            for i in range(n + k, len(deflated)):
                for p in range(lanes):
                    constant[r, p] -= 0.5 * deflated[i, p] * deflated[i, p]
            h[r] = deflated[: n + k]
            value[r], x[:] = constant[r], start
            unbounded.solve_unbounded(
                h[r], gram[r], tables, r, n, k, half, weight, mean, x, scratch, value[r],
                bound[r], curvature[r], v[r],
            )  # fmt: skip
            tau[r] = x
        work, own = np.empty((8 + k, max(n, k) + 1)), np.empty(n + k)
        at, free = np.empty(k), np.empty(k, np.bool_)
        for p in range(count):
            _bounded(
                p, h, gram, n, k, half, weight, mean, is_sky, hopeless, constant, value, bound,
                tau, curvature, v, at, free, own, work,
            )  # fmt: skip
            pixel = chunk * lanes + p
            for r in range(rows):
                m = material[r]
                if value[r, p] < energy[pixel, m]:
                    energy[pixel, m] = value[r, p]
                    temperature[pixel, m] = mid + half * tau[r, p]
                    sigma[pixel, m] = curvature[r, p] ** -0.5
                    row[pixel, m] = r
            lighting[pixel] = v[row[pixel, energy[pixel].argmin()], :, p]


@numba.njit(cache=True, fastmath=False)
def _bounded(
    p, h, gram, n, k, half, weight, mean, is_sky, hopeless, constant, value, bound, tau,
    curvature, v, at, free, own, work,
):  # fmt: skip
    """Put V's bounds on what `solve_unbounded` found for pixel p, the most promising row first."""
    best, ground = np.inf, np.inf  # of all, and of those that are not sky
    lead, least = 0, np.inf
    for r in range(len(value)):
        inside = value[r, p] > -np.inf
        for j in range(k):
            inside &= v[r, j, p] >= 0.0
        if inside:
            best = min(best, value[r, p])
            if not is_sky[r]:
                ground = min(ground, value[r, p])
            bound[r, p] = np.inf  # done
        if value[r, p] > -np.inf and not is_sky[r] and bound[r, p] < least:
            lead, least = r, bound[r, p]
    for i in range(-1, len(value)):
        r = lead if i == -1 else i
        if i < 1:  # later ones do not count, lest the order of materials matter
            enough, ground_enough = best + hopeless, ground
        if not (bound[r, p] < enough or (not is_sky[r] and bound[r, p] < ground_enough)):
            continue
        total = 0.0
        for j in range(k):
            at[j] = max(v[r, j, p], 0.0)
            free[j] = at[j] > 0.0
            total += at[j]
        for j in range(k):
            at[j] /= total
        own[:] = h[r, :, p]
        value[r, p], tau[r, p], curvature[r, p] = _solve(
            own, gram[r], n, k, half, weight, mean, tau[r, p], at, free, work
        )
        value[r, p] += constant[r, p]
        v[r, :, p] = at
        best = min(best, value[r, p])
        if not is_sky[r]:
            ground = min(ground, value[r, p])
        bound[r, p] = np.inf
    for r in range(len(value)):
        if bound[r, p] < np.inf:
            value[r, p] = bound[r, p]


@numba.njit(cache=True, parallel=True, fastmath=False)
def _solve_given(h, gram, n, k, half, weight, mean, energy, tau, curvature, lighting):
    size = max(n, k) + 1
    for pixel in numba.prange(len(h)):
        work = np.empty((8 + k, size))
        free = np.ones(k, np.bool_)
        lighting[pixel] = 1.0 / k
        start = min(max(tau[pixel], -1.0), 1.0)
        energy[pixel], tau[pixel], curvature[pixel] = _solve(
            h[pixel], gram, n, k, half, weight[pixel], mean[pixel], start,
            lighting[pixel], free, work,
        )  # fmt: skip
