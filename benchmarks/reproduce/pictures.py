"""TeX vision of several answers to one scene beside its truth, with the errors below each."""

import numpy as np

from texnet.figures import daylight_srgb
from texnet.vision import tex_vision

from .common import name_materials, panels, save, show, true_vision


def said(row):
    """Two phrases: the errors of T and m, and those of X and of its sky-lit part."""
    t, x = row["temperature_mse_k2"] ** 0.5, row["texture_mse_per_band"]
    if np.isnan(row["material_accuracy"]):  # a bound
        return f"T off by {t:.2f} K", f"X: MSE {x:.3g}"
    return (
        f"T off by {t:.2f} K, {100 * row['material_accuracy']:.1f} % right",
        f"X: MSE {x:.3g}, r {row['texture_correlation']:.2f}",
    )


def draw(pictures, truth, path):
    """A png with a row for each method, a column for each variant, and the truth before them.

    pictures  {(method, variant): (Decomposition, row of errors)}, of two methods
    """
    methods, variants = (list(dict.fromkeys(key[i] for key in pictures)) for i in (0, 1))
    fig, axes = panels(len(methods), 1 + len(variants), truth.material.shape, more_inches=0.35)
    show(axes[0, 0], true_vision(truth), "truth")
    show(axes[1, 0], daylight_srgb(truth), "the same by day")
    for line, method in zip(axes, methods, strict=True):
        for ax, variant in zip(line[1:], variants, strict=True):
            answer, row = pictures[method, variant]
            show(ax, tex_vision(answer), f"{variant}\n{method}", "\n".join(said(row)))
    name_materials(fig, truth)
    save(fig, path)
