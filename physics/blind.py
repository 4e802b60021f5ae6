"""A library from the cube alone, for those who have none.

1. Emissivity. What a surface outdoors mirrors is mostly sky, whose spectrum X is found in the
   cube (`estimate`). At any T a pixel has the emissivity

       e(T) = (S - X) / (B(T) - X)

   which at a wrong T bears the sky's own bands. T is where e is smooth (ISSTES: Borel 1998, Proc.
   IGARSS, 546) and its largest value near EMISSIVITY_MAX, as is most natural surfaces' (the
   normalised emissivity method: Gillespie et al. 1998, IEEE Trans. Geosci. 36, 1113).
2. Clusters. Where part of the sky is hidden, 1 - e comes out too small, in all bands by about one
   factor. So pixels are clustered (K-means) by the direction of 1 - e, and the cluster's curve is
   the median of its most open pixels, where 1 - e is longest.
3. Materials. With those curves as a library Eq. 6 is solved exactly (`exact.local`): each pixel's
   likeliest curve, T and V. As long as fewer than SHARE of the pixels lose NATS by a curve's
   absence, the one that is missed least is dropped, at last with all others solved for anew. Then
   every curve is solved for in turn, by least squares over its pixels with a penalty on second
   differences. ROUNDS of that.

The sky's curve is 1 - transmittance of the clearest sky in view, brought to the zenith by the
air mass at which it is nearest to the starter library's (its ozone comes out too clear: that is
high and cold, and the law takes all air as warm as at the ground).

What cannot be known: the level of e, which rests on EMISSIVITY_MAX (bare metal comes out wrong, and
what never sees the sky nearly black); two materials with 1 - e of one shape, which come out as one;
and whether two curves are two materials or one, wet and dry.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from sklearn.cluster import KMeans

from .cube.heat_cube import HeatCube
from .cube.prepared import prepared
from .cube.saturation import saturated
from .environment import Environment
from .errors import InputError
from .estimate import USUAL_OBJECTS, Sample
from .exact.local import solve_given, solve_local
from .exact.reduced import reduce_model
from .library import SKY, MaterialLibrary
from .planck import brightness_temperature, planck

MIN_BANDS, MIN_PIXELS = 20, 200
MIN_NETD_K = 0.05  # finer cubes get noise: what Eq. 1 says wrongly would pass for materials
EMISSIVITY_MAX, EMISSIVITY_MAX_SIGMA = 0.96, 0.01
LEVEL_SIGMA = 0.02  # of the curves found, beside which T is off likewise
ROUGHNESS = 0.002  # standard deviation of a true curve's second differences between bands
TEMPERATURES, FINER = 30, 8  # tried per pixel, and then between two of those
OVER_K = 3.0  # steps by which the hottest T tried exceeds how warm pixels look
CLUSTERS = 14
OPEN = 0.75  # quantile of a cluster's lengths of 1 - e
SHARE, NATS = 0.01, 5.0
MOST_SATURATED = 0.5  # of the pixels, to be left out
ROUNDS = 3  # more of them let the curves' levels drift
STIFFNESS = 0.3  # of the penalty, over the mean weight of a band
LEAST, MOST = 0.02, 1.0  # emissivity
AIR_EXCESS_K = 2.0  # of the air over the sky's largest brightness temperature


def library_from_cube(cube, materials=None, seed=0, progress=None):
    """A MaterialLibrary of a HeatCube's sky and "material_1", ..., the commonest first; and a note.

    materials  how many beside the sky; as many as the pixels need if None
    seed       of the subsample and of K-means
    progress   called as progress(done, total, what)

    The note says in one sentence what was found and what cannot be told apart.
    Raises InputError where materials is no whole number >= 1, and where the cube has fewer than 20
    bands, no sky, or too little beside it.
    """
    given = materials is not None
    if given and (not isinstance(materials, (int, np.integer)) or materials < 1):
        raise InputError(f"library: materials must be a whole number >= 1, got {materials!r}.")
    starter = MaterialLibrary.starter().subset([SKY])
    cube, left_out, shift, *_ = prepared(cube, starter)
    full = saturated(cube) & ~cube.dead
    if full.mean() < MOST_SATURATED:
        cube = replace(cube, dead=cube.dead | full)
    if cube.bands < MIN_BANDS:
        raise InputError(
            f"library: {cube.bands} bands cannot tell emissivity from the sky's light; use a cube "
            f"of {MIN_BANDS} or more, or a library from elsewhere."
        )
    own = cube.sigma**2 * (1 - cube.quiet)
    # as its spectra get the noise
    cube = replace(cube, netd_k=max(cube.netd_k, MIN_NETD_K), quiet=None)
    sample = Sample(cube, starter, seed)
    sky = sample.sky
    if not sky.any():
        raise InputError(
            "library: no sky was found in the cube, and emissivity cannot be told from "
            "temperature where all is about as warm as its surroundings; use another library."
        )
    if sample.overcast:
        raise InputError(
            "library: the sky in the cube is overcast, and in its light materials look alike; use "
            "a cube under a clear sky, or another library."
        )
    if np.count_nonzero(~sky) < MIN_PIXELS:
        raise InputError(f"library: the cube has fewer than {MIN_PIXELS} pixels besides the sky.")
    environment = sample.environment(USUAL_OBJECTS)
    s, rng = sample.spectra * cube.sigma, np.random.default_rng(seed)
    missing = np.sqrt(np.maximum(cube.sigma**2 - own, 0))
    s = np.maximum(s + missing * rng.standard_normal(s.shape), s / 2)
    e = _emissivity(cube, s[~sky], environment.radiance[list(environment.sky)].mean(axis=0))
    clusters = CLUSTERS if materials is None else max(CLUSTERS, materials)
    curves = _cluster_curves(e, clusters, seed)
    scene = _Scene(cube, s, environment, _sky_curve(cube, s[sky], starter))
    for done in range(ROUNDS):
        curves = _without_the_missed_least(scene, curves, materials)
        curves = _solved_for(scene, curves)
        if progress is not None:
            progress(done + 1, ROUNDS, "library")
    library, note = _named(scene, curves)
    if full.any():
        more = " and were left out" if full.mean() < MOST_SATURATED else ": too many to leave out"
        note += f" {full.mean():.1%} of the pixels are saturated{more}."
    if left_out:
        bands = ", ".join(f"{w:.4g} um ({why})" for w, why in left_out.items())
        note += f" Bands left out: {bands}."
    if shift:
        than = "less" if shift > 0 else "more"
        note += f" Wavelengths {abs(shift):.2f} um {than} than stated, judging by the sky's ozone."
    return library, note


class _Scene(NamedTuple):
    """cube; some of its pixels' spectra (P, bands); its environment; the sky's curve (bands,)."""

    cube: HeatCube
    spectra: np.ndarray
    environment: Environment
    sky_curve: np.ndarray

    def solve(self, curves):
        """The reduced model and Eq. 6 solved with the sky and curves (n, bands) as a library."""
        library = self.library([SKY, *(str(i) for i in range(len(curves)))], curves)
        model = reduce_model(self.cube, library, self.environment)
        return model, solve_local(model, self.spectra)

    def library(self, names, curves, descriptions=None):
        w, width, nodes = self.cube.wavelength_um, self.cube.fwhm_um, self.cube.nodes_um
        ends = np.array([w[0], w[-1]]) + np.diff(w)[[0, -1]] * [-0.5, 0.5]  # if bands are narrow
        low, high = np.minimum(w - width / 2, nodes[:, 0]), np.maximum(w + width / 2, nodes[:, -1])
        ends = min(ends[0], low.min()), max(ends[1], high.max())
        e = np.pad(np.concatenate([self.sky_curve[None], curves]), ((0, 0), (1, 1)), mode="edge")
        grid = np.concatenate([ends[:1], w, ends[1:]])
        level = [0.0] + [LEVEL_SIGMA] * (len(names) - 1)  # the first is the sky
        return MaterialLibrary(names, grid, e, descriptions=descriptions, level_sigma=level)


# --- 1. emissivity -----------------------------------------------------------------------


def _emissivity(cube, s, sky):
    """(P, bands) e of spectra s that mirror the sky (bands,), at the T that suits it best."""
    second = lambda a: a[:, 2:] - 2 * a[:, 1:-1] + a[:, :-2]
    low = np.sort(brightness_temperature(cube.wavelength_um, s), axis=1)[:, -2]
    high = np.maximum(np.quantile(low, 0.98), low + OVER_K) + OVER_K
    best, found, best_k = np.full(len(s), np.inf), np.empty_like(s), low.copy()

    def look(t):
        contrast = np.maximum(planck(cube.wavelength_um, t[:, None]) - sky, cube.sigma)
        e = (s - sky) / contrast
        noise = (cube.sigma / contrast) ** 2
        variance = noise[:, 2:] + 4 * noise[:, 1:-1] + noise[:, :-2] + ROUGHNESS**2
        largest = np.sort(e, axis=1)[:, -3]  # of some, so that noise does not choose it
        cost = (second(e) ** 2 / variance + np.log(variance)).sum(axis=1)
        cost += ((largest - EMISSIVITY_MAX) / EMISSIVITY_MAX_SIGMA) ** 2
        better = cost < best
        best[better], found[better], best_k[better] = cost[better], e[better], t[better]

    step = (high - low) / TEMPERATURES
    for i in range(TEMPERATURES + 1):
        look(low + i * step)
    around = best_k.copy()
    for x in np.linspace(-1, 1, 2 * FINER + 1):
        look(around + x * step)
    return found


def _sky_curve(cube, s, starter):
    """(bands,) 1 - transmittance to the zenith, from the sky's spectra s (P, bands)."""
    w, cold = cube.wavelength_um, s.mean(axis=1)
    seen = s[cold <= np.quantile(cold, 0.05)].mean(axis=0)
    air_k = brightness_temperature(w, seen).max() + AIR_EXCESS_K
    depth = -np.log(1 - seen / planck(w, air_k))
    known = -np.log1p(-np.minimum(starter.at(w)[0], 1 - 1e-6))  # some bands are opaque
    clear = known <= np.median(known)  # elsewhere the air's temperature decides
    mass = (depth[clear] @ known[clear]) / (known[clear] @ known[clear])
    return np.clip(-np.expm1(-depth / mass), 0, 1)


# --- 2. clusters -------------------------------------------------------------------------


def _cluster_curves(e, n, seed):
    """(n, bands) curves of clusters of e (P, bands)."""
    dark = 1 - e
    length = np.linalg.norm(dark, axis=1)
    direction = dark / length[:, None]
    fit = KMeans(min(n, len(np.unique(direction, axis=0))), n_init=3, random_state=seed)
    # nearly black pixels have no direction
    label = fit.fit_predict(direction, sample_weight=np.minimum(length, 1))
    curves = []
    for c in np.unique(label):
        mine, of = dark[label == c], length[label == c]
        curves.append(1 - np.median(mine[of >= np.quantile(of, OPEN)], axis=0))
    return np.clip(curves, LEAST, MOST)


# --- 3. materials ------------------------------------------------------------------------


def _missed(energy, curves):
    """Share of the pixels that lose more than NATS without each of some curves, given as columns
    of energy (P, 1 + n), of which column 0 is the sky's."""

    def loss(c):
        without = energy[:, [0, *(o for o in curves if o != c)]].min(axis=1)
        return np.mean(without - energy[:, c] > NATS)

    return np.array([loss(c) for c in curves])


def _without_the_missed_least(scene, curves, materials):
    energy = scene.solve(curves)[1].energy
    kept = list(range(1, len(curves) + 1))
    least = 1 if materials is None else materials
    while len(kept) > least:
        missed = _missed(energy, kept)
        if materials is None and missed.min() > SHARE:
            break
        del kept[int(missed.argmin())]
    curves = curves[np.array(kept) - 1]
    return curves if materials is not None else _without_the_replaced(scene, curves)


def _without_the_replaced(scene, curves):
    """The curves less those without which the others, solved for anew, fit as well."""
    energy = scene.solve(curves)[1].energy
    while len(curves) > 1:
        least = _missed(energy, range(1, len(curves) + 1)).argmin()
        fewer = _solved_for(scene, np.delete(curves, least, axis=0))
        anew = scene.solve(fewer)[1].energy
        if np.mean(anew.min(axis=1) - energy.min(axis=1) > NATS) > SHARE:
            break
        curves, energy = fewer, anew
    return curves


def _solved_for(scene, curves):
    """The curves that fit their pixels best, T and V given."""
    cube, s = scene.cube, scene.spectra
    model, local = scene.solve(curves)
    best, p = local.energy.argmin(axis=1), np.arange(len(s))
    row, t = local.row[p, best], local.temperature_k[p, best].astype(np.float64)
    _, t, v, _ = solve_given(model, s, row, t, np.zeros(len(s)), t)
    light = v @ scene.environment.radiance
    contrast = (planck(cube.wavelength_um, t[:, None]) - light) / cube.sigma
    bend = np.diff(np.eye(cube.bands), 2, axis=0)
    new = curves.copy()
    for c in range(len(curves)):
        mine = (best == c + 1) & (model.sky_share[row] == 0)
        if not mine.any():
            continue
        weight = (contrast[mine] ** 2).sum(axis=0)
        right = (contrast[mine] * ((s - light) / cube.sigma)[mine]).sum(axis=0)
        stiff = STIFFNESS * weight.mean() * bend.T @ bend
        new[c] = np.linalg.solve(np.diag(weight) + stiff, right)
    return np.clip(new, LEAST, MOST)


def _named(scene, curves):
    """The library, the commonest material first, and the note."""
    energy = scene.solve(curves)[1].energy
    best = energy.argmin(axis=1)
    order = np.argsort(-np.bincount(best, minlength=len(curves) + 1)[1:], kind="stable")
    names = [f"material_{i + 1}" for i in range(len(curves))]
    share = [np.mean(best == c + 1) for c in order]
    texts = [
        f"Found in a cube by clustering: {100 * x:.1f} % of its pixels. "
        f"Its level rests on an assumed largest emissivity of {EMISSIVITY_MAX}."
        for x in share
    ]
    of_sky = "1 - transmittance of the clearest sky in view, brought to the zenith."
    library = scene.library([SKY, *names], curves[order], [of_sky, *texts])
    missed = _missed(energy, [c + 1 for c in order])
    doubtful = [n for n, x in zip(names, missed, strict=True) if len(names) > 1 and x <= SHARE]
    note = (
        f"{len(names)} material{'s' * (len(names) > 1)} besides the sky; levels rest on an assumed "
        f"largest emissivity of {EMISSIVITY_MAX}"
    )
    if doubtful:
        note += (
            f"; {', '.join(doubtful)} cannot be told from the others: fewer than "
            f"{100 * SHARE:g} % of the pixels fit clearly worse without it"
        )
    return library, note + "."
