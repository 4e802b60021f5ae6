"""The paper's errors as curves: over the number of bands, and of environment objects.

Two groups of scenes: `patterned`, whose objects vary in temperature as in the paper, under several
draws of noise, and random scenes of the test split, in which some objects are metal. A point is
the mean over its group, its bar extends from the least to the largest.
"""

import numpy as np
from matplotlib.figure import Figure

from benchmarks.colours import BLACK, BLUE, ORANGE, SKY_BLUE, VERMILLION
from benchmarks.rows import write_csv
from physics.bands import equidistant_bands

from .common import save
from .errors import (
    ERRORS,
    LOCAL,
    OUR_BOUND,
    OURS,
    PAPER,
    PAPER_BOUND,
    measure,
    random_seeds,
    seen,
    traced,
    verdict,
)  # fmt: skip

TITLES = (
    "cross entropy of m\n(nats)", "mean square error of T\n(K²)",
    "mean square error of X per band\n((W/m²/sr/µm)²)",
)  # fmt: skip
STYLE = {  # a marker and dashes for every line
    PAPER: dict(color=VERMILLION, marker="s", linestyle="--"),
    OURS: dict(color=BLUE, marker="o", linestyle="-"),
    LOCAL: dict(color=SKY_BLUE, marker="D", linestyle="-.", linewidth=0.9, markersize=3.5),
    PAPER_BOUND: dict(color=ORANGE, marker="v", linestyle=":", markersize=4),
    OUR_BOUND: dict(color=BLACK, marker="^", linestyle=":", markersize=4),
}
TICKS = {"bands": (2, 5, 10, 20, 50, 100), "k": (1, 2, 4, 6, 8, 10, 12)}
FINE_BANDS = 100  # rendered, narrow and equidistant over 8-14 um


def sizes(full):
    """(height, width), paths per pixel, draws of noise, random scenes."""
    return ((256, 384), 256, 3, 4) if full else ((96, 144), 64, 3, 3)


def subset(n):
    """Indices of n equidistant bands of those rendered."""
    return ((np.arange(n) + 0.5) * FINE_BANDS / n).astype(int)


def sweep(points, full, progress, size=None):
    """Rows of errors for every (bands, k) of points on every scene."""
    (shape, spp, draws, scenes), rows = size or sizes(full), []
    what = [("patterned", 7, range(draws))] + [("random", s, (0,)) for s in random_seeds(scenes)]
    done, total = 0, len(points) * sum(len(seeds) for *_, seeds in what)
    for name, scene_seed, seeds in what:
        scene, library = traced(name, scene_seed, shape, spp)
        clean, truth = scene.shade(library, *equidistant_bands(FINE_BANDS), netd_k=0)
        for seed in seeds:
            for bands, k in points:
                cube, seen_truth = seen(clean, truth, subset(bands), seed)
                for method, e in measure(cube, seen_truth, library, k, seed).items():
                    where = dict(group=name, scene=scene_seed, seed=seed)
                    rows.append(where | dict(method=method, bands=bands, k=k) | e)
                done += 1
                if progress:
                    progress(done, total, f"{name} {scene_seed}")
    return rows


def summarised(rows):
    """Rows of the mean and the spread (standard deviation) over a group's scenes and draws."""
    for group, method, bands, k in dict.fromkeys(_key(r) for r in rows):
        of = [r for r in rows if _key(r) == (group, method, bands, k)]
        for name, over in (("mean", np.mean), ("spread", np.std)):
            where = dict(group=group, scene="all", seed=name, method=method, bands=bands, k=k)
            errors = {e: np.array([r[e] for r in of]) for e in of[0] if e not in where}
            yield where | {
                e: float(over(v)) if np.isfinite(v).all() else float("nan")
                for e, v in errors.items()
            }


def _key(row):
    return row["group"], row["method"], row["bands"], row["k"]


def publish(rows, x, label, out, name):
    """Write NAME.csv and NAME.png; returns text and the means. x: "bands" or "k"."""
    write_csv(out / f"{name}.csv", rows + list(summarised(rows)))
    draw(rows, x, label, out / f"{name}.png")
    means = [r for r in summarised(rows) if r["seed"] == "mean"]
    lines = [f"{'':9} {x:>5} {'cross entropy':>21} {'T MSE (K2)':>21} {'X MSE per band':>21}"]
    lines += [f"{'':15}" + f" {'net+sgd':>10} {'paper':>10}" * len(ERRORS)]
    for group in dict.fromkeys(r["group"] for r in means):
        for n in dict.fromkeys(r[x] for r in means):
            ours, paper = (_find(means, group, m, x, n) for m in (OURS, PAPER))
            values = (f"{r[e]:10.4g}" for e in ERRORS for r in (ours, paper))
            lines.append(f"{group:9} {n:5d} " + " ".join(values))
    return "\n".join(lines + [verdict(rows, x)]), {"rows": means}


def _find(means, group, method, x, n):
    return next(r for r in means if (r["group"], r["method"], r[x]) == (group, method, n))


def draw(rows, x, label, path):
    """The three errors of every group against x as a png."""
    names = dict.fromkeys(r["group"] for r in rows)
    groups = {g: [r for r in rows if r["group"] == g] for g in names}
    figure = Figure(figsize=(9.6, 3.1 * len(groups) + 0.5), layout="constrained", dpi=110)
    axes = figure.subplots(len(groups), len(ERRORS), squeeze=False, sharex=True)
    for line, (group, of_group) in zip(axes, groups.items(), strict=True):
        scenes = {(r["scene"], r["seed"]) for r in of_group}
        kind = "draws of noise" if len({s for s, _ in scenes}) == 1 else "scenes"
        line[0].set_ylabel(f"{group}\n({len(scenes)} {kind})")
        for axis, error in zip(line, ERRORS, strict=True):
            for method, style in STYLE.items():
                of_method = [r for r in of_group if r["method"] == method]
                _curve(axis, of_method, x, error, method, style)
            axis.set_yscale("log")
            if x == "bands":
                axis.set_xscale("log")
            axis.set_xticks(TICKS[x], TICKS[x])
            axis.minorticks_off()
            axis.grid(alpha=0.25)
    for top, bottom, title in zip(axes[0], axes[-1], TITLES, strict=True):
        top.set_title(title, fontsize=10)
        bottom.set_xlabel(label)
    figure.legend(*axes[0, 1].get_legend_handles_labels(), loc="outside lower center", ncols=5,
                  frameon=False)  # fmt: skip
    save(figure, path)


def _curve(axis, rows, x, error, method, style):
    at = sorted({r[x] for r in rows})
    values = [np.array([r[error] for r in rows if r[x] == n]) for n in at]
    finite = [(n, v.mean(), v.min(), v.max()) for n, v in zip(at, values, strict=True)
              if np.isfinite(v).all()]  # fmt: skip
    if not finite:
        return
    n, mean, low, high = np.array(finite).T
    axis.errorbar(n, mean, [mean - low, high - mean], label=method, elinewidth=0.7,
                  **dict(linewidth=1.4, markersize=4.5) | style)  # fmt: skip
