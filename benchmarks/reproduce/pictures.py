"""TeX vision of several answers to one scene beside its truth, with the errors below each."""

import io
from types import SimpleNamespace

import numpy as np
from matplotlib.figure import Figure
from PIL import Image

from physics.whole_file import whole_file
from texnet.figures import daylight_srgb
from texnet.vision import tex_vision

PANEL_INCHES, TEXT = 2.5, 9


def said(row):
    """Two phrases: the errors of T and m, and those of X."""
    t, x = row["temperature_mse_k2"] ** 0.5, row["texture_mse_per_band"]
    if np.isnan(row["material_accuracy"]):  # a bound
        return f"T off by {t:.2f} K", f"X MSE {x:.3g}"
    r = row["texture_correlation"]
    return (
        f"T off by {t:.2f} K, {row['material_accuracy']:.1%} right",
        f"X MSE {x:.3g}, sky-lit X correlates {r:.2f}",
    )


def draw(pictures, truth, library, path):
    """A png with a row for each method, a column for each variant, and the truth before them.

    pictures  {(method, variant): (Decomposition, row of errors)};  library  the truth's materials
    """
    methods, variants = (list(dict.fromkeys(key[i] for key in pictures)) for i in (0, 1))
    height = PANEL_INCHES * truth.material.shape[0] / truth.material.shape[1] + 0.75
    size = (PANEL_INCHES * (1 + len(variants)), height * len(methods))
    figure = Figure(figsize=size, layout="constrained", dpi=100)
    axes = figure.subplots(len(methods), 1 + len(variants), squeeze=False)
    true = tex_vision(SimpleNamespace(**vars(truth), hue_deg=library.hue_deg))
    _show(axes[0, 0], true, "truth", "")
    _show(axes[1, 0], daylight_srgb(truth), "the same by day", "")
    for line, method in zip(axes, methods, strict=True):
        for axis, variant in zip(line[1:], variants, strict=True):
            answer, row = pictures[method, variant]
            _show(axis, tex_vision(answer), f"{variant}\n{method}", "\n".join(said(row)))
    drawn = io.BytesIO()
    figure.savefig(drawn, format="png")
    with whole_file(path) as part:  # 256 colours take a third of the room
        Image.open(drawn).convert("RGB").quantize(256).save(part, format="PNG", optimize=True)


def _show(axis, picture, title, caption):
    axis.imshow(picture)
    axis.set_title(title, fontsize=TEXT)
    axis.set_xlabel(caption, fontsize=TEXT)
    axis.set_xticks([])
    axis.set_yticks([])
