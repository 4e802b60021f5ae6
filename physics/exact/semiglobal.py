"""Semi-global decomposition: Eq. 6 with smoothness of T and m. The objective is this:

    E(T, m, V) = sum_p [ J_p(T_p, m_p, V_p) + occam(m_p) - log pi(m_p) ]
               + beta sum_{p~q} w_pq D_pq

    D_pq = 1 where m_p != m_q (Potts),
           d^2 / (d^2 + delta^2) with d = T_p - T_q where they agree (Geman-McClure),
           0 between two sky pixels

over 4-neighbours p~q. J and occam are those of `local` and `reduced`; pi is the share of
each material in the scene, estimated from the evidence of all pixels (empirical Bayes),
which prunes the library to what the scene supports. An edge can cost at most
beta w_pq: within a material T is pulled together, across a step it is let go. The
weights follow the cube's own spectral edges (as in Rother et al. 2004, "GrabCut", eq. 11,
but with the median, since the few edges against the sky outweigh all others):
w_pq = exp(-|s_p - s_q|^2 / (8 median |s_p - s_q|^2)).

`smoothed` decreases E from any T, m, V, never increasing it, by two kinds of step:

T and V   At the present T the edge cost is majorised by a quadratic (half-quadratic
          weights, Geman & Reynolds 1992) and that by a separable one, so each pixel is
          left with J plus a parabola in T; Newton's method on T with V eliminated
          exactly (the gradient through Eq. 1, in the r dimensions of `reduced`) minimises
          it. E is below its majoriser, so it cannot rise.
m         A pixel may change to any material with that material's own local optimum,
          where J is known; it does so where E falls (iterated conditional modes, on the
          two colours of a chess board in turn). Before that, a whole labelling from a
          mean-field approximation, found likewise, is tried, and taken if E falls.

Which colour comes first goes by the upper left corner: where materials are hard to tell, mirroring
the picture may change them and their probabilities (with five that are nearly alike, under noise of
0.4 K, in up to a fifth of the pixels). It stops when a round lowers E by less than 1e-4 of a nat
per pixel, or after 12 rounds.
"""

from dataclasses import dataclass

import numba
import numpy as np
from scipy.special import softmax

from ..errors import InputError
from ..machinery.compiled import compiled
from .local import LocalSolution, energy_given, solve_given
from .reduced import ReducedModel

BETA = 3.0  # nats that a full-weight edge between two materials costs
EDGE_SCALE = 4.0
DELTA_K = 1.0  # temperature steps well below this are smoothed, well above are kept
MEAN_FIELD_SWEEPS = 10
MAX_ROUNDS = 12
MIN_GAIN_NATS = 1e-3  # for a pixel to change material: far above the tables' rounding
TOLERANCE_NATS = 1e-4  # per pixel
SHARE_SWEEPS, SHARE_SAMPLES = 5, 20_000  # of the search for the shares of the materials


@dataclass(frozen=True, eq=False)
class State:
    """T (P,) K, m (P,) library indices and V (P, k) on the simplex; row (P,) is the
    hypothesis of the reduced model (m alone, or at the sky's edge). `Objective.state`
    makes one."""

    temperature_k: np.ndarray
    material: np.ndarray
    thermal_lighting: np.ndarray
    row: np.ndarray


def material_shares(energy):
    """(L,) maximum-likelihood shares pi of the materials, by expectation maximisation, of the
    energy (n, L) of some pixels."""
    u = energy.astype(np.float64)
    likelihood = np.exp(u.min(axis=1, keepdims=True) - u)
    pi = np.full(u.shape[1], 1.0 / u.shape[1])
    for _ in range(SHARE_SWEEPS):
        posterior = likelihood * pi
        pi = (posterior / posterior.sum(axis=1, keepdims=True)).mean(axis=0)
    floor = 1.0 / u.size  # a rare material stays possible
    return np.maximum(pi, floor)


def edge_weights(radiance, sigma, dead):
    """Spectral edge weights w in 0..1 to the neighbour below (H-1, W) and right (H, W-1); 0 where
    one of both is dead (H, W), or both are the same, as where a picture was resampled: a copy says
    nothing new."""
    squared, measured = [], [~(dead[1:] | dead[:-1]), ~(dead[:, 1:] | dead[:, :-1])]
    for axis in (1, 2):
        d2 = np.zeros(measured[axis - 1].shape)
        for band, s in zip(radiance, sigma, strict=True):
            d2 += (np.diff(band.astype(np.float64), axis=axis - 1) / s) ** 2
        squared.append(d2)
        measured[axis - 1] &= d2 > 0
    of = np.concatenate([d[m] for d, m in zip(squared, measured, strict=True)])
    typical = max(float(np.median(of)), 1e-12) if of.size else 1.0
    return tuple(
        m * np.exp(-d / (2 * EDGE_SCALE * typical)) for d, m in zip(squared, measured, strict=True)
    )


@dataclass(frozen=True, eq=False)
class Smoothed:
    """What `smoothed` returns: the state, sigma of T (P,) K, material probabilities (P, L)
    of the mean-field approximation, and E at the start and after every descent."""

    state: State
    sigma_k: np.ndarray
    probability: np.ndarray
    objective: tuple[float, ...]


def unsmoothed(local: LocalSolution) -> Smoothed:
    """The local answer alone: of every pixel the material of least energy."""
    p, m = np.arange(len(local.energy)), local.energy.argmin(axis=1)
    state = State(
        temperature_k=local.temperature_k[p, m].astype(np.float64), material=m,
        thermal_lighting=local.lighting.astype(np.float64), row=local.row[p, m],
    )  # fmt: skip
    return Smoothed(
        state=state, sigma_k=local.sigma_k[p, m].astype(np.float64),
        probability=softmax(-local.energy, axis=1), objective=(),
    )  # fmt: skip


class Objective:
    """E of one cube: the unaries come from the local solution, the edges from the cube.

    local is for the pixels of cube, a HeatCube, in row order.
    """

    def __init__(self, model: ReducedModel, cube, local: LocalSolution):
        self.model = model
        self.shape = cube.shape
        self.spectra = cube.spectra
        self.local = local
        some = cube.regular_pixels(SHARE_SAMPLES)
        self.log_share = np.log(material_shares(local.energy[some])).astype(np.float32)
        self.unary = local.energy - self.log_share  # of every material at its local optimum
        down, right = (BETA * w for w in edge_weights(cube.radiance, model.sigma, cube.dead))
        row, column = np.zeros((1, self.shape[1])), np.zeros((self.shape[0], 1))
        self.edges = np.stack([  # (4, H, W) to the pixel above, below, left, right
            np.concatenate([row, down]), np.concatenate([down, row]),
            np.concatenate([column, right], 1), np.concatenate([right, column], 1),
        ])  # fmt: skip
        self.sky = -1 if model.library.sky_index is None else model.library.sky_index

    def state(self, temperature_k, material, thermal_lighting):
        """The State at any T (P,) K, m (P,) and V (P, k).

        Raises InputError where m is the sky and there is none in view.
        """
        if not np.isfinite(self.local.energy[np.arange(len(material)), material]).all():
            raise InputError("smoothed: a pixel starts as sky, but the environment has no sky.")
        row = self.local.row[np.arange(len(material)), material]
        return State(
            temperature_k=np.asarray(temperature_k, float), material=material,
            thermal_lighting=thermal_lighting, row=row,
        )  # fmt: skip

    def local_state(self):
        """The local answer as a start: each pixel's material of least energy."""
        return unsmoothed(self.local).state

    def value(self, state):
        """E(T, m, V) in nats."""
        return self.unaries(state).sum() + self.smoothness(state)

    def unaries(self, state):
        """(P,) the terms of E's first sum."""
        energy = energy_given(
            self.model, self.spectra, state.row, state.temperature_k, state.thermal_lighting
        )
        return energy - self.log_share[state.material]

    def smoothness(self, state):
        """E's second sum."""
        t, m = state.temperature_k.reshape(self.shape), state.material.reshape(self.shape)
        total = 0.0
        for edge, a, b in zip(
            (self.edges[1][:-1], self.edges[3][:, :-1]),
            ((slice(None, -1), slice(None)), (slice(None), slice(None, -1))),
            ((slice(1, None), slice(None)), (slice(None), slice(1, None))),
            strict=True,
        ):
            d2 = (t[a] - t[b]) ** 2
            within = np.where(m[a] == self.sky, 0.0, d2 / (d2 + DELTA_K**2))
            total += (edge * np.where(m[a] == m[b], within, 1.0)).sum()
        return float(total)

    def descend_tv(self, state):
        """One majorise-minimise step on T and V; returns the state, its unaries and sigma."""
        t, m = state.temperature_k.reshape(self.shape), state.material.reshape(self.shape)
        weight = np.zeros(self.shape)
        pull = np.zeros(self.shape)
        for edge, tq, mq in zip(self.edges, _neighbours(t), _neighbours(m), strict=True):
            # d^2/(d^2+delta^2) <= const + slope d^2, and d^2 <= 2(Tp-mid)^2 + 2(Tq-mid)^2
            slope = DELTA_K**2 / ((t - tq) ** 2 + DELTA_K**2) ** 2
            w = np.where((m == mq) & (m != self.sky), 4 * edge * slope, 0.0)
            weight += w
            pull += w * 0.5 * (t + tq)
        mean = pull / np.maximum(weight, 1e-30)
        energy, t, v, sigma = solve_given(
            self.model, self.spectra, state.row, state.temperature_k,
            weight.ravel(), mean.ravel(),
        )  # fmt: skip
        unary = energy - self.log_share[state.material]
        return State(t, state.material, v, state.row), unary, sigma

    def descend_m(self, state, unary):
        """One sweep of iterated conditional modes from a state and its unaries."""
        t, m, unary = state.temperature_k.copy(), state.material.copy(), unary.copy()
        for colour in (0, 1):
            _icm(
                colour, self.unary, self.local.temperature_k, self.edges, self.sky,
                t.reshape(self.shape), m.reshape(self.shape), unary.reshape(self.shape),
            )  # fmt: skip
        return self.state(t, m, state.thermal_lighting)

    def mean_field(self):
        """(P, L) float32 material probabilities with the Potts term, by mean field."""
        q = softmax(-self.unary, axis=1)
        for _ in range(MEAN_FIELD_SWEEPS):
            for colour in (0, 1):  # all pixels at once would go to and fro for ever
                _mean_field(colour, self.unary, self.edges, q)
        return q


def smoothed(objective: Objective, state: State, progress=None) -> Smoothed:
    """Decrease E from any state, monotonically, until it stops moving."""
    trace = [objective.value(state)]
    probability = objective.mean_field()
    current = objective.descend_tv(state)
    trace.append(current[1].sum() + objective.smoothness(current[0]))
    proposal = _relabel(objective, current[0], probability.argmax(axis=1))
    proposal = objective.descend_tv(proposal)
    value = proposal[1].sum() + objective.smoothness(proposal[0])
    if value < trace[-1]:
        current = proposal
        trace.append(value)
    for done in range(MAX_ROUNDS):
        current = objective.descend_tv(objective.descend_m(*current[:2]))
        trace.append(current[1].sum() + objective.smoothness(current[0]))
        if progress:
            progress(done + 1, MAX_ROUNDS)
        if trace[-2] - trace[-1] < TOLERANCE_NATS * len(objective.spectra):
            break
    state, _, sigma = current
    trace = tuple(float(value) for value in trace)
    return Smoothed(state=state, sigma_k=sigma, probability=probability, objective=trace)


def _relabel(objective, state, material):
    """The state with these materials, each changed pixel at its new material's optimum."""
    p = np.arange(len(material))
    changed = material != state.material
    t = np.where(changed, objective.local.temperature_k[p, material], state.temperature_k)
    return objective.state(t, material, state.thermal_lighting)


def _neighbours(a):
    """The maps of the neighbour above, below, left and right (itself beyond the border)."""
    yield np.concatenate([a[:1], a[:-1]])
    yield np.concatenate([a[1:], a[-1:]])
    yield np.concatenate([a[:, :1], a[:, :-1]], 1)
    yield np.concatenate([a[:, 1:], a[:, -1:]], 1)


@compiled(inline="always")
def _edge_cost(t, m, tq, mq, sky):
    """What neighbours of T (K) and materials t, m and tq, mq cost: 0, alike, to 1."""
    if m != mq:
        return 1.0
    if m == sky:
        return 0.0
    d2 = (t - tq) ** 2
    return d2 / (d2 + DELTA_K * DELTA_K)


@compiled(parallel=True)
def _mean_field(colour, unary, edges, q):
    """Set q (P, L) of the pixels of a colour to what lowers the free energy most, that of all
    others being given."""
    height, width = edges.shape[1:]
    for row in numba.prange(height):
        field = np.empty(q.shape[1])
        for col in range((row + colour) % 2, width, 2):
            p = row * width + col
            for label in range(len(field)):
                field[label] = -unary[p, label]
            for i in range(4):
                if edges[i, row, col] > 0.0:
                    neighbour = (row + (i == 1) - (i == 0)) * width + col + (i == 3) - (i == 2)
                    for label in range(len(field)):
                        field[label] += edges[i, row, col] * q[neighbour, label]
            field = np.exp(field - field.max())
            field /= field.sum()
            for label in range(len(field)):
                q[p, label] = field[label]


@compiled(parallel=True)
def _icm(colour, table, optimum_k, edges, sky, t, m, unary):
    """Give each pixel of a colour the label that costs least, that of all others being given.

    t (K), m (material) and unary (nats), all (height, width), are changed in place; table and
    optimum_k (P, L) hold all labels' nats and K, edges (4, height, width) what differing from each
    neighbour costs.
    """
    height, width = t.shape
    for row in numba.prange(height):
        for col in range((row + colour) % 2, width, 2):
            p = row * width + col
            best, label, at = np.inf, -1, 0.0  # best: cost to beat
            for candidate in range(-1, table.shape[1]):  # -1: stay
                if candidate < 0:
                    tc, mc, cost = t[row, col], m[row, col], unary[row, col]
                else:
                    tc, mc, cost = optimum_k[p, candidate], candidate, table[p, candidate]
                if cost >= best:
                    continue
                for i in range(4):
                    if edges[i, row, col] > 0.0:
                        r = row + (i == 1) - (i == 0)
                        c = col + (i == 3) - (i == 2)
                        cost += edges[i, row, col] * _edge_cost(tc, mc, t[r, c], m[r, c], sky)
                if candidate < 0:
                    best = cost - MIN_GAIN_NATS
                elif cost < best:
                    best, label, at = cost, candidate, tc
            if label >= 0:
                t[row, col], m[row, col], unary[row, col] = at, label, table[p, label]
