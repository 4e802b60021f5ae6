"""Geometry or temperature? A scene where both vary (the paper's Fig. 6, and Eq. 7).

The preset `patterned`: every object has relief, and a pattern of temperature independent of it.
temperature.png shows the pictures made from its cube, each with how much of the true sky-lit
texture it shows (`texnet.metrics.texture_scores`, non-sky pixels): Pearson correlation and SSIM.
The sign of a thermal picture, of CLAHE and of a principal component is arbitrary, so here each has
the sign that correlates positively; of the three components the best-correlated counts. TeX vision
(`net+sgd`, k = 5) is scored by its brightness, including its sign, the daylight picture by its
luminance.

temperature-contributions.png shows why: Eq. 7 splits the contrast between neighbouring pixels,

    dS = dT e B'(T) + de (B(T) - X) + dX (1 - e)

Each term is integrated over the bands (W m-2 sr-1), as a gradient over two pixels down and across,
and its magnitude is shown. S is that of Eq. 1 with the true T, e and X; the fourth map is what
remains of its gradient without those three terms, the second and higher orders. Pixels with a sky
neighbour are blank. The maps include the noise of the paths; the root mean squares do not, as each
square is the product of two exposures with independent paths.

temperature.csv: picture, correlation, ssim. temperature-contributions.csv: term, and its root mean
square in W m-2 sr-1 over all those pixels and over those whose four neighbours are of the same
material.
"""

import numpy as np
from matplotlib.colors import LogNorm
from scipy.ndimage import binary_erosion, generate_binary_structure, maximum_filter, minimum_filter

from benchmarks.rows import write_csv
from physics.contrast import contrast_terms
from physics.planck import planck
from texnet.baselines import clahe, panchromatic, principal_components
from texnet.figures import daylight_srgb
from texnet.metrics import non_sky, texture_scores
from texnet.pipeline import decompose
from texnet.vision import tex_vision

from . import common
from .ghosting import LUMINANCE

K, DECADES = 5, 3  # decades of contrast shown
CROSS = generate_binary_structure(2, 1)  # a pixel and its four neighbours


def reproduce(out, full, progress):
    """temperature.csv and .png, temperature-contributions.csv and .png in the folder out."""
    cube, truth = common.night("patterned", full, progress)
    answer = decompose(cube, method="net+sgd", k=K, progress=progress)
    _, again = common.night("patterned", full, progress, exposure=1)
    terms, repeated = (contributions(t, cube.fwhm_um) for t in (truth, again))
    seen = binary_erosion(non_sky(truth) & non_sky(again), CROSS, border_value=1)
    contrast = measure_contrast(terms, repeated, truth.material, seen)
    scored = pictures(cube, truth, answer)
    scores = [{"picture": name, **score(picture, truth)} for name, picture in scored.items()]
    write_csv(out / "temperature.csv", scores)
    write_csv(out / "temperature-contributions.csv", contrast)
    _draw(scores, scored, truth, answer, out / "temperature.png")
    _draw_contrast(contrast, terms, seen, out / "temperature-contributions.png")
    lines = [
        f"{s['picture']:20} texture correlation {s['correlation']:.2f}, SSIM {s['ssim']:.2f}"
        for s in scores
    ]
    lines += [f"{c['term']:20} contrast {c['rms']:.3f} W/m2/sr (RMS)" for c in contrast]
    return "\n".join(lines), {"pictures": scores, "contributions": contrast}


# --- the pictures, and how much texture they show ----------------------------------------


def pictures(cube, truth, answer):
    """{name: (height, width) picture} to be scored, with the sign of the texture."""
    raw = panchromatic(cube)
    components = [_signed(c, truth) for c in principal_components(cube)]
    best = max(components, key=lambda c: texture_scores(c, truth)["correlation"])
    return {
        "daylight": truth.visible @ LUMINANCE,
        "thermal": _signed(raw, truth),
        "clahe": _signed(clahe(raw), truth),
        "principal components": best,
        "tex vision": answer.sky_texture,
    }


def score(picture, truth):
    """The two scores shown for a picture."""
    scores = texture_scores(picture, truth)
    return {name: scores[name] for name in ("correlation", "ssim")}


def _signed(picture, truth):
    return picture if texture_scores(picture, truth)["correlation"] >= 0 else -picture


# --- Eq. 7 -------------------------------------------------------------------------------


def contributions(truth, fwhm_um):
    """{term: (2, height, width)} over the bands, W m-2 sr-1 per pixel, down and across.

    "temperature", "material", "texture" of Eq. 7, and "higher orders": the remainder.
    """
    names = ("temperature", "material", "texture", "higher orders")
    total = {name: np.zeros((2, *truth.material.shape)) for name in names}
    t = truth.temperature_k.astype(float)
    for band, width in enumerate(fwhm_um):  # all bands at once fill the memory at full size
        w = truth.wavelength_um[band : band + 1]
        e, x = (a[band : band + 1].astype(float) for a in (truth.emissivity, truth.texture))
        terms = contrast_terms(t, e, x, w)
        ds = np.stack(np.gradient((e * planck(w[:, None, None], t) + (1 - e) * x)[0]))
        total["higher orders"] += width * ds
        for name, term in terms.items():
            total[name] += width * term[:, 0]
            total["higher orders"] -= width * term[:, 0]
    return total


def measure_contrast(terms, repeated, material, seen):
    """Rows of RMS contrast from terms and their repetition with other paths.

    Over the pixels seen, and over those of them within one material (height, width).
    """
    one = maximum_filter(material, footprint=CROSS) == minimum_filter(material, footprint=CROSS)

    def rms(name, mask):
        square = (terms[name] * repeated[name])[:, mask].sum(axis=0).mean()
        return float(np.sqrt(max(square, 0)))

    return [
        {"term": n, "rms": rms(n, seen), "rms_within_one_material": rms(n, seen & one)}
        for n in terms
    ]


# --- drawing -----------------------------------------------------------------------------


def _draw(scores, scored, truth, answer, path):
    captions = [f"correlation {s['correlation']:.2f}, SSIM {s['ssim']:.2f}" for s in scores]
    caption, ground = dict(zip(scored, captions, strict=True)), non_sky(truth)
    t = np.where(ground, truth.temperature_k, np.nan)
    span = common.between(t)
    fig, axes = common.panels(2, 4, ground.shape, more_inches=0.1)
    common.show(axes[0, 0], t, "temperature (truth)", f"{span.vmin:.0f} K to {span.vmax:.0f} K",
                "inferno", span)  # fmt: skip
    common.show(axes[0, 1], daylight_srgb(truth), "by day (truth)", caption["daylight"])
    for ax, name, title in (
        (axes[0, 2], "thermal", "raw thermal, 8-14 µm"),
        (axes[0, 3], "clahe", "CLAHE of all bands"),
        (axes[1, 0], "principal components", "best principal component"),
    ):
        norm = common.between(scored[name][ground])
        common.show(ax, scored[name], title, caption[name], norm=norm)
    common.show(axes[1, 1], tex_vision(answer), "TeX vision", caption["tex vision"])
    common.show(axes[1, 2], common.true_vision(truth), "TeX vision (truth)")
    texture = np.where(ground, truth.sky_texture, np.nan)
    common.show(axes[1, 3], texture, "sky-lit texture (truth)", "what all are scored against")
    common.name_materials(fig, truth)
    common.save(fig, path)


def _draw_contrast(rows, terms, seen, path):
    titles = {
        "temperature": "temperature: dT e B'", "material": "material: de (B - X)",
        "texture": "texture: dX (1 - e)", "higher orders": "higher orders: dS - the three",
    }  # fmt: skip
    magnitude = {n: np.where(seen, np.hypot(*d), np.nan) for n, d in terms.items()}
    top = np.nanpercentile(np.stack(list(magnitude.values())), 99.5)
    norm = LogNorm(top / 10**DECADES, top, clip=True)
    fig, axes = common.panels(2, 2, seen.shape, more_inches=0.2)
    for ax, row in zip(axes.flat, rows, strict=True):
        caption = f"RMS {row['rms']:.3f}, within one material {row['rms_within_one_material']:.3f}"
        common.show(
            ax, magnitude[row["term"]], titles[row["term"]], caption, "cividis", norm,
            unit="W/m²/sr per pixel",
        )  # fmt: skip
    common.save(fig, path)
