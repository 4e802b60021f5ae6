"""Does --k auto do as well as the best fixed k, and what does it save?

    python -m benchmarks.automatic_k --out DIR

The scenes of `accuracy` (54 bands, 50 mK, the whole starter library, net+sgd in ONNX Runtime, two
threads), with every fixed k and auto, whose time includes the search. Writes automatic_k.csv, one
row per scene and k, and prints the means over the scenes, for time the median.
"""

import time

import numpy as np

from benchmarks import ONNX
from benchmarks.accuracy import NETD_K, SCENES, test_scenes
from benchmarks.arguments import arguments
from benchmarks.rows import write_csv
from benchmarks.threads import THREADS, on_two_threads
from physics.bands import equidistant_bands
from physics.library import MaterialLibrary
from texnet.metrics import evaluate
from texnet.pipeline import decompose
from texnet.runtime import Runtime

COUNTS = (1, 2, 3, 4, 5, 6, 8, 10, "auto")
SHOWN = (
    "temperature_rmse_k", "temperature_mae_k", "material_accuracy", "cross_entropy",
    "texture_correlation", "seconds",
)  # fmt: skip


def main():
    args = arguments(__doc__, bands=54, scenes=SCENES)
    on_two_threads()
    library, run, rows = MaterialLibrary.starter(), Runtime(ONNX, THREADS).run, []
    for name, traced in test_scenes(args.scenes):
        cube, truth = traced.shade(library, *equidistant_bands(args.bands), NETD_K)
        for k in COUNTS:
            start = time.perf_counter()
            answer = decompose(cube, library, k=k, model=run)
            seconds = time.perf_counter() - start
            metrics = evaluate(answer, truth) | {"seconds": seconds}
            row = {"scene": name, "k": k, "objects": len(answer.environment)}
            rows.append(row | {what: metrics[what] for what in SHOWN})
        print(f"{name}: {rows[-1]['objects']} objects", flush=True)
        write_csv(args.out / "automatic_k.csv", rows)
    print(f"{'k':>5}" + "".join(f"{what[:18]:>20}" for what in SHOWN))
    for k in COUNTS:
        of = {what: [r[what] for r in rows if r["k"] == k] for what in SHOWN}
        means = [np.nanmean(values) for values in of.values()]
        means[-1] = np.median(of["seconds"])  # the first run may compile
        print(f"{k:>5}" + "".join(f"{mean:20.3f}" for mean in means))


if __name__ == "__main__":
    main()
