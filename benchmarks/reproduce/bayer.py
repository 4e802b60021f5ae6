"""The paper's Fig. "4band": TeX vision from 4 bands beside 54 and the truth; and from a mosaic.

The 4 bands cover 8-14 um contiguously, each with the NETD of the 54 narrow ones. As four full
frames they only cost bands. On one sensor under a 2 x 2 pattern of filters (`mosaic`) they also
cost resolution: every pixel lacks three of the four bands.
"""

from collections import Counter
from dataclasses import replace

import numpy as np

from benchmarks.paper_method import kmeans_environment, paper_decompose
from benchmarks.rows import write_csv
from physics.bands import equidistant_bands
from texnet.pipeline import decompose

from .errors import ERRORS, OURS, PAPER, errors, random_seeds, seen, traced, verdict
from .mosaic import bilinear, cells, demosaic, edge_aware, sample
from .pictures import draw, said

K = 5
MANY, FOUR, MOSAIC = "54 bands", "4 bands, full frames", "4 bands, one mosaic"
WAYS = {  # to invert a mosaic
    MOSAIC: edge_aware,
    MOSAIC + ", bilinear": bilinear,
    MOSAIC + ", cells": None,
}
PER_PIXEL = (
    "temperature_k", "material", "thermal_lighting", "texture", "sky_texture", "residual",
    "temperature_sigma_k", "material_probability", "unknown", "dead",
)  # fmt: skip


def reproduce(out, full, progress):
    (shape, spp, scenes) = ((256, 384), 256, 8) if full else ((128, 192), 128, 3)
    chosen = [("patterned", 7)] + [("random", s) for s in random_seeds(scenes)]
    rows, shown = [], None
    for done, (name, scene_seed) in enumerate(chosen):
        if progress:
            progress(done, len(chosen), "scenes")
        of_scene, pictures = _scene(name, scene_seed, shape, spp)
        rows += of_scene
        shown = shown or pictures
    write_csv(out / "bayer.csv", rows)
    draw(*shown, out / "bayer.png")
    lines = [
        f"{r['group']:9} {r['scene']:7} {r['method']:19} {r['camera']:30} {', '.join(said(r))}"
        for r in rows
    ]
    return "\n".join([*lines, _best_way(rows), verdict(rows, "camera")]), {"rows": rows}


def _scene(name, scene_seed, shape, spp):
    """Rows of errors, and what `pictures.draw` takes."""
    scene, library = traced(name, scene_seed, shape, spp)
    cubes, truths = {}, {}
    for label, n in ((MANY, 54), (FOUR, 4)):
        clean, truth = scene.shade(library, *equidistant_bands(n), netd_k=0)
        cubes[label], truths[label] = seen(clean, truth, np.arange(n), scene_seed)
    raw, four = sample(cubes[FOUR]), cubes[FOUR]
    for label, way in WAYS.items():
        cubes[label] = demosaic(raw, four, way) if way else cells(raw, four)
    rows, pictures = [], {}
    for method in (OURS, PAPER):
        for label, cube in cubes.items():
            truth = truths.get(label, truths[FOUR])
            answer = _at(decompose_by(method, cube, library), truth)
            rows.append(
                dict(group=name, scene=scene_seed, seed=scene_seed, method=method, camera=label)
                | dict(bands=cube.bands, k=K, netd_k=cube.netd_k) | errors(answer, truth)
            )  # fmt: skip
            if label in (MANY, FOUR, MOSAIC):
                pictures[method, label] = answer, rows[-1]
    return rows, (pictures, truths[MANY])


def decompose_by(method, cube, library):
    if method == OURS:
        return decompose(cube, library, k=K)
    return paper_decompose(cube, library, kmeans_environment(cube, K))


def _at(answer, truth):
    """The answer at the truth's resolution: each cell repeated for its pixels."""
    if answer.material.shape == truth.material.shape:
        return answer
    fine = lambda a: a.repeat(2, axis=-2).repeat(2, axis=-1)
    return replace(answer, **{name: fine(getattr(answer, name)) for name in PER_PIXEL})


def _best_way(rows):
    """Which way to invert a mosaic is best by each error, in how many scenes."""
    ours = [r for r in rows if r["method"] == OURS and r["camera"] in WAYS]
    scenes = dict.fromkeys((r["group"], r["scene"]) for r in ours)
    lines = []
    for error in ERRORS:
        of = [[r for r in ours if (r["group"], r["scene"]) == scene] for scene in scenes]
        wins = Counter(min(o, key=lambda r: r[error])["camera"] for o in of)
        lines.append(f"least {error}: " + ", ".join(f"{w} ({n})" for w, n in wins.most_common()))
    return f"Of the ways to invert a mosaic, in {len(scenes)} scenes, " + "; ".join(lines) + "."
