"""Accuracy against time: texnet's methods beside what a user would take instead.

    texnet bench chart --out DIR [--network FILE.safetensors ...]

Five test scenes, 128 x 160 pixels, path-traced once and shaded in 4, 18 and 54 bands over 8-14 um,
noise 50 mK, the starter library of 30 materials. All in one run, in turn, on two threads, each
method once before it is timed:

    local, sgd, net, net+sgd      texnet: all of `decompose` except files and pictures, with the
                                  environment estimated from the cube, k = 5; net+sgd by ONNX
                                  Runtime, as users get it, all other networks in torch
    net+sgd, 2 (5, 10) steps      more refinement than the one step that ships
    NAME                          net+sgd with the network of NAME.safetensors, if given
    brightness temperature, NEM, ISSTES   temperature-emissivity separation (benchmarks.peers),
                                  then the library's nearest curve, then X
    scipy                         Eq. 6 per pixel and material by bounded least squares, in one
                                  thread, on 50 random pixels, for which time and errors hold. So
                                  few miss most of what is rare and wrong: it is excluded from the
                                  Pareto front, and what it minimises is `local`'s objective

The separations have an advantage: they are given the true downwelling radiance of the scene's sky
(in a room the mean of the true X) and, like scipy, which pixels are sky. Their picture of the
sky-lit texture is their X or its negative, whichever matches better.

Writes chart.csv, a row per scene, bands and method; chart.png, medians over the scenes with
quartiles and the Pareto front. A stopped run resumes after the last complete scene measured with
the same settings.
"""

import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import NullLocator

from benchmarks import ONNX
from benchmarks.accuracy import NETD_K, K, test_scenes
from benchmarks.colours import BLACK, BLUE, GREEN, ORANGE, SKY_BLUE, VERMILLION
from benchmarks.peers import brightness, isstes, nem
from benchmarks.peers.band_planck import BandPlanck
from benchmarks.peers.naming import light, nearest
from benchmarks.peers.scipy_fit import fit_all
from benchmarks.peers.surroundings import surroundings
from benchmarks.rows import read_csv, settings, whole_scenes, write_csv
from benchmarks.threads import THREADS, on_two_threads
from physics.bands import equidistant_bands, quadrature
from physics.errors import InputError
from physics.estimate import estimate_environment
from physics.exact.reduced import reduce_model
from physics.library import MaterialLibrary
from physics.machinery.whole_file import whole_file
from texnet.budget import ERRORS
from texnet.files.weights import load_network
from texnet.learned import torch_model
from texnet.metrics import correlation, evaluate, non_sky
from texnet.pipeline import decompose
from texnet.runtime import Runtime

BANDS = (4, 18, 54)
SCENES = 5
# of refinement, besides the one that ships
STEPS = {f"net+sgd, {n} steps": n for n in (2, 5, 10)}
SCIPY_PIXELS = 50
SEPARATIONS = {"brightness temperature": brightness, "NEM": nem, "ISSTES": isstes}
TITLES = {
    "temperature_rmse_k": "T off by (RMS, K)",
    "material_accuracy": "right material",
    "texture_correlation": "sky-lit texture, correlation",
}
SHOWN = ("seconds_per_megapixel", *ERRORS)


# --- the methods: each takes a Scene and returns what `evaluate` takes, and its Truth ------


class Scene:
    """A shaded scene with what methods are given: the cube, its truth, library and sky."""

    def __init__(self, traced, bands):
        self.library = MaterialLibrary.starter()
        w, fwhm = equidistant_bands(bands)
        self.cube, self.truth = traced.shade(self.library, w, fwhm, NETD_K)
        self.law = BandPlanck(w, fwhm)
        self.curves = self.library.of_bands(quadrature(w, fwhm))
        self.sky = surroundings(traced, self.truth, w, fwhm)


def by_texnet(method, model=None):
    """A method of `decompose`."""
    return lambda scene: (
        decompose(scene.cube, scene.library, method=method, k=K, model=model), scene.truth
    )  # fmt: skip


def by_separation(method):
    """A temperature-emissivity separation, and the steps after it."""

    def run(scene):
        spectra, truth = scene.cube.spectra.astype(float), scene.truth
        t, e = method.separate(spectra, scene.law, scene.sky)
        solid = np.flatnonzero(~scene.library.is_sky)
        named = solid[nearest(e, scene.curves[solid])]
        x, mean = light(spectra, t, scene.curves[named], scene.law)
        ground = non_sky(truth)
        if correlation(mean.reshape(ground.shape), truth.sky_texture, ground) < 0:
            mean = -mean
        return _answer(scene, truth, t, named, x.T, mean), truth

    return run


def by_scipy(scene):
    """Eq. 6 on SCIPY_PIXELS of the scene, as one-row pictures."""
    model = reduce_model(
        scene.cube, scene.library, estimate_environment(scene.cube, scene.library, K)
    )
    pixels = scene.truth.material.size
    some = np.random.default_rng(0).choice(pixels, min(pixels, SCIPY_PIXELS), replace=False)
    truth = replace(
        scene.truth,
        **{
            name: array.reshape(*array.shape[:-2], 1, -1)[..., some]
            for name, array in vars(scene.truth).items()
            if name not in ("material_names", "wavelength_um", "visible")
        },
    )
    spectra = scene.cube.spectra[some].astype(float)
    fits = [fit_all(model, s, scene.cube.fwhm_um) for s in spectra]
    material, t, v = (np.array(part) for part in zip(*fits, strict=True))
    sky = list(model.environment.sky)
    of_sky = v[:, sky] @ model.environment.radiance[sky].mean(axis=1)
    return _answer(scene, truth, t, material, (v @ model.environment.radiance).T, of_sky), truth


def _answer(scene, truth, temperature_k, material, x, picture):
    """What `evaluate` takes, from flat maps; sky pixels are given."""
    maps = lambda a: a.reshape(*a.shape[:-1], *truth.material.shape)
    material = np.where(non_sky(truth), maps(material), scene.library.sky_index)
    return SimpleNamespace(
        temperature_k=maps(temperature_k), material=material, material_names=scene.library.names,
        wavelength_um=truth.wavelength_um, texture=maps(x), sky_texture=maps(picture),
        dead=np.zeros(material.shape, bool),
        # not provided by these methods
        temperature_sigma_k=np.zeros(material.shape), unknown=np.zeros(material.shape, bool),
        material_probability=np.ones((len(scene.library), *material.shape)),
    )  # fmt: skip


def all_methods(networks):
    """{name: method}; networks are paths."""
    methods = {name: by_separation(module) for name, module in SEPARATIONS.items()}
    methods |= {"scipy": by_scipy, "local": by_texnet("local"), "sgd": by_texnet("sgd")}
    methods["net"] = by_texnet("net", torch_model())
    methods["net+sgd"] = by_texnet("net+sgd", Runtime(ONNX, THREADS).run)
    for name, steps in STEPS.items():
        methods[name] = by_texnet("net+sgd", torch_model(steps=steps))
    for path in networks:
        if path.stem in methods:
            raise InputError(f"chart: two methods are called {path.stem}; rename {path}.")
        methods[path.stem] = by_texnet("net+sgd", torch_model(network=load_network(path)[0]))
    return methods


# --- measuring ----------------------------------------------------------------------------


def measure(out, networks=(), progress=None):
    """Measure what is not yet in chart.csv, write everything -> {"rows", "medians", "pareto"}.

    networks  paths of further .safetensors to chart
    progress  called as progress(done, total, what)

    Raises InputError if a network cannot be read.
    """
    methods, made = all_methods(networks), settings(*networks)
    out.mkdir(parents=True, exist_ok=True)
    on_two_threads()
    wanted = {(b, m) for b in BANDS for m in methods}
    rows = whole_scenes(read_csv(out / "chart.csv", made), wanted)
    done = list(dict.fromkeys(r["scene"] for r in rows))
    total, count = SCENES * len(wanted), len(rows)
    for name, traced in test_scenes(SCENES, done):
        of_scene = []
        for bands in BANDS:
            scene = Scene(traced, bands)
            for method, run in methods.items():
                if progress:
                    progress(count + len(of_scene), total, "chart")
                row = {"scene": name, "bands": bands, "method": method}
                of_scene.append(row | _scores(run, scene))
        rows += of_scene
        count += len(of_scene)
        write_csv(out / "chart.csv", rows, made)
    summary = medians(rows)
    front = {b: {m: pareto_methods(summary, b, m) for m in ERRORS} for b in BANDS}
    _draw(summary, front, out / "chart.png")
    return {"rows": rows, "medians": summary, "pareto": front}


def _scores(run, scene):
    """Seconds per megapixel of a second run, and the errors."""
    run(scene)
    start = time.perf_counter()
    answer, truth = run(scene)
    seconds = time.perf_counter() - start
    errors = evaluate(answer, truth)
    per = seconds / truth.material.size * 1e6
    return {"seconds_per_megapixel": per} | {name: errors[name] for name in ERRORS}


def medians(rows):
    """A row per bands and method: for each of SHOWN its median over the scenes, and as NAME_low and
    NAME_high its quartiles; scenes where it is undefined are left out."""
    summary = []
    for key in dict.fromkeys((r["bands"], r["method"]) for r in rows):
        row = dict(zip(("bands", "method"), key, strict=True))
        for name in SHOWN:
            of = np.array([r[name] for r in rows if (r["bands"], r["method"]) == key])
            low, row[name], high = (float(q) for q in np.nanpercentile(of, [25, 50, 75]))
            row |= {f"{name}_low": low, f"{name}_high": high}
        summary.append(row)
    return summary


def pareto(cost, score):
    """Indices, cheapest first, of the points that no other dominates, that is, costs at most as
    much and scores more, or less and as much."""
    front = []
    for i in sorted(range(len(cost)), key=lambda i: (cost[i], -score[i])):
        if not front or score[i] > score[front[-1]]:
            front.append(i)
    return front


def pareto_methods(summary, bands, metric):
    """Names of the methods on the front of time and a metric, fastest first."""
    of = [r for r in summary if r["bands"] == bands and r["method"] != "scipy"]
    sign = 1 if ERRORS[metric] else -1
    front = pareto([r["seconds_per_megapixel"] for r in of], [sign * r[metric] for r in of])
    return [of[i]["method"] for i in front]


# --- drawing ------------------------------------------------------------------------------

GREY = "#999999"
# markers as a second cue
STYLE = {
    "brightness temperature": (GREY, "v"), "NEM": (GREY, "^"), "ISSTES": (GREY, "s"),
    "scipy": (BLACK, "X"), "local": (BLUE, "o"), "sgd": (SKY_BLUE, "D"), "net": (ORANGE, "o"),
    "net+sgd": (VERMILLION, "*"),
}  # fmt: skip
OTHERS = GREEN, "Pph<>"
TICKS = {
    "temperature_rmse_k": (0.2, 0.5, 1, 2, 5, 10),
    "material_accuracy": (0, 0.5, 0.8, 0.9, 0.95, 0.98, 0.99),
    "texture_correlation": (0, 0.5, 0.8, 0.9, 0.95, 0.98, 0.99),
}


def _draw(summary, front, path):
    """A row of panels per number of bands; up is better, and the scale is that of the losses."""
    figure = Figure(figsize=(9, 9.4), layout="constrained", dpi=110)
    grid = figure.subplots(len(BANDS), len(ERRORS), sharex=True, sharey="col", squeeze=False)
    style = _styles(list(dict.fromkeys(r["method"] for r in summary)))
    within = [r["seconds_per_megapixel_high"] for r in summary if r["method"] != "scipy"]
    edge = 20 * max(within)
    for axes, bands in zip(grid, BANDS, strict=True):
        of = {r["method"]: r for r in summary if r["bands"] == bands}
        for axis, metric in zip(axes, ERRORS, strict=True):
            for method in style:
                if method in of and np.isfinite(of[method][metric]):
                    _point(axis, of[method], metric, method, *style[method], edge)
            more = [of[m] for m in ("net+sgd", *STEPS) if m in of]
            x, errors = ([r[n] for r in more] for n in ("seconds_per_megapixel", metric))
            colour = STYLE["net+sgd"][0]
            axis.plot(
                x, _lost(metric, errors), ".-", color=colour, ms=5, lw=1,
                label=f"net+sgd, {', '.join(map(str, STEPS.values()))} steps",
            )  # fmt: skip
            best = [of[m] for m in front[bands][metric]]
            x, errors = ([r[n] for r in best] for n in ("seconds_per_megapixel", metric))
            axis.plot(x, _lost(metric, errors), ":", color="0.4", label="Pareto front", zorder=1)
        axes[0].set_ylabel(f"{bands} bands", fontsize=13)
    for axis, (metric, title) in zip(grid[0], TITLES.items(), strict=True):
        axis.set_title(title, fontsize=12)
        axis.set(xscale="log", yscale="log")
        axis.yaxis.set_inverted(True)
        text = [f"{t:.0%}" if metric == "material_accuracy" else f"{t:g}" for t in TICKS[metric]]
        axis.set_yticks(_lost(metric, TICKS[metric]), text)
        axis.yaxis.set_minor_locator(NullLocator())
    for axis in grid.flat:
        axis.grid(color="0.92")
    grid[-1, 1].set_xlabel("seconds per megapixel, two threads", fontsize=12)
    figure.suptitle(f"Medians and quartiles of {SCENES} scenes; up and to the left is better")
    handles, names = grid[0, 0].get_legend_handles_labels()
    only = f"scipy, on {SCIPY_PIXELS} pixels:\nits time is to be compared"
    names = [only if n == "scipy" else n for n in names]
    figure.legend(handles, names, loc="outside lower center", ncols=3, fontsize=11)
    with whole_file(path) as part:
        figure.savefig(part)


def _lost(metric, values):
    """Errors unchanged; for scores, what is missing to 1."""
    return 1 - np.asarray(values) if ERRORS[metric] else np.asarray(values)


def _styles(methods):
    """{method: (colour, marker)}, except for more steps, which form a line."""
    others = [m for m in methods if m not in STYLE and m not in STEPS]
    colour, markers = OTHERS
    return STYLE | {m: (colour, markers[i % 5]) for i, m in enumerate(others)}


def _point(axis, r, metric, method, colour, marker, edge):
    """A median with its quartiles; beyond the right edge it is drawn there with its time."""
    time_s, of_time = r["seconds_per_megapixel"], _quartiles(r, "seconds_per_megapixel")
    at, bar = _lost(metric, r[metric]), _quartiles(r, metric)
    if time_s > edge:
        text = f"{float(f'{time_s:.1g}'):,.0f} s \u2192"
        axis.annotate(text, (edge, at), xytext=(5, -13), textcoords="offset points", ha="right",
                      fontsize=8)  # fmt: skip
        time_s, of_time = edge, None
    axis.errorbar(
        time_s, at, bar, of_time, ls="none", marker=marker, color=colour, ms=8, elinewidth=0.8,
        label=method, zorder=2,
    )  # fmt: skip


def _quartiles(r, name):
    """(2, 1) distances of the quartiles from the median, the smaller coordinate first."""
    below, above = r[name] - r[f"{name}_low"], r[f"{name}_high"] - r[name]
    turned = name in ERRORS and ERRORS[name]
    return np.array([[above], [below]] if turned else [[below], [above]])


def table(summary):
    """Lines of text: a row per bands and method, medians."""
    yield f"{'bands':>5} {'method':24}" + "".join(f"{n[:20]:>22}" for n in SHOWN)
    for r in summary:
        yield f"{r['bands']:5d} {r['method']:24}" + "".join(f"{r[n]:22.3f}" for n in SHOWN)
