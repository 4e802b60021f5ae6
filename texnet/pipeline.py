"""The pipeline: a heat cube in, its TeX decomposition out.

net, net+sgd   environment from the cube -> evidence -> network -> refinement and texture
local, sgd     environment from the cube -> exact local solution of every pixel and material
               -> semi-global refinement -> distilled texture, with how sure each part is
"""

import time
from dataclasses import dataclass, field

import numpy as np

from physics.distill import distill
from physics.environment import Environment
from physics.errors import InputError
from physics.estimate import estimate_environment
from physics.heat_cube import HeatCube
from physics.library import MaterialLibrary
from physics.local import PIXELS_PER_BLOCK, solve_local
from physics.planck import brightness_temperature
from physics.reduced import reduce_model
from physics.refinement import STEPS
from physics.semiglobal import Objective, refine

from .inputs import known_arrays
from .learned import torch_model
from .model import AIR_SIGMA_K, CHI2_SIGMAS, OWN_PROBABILITY, RIM_NATS

METHODS = ("local", "sgd", "net", "net+sgd")
MAX_K = 10


@dataclass(frozen=True, eq=False)
class Decomposition:
    """TeX and how sure it is. Maps are (height, width).

    temperature_k         K; for sky pixels that of what stands before the sky, if any, or the air's
    material              int16, index into material_names
    thermal_lighting      V (k, height, width), summing to 1; zero where only sky is seen
    environment           (k, bands) W m-2 sr-1 um-1;  sky: which of them stand for the sky
    texture               X (bands, height, width) W m-2 sr-1 um-1, zero there
    sky_texture           the texture that the sky alone lights, W m-2 sr-1 um-1 (band mean);
                          the residual where the environment has no sky
    residual              root mean square of S - S~ in noise units, less what deviations of
                          the surroundings from the k objects explain
    temperature_sigma_k   one standard deviation of T, K, doubt about m included
    material_probability  (materials, height, width)
    unknown               True where the answer should not be trusted: nothing in the library
                          fits, no material is likelier than not, or only the neighbours
                          speak for the one given
    hue_deg               (materials,) TeX-vision hues
    netd_k                the noise that was assumed, K
    objective             E of `physics.semiglobal` along the refinement, nats; empty for local
    seconds               time by stage
    """

    temperature_k: np.ndarray
    material: np.ndarray
    material_names: tuple[str, ...]
    thermal_lighting: np.ndarray
    environment: np.ndarray
    sky: tuple[int, ...]
    texture: np.ndarray
    sky_texture: np.ndarray
    residual: np.ndarray
    temperature_sigma_k: np.ndarray
    material_probability: np.ndarray
    unknown: np.ndarray
    wavelength_um: np.ndarray
    hue_deg: np.ndarray
    netd_k: float
    objective: tuple[float, ...] = ()
    seconds: dict = field(default_factory=dict)


def decompose(
    cube: HeatCube,
    library: MaterialLibrary | None = None,
    *,
    method: str = "net+sgd",
    k: int = 5,
    environment: Environment | None = None,
    seed: int = 0,
    model=None,
    progress=None,
) -> Decomposition:
    """Decompose a heat cube.

    library      the materials that may occur; the starter library if None
    method       "net+sgd": the network's proposal, refined; "net": the network alone;
                 "local": each pixel by itself, exactly; "sgd": semi-global, from local
    k            number of environment objects, 1..10, estimated from the cube by K-means
    environment  take this one instead
    seed         of the K-means
    model        for net and net+sgd, run(radiance, known, progress) -> maps, such as
                 export.Runtime(FILE).run; the shipped weights in torch if None
    progress     called as progress(done, total, what)

    Raises InputError where the library does not cover the bands, or method or k are wrong.
    """
    if method not in METHODS:
        raise InputError(f"decompose: method must be one of {', '.join(METHODS)}, got {method!r}.")
    if not 1 <= k <= MAX_K:
        raise InputError(f"decompose: k must be 1..{MAX_K}, got {k}.")
    library = library or MaterialLibrary.starter()
    cube = cube.with_netd()
    seconds, clock = {}, time.perf_counter()

    def lap(stage):
        nonlocal clock
        seconds[stage], clock = time.perf_counter() - clock, time.perf_counter()

    def report(what):
        return (lambda done, total: progress(done, total, what)) if progress else None

    environment = environment or estimate_environment(cube, library, k, seed=seed)
    lap("environment")
    if method.startswith("net"):
        run = model or torch_model(steps=STEPS if method == "net+sgd" else 0)
        maps = run(cube.radiance, known_arrays(cube, library, environment), report("network"))
        lap("network")
        return _of_maps(cube, library, environment, maps, seconds)
    model = reduce_model(cube, library, environment)
    local = solve_local(model, cube.spectra, report("local"))
    lap("local")
    objective = Objective(model, cube.radiance, local)
    start = objective.local_state()
    if method == "local":
        answer = objective.unsmoothed(start)
    else:
        answer = refine(objective, start, report("refine"))
    lap("refine")
    return _assemble(cube, library, environment, model, local, answer, seconds, lap)


def _of_maps(cube, library, environment, maps, seconds):
    return Decomposition(
        **{name: np.asarray(a) for name, a in maps.items()},
        material_names=library.names, environment=environment.radiance, sky=environment.sky,
        wavelength_um=cube.wavelength_um, hue_deg=library.hue_deg, netd_k=cube.netd_k,
        seconds=seconds,
    )  # fmt: skip


def _temperature_at_sky(cube, library, model, local, state, sky):
    """T and its sigma, K, of sky pixels: of what stands before the sky, if any, or the air's."""
    energy = local.energy[sky].copy()
    of_sky = energy[:, library.sky_index].copy()
    energy[:, library.sky_index] = np.inf
    best = energy.argmin(axis=1)
    p = np.arange(len(best))
    rim = (model.sky_share[state.row[sky]] < 1) | (energy[p, best] - of_sky < RIM_NATS)
    air = brightness_temperature(cube.wavelength_um, cube.spectra[sky].astype(np.float64))
    # the air is as warm as its opaque bands look
    return (
        np.where(rim, local.temperature_k[sky][p, best], air.max(axis=1)),
        np.where(rim, local.sigma_k[sky][p, best], AIR_SIGMA_K),
    )


def _assemble(cube, library, environment, model, local, answer, seconds, lap):
    state, probability = answer.state, answer.probability
    texture = np.empty((cube.bands, len(state.material)), np.float32)
    sky_texture = np.empty(len(state.material), np.float32)
    residual = np.empty_like(sky_texture)
    for start in range(0, len(state.material), PIXELS_PER_BLOCK):
        b = slice(start, start + PIXELS_PER_BLOCK)
        x, sky_texture[b], residual[b] = distill(
            model, cube.spectra[b].astype(np.float64), state.row[b],
            state.temperature_k[b], state.thermal_lighting[b],
        )  # fmt: skip
        texture[:, b] = x.T
    sky = state.material == (library.sky_index if environment.sky_mean is not None else -1)
    lighting = np.where(sky[:, None], 0.0, state.thermal_lighting)
    t, own_sigma = state.temperature_k.copy(), answer.sigma_k.copy()
    if sky.any():
        t[sky], own_sigma[sky] = _temperature_at_sky(cube, library, model, local, state, sky)
    # doubt about m widens sigma of T: variance of the mixture about the answer
    variance = (probability * (local.sigma_k**2 + (local.temperature_k - t[:, None]) ** 2)).sum(1)
    sigma = np.where(sky, own_sigma, np.sqrt(np.maximum(variance, own_sigma**2)))
    # chi^2 far beyond its spread; or no material likelier than not; or the pixel's own
    # evidence against what its neighbours made of it
    p = np.arange(len(t))
    own = np.exp(local.energy.min(axis=1) - local.energy[p, state.material])
    own /= np.exp(local.energy.min(axis=1, keepdims=True) - local.energy).sum(axis=1)
    unknown = residual**2 > 1 + CHI2_SIGMAS * np.sqrt(2 / cube.bands)
    unknown |= (probability[p, state.material] < 0.5) | (own < OWN_PROBABILITY)
    maps = lambda a, dtype=np.float32: np.ascontiguousarray(  # noqa: E731
        a.reshape(*a.shape[:-1], *cube.shape), dtype
    )
    lap("texture")
    return Decomposition(
        temperature_k=maps(t),
        material=maps(state.material, np.int16),
        material_names=library.names,
        thermal_lighting=maps(lighting.T),
        environment=environment.radiance,
        sky=environment.sky,
        texture=maps(texture),
        sky_texture=maps(sky_texture),
        residual=maps(residual),
        temperature_sigma_k=maps(sigma),
        material_probability=maps(probability.T),
        unknown=maps(unknown, bool),
        wavelength_um=cube.wavelength_um,
        hue_deg=library.hue_deg,
        netd_k=cube.netd_k,
        objective=answer.objective,
        seconds=seconds,
    )
