"""TeX vision beside the raw thermal picture and the truth (the paper's Fig. 5).

The presets `forest` and `street`, decomposed with the whole starter library and k = 5 environment
objects by TeX-SGD (`sgd`) and by the network with refinement (`net+sgd`). The true TeX vision is
painted by the same rule (`texnet.vision`) from the truth of the traced paths, brightness being the
part of X that the sky alone lights.

tex-vision.csv, one row per scene and picture: material_accuracy (all pixels), temperature_rmse_k
(K, non-sky pixels), texture_correlation (Pearson, with the true sky-lit texture, same pixels); for
the thermal picture only the last, as a magnitude.
"""

import numpy as np

from benchmarks.rows import write_csv
from texnet.baselines import panchromatic
from texnet.metrics import evaluate, non_sky, texture_scores
from texnet.pipeline import decompose
from texnet.vision import tex_vision

from . import common

SCENES, K = ("forest", "street"), 5
METHODS = {"sgd": "sgd (TeX-SGD)", "net+sgd": "net+sgd"}
MEASURED = ("material_accuracy", "temperature_rmse_k", "texture_correlation")


def reproduce(out, full, progress):
    """tex-vision.csv and tex-vision.png in the folder out."""
    rows, pictures, truths = [], [], []
    for name in SCENES:
        cube, truth = common.night(name, full, progress)
        truths.append(truth)
        thermal = panchromatic(cube)
        raw = abs(texture_scores(thermal, truth)["correlation"])
        rows.append({"scene": name, "picture": "thermal", **dict.fromkeys(MEASURED)})
        rows[-1]["texture_correlation"] = raw
        seen = common.between(thermal[non_sky(truth)])
        painted = [np.clip(seen(thermal), 0, 1).data]
        for method in METHODS:
            answer = decompose(cube, method=method, k=K, progress=progress)
            metrics = evaluate(answer, truth)
            rows.append({"scene": name, "picture": method, **{m: metrics[m] for m in MEASURED}})
            painted.append(tex_vision(answer))
        pictures += [*painted, common.true_vision(truth)]
    write_csv(out / "tex-vision.csv", rows)
    _draw(rows, pictures, truths, out / "tex-vision.png")
    lines = [f"{r['scene']:7} {r['picture']:8} {_caption(r)}" for r in rows]
    return "\n".join(lines), {"rows": rows}


def _caption(row, end=", "):
    texture = f"texture correlation {row['texture_correlation']:.2f}"
    if row["material_accuracy"] is None:
        return texture
    right, off = 100 * row["material_accuracy"], row["temperature_rmse_k"]
    return f"material {right:.1f} %, T off {off:.2f} K{end}{texture}"


def _draw(rows, pictures, truths, path):
    titles = ("raw thermal, 8-14 µm", *METHODS.values(), "truth")
    fig, axes = common.panels(len(SCENES), 4, pictures[0].shape, more_inches=0.2)
    rows, pictures = iter(rows), iter(pictures)
    for line in axes:
        for ax, title in zip(line, titles, strict=True):
            caption = "" if title == "truth" else _caption(next(rows), end="\n")
            common.show(ax, next(pictures), title, caption)
    common.name_materials(fig, *truths)
    common.save(fig, path)
