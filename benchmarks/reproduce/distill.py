"""Texture distillation in pictures (the paper's Fig. 4): estimated above, true below.

The preset `forest`, decomposed by TeX-SGD (`sgd`) with the whole starter library and k = 5
environment objects, three of which are sky. From left to right, for pixels that are sky neither in
truth nor in the answer:

    X~      the light that the k objects send, sum of V_j S_j, mean over bands
    ground  the part of it from objects on the ground, which is removed: by day they emit no light
    sky     the part of it from the sky's objects
    delta   the residual |S~ - S|, root mean square over bands in noise units
    fused   the sky's part plus what the residual says of the sky's light (`physics.exact.distill`)

Truth: X and its sky-lit part from the traced paths, and the ground's as their difference. Its delta
is what the k objects cannot explain even with the true T and e: V is then the least-squares fit of
the true X on the simplex.

distill.csv, one row per picture: correlation (Pearson) of estimate and truth, for delta of their
logarithms (leaves against the sky are mixed pixels, with residuals hundreds of times those of
others), and the medians of both.
"""

import numpy as np
from matplotlib.colors import LogNorm

from benchmarks.rows import write_csv
from physics.eq1 import render
from physics.exact.reduced import PIXELS_PER_GROUP
from physics.library import MaterialLibrary
from physics.planck import noise_sigma
from texnet.metrics import correlation, non_sky
from texnet.pipeline import decompose

from . import common
from .errors import best_lighting

K = 5
RADIANCE, NOISE = "W/m²/sr/µm", "noise units"


def reproduce(out, full, progress):
    """distill.csv and distill.png in the folder out."""
    cube, truth = common.night("forest", full, progress)
    answer = decompose(cube, method="sgd", k=K, progress=progress)
    pictures = steps(cube, truth, answer, MaterialLibrary.starter())
    ground = non_sky(truth) & non_sky(answer)
    rows = [measure(name, *pair, ground) for name, pair in pictures.items()]
    write_csv(out / "distill.csv", rows)
    _draw(rows, pictures, ground, out / "distill.png")
    lines = [f"{r['picture']:6} correlates with its truth at {r['correlation']:.2f}" for r in rows]
    return "\n".join(lines), {"rows": rows}


def steps(cube, truth, answer, library):
    """{name: (estimated, true)} pictures (height, width), see the module."""
    sky = list(answer.sky)
    own = [j for j in range(len(answer.environment)) if j not in sky]
    strength = answer.environment.mean(axis=1)
    of = lambda objects: np.tensordot(strength[objects], answer.thermal_lighting[objects], axes=1)
    x = truth.texture.mean(axis=0)
    return {
        "X~": (of(sky) + of(own), x),
        "ground": (of(own), x - truth.sky_texture),
        "sky": (of(sky), truth.sky_texture),
        "delta": tuple(d.reshape(cube.shape) for d in _residuals(cube, truth, answer)),
        "fused": (answer.sky_texture, truth.sky_texture),
    }


def _residuals(cube, truth, answer):
    """(2, pixels) delta of the answer, and of the truth with V fitted to its X."""
    sigma = noise_sigma(cube.wavelength_um, answer.netd_k)
    curves = answer.emissivity
    by_pixel = lambda a: a.reshape(*a.shape[: a.ndim - 2], -1).T
    t, v = by_pixel(answer.temperature_k), by_pixel(answer.thermal_lighting)
    true_t, true_e, true_x = map(by_pixel, (truth.temperature_k, truth.emissivity, truth.texture))
    delta = np.empty((2, len(t)))
    for start in range(0, len(t), PIXELS_PER_GROUP):
        b = slice(start, start + PIXELS_PER_GROUP)
        fitted = best_lighting(true_x[b] / sigma, answer.environment / sigma)
        answers = (t[b], curves[answer.material.ravel()[b]], v[b]), (true_t[b], true_e[b], fitted)
        for d, tev in zip(delta, answers, strict=True):
            s, _ = render(*tev, answer.environment, cube.wavelength_um)
            d[b] = np.sqrt((((s - cube.spectra[b]) / sigma) ** 2).mean(axis=1))
    return delta


def measure(name, estimate, true, mask):
    """The row of a picture, over mask."""
    scale = np.log if name == "delta" else np.asarray
    return {
        "picture": name, "unit": NOISE if name == "delta" else RADIANCE,
        "correlation": correlation(scale(estimate), scale(true), mask),
        "estimated_median": float(np.median(estimate[mask])),
        "true_median": float(np.median(true[mask])),
    }  # fmt: skip


# --- drawing -----------------------------------------------------------------------------

TITLES = {
    "X~": "X from all objects", "ground": "from the ground", "sky": "from the sky",
    "delta": "residual δ", "fused": "fused texture",
}  # fmt: skip
LARGEST_DELTA = 100.0  # noise units; above only leaves against the sky


def _draw(rows, pictures, ground, path):
    fig, axes = common.panels(2, len(rows), ground.shape, more_inches=0.05)
    for column, row in zip(axes.T, rows, strict=True):
        pair = [np.where(ground, picture, np.nan) for picture in pictures[row["picture"]]]
        cmap, norm = "gray", common.between(*pair)
        if row["picture"] == "delta":
            cmap, norm = "cividis", LogNorm(1, LARGEST_DELTA)
        of = " of logarithms" if row["picture"] == "delta" else ""
        caption = f"correlation{of} {row['correlation']:.2f}"
        common.show(column[0], pair[0], TITLES[row["picture"]], caption, cmap, norm)
        title = "with true T, m and best V" if row["picture"] == "delta" else "truth"
        common.show(column[1], pair[1], title, "", cmap, norm, unit=row["unit"])
    common.save(fig, path)
