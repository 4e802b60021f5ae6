"""Accuracy and time of every method against the number of bands, on scenes nobody trained on.

    texnet bench accuracy --out DIR [--enclosed] [--finer TIMES]

Twenty-four random scenes of the test split (seeds from 3,000,000; training uses 1,000,000 and
2,000,000, tuning 5,000,000 and more); with fewer, one or two with much bare metal would dominate
the temperature error. The presets are not among them: other seeds of these, which differ little,
were used for tuning. Each scene is path-traced once and shaded in 4, 9, 18, 54 and 100 bands over
8-14 um, noise 50 mK; the environment is estimated from the noisy cube with k = 5 objects; the
library is the whole starter library. `net+sgd` is the ONNX file, as users get it. Everything runs
on two threads. --enclosed places the same scenes, if outdoors, in woods and streets (`enclosed`);
--finer traces them with so many times the pixels on each side.

Writes accuracy.csv, one row per scene, bands and method; confusion.csv, the pixels of each material
that got each name; methods.csv, the means that `texnet decompose --budget` uses. Resumes after the
last complete scene if earlier ones have the same code and arguments, and replaces them if not.
Prints the means, the share of each scene that is unknown, the difference of net+sgd from the other
methods by scene, and which materials the last method mistakes for which.
"""

import time
from collections import Counter

import numpy as np

from benchmarks import ONNX, confusion
from benchmarks.rows import read_csv, settings, whole_scenes, write_csv
from benchmarks.threads import THREADS, on_two_threads
from physics.bands import equidistant_bands
from physics.library import MaterialLibrary
from physics.machinery.whole_file import whole_file
from physics.simulator import trace_scene
from physics.simulator.presets import preset
from texnet import budget
from texnet.methods import METHODS
from texnet.metrics import evaluate
from texnet.pipeline import decompose
from texnet.runtime import Runtime
from training.scenes import BASE_SEED

BANDS = (4, 9, 18, 54, 100)
SCENES, SIZE, SPP, NETD_K, K = 24, (128, 160), 64, 0.05, 5
ERRORS = (
    "temperature_rmse_k", "temperature_mae_k", "material_accuracy", "mean_iou", "cross_entropy",
    "texture_correlation",
)  # fmt: skip
DOUBT = ("within_1_sigma", "within_2_sigma", "abstention", "accuracy_answered")
SHOWN = (*ERRORS, *DOUBT, "seconds_per_megapixel")
LESS_IS_BETTER = ("temperature_rmse_k", "temperature_mae_k", "cross_entropy")


def test_scenes(scenes=SCENES, done=(), finer=1, kind="random"):
    """Yield name and TracedScene of the first test scenes, including rooms without sky, except
    those whose names are in done. They have SIZE pixels, or finer times as many on each side; kind
    is "random" or "enclosed"."""
    size = tuple(finer * n for n in SIZE)
    library = MaterialLibrary.starter()
    for seed in range(BASE_SEED["test"], BASE_SEED["test"] + scenes):
        if f"{kind} {seed}" not in done:
            yield f"{kind} {seed}", trace_scene(preset(kind, seed), size, SPP, seed, library)


def measure(cube, truth, method, model=None):
    """The metrics of one method on one cube, with its time, and the names it gives to materials
    (see `confusion.named_as`); model as in `decompose`."""
    start = time.perf_counter()
    answer = decompose(cube, method=method, k=K, model=model)
    seconds = time.perf_counter() - start
    pixels = cube.shape[0] * cube.shape[1]
    scores = evaluate(answer, truth) | {"seconds_per_megapixel": seconds / pixels * 1e6}
    return scores, confusion.named_as(answer, truth)


def measured(out, made, wanted):
    """Rows of accuracy.csv and of confusion.csv in a directory that were made with these settings
    (see `rows.settings`), for scenes that have all (bands, method) wanted."""
    rows = whole_scenes(read_csv(out / "accuracy.csv", made), wanted)
    scenes = {r["scene"] for r in rows}
    return rows, [r for r in read_csv(out / "confusion.csv", made) if r["scene"] in scenes]


def means(rows):
    """Yield, per number of bands and method, these and {name: mean over scenes} of what is SHOWN,
    for time the median."""
    for bands in sorted({r["bands"] for r in rows}):
        for method in METHODS:
            of = [r for r in rows if (r["bands"], r["method"]) == (bands, method)]
            if of:
                mean = {name: np.nanmean([r[name] for r in of]) for name in SHOWN}
                yield bands, method, mean | {SHOWN[-1]: np.median([r[SHOWN[-1]] for r in of])}


def table(rows):
    """Lines of text of `means`."""
    yield f"{'bands':>5} {'method':8}" + "".join(f"{name[:14]:>16}" for name in SHOWN)
    for bands, method, mean in means(rows):
        yield f"{bands:5d} {method:8}" + "".join(f"{m:16.3f}" for m in mean.values())


def write_methods(rows, path):
    """Write the table that `texnet.budget` reads."""
    lines = ["# means over the test scenes, by: texnet bench accuracy --out DIR"]
    lines.append(",".join(("bands", "method", *budget.ERRORS)))
    for bands, method, mean in means(rows):
        lines.append(",".join([f"{bands},{method}", *(f"{mean[e]:.4g}" for e in budget.ERRORS)]))
    with whole_file(path) as part:
        part.write_text("\n".join(lines) + "\n", encoding="utf-8")


def unknown(rows):
    """Lines of text: per number of bands and method the quartiles over scenes of abstention."""
    yield "abstention: a quarter of the scenes below, half, three quarters"
    for bands, method in dict.fromkeys((r["bands"], r["method"]) for r in rows):
        of = [r["abstention"] for r in rows if (r["bands"], r["method"]) == (bands, method)]
        quartiles = np.quantile(of, (0.25, 0.5, 0.75))
        yield f"{bands:5d} {method:8}" + "".join(f"{q:8.3f}" for q in quartiles)


def differences(rows, other):
    """Lines of text: per number of bands and error, the mean over scenes of net+sgd's minus that of
    another method, its standard error, and the number of scenes in which net+sgd is better."""
    yield f"net+sgd less {other}: mean, standard error, better in so many scenes"
    error = {(r["bands"], r["scene"], r["method"]): r for r in rows}
    for bands in sorted({r["bands"] for r in rows}):
        scenes = {r["scene"] for r in rows if r["bands"] == bands}
        for name in ERRORS:
            ours, theirs = (
                np.array([error[bands, scene, m][name] for scene in scenes])
                for m in ("net+sgd", other)
            )
            less = (ours - theirs)[np.isfinite(ours - theirs)]
            better = sum(d < 0 if name in LESS_IS_BETTER else d > 0 for d in less)
            yield (
                f"{bands:5d} {name:22} {np.mean(less):8.3f} "
                f"{np.std(less, ddof=1) / np.sqrt(len(less)):8.3f} {better:4d} of {len(less)}"
            )


def run(out, scenes=SCENES, bands=BANDS, methods=METHODS, finer=1, kind="random", progress=None):
    """Write accuracy.csv, confusion.csv and methods.csv into the folder out -> the rows of the
    first two. progress is called as progress(done, total, what) after each scene."""
    out.mkdir(parents=True, exist_ok=True)
    on_two_threads()
    models = {"net+sgd": Runtime(ONNX, THREADS).run}
    library = MaterialLibrary.starter()
    made = f"{settings()}, {scenes} {kind} scenes, {finer} times finer"
    rows, named = measured(out, made, {(b, m) for b in bands for m in methods})
    done = {r["scene"] for r in rows}
    for i, (name, traced) in enumerate(test_scenes(scenes, done, finer, kind), len(done) + 1):
        for n in bands:
            cube, truth = traced.shade(library, *equidistant_bands(n), NETD_K)
            for method in methods:
                row = {"scene": name, "bands": n, "method": method}
                scores, names = measure(cube, truth, method, models.get(method))
                rows.append(row | scores)
                named += [
                    row | {"true": true, "named": given, "pixels": pixels}
                    for (true, given), pixels in names.items()
                ]
        write_csv(out / "confusion.csv", named, made)
        write_csv(out / "accuracy.csv", rows, made)
        if progress is not None:
            progress(i, scenes, "scenes")
    write_methods(rows, out / "methods.csv")
    return rows, named


def summary(rows, named):
    """Lines of text on all that was measured."""
    bands, methods = (list(dict.fromkeys(r[what] for r in rows)) for what in ("bands", "method"))
    yield from table(rows)
    yield from unknown(rows)
    if "net+sgd" in methods:
        for other in methods:
            if other != "net+sgd":
                yield from differences(rows, other)
    for n in bands:
        counts = Counter()
        for r in named:
            if (r["bands"], r["method"]) == (n, methods[-1]):
                counts[r["true"], r["named"]] += r["pixels"]
        yield f"{n} bands, {methods[-1]}"
        yield from confusion.table(counts)
