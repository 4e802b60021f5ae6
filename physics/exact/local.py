"""The exact local solver of Eq. 6: every pixel, every material, no smoothness.

For one pixel and one material, minimise over T and over V on the simplex

    J = chi^2 / 2 + (T - T_prior)^2 / (2 sigma_T^2) + |V - V_usual|^2 / (2 sigma_V^2)

in the r dimensions of `reduced`. The priors are as wide as the scene and matter only if the data
say nothing; the answer's sigma is then the prior's, which is how the solver says that it cannot
know.

    energy_m = J + occam_m = -log evidence of material m

The answer is the material of least energy, with its T and V. `faces` first solves every hypothesis
without the bounds on V. If no V_j is negative, that is the solution; otherwise it gives an
approximate lower bound, and hypotheses whose bound is HOPELESS nats above the pixel's best are not
solved any further. The others are solved on the face of the simplex where their V is not negative,
and the few that do not converge there by `simplex`. T starts at the brightness temperature of the
middle band. For materials that reflect a third or more, J may have several minima: T then also
starts halfway to either end of its range, and each minimum found contributes to sigma according to
its evidence.
"""

from dataclasses import dataclass

import numba
import numpy as np
from numpy.polynomial import chebyshev

from .. import prior
from ..machinery.compiled import compiled
from ..machinery.threads import in_threads
from ..planck import brightness_temperature
from . import faces, simplex
from .faces import LANES
from .reduced import ReducedModel, groups

# A material so far behind cannot win in `semiglobal`: neighbours give at most 4 BETA = 12 nats, the
# materials' shares at most log of some 40,000 pixels times the materials, 18 for 1500
HOPELESS = 30.0  # nats
BLOCK, BLOCK_BYTES = 1024, 1 << 25  # solved together: of fewer pixels, too few are on one face
PANEL = 4  # times LANES, pixels whose spectra stay in the cache through all hypotheses
ROUNDS = 6  # of faces, for one hypothesis
PULL = 1e-4  # nats that a V_j might lower J by, at most, and yet stay zero
REFLECTS, HALFWAY = 0.7, (-0.5, 0.5)  # mean emissivity below which T starts there, too, in tau
SAME = 0.1  # sigmas, between two minima that are one
_DONE, _NONE = -2, -1  # in place of a face's number


@dataclass(frozen=True, eq=False)
class LocalSolution:
    """Every material's answer, for P pixels and L materials (library order, sky included).

    energy         (P, L) float32, -log evidence up to one constant; +inf for what cannot be
                   there, such as sky where none is in view; beyond `hopeless` nats above the
                   least it may be about a lower bound, with the T that V without bounds would
                   give, but never for the best of the materials that are not sky
    temperature_k  (P, L) float32, K; of the sky, the prior's
    sigma_k        (P, L) float32, one standard deviation of T given m, K, over the minima found
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
    model: ReducedModel, spectra, progress=None, hopeless=HOPELESS, threads=None, among=None,
    partly=True,
) -> LocalSolution:  # fmt: skip
    """Solve Eq. 6 for every pixel and material of spectra (P, bands), W m-2 sr-1 um-1.

    progress, if given, is called as progress(done, total); hopeless is in nats, see LocalSolution:
    less is faster, and enough where nothing but the evidence decides; threads are as many as
    numba's if None; among (L,) bool are the materials that may be there, one of them not sky, all
    if None: the energy of the others is +inf; partly is whether pixels may be partly sky, which
    they are not without sky among the materials either.
    """
    pixels, shape = len(spectra), (len(spectra), len(model.library))
    energy = np.full(shape, np.inf, np.float32)
    temperature = np.full(shape, model.prior_mean_k, np.float32)
    sigma = np.full(shape, model.prior_sigma_k, np.float32)
    row = np.zeros(shape, np.int16)
    lighting = np.empty((pixels, model.k), np.float32)
    (linear, square), tables, of_t = model.of_all, model.tables, model.of_t
    rows, tries, of_try, origin = _tries(model, among, partly)
    material, square = model.material[rows], square[rows]
    is_sky = model.library.is_sky[material]
    middle = len(model.sigma) // 2
    threads = threads or numba.get_num_threads()
    fits = BLOCK_BYTES // (8 * len(of_try) * (model.terms + 2 * model.k + 5))
    size = max(LANES, min(BLOCK, fits, -(-pixels // threads)) // LANES * LANES)

    def solve_block(first):
        part = slice(first, first + size)
        radiance = np.array(spectra[part].T, np.float64, order="C")
        start_k = brightness_temperature(
            model.wavelength_um[middle], np.maximum(radiance[middle], 1e-9)
        )
        looks = (start_k - model.mid_k) / model.half_k
        start = np.stack([looks, *(np.full_like(looks, tau) for tau in HALFWAY)])
        _solve_block(
            radiance / model.sigma[:, None], start, rows, tries, of_try, origin, linear, square,
            model.gram, tables, model.terms, model.k, *of_t, material, is_sky, model.mid_k,
            hopeless, energy[part], temperature[part], sigma[part], row[part], lighting[part],
        )  # fmt: skip

    blocks = range(0, pixels, size)
    in_threads(solve_block, blocks, threads, progress)
    rows = rows[of_try].astype(np.int16)
    return LocalSolution(energy, temperature, sigma, rows[row], lighting)


def _tries(model, among, partly):
    """What is tried: the model's rows (H,) that are hypotheses; of each its tries (H, 3), -1 for
    none; and of each try its hypothesis and the start (Q,)."""
    held = np.ones(len(model.library), bool) if among is None else among
    rows = np.flatnonzero(
        prior.among(model.material, model.sky_share, model.library.is_sky, held, partly)
    )
    once = np.arange(len(rows))
    again = np.flatnonzero(model.emissivity[rows].mean(axis=1) < REFLECTS)
    tries = np.full((len(rows), 3), -1)
    tries[:, 0] = once
    tries[again, 1:] = len(rows) + np.arange(2 * len(again)).reshape(2, -1).T
    origin = np.repeat([0, 1, 2], [len(rows), len(again), len(again)])
    return rows, tries, np.concatenate([once, again, again]), origin


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


@compiled(nogil=True, error_model="numpy")
def _solve_block(
    s, start, rows, tries, of_try, origin, linear, square, gram, tables, n, k, half, weight, mean,
    material, is_sky, mid, hopeless, energy, temperature, sigma, row, lighting,
):  # fmt: skip
    """All hypotheses of P pixels, for `solve_local`: s (bands, P) in noise units, start (3, P) tau;
    rows to origin by `_tries`; row here is that of a try.

    Here pixel p is lane p % LANES of group p // LANES."""
    pixels, groups = s.shape[1], (s.shape[1] + LANES - 1) // LANES
    h, constant = np.empty((len(rows), groups, n + k, LANES)), np.empty((len(rows), groups, LANES))
    every = (len(of_try), groups, LANES)
    value, bound = np.empty(every), np.empty(every)
    tau, curvature = np.empty(every), np.empty(every)
    v = np.empty((len(of_try), groups, k, LANES))
    _without_bounds(
        s, start, rows, tries, origin, linear, square, tables, n, k, half, weight, mean, h,
        constant, value, bound, tau, curvature, v,
    )  # fmt: skip

    best, ground = np.full(pixels, np.inf), np.full(pixels, np.inf)  # of all; of what is not sky
    lead, least = np.zeros(pixels, np.int64), np.full(pixels, np.inf)  # the most promising try
    for q in range(len(of_try)):
        sky = is_sky[of_try[q]]
        for p in range(pixels):
            g, i = p // LANES, p % LANES
            b = bound[q, g, i]
            if b == np.inf:
                best[p] = min(best[p], value[q, g, i])
                if not sky:
                    ground[p] = min(ground[p], value[q, g, i])
            elif -np.inf < b < least[p] and not sky:
                lead[p], least[p] = q, b

    todo = np.empty(pixels, np.int64)
    for leading in (True, False):
        # what comes later in the round does not count, lest the order of materials matter
        enough, ground_enough = best + hopeless, ground.copy()
        for q in range(len(of_try)):
            r, count = of_try[q], 0
            for p in range(pixels):
                b = bound[q, p // LANES, p % LANES]
                if (not leading or lead[p] == q) and (
                    b < enough[p] or (b < ground_enough[p] and not is_sky[r])
                ):
                    todo[count] = p
                    count += 1
            if not count:
                continue
            _put_bounds(
                todo[:count], rows[r], h[r], constant[r], gram[rows[r]], tables, n, k, half,
                weight, mean, value[q], tau[q], curvature[q], v[q],
            )  # fmt: skip
            for p in todo[:count]:
                g, i = p // LANES, p % LANES
                best[p] = min(best[p], value[q, g, i])
                if not is_sky[r]:
                    ground[p] = min(ground[p], value[q, g, i])
                bound[q, g, i] = np.inf

    nats, deviation, variance = np.empty(3), np.empty(3), np.empty(3)
    for g in range(groups):
        here = min(LANES, pixels - g * LANES)
        for r in range(len(rows)):
            m, count = material[r], 3 if tries[r, 1] >= 0 else 1
            for i in range(here):
                p = g * LANES + i
                for a in range(count):
                    q = tries[r, a]
                    nats[a] = value[q, g, i] if bound[q, g, i] == np.inf else bound[q, g, i]
                a = 0 if count == 1 else np.argmin(nats)
                if not nats[a] < energy[p, m]:
                    continue
                energy[p, m], row[p, m] = nats[a], tries[r, a]
                for b in range(count):
                    q = tries[r, b]
                    deviation[b], variance[b] = half * tau[q, g, i], 1.0 / curvature[q, g, i]
                of_t = variance[0] if count == 1 else _over_minima(nats, deviation, variance, a)
                temperature[p, m], sigma[p, m] = mid + deviation[a], np.sqrt(of_t)
    for p in range(pixels):
        m = 0
        for other in range(1, energy.shape[1]):
            m = other if energy[p, other] < energy[p, m] else m
        for j in range(k):
            lighting[p, j] = v[row[p, m], p // LANES, j, p % LANES]


@compiled()
def _over_minima(nats, deviation, variance, best):
    """Variance of T about the best of up to three minima, of which some may be the same."""
    total, off = 1.0, variance[best]
    for a in range(len(nats)):
        same = a == best
        for b in range(len(nats)):
            if b < a or b == best:
                same |= abs(deviation[a] - deviation[b]) < SAME * np.sqrt(variance[b])
        if not same:
            share = np.exp(nats[best] - nats[a]) * np.sqrt(variance[a] / variance[best])
            total += share
            off += share * (variance[a] + (deviation[a] - deviation[best]) ** 2)
    return off / total


@compiled()
def _without_bounds(
    spectra, start, rows, tries, origin, linear, square, tables, n, k, half, weight, mean, h,
    constant, value, bound, tau, curvature, v,
):  # fmt: skip
    """All tries on the face of all V; h and constant are (H, groups, .., LANES), value to v (Q,
    groups, .., LANES), out. In bound is inf where that is the answer."""
    (bands, pixels), groups = spectra.shape, h.shape[1]
    s, squared = np.ones((PANEL, bands + 1, LANES)), np.ones((bands + 1, LANES))
    constants = np.empty((PANEL, len(rows), LANES))
    deflated = np.empty((linear.shape[1] - n - k, LANES))
    work, v_gradient = np.empty((4 * n + 2 * k + 6, LANES)), np.empty((k, LANES))
    for first in range(0, groups, PANEL):
        panel = min(PANEL, groups - first)
        for i in range(panel):
            at = (first + i) * LANES
            for j in range(bands):
                for p in range(LANES):
                    s[i, j, p] = spectra[j, min(at + p, pixels - 1)]
                    squared[j, p] = s[i, j, p] ** 2
            faces.times(square, squared, constants[i], LANES)
        for r in range(len(rows)):
            for i in range(panel):
                g = first + i
                faces.times(linear[rows[r], : n + k], s[i], h[r, g], LANES)
                faces.times(linear[rows[r], n + k :], s[i], deflated, LANES)
                faces.less_half_squares(deflated, constants[i, r])
                for p in range(LANES):
                    constant[r, g, p] = constants[i, r, p]
                for q in tries[r]:
                    if q < 0:
                        continue
                    for p in range(LANES):
                        tau[q, g, p] = start[origin[q], min(g * LANES + p, pixels - 1)]
                    faces.solve_on_face(
                        h[r, g], constant[r, g], LANES, tables, rows[r], 0, half, weight, mean,
                        tau[q, g], work, value[q, g], curvature[q, g], v[q, g], v_gradient,
                    )  # fmt: skip
                    faces.lower_bound(
                        tables, rows[r], half, tau[q, g], work, value[q, g], curvature[q, g],
                        v[q, g], bound[q, g],
                    )  # fmt: skip


@compiled()
def _put_bounds(
    todo, r, h, constant, gram, tables, n, k, half, weight, mean, value, tau, curvature, v
):
    """Put V's bounds on pixels todo (count,) of a try of hypothesis r; h to v as there, of these.

    What is negative leaves the free V_j and what would lower J joins them, until all is well."""
    free, sets, count = tables[0], tables[1], len(todo)
    face, x = np.empty(count, np.int64), np.empty(count)
    own, own_v, v_gradient = np.empty((n + k, LANES)), np.empty((k, LANES)), np.empty((k, LANES))
    own_constant, own_x, own_value = np.empty(LANES), np.empty(LANES), np.empty(LANES)
    own_curvature, work = np.empty(LANES), np.empty((4 * n + 2 * k + 6, LANES))
    for q in range(count):
        g, i = todo[q] // LANES, todo[q] % LANES
        x[q] = tau[g, i]
        held = 0
        for j in range(k):
            held += (v[g, j, i] >= 0.0) << j
        face[q] = _number(sets, held) if value[g, i] > -np.inf else _NONE
    for _ in range(ROUNDS):
        order = _by_face(face, len(free))
        done, at = True, 0
        while at < count:
            f, c = face[order[at]], 1
            while c < LANES and at + c < count and face[order[at + c]] == f:
                c += 1
            those = order[at : at + c]
            at += c
            if f < 0:
                continue
            done = False
            whole = (c + 7) // 8 * 8  # whole registers
            for p in range(whole):
                q = those[min(p, c - 1)]
                g, i = todo[q] // LANES, todo[q] % LANES
                for a in range(n + k):
                    own[a, p] = h[g, a, i]
                own_constant[p], own_x[p] = constant[g, i], x[q]
            faces.solve_on_face(
                own, own_constant, whole, tables, r, f, half, weight, mean, own_x, work, own_value,
                own_curvature, own_v, v_gradient,
            )  # fmt: skip
            for p in range(c):
                q = those[p]
                x[q] = own_x[p]
                held, joins, strongest = 0, 0, -PULL
                for j in range(k):
                    held += (free[f, j] and own_v[j, p] >= 0.0) << j
                    if not free[f, j] and v_gradient[j, p] < strongest:
                        joins, strongest = 1 << j, v_gradient[j, p]
                inside = held == sets[f]
                if own_value[p] == -np.inf:
                    face[q] = _NONE
                elif inside and not joins:
                    face[q] = _DONE
                    g, i = todo[q] // LANES, todo[q] % LANES
                    value[g, i], tau[g, i] = own_value[p], own_x[p]
                    curvature[g, i] = own_curvature[p]
                    for j in range(k):
                        v[g, j, i] = own_v[j, p]
                else:
                    face[q] = _number(sets, held + joins if inside else held)
        if done:
            break
    for q in range(count):
        if face[q] != _DONE:
            _one_by_one(
                todo[q] // LANES, todo[q] % LANES, h, constant, gram, n, k, half, weight, mean,
                value, tau, curvature, v,
            )  # fmt: skip


@compiled()
def _number(sets, held):
    """The face of a set of free V_j, or _NONE."""
    for f in range(len(sets)):
        if sets[f] == held:
            return f
    return _NONE


@compiled()
def _by_face(face, faces):
    """(P,) the pixels of a face together, of face (P,) < faces."""
    at = np.zeros(faces + 3, np.int64)  # _DONE and _NONE come first
    for f in face:
        at[f + 3] += 1
    for f in range(1, len(at)):
        at[f] += at[f - 1]
    order = np.empty(len(face), np.int64)
    for q in range(len(face)):
        order[at[face[q] + 2]] = q
        at[face[q] + 2] += 1
    return order


@compiled()
def _one_by_one(
    g, i, h, constant, gram, n, k, half, weight, mean, value, tau, curvature, v
):  # fmt: skip
    """Solve pixel i of hypothesis g by itself, from v[g, :, i] and tau[g, i], in place."""
    own, at, free, total = np.empty(n + k), np.empty(k), np.empty(k, np.bool_), 0.0
    for a in range(n + k):
        own[a] = h[g, a, i]
    for j in range(k):
        at[j] = max(v[g, j, i], 0.0)
        free[j] = at[j] > 0.0
        total += at[j]
    for j in range(k):
        at[j] /= total
    e, tau[g, i], curvature[g, i] = simplex.solve(
        own, gram, n, k, half, weight, mean, tau[g, i], at, free,
        np.empty((8 + k, max(n, k) + 1)),
    )  # fmt: skip
    value[g, i] = e + constant[g, i]
    for j in range(k):
        v[g, j, i] = at[j]


@compiled(parallel=True)
def _solve_given(h, gram, n, k, half, weight, mean, energy, tau, curvature, lighting):
    """Solve pixels h (P, n + k) of one hypothesis from tau; fills energy, tau, curvature (P,) and
    lighting (P, k)."""
    size = max(n, k) + 1
    for pixel in numba.prange(len(h)):
        work = np.empty((8 + k, size))
        free = np.ones(k, np.bool_)
        lighting[pixel] = 1.0 / k
        start = min(max(tau[pixel], -1.0), 1.0)
        energy[pixel], tau[pixel], curvature[pixel] = simplex.solve(
            h[pixel], gram, n, k, half, weight[pixel], mean[pixel], start,
            lighting[pixel], free, work,
        )  # fmt: skip
