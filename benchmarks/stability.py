"""Where methods fail: errors of every method from easy to hopeless, and what sigma says of them.

    texnet bench stability --out DIR [--axes AXIS ...]

One difficulty at a time is raised on path-traced test scenes (`benchmarks.difficulties`); the
environment is estimated from each cube (k = 5, or the default if the sky may be out of view), the
library is the whole starter library. Methods with the same looks share what is found before pixels
are solved (`texnet.circumstances`). For each axis, level, scene and method stability.csv has a row:

    the errors of T (K), its median sigma and the shares of errors within one and two of them
    material accuracy, abstention, accuracy among the answered, correlation of the texture
    residual, median over pixels, noise units
    worse_than_brightness  share of pixels whose error of T exceeds that of a brightness
                           temperature (`peers.brightness`, given the true sky) by more than
                           two of their own sigmas
    amplification          change of T between two draws of the noise, in standard deviations
                           of the Cramer-Rao bound for that noise (median over pixels)
    failure                what was raised, or what is not finite; empty if nothing

A case common to several axes, such as the one without difficulty, is solved once and listed in
each.

missing.csv describes, for each random scene of `benchmarks.accuracy` and each of its commonest
materials, the answers if the library lacks that material:

    covered       share of its pixels that are unknown, or whose error of T is within two sigmas
    unknown       share of its pixels that are unknown
    false_alarms  share of all other pixels that are unknown though their material is right
    unknown_else  share of all other pixels that are unknown

atlas.png shows the axes; atlas.md has the figures, and lists the faults (`benchmarks.atlas`).
"""

from dataclasses import replace

import numpy as np

from benchmarks import ONNX
from benchmarks.accuracy import NETD_K, SCENES, test_scenes
from benchmarks.atlas import draw, faults, page
from benchmarks.difficulties import AXES, BANDS, Case, common
from benchmarks.peers import brightness
from benchmarks.peers.band_planck import BandPlanck
from benchmarks.peers.surroundings import surroundings
from benchmarks.rows import made_otherwise, read_csv, settings, write_csv
from physics.bands import equidistant_bands
from physics.environment import Environment
from physics.errors import InputError
from physics.estimate import estimate_environment
from physics.identifiability import cramer_rao
from physics.library import MaterialLibrary
from physics.planck import brightness_temperature, noise_sigma, planck_derivative
from texnet.circumstances import circumstances
from texnet.metrics import evaluate, non_sky
from texnet.pipeline import answered, method_of
from texnet.runtime import Runtime

COLUMNS = (
    "temperature_rmse_k", "temperature_mae_k", "brightness_mae_k", "sigma_k", "within_1_sigma",
    "within_2_sigma", "material_accuracy", "abstention", "accuracy_answered",
    "texture_correlation", "residual", "worse_than_brightness", "amplification",
)  # fmt: skip
# these share looks, those of the last one; so does net, in ONNX Runtime
ALIKE = ("local", "sgd"), ("net", "net+sgd")
COMMONEST, LEAST_SHARE = 3, 0.02  # materials left out in turn in each scene; their least share


def answers(case, methods, model):
    """{method: Decomposition} of a Case by methods with the same looks. A given environment is the
    spectra of its estimate, off by the case's error. model is that of net+sgd."""
    environment = None
    if case.wrong_k is not None:
        found = estimate_environment(case.cube, case.library, case.k)
        w, s = found.wavelength_um, found.radiance
        slope = planck_derivative(w, brightness_temperature(w, s))
        environment = Environment(s + case.wrong_k * slope, w, found.sky)
        environment = environment.off_by(case.stated_k) if case.stated_k else environment
    ways = {m: method_of(m, case.library, model if m == "net+sgd" else None) for m in methods}
    looks = ways[methods[-1]].looks
    of = circumstances(case.cube, case.library, looks, k=case.k, environment=environment)
    return {m: answered(of, case.library, way, case.said_k) for m, way in ways.items()}


def row_of(case, d, grey):
    """stability.csv's row for one answer; grey (n,) K is the ground's brightness temperature."""
    m = evaluate(d, case.truth)
    ground = non_sky(case.truth)
    t, sigma = case.truth.temperature_k[ground], d.temperature_sigma_k[ground]
    excess = np.abs(d.temperature_k[ground] - t) - np.abs(grey - t)
    maps = {name: np.asarray(getattr(d, name)) for name in (
        "temperature_k", "temperature_sigma_k", "thermal_lighting", "texture", "sky_texture",
        "residual", "material_probability",
    )}  # fmt: skip
    bad = [name for name, a in maps.items() if not np.isfinite(a).all()]
    return {
        "temperature_rmse_k": m["temperature_rmse_k"], "temperature_mae_k": m["temperature_mae_k"],
        "brightness_mae_k": float(np.abs(grey - t).mean()), "sigma_k": float(np.median(sigma)),
        "within_1_sigma": m["within_1_sigma"], "within_2_sigma": m["within_2_sigma"],
        "material_accuracy": m["material_accuracy"], "abstention": m["abstention"],
        "accuracy_answered": m["accuracy_answered"],
        "texture_correlation": m["texture_correlation"],
        "residual": float(np.median(d.residual)),
        "worse_than_brightness": float((excess > 2 * sigma).mean()),
        "failure": f"not finite: {', '.join(bad)}" if bad else "",
    }  # fmt: skip


def brightness_k(case, view):
    """(n,) K, brightness temperature of the ground of a Case of a View, given the true sky."""
    bands, traced = (case.cube.wavelength_um, case.cube.fwhm_um), view.traced
    if case.atmosphere is not None:
        traced = replace(traced, atmosphere=case.atmosphere)
    x = surroundings(traced, case.truth, *bands)
    ground = case.cube.radiance[:, non_sky(case.truth)].T.astype(float)
    return brightness.separate(ground, BandPlanck(*bands), x)[0]


def amplification(case, d, other):
    """Median over the ground of |T - T of another draw of noise|, divided by the bound for the
    sensor's noise."""
    ground = non_sky(case.truth)
    used = np.isin(case.cube.wavelength_um, d.wavelength_um)
    e = case.truth.emissivity[used][:, ground].T.astype(np.float64)
    t = case.truth.temperature_k[ground].astype(np.float64)
    w = d.wavelength_um - d.spectral_shift_um
    sigma = cramer_rao(w, noise_sigma(w, case.noise_k), e, d.environment, t)
    moved = np.abs(d.temperature_k - other.temperature_k)[ground]
    ratio = moved / (np.sqrt(2) * 0.6745 * sigma)
    return float(np.median(ratio[np.isfinite(sigma)])) if np.isfinite(sigma).any() else np.nan


def measured(axis, level, view, library, model, known):
    """Rows of one axis and level in one scene, for all methods; known {Case.fingerprint: its rows}
    is extended by them."""
    of = {"axis": axis, "level": float(level), "scene": f"{view.name} {view.seed}"}
    case = AXES[axis].case(view, library, level)
    if case.fingerprint not in known:
        again = AXES[axis].case(replace(view, draw=view.draw + 1), library, level)
        known[case.fingerprint] = list(_rows(case, again, view, model))
    return [of | row for row in known[case.fingerprint]]


def _rows(case, again, view, model):
    """Rows of a Case of a View, for all methods; again has another draw of its noise."""
    grey = brightness_k(case, view)
    for methods in ALIKE:
        try:
            of_both = [answers(c, methods, model) for c in (case, again)]
        except InputError as e:  # one sentence instead of an answer
            none = dict.fromkeys(COLUMNS, np.nan) | {"failure": str(e)}
            yield from ({"method": method} | none for method in methods)
            continue
        for method in methods:
            d, other = (by[method] for by in of_both)
            row = {"method": method} | row_of(case, d, grey)
            yield row | {"amplification": amplification(case, d, other)}


def missing_rows(scene, cube, truth, library, model):
    """Rows of missing.csv of one scene."""
    seen = np.array(truth.material_names)[truth.material]
    for name in common(truth)[:COMMONEST]:
        gone = seen == name
        if gone.mean() < LEAST_SHARE:
            continue
        case = Case(cube, truth, library.subset([m for m in library.names if m != name]))
        every = {}
        for methods in ALIKE:
            every |= answers(case, methods, model)
        for method, d in every.items():
            off = np.abs(d.temperature_k - truth.temperature_k)
            right = np.array(d.material_names)[d.material] == seen
            yield {
                "scene": scene, "missing": name, "method": method,
                "pixels": float(gone.mean()),
                "covered": float((d.unknown | (off <= 2 * d.temperature_sigma_k))[gone].mean()),
                "unknown": float(d.unknown[gone].mean()),
                "false_alarms": float((d.unknown & right)[~gone].mean()),
                "unknown_else": float(d.unknown[~gone].mean()),
            }  # fmt: skip


def measure(out, axes=None, progress=None):
    """Write stability.csv, missing.csv, atlas.png and atlas.md into the folder out -> the rows of
    the first two and sentences on faults.

    axes      names in AXES; None: all of them
    progress  called as progress(done, total, what) after each level; rows already in the tables
              from this code and machine are not measured again

    Raises InputError if an axis is unknown or the network cannot be read.
    """
    axes = AXES if axes is None else axes
    unknown = [name for name in axes if name not in AXES]
    if unknown:
        raise InputError(f"stability: no axis {unknown[0]!r} among {'; '.join(AXES)}.")
    model = Runtime(ONNX).run
    out.mkdir(parents=True, exist_ok=True)
    library, made = MaterialLibrary.starter(), settings()
    lost = {r["axis"] for r in made_otherwise(out / "stability.csv", made)} - {*axes}
    if lost:
        raise InputError(
            f"stability: {out / 'stability.csv'} holds results that other code or another machine "
            f"measured for other axes ({'; '.join(sorted(lost))}); take another --out."
        )
    rows = read_csv(out / "stability.csv", made)
    answered_already = {(r["axis"], r["level"], r["scene"]) for r in rows}
    by_case, jobs = {}, [
        (axis, level, view) for axis in axes for view in AXES[axis].views
        for level in AXES[axis].levels
    ]  # fmt: skip
    for done, (axis, level, view) in enumerate(jobs, 1):
        if (axis, float(level), f"{view.name} {view.seed}") not in answered_already:
            rows += measured(axis, level, view, library, model, by_case)
            write_csv(out / "stability.csv", rows, made)
        if progress:
            progress(done, len(jobs), axis)
    draw(rows, AXES, out / "atlas.png")
    doubt = read_csv(out / "missing.csv", made)
    if "material missing" in axes:
        known = list(dict.fromkeys(r["scene"] for r in doubt))
        for scene, traced in test_scenes(SCENES, known):
            cube, truth = traced.shade(library, *equidistant_bands(BANDS), NETD_K)
            doubt += missing_rows(scene, cube, truth, library, model)
            write_csv(out / "missing.csv", doubt, made)
            known.append(scene)
            if progress:
                progress(len(known), SCENES, "missing")
    page(rows, AXES, doubt, out / "atlas.md")
    return rows, doubt, list(faults(rows))
