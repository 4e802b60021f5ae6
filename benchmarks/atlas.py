"""The atlas of `benchmarks.stability`: its rows as a picture and as a page.

A method is at fault if it raises or returns values that are not finite, or if from one level to the
next its error grows while its sigma shrinks, both by more than a tenth.
"""

from functools import partial

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter

from benchmarks.colours import BLUE, GREEN, ORANGE, VERMILLION
from physics.machinery.whole_file import whole_file
from texnet.methods import METHODS

STYLE = {
    "local": (BLUE, "o-"), "sgd": (GREEN, "^--"), "net": (ORANGE, "s-."),
    "net+sgd": (VERMILLION, "D-"),
}  # fmt: skip
TABLED = "net+sgd", "local"
KELVIN = {"temperature_mae_k": "T off by (K)", "sigma_k": "sigma (K)"}
SHARES = {"within_2_sigma": "in 2 sigma", "material_accuracy": "right", "abstention": "`unknown`"}
FAULT = 1.1
LOW_K, HIGH_K = 0.2, 10.0  # of the panels' axes, unless there is more to see
HEAD = """# The atlas in figures

    texnet bench stability --out stability      # about two hours on two cores

writes this page, `atlas.md`, and `atlas.png` from `stability.csv` and `missing.csv`, which have one
row per answer. One difficulty at a time is increased (`benchmarks/difficulties.py`); there are 54
bands and 50 mK of noise unless that is the difficulty. Each value is a mean over the scenes: T's
mean absolute error, its median sigma, the share of T's errors within two sigmas, and the shares of
pixels with the right material and of those called `unknown`. The brightness temperature assumes an
emissivity of 0.95 and subtracts what the surface reflects of the true sky.
"""
MISSING = """
## A material that the library lacks

One of the three commonest materials of a scene is missing from the library. Covered: of its pixels,
those that are `unknown` or have a T within two sigmas. False alarms: of all other pixels, those
that are `unknown` though their material is right. Mean, its standard error, median.
"""
NOISE = """
## Noise in, noise out

How far T moves between two draws of the noise, relative to the Cramér-Rao bound on its standard
deviation (without air): the median over all different answers where that is finite, and the 90th
percentile.
"""
FAULTS = """
## Faults

{} in {} different answers: failures, and errors of T that grow by more than a tenth from one level
to the next while the median sigma shrinks by more than a tenth.
"""


def draw(rows, axes, path):
    """The atlas: for each axis a panel of T's error and sigma, above one of materials."""
    columns = 4
    lines = -(-len(axes) // columns)
    figure = Figure(figsize=(2.7 * columns, 3.9 * lines), layout="constrained")
    cells = figure.subfigures(lines, columns)
    for cell, (name, axis) in zip(cells.flat, axes.items(), strict=False):
        top, bottom = cell.subplots(2, 1, sharex=True)
        at = range(len(axis.levels))
        for method, (colour, mark) in STYLE.items():
            of = [r for r in rows if (r["axis"], r["method"]) == (name, method)]
            mean = partial(_means, of, axis.levels)
            top.plot(at, mean("temperature_mae_k"), mark, color=colour, label=method)
            bottom.plot(at, mean("material_accuracy"), mark, color=colour)
            if method == "net+sgd":
                dots = "net+sgd: above its median sigma, below the share unknown"
                top.plot(at, mean("sigma_k"), ":", color=colour, label=dots)
                today = "brightness temperature"
                top.plot(at, mean("brightness_mae_k"), "-", color="0.7", label=today)
                bottom.plot(at, mean("abstention"), ":", color=colour)
        shown = np.concatenate([line.get_ydata() for line in top.lines])
        low, high = np.nanmin(shown, initial=LOW_K), np.nanmax(shown, initial=HIGH_K)
        top.set(yscale="log", ylabel="T error (K)", ylim=(low, high))
        top.set_title(name, fontsize=9)  # so that the longest fits
        top.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        top.yaxis.set_major_formatter("{x:g}")  # 0.5, not 5 x 10^-1
        top.yaxis.set_minor_formatter(NullFormatter())
        bottom.set(ylim=(0, 1), xlabel=axis.label, ylabel="share")
        levels = [f"{level:g}" for level in axis.levels]
        if len(levels) >= 8:  # no room for more than .05
            levels = [level.removeprefix("0") or "0" for level in levels]
        bottom.set_xticks(list(at), levels, fontsize=9)
    handles = top.get_legend_handles_labels()
    what = "Above: mean error of T; below: share of pixels with the right material"
    figure.legend(*handles, loc="outside upper center", ncols=3, title=what)
    with whole_file(path) as part:
        figure.savefig(part, dpi=80)


def page(rows, axes, missing, path):
    """Write the atlas in figures, as Markdown."""
    wrong = list(faults(rows))
    lines = [HEAD, *table(rows, axes)]
    if missing:
        lines += [MISSING, *missing_table(missing)]
    different = distinct(rows)
    lines += [NOISE, *noise_table(different)]
    lines += [FAULTS.format(len(wrong), len(different)), *(f"* {fault}" for fault in wrong)]
    with whole_file(path) as part:
        part.write_text("\n".join(lines).rstrip() + "\n", encoding="utf-8")


def table(rows, axes):
    """Lines of the page: a row for each level."""
    heads = KELVIN | SHARES
    names = [f"`{m}`: {h}" if i == 0 else h for m in TABLED for i, h in enumerate(heads.values())]
    names = ["difficulty", "level", "brightness temperature: T off by (K)", *names]
    yield f"| {' | '.join(names)} |"
    yield "|---" * len(names) + "|"
    for name, axis in axes.items():
        of = {m: [r for r in rows if (r["axis"], r["method"]) == (name, m)] for m in TABLED}
        if not any(of.values()):
            continue
        columns = [(TABLED[0], "brightness_mae_k"), *((m, what) for m in TABLED for what in heads)]
        means = [_means(of[m], axis.levels, what) for m, what in columns]
        for i, level in enumerate(axis.levels):
            values = (
                f"{of_what[i]:.0%}" if what in SHARES else f"{of_what[i]:.2f}"
                for (_, what), of_what in zip(columns, means, strict=True)
            )
            title = f"{name}: {axis.label}" if i == 0 else ""
            yield f"| {title} | {level:g} | {' | '.join(values)} |"


def missing_table(rows):
    """Lines of the page: for each method, over the cases."""
    yield "| | covered | median | cases with 90 % | false alarms | median |"
    yield "|---" * 6 + "|"
    for method in METHODS:
        of = [r for r in rows if r["method"] == method]
        covered, alarms, scenes = (
            np.array([r[what] for r in of]) for what in ("covered", "false_alarms", "scene")
        )
        enough = f"{np.count_nonzero(covered >= 0.9)} of {len(of)}"
        yield f"| `{method}` | {_spread(covered, scenes)} | {enough} | {_spread(alarms, scenes)} |"


def distinct(rows):
    """The rows without repetitions in several axes of the same case."""
    return list({
        tuple(value for name, value in r.items() if name not in ("axis", "level")): r for r in rows
    }.values())  # fmt: skip


def noise_table(rows):
    """Lines of the page: how far T moves with the noise."""
    yield "| | median | 90th percentile |"
    yield "|---" * 3 + "|"
    for method in METHODS:
        of = np.array([r["amplification"] for r in rows if r["method"] == method])
        of = of[np.isfinite(of)]
        if of.size:
            yield f"| `{method}` | {np.median(of):.2f} | {np.quantile(of, 0.9):.2f} |"


def _spread(of, scenes):
    """Mean, its standard error for dependent cases within scenes, and median."""
    off = [(of - of.mean())[scenes == scene].sum() for scene in np.unique(scenes)]
    error = np.nan
    if len(off) > 1:
        error = np.linalg.norm(off) / len(of) * (len(off) / (len(off) - 1)) ** 0.5
    return f"{100 * of.mean():.1f} ± {100 * error:.1f} % | {100 * np.median(of):.1f} %"


def faults(rows):
    """Sentences on what must not happen: failures, and errors that grow while sigma shrinks."""
    for r in rows:
        if r["failure"]:
            yield f"{r['axis']} {r['level']:g}, {r['scene']}, {r['method']}: {r['failure']}"
    for key in dict.fromkeys((r["axis"], r["scene"], r["method"]) for r in rows):
        of = [r for r in rows if (r["axis"], r["scene"], r["method"]) == key and not r["failure"]]
        for a, b in zip(of, of[1:], strict=False):
            grew = b["temperature_mae_k"] > FAULT * a["temperature_mae_k"]
            if grew and b["sigma_k"] * FAULT < a["sigma_k"]:
                yield (
                    f"{', '.join(key)}, from {a['level']:g} to {b['level']:g}: T off by "
                    f"{b['temperature_mae_k']:.2f} K instead of {a['temperature_mae_k']:.2f}, "
                    f"sigma {b['sigma_k']:.2f} K instead of {a['sigma_k']:.2f}"
                )


def _means(rows, levels, what):
    """Means of a column over the scenes at each level."""
    of = [[r[what] for r in rows if r["level"] == level] for level in levels]
    return [np.nanmean(values) if np.isfinite(values).any() else np.nan for values in of]
