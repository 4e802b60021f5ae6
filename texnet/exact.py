"""local and sgd: every pixel and material exactly, and the semi-global refinement of that."""

from dataclasses import replace

import numba
import numpy as np

from physics.cube import hot
from physics.exact.distill import distill
from physics.exact.local import solve_local
from physics.exact.reduced import reduce_model
from physics.exact.semiglobal import Objective, refine, unsmoothed
from physics.machinery.blas import no_blas_threads
from physics.machinery.tiles import TILE_BYTES, run_tiled
from physics.planck import brightness_temperature

from .doubt import (
    AIR_SIGMA_K,
    EVEN,
    LIKELY,
    LOCAL_TRUST,
    OTHER_K,
    OWN_PROBABILITY,
    RIM_NATS,
    SGD_TRUST,
    SGD_TRUST_OF_FEW,
    fits,
)

HOPELESS_ALONE = 15.0  # nats; by more, no tuning scene was answered better
BYTES_PER_MATERIAL, BYTES_PER_BAND = 60, 12  # of a pixel's answer, about


def solve(cube, library, environment, regions, smooth, report, lap):
    """Maps of a Decomposition by name, and "objective".

    regions  physics.expected.Regions, whose materials alone local looks for; of all if None
    smooth   sgd, which needs the whole cube at once; else local, tile by tile
    report   report(what) gives a progress(done, total) or None
    lap      lap(stage) is called after each stage
    """
    model = reduce_model(cube, library, environment)
    threads = numba.get_num_threads()
    solve_local(model, cube.pixels([0]), threads=1)  # compiled here, where it can be interrupted

    with no_blas_threads():
        if smooth:
            local = solve_local(model, cube.spectra, report("local"))
            lap("local")
            objective = Objective(model, cube, local)
            answer = refine(objective, objective.local_state(), report("refine"))
            lap("refine")
            trust = min(SGD_TRUST * cube.bands**-0.5, SGD_TRUST_OF_FEW * cube.bands**2)
            maps = _maps(cube.radiance, model, local, answer, trust, threads)
            lap("texture")
            return maps | {"objective": answer.objective}
        maps = _by_tiles(model, cube.radiance, threads, regions, report("local"))
        lap("local")
        return maps


def solve_hot(cube, radiance, library, environment):
    """Maps (..., n) by local of the n pixels of a HeatCube that are far hotter than the rest, of
    radiance (bands, n), as `physics.cube.hot` parts them."""
    noisy = replace(cube, netd_k=hot.netd_k(cube, radiance))
    of_hot = hot.temperatures(cube.wavelength_um, radiance)
    model = reduce_model(noisy, library, environment, of_hot)
    with no_blas_threads():
        maps = _by_tiles(model, radiance[:, None], numba.get_num_threads())
    return {name: a[..., 0, :] for name, a in maps.items()}


def _by_tiles(model, radiance, threads, regions=None, progress=None):
    """Maps of radiance (bands, height, width), each pixel by itself."""
    bands = len(radiance)

    def tile(part, _, corner):
        spectra = part.reshape(bands, -1).T
        among = regions and regions.at(*corner)
        local = solve_local(model, spectra, hopeless=HOPELESS_ALONE, threads=1, among=among)
        return _maps(part, model, local, unsmoothed(local), min(1.0, LOCAL_TRUST * bands**-0.5), 1)

    each = BYTES_PER_MATERIAL * len(model.library) + BYTES_PER_BAND * bands
    cuts = regions and regions.cuts
    pixels = TILE_BYTES / threads / each
    return run_tiled(tile, radiance, 0, pixels, progress, at_once=threads, cuts=cuts)


def _temperature_at_sky(spectra, library, model, local, state, sky):
    """T and its sigma, K, of sky pixels: of what stands before the sky, if any, or the air's."""
    energy = local.energy[sky].copy()
    of_sky = energy[:, library.sky_index].copy()
    energy[:, library.sky_index] = np.inf
    best = energy.argmin(axis=1)
    p = np.arange(len(best))
    rim = (model.sky_share[state.row[sky]] < 1) | (energy[p, best] - of_sky < RIM_NATS)
    t, sigma = local.temperature_k[sky][p, best], local.sigma_k[sky][p, best]
    air = brightness_temperature(model.wavelength_um.astype(np.float32), spectra[sky][~rim])
    t[~rim], sigma[~rim] = air.max(axis=1), AIR_SIGMA_K  # as warm as its opaque bands look
    return t, sigma


def _maps(radiance, model, local, answer, trust, threads):
    state, bands, library = answer.state, len(radiance), model.library
    probability = answer.probability**trust
    probability /= probability.sum(axis=1, keepdims=True)
    spectra = radiance.reshape(bands, -1).T
    texture, sky_texture, residual = distill(
        model, spectra, state.row, state.temperature_k, state.thermal_lighting, threads
    )
    sky = state.material == (library.sky_index if model.environment.sky_mean is not None else -1)
    lighting = np.where(sky[:, None], 0.0, state.thermal_lighting)
    t, own_sigma = state.temperature_k.copy(), answer.sigma_k.copy()
    if sky.any():
        t[sky], own_sigma[sky] = _temperature_at_sky(spectra, library, model, local, state, sky)
    # doubt about m widens sigma of T: variance of the mixture about the answer
    variance = (probability * (local.sigma_k**2 + (local.temperature_k - t[:, None]) ** 2)).sum(1)
    p = np.arange(len(t))
    doubt = OTHER_K**2 * (1 - probability[p, state.material])
    # and a misfit beyond the noise does (Birge's ratio)
    variance = np.maximum(variance, own_sigma**2) * np.maximum(residual, 1) ** 2
    sigma = np.sqrt(variance + doubt)
    sigma = np.where(sky, own_sigma, sigma)
    # chi^2 far beyond its spread; or no material likelier than not; or the pixel's own
    # evidence against what its neighbours made of it
    own = np.exp(trust * (local.energy.min(axis=1, keepdims=True) - local.energy))
    own = own[p, state.material] / own.sum(axis=1)
    known = fits(residual, bands)
    least = max(OWN_PROBABILITY, min(EVEN / len(library), LIKELY))
    known &= (probability[p, state.material] >= LIKELY) & (own >= least) & (t > 0)
    maps = lambda a, dtype=np.float32: np.ascontiguousarray(
        a.reshape(*a.shape[:-1], *radiance.shape[1:]), dtype
    )
    return {
        "temperature_k": maps(t),
        "material": maps(state.material, np.int16),
        "thermal_lighting": maps(lighting.T),
        "texture": maps(texture.T),
        "sky_texture": maps(sky_texture),
        "residual": maps(residual),
        "log_evidence": maps(np.logaddexp.reduce(-local.energy.astype(np.float64), axis=1)),
        "temperature_sigma_k": maps(sigma),
        "material_probability": maps(probability.T),
        "unknown": maps(~known, bool),  # so that what is no number is unknown
    }
