"""The three errors that the paper plots, on scenes of the test split, and their bounds.

    cross_entropy         of the material, nats (texnet.metrics)
    temperature_mse_k2    mean square error of T where the truth is not sky, K^2
    texture_mse_per_band  of X there, (W m-2 sr-1 um-1)^2, divided by the number of bands

`bounds` says what no method can beat that replaces the surroundings by the k objects of a given
environment: for T the Cramer-Rao bound (which an estimate that knows V >= 0, or what is usual,
may still beat), for X the V on the simplex that comes nearest to the true X.

The library is the paper's: exactly the scene's materials, and the sky.
"""

from dataclasses import replace

import numpy as np
from scipy.optimize import nnls

from benchmarks.accuracy import NETD_K
from benchmarks.paper_method import kmeans_environment, paper_decompose
from physics.cube.heat_cube import HeatCube
from physics.estimate import estimate_environment
from physics.identifiability import cramer_rao
from physics.library import SKY, MaterialLibrary
from physics.simulator import trace_scene
from physics.simulator.presets import preset
from physics.simulator.sensor import add_noise
from texnet.metrics import evaluate, non_sky
from texnet.pipeline import decompose
from training.scenes import BASE_SEED

BESIDE = ("material_accuracy", "texture_correlation")
ERRORS = ("cross_entropy", "temperature_mse_k2", "texture_mse_per_band")
PAPER, OURS, LOCAL = "the paper's method", "net+sgd", "local"
PAPER_BOUND, OUR_BOUND = "bound, the paper's environment", "bound, our environment"
MARGIN = 1.05  # ours counts as worse if it exceeds the paper's method by this factor


def traced(name, seed, size, spp):
    """TracedScene of a preset, and the MaterialLibrary of its materials and the sky."""
    starter = MaterialLibrary.starter()
    scene = trace_scene(preset(name, seed), size, spp, seed, starter)
    return scene, starter.subset([SKY, *(n for n in starter.names if n in scene.materials)])


def random_seeds(n):
    """Seeds of the first n random scenes of the test split."""
    return [BASE_SEED["test"] + i for i in range(n)]


def seen(clean, truth, bands, seed):
    """The bands (indices) of a noise-free cube as read by a sensor with NETD_K -> HeatCube and
    Truth."""
    w, rng = clean.wavelength_um[bands], np.random.default_rng(seed)
    cube = HeatCube(
        add_noise(clean.radiance[bands], w, NETD_K, rng), w, clean.fwhm_um[bands], NETD_K
    )
    return cube, replace(
        truth, wavelength_um=w, texture=truth.texture[bands], emissivity=truth.emissivity[bands]
    )


def errors(answer, truth):
    """The three ERRORS of a Decomposition; with them `evaluate`'s material_accuracy (fraction) and
    texture_correlation (of the sky-lit texture)."""
    e = evaluate(answer, truth)
    e["temperature_mse_k2"] = e["temperature_rmse_k"] ** 2
    # the last digits of float32 sums depend on where the arrays lie in memory
    return {name: float(f"{e[name]:.5g}") for name in (*ERRORS, *BESIDE)}


def bounds(cube, truth, environment):
    """Lower limits of the ERRORS for a given environment, with T and m true; no bound on m is
    known.

    That on T is infinite if there are too few bands to tell T from V.
    """
    ground = non_sky(truth)
    e, x = (a[:, ground].T.astype(float) for a in (truth.emissivity, truth.texture))
    t = truth.temperature_k[ground].astype(float)
    sigma = cramer_rao(cube.wavelength_um, cube.sigma, e, environment.radiance, t)
    nearest = best_lighting(x, environment.radiance) @ environment.radiance
    return dict.fromkeys((*ERRORS, *BESIDE), np.nan) | {
        "temperature_mse_k2": float((sigma**2).mean()),
        "texture_mse_per_band": float(((nearest - x) ** 2).mean()),
    }


def best_lighting(texture, radiance):
    """V (P, k) on the simplex whose V S is nearest to X (P, bands), S being (k, bands).

    Since V sums to 1, X - V S = V (X - S), so this is non-negative least squares of zero with the
    sum as one additional, heavily weighted row (Lawson and Hanson 1974, ch. 23).
    """
    heavy = 1e4 * np.abs(radiance).max()
    rest = np.zeros(radiance.shape[1] + 1)
    rest[-1] = heavy
    v = np.empty((len(texture), len(radiance)))
    for i, x in enumerate(texture):
        v[i] = nnls(np.vstack([(radiance - x).T, np.full((1, len(radiance)), heavy)]), rest)[0]
    return v / v.sum(axis=1, keepdims=True)


def measure(cube, truth, library, k, seed):
    """{method: its errors} for one cube with k objects, including the bounds."""
    ours = estimate_environment(cube, library, k, seed=seed)
    theirs = kmeans_environment(cube, k, seed)
    own = {m: decompose(cube, library, method=m, environment=ours) for m in (OURS, LOCAL)}
    found = own | {PAPER: paper_decompose(cube, library, theirs)}
    return {method: errors(answer, truth) for method, answer in found.items()} | {
        PAPER_BOUND: bounds(cube, truth, theirs),
        OUR_BOUND: bounds(cube, truth, ours),
    }


def verdict(rows, x):
    """A sentence on where net+sgd's error exceeds that of the paper's method by more than MARGIN,
    for each scene and each x.

    rows   dicts of group, scene, seed, method, ERRORS and x, the name of what varies
    """
    pairs, worse = {}, {}
    for r in rows:
        if r["method"] in (OURS, PAPER):
            at = f"{r['group']} {r['scene']}", r["seed"], r[x]
            pairs.setdefault(at, {})[r["method"]] = r
    for (scene, _, n), pair in pairs.items():
        for e in ERRORS:
            if pair[OURS][e] > MARGIN * pair[PAPER][e]:
                by = f"{pair[OURS][e] / pair[PAPER][e] - 1:.0%}"
                worse.setdefault(f"{e} of {scene}", []).append(f"{x} = {n} (by {by})")
    above = f"{MARGIN - 1:.0%} above the paper's method"
    if not worse:
        return f"net+sgd is nowhere more than {above}: in no scene, for no value of {x}."
    said = "; ".join(f"{what} at {', '.join(where)}" for what, where in worse.items())
    return f"net+sgd is above the paper's method in {said}; elsewhere not more than {above}."
