"""The paper's Fig. "dn": how the environment is found, and the cost of that alone.

The means of the picture's halves against K-means for k = 2, and K-means for k = 5. The paper's
method uses the centres as they are; ours finds the sky overhead from the sky in view
(physics/estimate.py), by default for k = 5. The bounds are those of `errors.bounds`.
"""

from benchmarks.paper_method import halves_environment, kmeans_environment, paper_decompose
from benchmarks.rows import write_csv
from physics.bands import equidistant_bands
from physics.estimate import estimate_environment
from texnet.pipeline import decompose

from .errors import (
    OUR_BOUND,
    OURS,
    PAPER,
    PAPER_BOUND,
    bounds,
    errors,
    random_seeds,
    seen,
    traced,
    verdict,
)  # fmt: skip
from .pictures import draw, said

BANDS = 54
HALVES, TWO, FIVE = "halves, k = 2", "k = 2", "k = 5"


def reproduce(out, full, progress):
    (shape, spp, scenes) = ((256, 384), 256, 8) if full else ((128, 192), 128, 3)
    chosen = [("forest", 7), ("patterned", 7)] + [("random", s) for s in random_seeds(scenes)]
    rows, shown = [], None
    for done, (name, seed) in enumerate(chosen):
        if progress:
            progress(done, len(chosen), "scenes")
        scene, library = traced(name, seed, shape, spp)
        clean, truth = scene.shade(library, *equidistant_bands(BANDS), netd_k=0)
        cube, truth = seen(clean, truth, slice(None), seed)
        pictures = {}
        for variant, (theirs, ours) in _environments(cube, library).items():
            where = dict(group=name, scene=seed, seed=seed, environment=variant)
            where |= dict(bands=BANDS, k=len(ours))
            for method, answer in (
                (PAPER, paper_decompose(cube, library, theirs)),
                (OURS, decompose(cube, library, environment=ours)),
            ):
                rows.append(where | dict(method=method) | errors(answer, truth))
                pictures[method, variant] = answer, rows[-1]
            for method, environment in ((PAPER_BOUND, theirs), (OUR_BOUND, ours)):
                rows.append(where | dict(method=method) | bounds(cube, truth, environment))
        shown = shown or (pictures, truth)
    write_csv(out / "environment-method.csv", rows)
    draw(*shown, out / "environment-method.png")
    lines = [
        f"{r['group']:9} {r['scene']:7} {r['environment']:14} {r['method']:30} {', '.join(said(r))}"
        for r in rows
    ]
    return "\n".join([*lines, verdict(rows, "environment")]), {"rows": rows}


def _environments(cube, library):
    """{variant: (the paper's, ours)}"""
    halves = halves_environment(cube)
    return {
        HALVES: (halves, halves),
        TWO: (kmeans_environment(cube, 2), estimate_environment(cube, library, 2)),
        FIVE: (kmeans_environment(cube, 5), estimate_environment(cube, library, 5)),
    }
