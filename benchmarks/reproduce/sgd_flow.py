"""How TeX-SGD decides what a pixel is (the paper's Fig. 3).

The preset `forest`; the library is that of the scene's own materials and the sky, as in the
paper; k = 2 environment objects. In every pixel Eq. 6 is solved exactly for each material
(`physics.exact.local`): T and V on the simplex that leave the least residual

    delta_m = |S~ - S| / sigma / sqrt(bands),    S~ = e_m B(T) + (1 - e_m) (V_1 S_1 + V_2 S_2)

that is, the root mean square over the bands in noise units: 1 is noise alone. As in the paper, the
sky is a material like the others here, with its own T and V and the curve of the zenith. The answer
is the material with the least residual. The package's other steps are left out: evidence instead of
residual, a sky with its own mean spectrum, allowance for surroundings that deviate from the k
objects, and neighbours. (The solver's weak priors on T and V stay; at most they add a nat or two to
a cost of residual^2 bands / 2.)

sgd-flow.csv, one row per marked pixel and material: pixel, truth, row, column, material,
residual (noise units), temperature_k, and V of both objects (the sky's is v_sky).
"""

import numpy as np
from matplotlib.figure import Figure
from scipy.ndimage import distance_transform_edt

from benchmarks.colours import BLACK, BLUE, GREEN, ORANGE, PURPLE, SKY_BLUE, VERMILLION
from benchmarks.rows import write_csv
from physics.environment import Environment
from physics.eq1 import render
from physics.estimate import estimate_environment
from physics.exact.local import solve_given, solve_local
from physics.exact.reduced import reduce_model
from physics.library import SKY, MaterialLibrary
from texnet.baselines import panchromatic
from texnet.metrics import non_sky

from . import common

K = 2
MARKED = {  # material: letter, colour, marker
    "sky": ("Sky", SKY_BLUE, "o"),
    "bark": ("B", VERMILLION, "s"),
    "foliage": ("F", GREEN, "^"),
    "granite": ("R", BLACK, "D"),
    "water": ("W", BLUE, "v"),
}
OTHERS = {"grass": (ORANGE, "P"), "soil": (PURPLE, "X")}


def reproduce(out, full, progress):
    """sgd-flow.csv and sgd-flow.png in the folder out."""
    cube, truth = common.night("forest", full, progress)
    library = common.scene_library(truth)
    pixels = {name: inmost(truth, name) for name in MARKED}
    rows = residuals(cube, library, pixels)
    write_csv(out / "sgd-flow.csv", rows)
    _draw(cube, truth, library, pixels, rows, out / "sgd-flow.png")
    best = {name: _best(rows, name) for name in MARKED}
    lines = [
        f"{name:8} taken for {r['material']}, residual {r['residual']:.1f} noise units"
        for name, r in best.items()
    ]
    return "\n".join(lines), {"rows": rows}


def inmost(truth, name):
    """(row, column) of the pixel of a material that is farthest from any other material."""
    inside = np.pad(truth.material == truth.material_names.index(name), 1)
    return tuple(int(i) - 1 for i in np.unravel_index(
        distance_transform_edt(inside).argmax(), inside.shape
    ))  # fmt: skip


def residuals(cube, library, pixels):
    """Rows, see the module, of pixels {truth: (row, column)}."""
    seen = estimate_environment(cube, library, K)
    # only the k spectra, so that the solver's cost is the residual's square
    environment = Environment(seen.radiance, seen.wavelength_um)
    everything = MaterialLibrary(
        [f"{SKY}, a material" if n == SKY else n for n in library.names],
        library.wavelength_um, library.emissivity,
    )  # fmt: skip
    model = reduce_model(cube, everything, environment)
    spectra = np.stack([cube.radiance[:, r, c] for r, c in pixels.values()]).astype(float)
    local = solve_local(model, spectra)
    rows, none = [], np.zeros(1)
    for p, (name, (r, c)) in enumerate(pixels.items()):
        for m, material in enumerate(library.names):
            of = np.array([m])
            _, t, v, _ = solve_given(
                model, spectra[p : p + 1], of, local.temperature_k[p, of].astype(float), none, none
            )
            s, _ = render(t, model.emissivity[of], v, environment.radiance, cube.wavelength_um)
            delta = ((s[0] - spectra[p]) / model.sigma).astype(float)
            v_sky = v[0, list(seen.sky)].sum()
            rows.append({
                "pixel": name, "row": r, "column": c, "material": material,
                "residual": float(np.sqrt(np.mean(delta**2))), "temperature_k": float(t[0]),
                "v_sky": float(v_sky), "v_ground": float(v[0].sum() - v_sky),
            })  # fmt: skip
    return rows


def _best(rows, pixel):
    return min((r for r in rows if r["pixel"] == pixel), key=lambda r: r["residual"])


# --- drawing -----------------------------------------------------------------------------


def _draw(cube, truth, library, pixels, rows, path):
    size = common.WIDTH_INCHES, 7.6
    fig = Figure(figsize=size, dpi=common.dpi(cube.shape), layout="constrained")
    axes = fig.subplots(2, 2)
    _draw_cube(axes[0, 0], panchromatic(cube), non_sky(truth), pixels)
    _draw_spectra(axes[0, 1], cube, pixels)
    _draw_library(axes[1, 0], library)
    _draw_residuals(axes[1, 1], [r for r in rows if r["pixel"] == SKY])
    for ax in axes.flat[1:]:
        ax.title.set_fontsize(common.TEXT)
    common.save(fig, path)


def _draw_cube(ax, picture, ground, pixels):
    norm = common.between(picture[ground])
    common.show(ax, picture, "(a) heat cube, all bands, with marked pixels", norm=norm)
    for name, (r, c) in pixels.items():
        letter, _, _ = MARKED[name]
        ax.plot(c, r, "x", color="white", ms=9, mew=4)
        ax.plot(c, r, "x", color=VERMILLION, ms=8, mew=2)
        ax.annotate(
            letter, (c, r), xytext=(6, 3), textcoords="offset points", fontsize=11, weight="bold",
            color="white", bbox=dict(boxstyle="round,pad=0.15", color="black", alpha=0.6),
        )  # fmt: skip


def _draw_spectra(ax, cube, pixels):
    for name, (r, c) in pixels.items():
        letter, colour, marker = MARKED[name]
        ax.plot(
            cube.wavelength_um, cube.radiance[:, r, c], color=colour, marker=marker, ms=4,
            markevery=6, label=name if name == SKY else f"{name} ({letter})",
        )  # fmt: skip
    ax.set(title="(b) spectra of the marked pixels", xlabel="wavelength (µm)",
           ylabel="radiance (W/m²/sr/µm)")  # fmt: skip
    ax.legend(fontsize=common.TEXT - 1)


def _draw_library(ax, library):
    styles = {n: (colour, marker) for n, (_, colour, marker) in MARKED.items()} | OTHERS
    for name, e in zip(library.names, library.emissivity, strict=True):
        colour, marker = styles[name]
        ax.plot(library.wavelength_um, e, color=colour, marker=marker, ms=4, markevery=0.09,
                label=name)  # fmt: skip
    ax.set(title="(c) material library", xlabel="wavelength (µm)", ylabel="emissivity",
           xlim=(8, 14), ylim=(0, 1.02))  # fmt: skip
    ax.legend(fontsize=common.TEXT - 1, loc="center", bbox_to_anchor=(0.5, 0.42))


def _draw_residuals(ax, rows):
    delta, least = [r["residual"] for r in rows], min(r["residual"] for r in rows)
    colours = [VERMILLION if d == least else BLUE for d in delta]
    bars = ax.bar([r["material"] for r in rows], delta, color=colours)
    ax.bar_label(bars, [f"{d:.0f}\nleast" if d == least else f"{d:.0f}" for d in delta],
                 fontsize=common.TEXT - 1)  # fmt: skip
    ax.margins(y=0.15)
    ax.tick_params(axis="x", labelsize=common.TEXT - 1, rotation=20)
    ax.set(title="(d) the pixel 'Sky', fitted with every material",
           ylabel="residual (noise units, RMS)")  # fmt: skip
