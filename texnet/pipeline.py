"""The pipeline: a heat cube in, its TeX decomposition out.

First, `circumstances` finds the bands, the noise and the environment, and corrects errors of the
camera and the effect of the air before it. Then `answered` solves the pixels: a glance from afar
finds which materials there are and where (`glance`), and one of four `methods` does the rest.

Pixels far hotter than the rest are removed beforehand and solved separately (`physics.cube.hot`).
"""

import math
from dataclasses import replace
from functools import cache, partial
from importlib.metadata import version
from inspect import signature
from threading import Lock

import numpy as np

from physics.cube.heat_cube import MAX_NETD_K, HeatCube, numbers
from physics.cube.hot import split_hot
from physics.environment import MOST_OBJECTS, Environment
from physics.errors import InputError
from physics.library import MaterialLibrary
from physics.machinery import scratch
from physics.prior import MIN_TEMPERATURE_SPREAD_K

from . import glance
from .circumstances import circumstances
from .decomposition import Decomposition
from .methods import METHODS, NETS, by_network, by_solver
from .progress import Laps, compiling
from .uncertainty import (
    FEW_BANDS,
    shared_error_k,
    sigma_among_neighbours,
    unreliable,
    with_calibration_error,
    with_level_error,
)

MAX_SEED = 2**32 - 1  # scikit-learn's limit
_LOADING = Lock()  # the model is loaded once, however many threads ask


def decompose(
    cube: HeatCube,
    library: MaterialLibrary | None = None,
    *,
    method: str = "net+sgd",
    k: int | str | None = None,
    environment: Environment | None = None,
    seed: int = 0,
    calibration_error_k: float = 0.0,
    model=None,
    progress=None,
) -> Decomposition:
    """Decompose a heat cube, after removing bad bands and correcting the camera (see above).

    library      the materials that may occur; the starter library if None
    method       "net+sgd": the network's proposal, refined; "net": the network alone;
                 "local": each pixel on its own, exactly; "sgd": semi-global, starting from local
    k            number of environment objects, 1..10, found in the cube by K-means, fewer if its
                 pixels differ too little; or "auto": as many as the scene supports
                 (`physics.support`). If None, 5 if the sky is in view, otherwise as "auto"
    environment  use this one, at the cube's bands, and do not pass k. If it is all sky, the other
                 objects are estimated: 5 objects in all, and at least 2 of them not sky. It is
                 taken as the camera shows it: it shifts with the wavelengths if the sky's ozone
                 shows that, but no other shift, gain, offset or air is looked for, only whether
                 it is kelvins off. If you know its error, pass environment.off_by(kelvin)
    seed         of the K-means
    calibration_error_k  one standard deviation, K at 300 K, of an offset or gain error common to
                 all radiance, beyond what the cube shows; temperature_sigma_k includes it
    model        run(radiance, known, progress, expected, regions) -> maps for net+sgd, such as
                 export.Runtime(FILE).run; for net it must also take refined=False, as
                 learned.torch_model(network) does. If None, the shipped network, in ONNX Runtime
                 or, for net, in torch, on all cores (OMP_NUM_THREADS). It is called from several
                 threads at once only if it is a method of an object with an attribute at_once,
                 the number of threads, as Runtime has
    progress     called as progress(done, total, what)

    Raises InputError if the library does not cover the bands, or an argument is wrong.
    """
    _check(cube, library, environment, method, k, seed, calibration_error_k, model)
    library, lap = library or MaterialLibrary.starter(), Laps()
    way = method_of(method, library, model, progress)
    lap("loading")
    with compiling(progress if method not in NETS else None):  # which loads numba
        of = circumstances(
            cube, library, way.looks,
            k=k, environment=environment, seed=seed, lap=lap, progress=progress,
        )  # fmt: skip
        answer = answered(of, library, way, calibration_error_k, lap, progress)
    k = k if k is None or isinstance(k, str) else int(k)
    made_by = {
        "texnet": version("texnet"), "method": method, "k": k, "seed": int(seed),
        "environment": None if environment is None else "given",
    }  # fmt: skip
    return replace(answer, made_by=made_by)


def method_of(method, library, model=None, progress=None):
    """The Method of that name, solving pixels with a MaterialLibrary; model and progress as in
    `decompose`."""

    def report(what):
        return (lambda done, total: progress(done, total, what)) if progress else None

    if method in NETS:
        with _LOADING:
            model = model or shipped_model(method)
        return by_network(library, model, method == "net+sgd", report("network"))
    return by_solver(library, method == "sgd", report)


@cache
def shipped_model(method):
    """The network that comes with the package, as `decompose` takes one. It is loaded once and
    keeps its memory: net+sgd in ONNX Runtime, net in torch."""
    if method == "net":
        from .learned import torch_model  # torch takes a second to load

        return torch_model()
    from .runtime import shipped_runtime

    return shipped_runtime().run


def answered(of, library, way, calibration_error_k=0.0, lap=None, progress=None):
    """The Decomposition of a cube from its Circumstances, found with the same MaterialLibrary and
    with this Method or one with the same looks: local and sgd share theirs, as do net and net+sgd.

    calibration_error_k, progress  as in `decompose`
    lap  Laps whose seconds the answer takes; new ones if None
    """
    lap = lap or Laps()
    cold, is_hot, hot_radiance = split_hot(of.cube)
    maps = glance.answer(
        partial(way.run, of.environment, lap=lap), partial(way.looks(), of.environment), cold,
        len(library), library.sky_index, way.expects,
    )  # fmt: skip
    if is_hot.any():
        from .solver import solve_hot  # numba takes a second to load

        with compiling(progress if way.expects else None):  # the others report it already
            of_hot = solve_hot(cold, hot_radiance, library, of.environment)
        for name, a in of_hot.items():
            maps[name][..., is_hot] = a
            scratch.release(maps[name])
        lap("hot")
    maps = _with_scene_errors(maps, library, of, calibration_error_k)
    ready, found, air = of.ready, of.found, of.found.air
    return Decomposition(
        **{name: a for name, a in maps.items() if name not in ("objective", "log_evidence")},
        saturated=of.saturated, dead=ready.cube.dead, hot=is_hot,
        gain=found.gain, band_gains=found.of_bands(of.cube.bands), offset_k=found.offset_k,
        air_m=air.metres if air else 0.0, air_k=air.temperature_k if air else math.nan,
        air_error=found.air_error, air_error_k=found.air_error_k, distance_m=of.distance_m,
        material_names=library.names, environment=of.environment.radiance, sky=of.environment.sky,
        sky_assumed=of.assumed_air is not None,
        wavelength_um=ready.stated_um,
        emissivity=library.of_bands(of.cube.nodes_um),
        hue_deg=library.hue_deg, camera_netd_k=ready.camera_netd_k,
        netd_k=of.cube.netd_k, noise_raised=found.noise * ready.cube.netd_k / ready.camera_netd_k,
        spectral_shift_um=ready.shift_um, calibration_error_k=float(calibration_error_k),
        curve_error=found.curves, suspected_error_k=found.suspected_k,
        environment_error_k=of.environment_error_k, left_out=ready.left_out,
        objective=maps.get("objective", ()), seconds=lap.seconds,
    )  # fmt: skip


def _with_scene_errors(maps, library, of, calibration_error_k):
    """A method's maps, with sigma and unknown extended by edges, the calibration error, stated and
    found in the Circumstances, and pixels without information."""
    cube, found = of.cube, of.found
    sigma, t = maps["temperature_sigma_k"], maps["temperature_k"]
    sigma = sigma_among_neighbours(sigma, t, maps["material"])
    sigma = with_level_error(sigma, maps, library, cube, found.curves)
    # stated for the radiance as measured, before air and a gain were corrected
    stated_k = calibration_error_k * cube.netd_k / (found.noise * of.ready.cube.netd_k)
    shared_k = float(np.hypot(stated_k, shared_error_k(found, cube)))
    if shared_k:
        e = None
        if of.given:
            means = library.of_bands(cube.nodes_um).mean(axis=1)
            e = np.where(library.is_sky, 1.0, means).astype(np.float32)[maps["material"]]
        sigma = with_calibration_error(sigma, t, cube.wavelength_um, shared_k, e)
    if another_k := math.hypot(found.suspected_k, found.air_error_k):
        sigma = np.hypot(sigma, np.float32(another_k))
    invalid = of.ready.cube.dead | of.saturated
    sigma[invalid] += MIN_TEMPERATURE_SPREAD_K  # as if nothing were known
    unknown = maps["unknown"] | invalid
    if found.noise > 1 or found.curves or found.air_error or cube.bands < FEW_BANDS:
        unknown |= unreliable(maps, found, cube.bands)
    return maps | {"temperature_sigma_k": sigma, "unknown": unknown}


def _check(cube, library, environment, method, k, seed, calibration_error_k, model):
    """Raise InputError if an argument of decompose is wrong."""
    if not isinstance(cube, HeatCube):
        raise InputError(
            f"decompose: cube must be a HeatCube, as texnet.read_cube reads one, got "
            f"{type(cube).__name__}."
        )
    if not isinstance(library, MaterialLibrary | None):
        raise InputError(
            f"decompose: library must be a MaterialLibrary, as MaterialLibrary.load reads one, got "
            f"{type(library).__name__}."
        )
    if not isinstance(environment, Environment | None):
        raise InputError(
            f"decompose: environment must be an Environment, as texnet.Environment(radiance, "
            f"wavelength_um) makes one, got {type(environment).__name__}."
        )
    if environment is not None:
        environment.check_bands(cube.wavelength_um)
        if k is not None:
            raise InputError("decompose: the environment that is given has its own k; leave out k.")
    if method not in METHODS:
        raise InputError(f"decompose: method must be one of {', '.join(METHODS)}, got {method!r}.")
    if model is not None and method not in NETS:
        raise InputError(f"decompose: {method} uses no network; leave out model.")
    if model is not None and not callable(model):
        raise InputError(
            "decompose: model must be a function, such as export.Runtime(FILE).run, got "
            f"{type(model).__name__}."
        )
    if method == "net" and model and "refined" not in signature(model).parameters:
        raise InputError(
            "decompose: model runs net+sgd only; net needs one that takes refined=False, as "
            "texnet.learned.torch_model makes."
        )
    if not (k is None or _whole(k, 1, MOST_OBJECTS) or isinstance(k, str) and k == "auto"):
        raise InputError(
            f"decompose: k must be a whole number 1..{MOST_OBJECTS} or auto, got {k!r}."
        )
    if not _whole(seed, 0, MAX_SEED):
        raise InputError(f"decompose: seed must be a whole number 0..{MAX_SEED}, got {seed!r}.")
    error = numbers(calibration_error_k, "decompose: calibration_error_k")
    if error.ndim or not 0 <= error <= MAX_NETD_K:
        raise InputError(
            f"decompose: calibration_error_k must be 0-{MAX_NETD_K:g} K, got {calibration_error_k}."
        )


def _whole(value, low, high):
    whole = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    return whole and low <= value <= high
