"""What a good start buys: the objective of TeX-SGD against time, from four starts.

    python -m benchmarks.starts --out DIR

The semi-global objective (`physics.exact.semiglobal`, nats per pixel) of path-traced test scenes,
54 bands, 50 mK, environment estimated, k = 5, is lowered by its own refinement from

    network    T, m and V that TeXNet proposes
    local      every pixel's own best
    constant   the median brightness temperature, the commonest material, V = 1/k
    random     T within 10 K of it, any material but sky, any V

Time includes what made the start; the local solution that the objective is built on costs
each the same and is left out of all but `local`. Writes starts.csv and starts.png.
"""

import argparse
import time
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from benchmarks.accuracy import NETD_K, K, test_scenes
from benchmarks.rows import write_csv
from physics.bands import equidistant_bands
from physics.estimate import estimate_environment
from physics.exact.local import solve_local
from physics.exact.reduced import reduce_model
from physics.exact.semiglobal import Objective, smoothed
from physics.known import known_arrays
from physics.library import MaterialLibrary
from physics.machinery.whole_file import whole_file
from physics.planck import brightness_temperature
from texnet.learned import torch_model

STARTS = ("network", "local", "constant", "random")


def curves(cube, library, rng):
    """Yield start, round, seconds and objective in nats per pixel."""
    environment = estimate_environment(cube, library, K)
    model = reduce_model(cube, library, environment)
    clock = time.perf_counter()
    local = solve_local(model, cube.spectra)
    local_seconds = time.perf_counter() - clock
    objective = Objective(model, cube, local)
    known = known_arrays(cube, library, environment)
    clock = time.perf_counter()
    proposal = torch_model()(cube.radiance, known, refined=False)
    seconds = {"network": time.perf_counter() - clock, "local": local_seconds}
    states = _states(cube, objective, proposal, rng)
    for start in STARTS:
        stamps = []
        clock = time.perf_counter()
        note = lambda *_, to=stamps: to.append(time.perf_counter())
        refined = smoothed(objective, states[start], note)
        # the trace also holds the start and the steps before the first round
        rounds = len(stamps)
        first = seconds.get(start, 0.0)
        pixels = len(cube.spectra)
        yield start, 0, first, refined.objective[0] / pixels
        for i, stamp in enumerate(stamps, 1):
            value = refined.objective[len(refined.objective) - rounds + i - 1]
            yield start, i, first + stamp - clock, value / pixels


def _states(cube, objective, proposal, rng):
    pixels, k = len(cube.spectra), objective.model.k
    sky, library = objective.sky, objective.model.library
    t = brightness_temperature(cube.wavelength_um, cube.spectra.astype(float)).mean(axis=1)
    best = objective.local_state()
    ground = np.setdiff1d(np.arange(len(library)), [sky])
    common = ground[np.bincount(best.material, minlength=len(library))[ground].argmax()]
    even = np.full((pixels, k), 1 / k)
    m = proposal["material"].ravel().astype(int)
    v = proposal["thermal_lighting"].reshape(k, -1).T.astype(float)
    v = np.where(v.sum(1, keepdims=True) > 0, v, 1 / k)
    return {
        "network": objective.state(proposal["temperature_k"].ravel(), m, v),
        "local": best,
        "constant": objective.state(np.full(pixels, np.median(t)), np.full(pixels, common), even),
        "random": objective.state(
            np.median(t) + rng.uniform(-10, 10, pixels), rng.choice(ground, pixels),
            rng.dirichlet(np.ones(k), pixels),
        ),
    }  # fmt: skip


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--scenes", type=int, default=2, help="random ones, beside the presets")
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    library, rows = MaterialLibrary.starter(), []
    for name, traced in test_scenes(args.scenes):
        cube, _ = traced.shade(library, *equidistant_bands(54), NETD_K)
        if not rows:  # compile once, untimed
            list(curves(cube, library, np.random.default_rng(0)))
        for row in curves(cube, library, np.random.default_rng(0)):
            rows.append(dict(zip(("start", "round", "seconds", "nats"), row, strict=True)))
            rows[-1]["scene"] = name
            print(name, *row, flush=True)
    write_csv(args.out / "starts.csv", rows)
    _draw(rows, args.out / "starts.png")


def _draw(rows, path):
    scenes = list(dict.fromkeys(r["scene"] for r in rows))
    figure = Figure(figsize=(3.2 * len(scenes), 3.2), layout="constrained")
    axes = figure.subplots(1, len(scenes), squeeze=False)
    for axis, scene in zip(axes[0], scenes, strict=True):
        of = [r for r in rows if r["scene"] == scene]
        floor = min(r["nats"] for r in of)
        for start, marker in zip(STARTS, "osv^", strict=True):
            line = [r for r in of if r["start"] == start]
            axis.semilogy(
                [r["seconds"] for r in line], [r["nats"] - floor + 1e-4 for r in line],
                marker=marker, ms=4, label=start,
            )  # fmt: skip
        axis.set(title=scene, xlabel="seconds")
    axes[0, 0].set_ylabel("objective above the least\n(nats per pixel)")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=4)
    with whole_file(path) as part:
        figure.savefig(part, dpi=110)


if __name__ == "__main__":
    main()
