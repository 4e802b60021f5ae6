"""local and sgd: exact solutions per pixel and material, and their semi-global refinement."""

from dataclasses import fields, replace

import numba
import numpy as np

from physics.cube import hot
from physics.exact.distill import distill
from physics.exact.local import LocalSolution, solve_local
from physics.exact.reduced import Temperatures, reduce_model
from physics.exact.semiglobal import Objective, smoothed, unsmoothed
from physics.expected import SKY_NEAR
from physics.machinery.blas import no_blas_threads
from physics.machinery.tiles import TILE_BYTES, run_tiled
from physics.planck import brightness_temperature

from .uncertainty import (
    AIR_SIGMA_K,
    EVEN,
    LIKELY,
    OTHER_K,
    OWN_PROBABILITY,
    RIM_NATS,
    fits,
    local_trust,
    smooth_trust,
)

FEW = 4000  # pixels, for which starting more threads is not worthwhile
# for pixels far hotter than the rest, K: T's limits below and above what they show, and its prior
BELOW_K, ABOVE_K, HOT_SPREAD_K = 40.0, 900.0, 150.0
HOPELESS_ALONE = 15.0  # nats; a larger limit improved no tuning scene
BYTES_PER_MATERIAL, BYTES_PER_BAND = 60, 12  # per pixel of an answer, about


def solve_each(cube, library, environment, expected=None, regions=None, progress=None):
    """Maps of a Decomposition by name: each pixel of a HeatCube on its own, tile by tile.

    expected  physics.expected.Expected, which says where pixels may be partly sky; None: everywhere
    regions   physics.expected.Regions that restrict the materials; None: all everywhere
    progress  called as progress(done, total)
    """
    model = _compiled(cube, library, environment)
    threads = numba.get_num_threads() if cube.radiance[0].size > FEW else 1
    with no_blas_threads():
        return _by_tiles(model, cube.radiance, threads, expected, regions, progress)


def solve_smooth(cube, library, environment, expected, report, lap):
    """The same plus "objective", with T and m smoothed, which needs the whole cube at once.

    report   report(what) gives a progress(done, total) or None
    lap      lap(stage) is called after each stage
    """
    model = _compiled(cube, library, environment)
    with no_blas_threads():
        near = _near_sky(model.library, expected, (0, 0), cube.shape)
        local = _solved(model, cube.spectra, near, progress=report("local"))
        lap("local")
        objective = Objective(model, cube, local)
        answer = smoothed(objective, objective.local_state(), report("smooth"))
        lap("smooth")
        trust = smooth_trust(cube.bands)
        maps = _maps(cube.radiance, model, local, answer, trust, numba.get_num_threads())
        lap("texture")
    return maps | {"objective": answer.objective}


def _compiled(cube, library, environment):
    """The ReducedModel, with the solver compiled here, where that can be interrupted."""
    model = reduce_model(cube, library, environment)
    solve_local(model, cube.pixels([0]), threads=1)
    return model


def solve_hot(cube, radiance, library, environment):
    """Maps (..., n) by local of the n pixels of a HeatCube that are far hotter than the rest, with
    radiance (bands, n), as split off by `physics.cube.hot`."""
    # most of their error comes from the curves, whatever the bands' noise and the air
    noisy = replace(cube, netd_k=hot.netd_k(cube, radiance), relative_noise=None, quiet=None)
    model = reduce_model(noisy, library, environment, _of_hot(cube.wavelength_um, radiance))
    with no_blas_threads():
        maps = _by_tiles(model, radiance[:, None], numba.get_num_threads())
    return {name: a[..., 0, :] for name, a in maps.items()}


def _of_hot(wavelength_um, hot):
    """Temperatures for hot (bands, n): bare metal is hundreds of kelvin hotter than it looks."""
    t = brightness_temperature(wavelength_um[:, None], hot)
    low, usual = float(t.mean(axis=0).min()) - BELOW_K, float(np.median(t.max(axis=0)))
    high = float(t.max()) + ABOVE_K
    return Temperatures(0.5 * (high + low), 0.5 * (high - low), usual, HOT_SPREAD_K)


def _by_tiles(model, radiance, threads, expected=None, regions=None, progress=None):
    """Maps of radiance (bands, height, width), each pixel on its own."""
    bands = len(radiance)

    def tile(part, _, corner):
        spectra = part.reshape(bands, -1).T
        among = regions and regions.at(*corner)
        near = _near_sky(model.library, expected, corner, part.shape[1:])
        how = dict(hopeless=HOPELESS_ALONE, threads=1, among=among)
        local = _solved(model, spectra, near, **how)
        return _maps(part, model, local, unsmoothed(local), local_trust(bands), 1)

    each = BYTES_PER_MATERIAL * len(model.library) + BYTES_PER_BAND * bands
    cuts = regions and regions.cuts
    pixels = TILE_BYTES / threads / each
    return run_tiled(tile, radiance, 0, pixels, progress, at_once=threads, cuts=cuts)


def _near_sky(library, expected, corner, shape):
    """(P,) bool: which pixels of a tile may be partly sky, by what is Expected, if anything is."""
    if expected is None or library.sky_index is None:
        return np.ones(shape, bool).ravel()
    of_sky = expected.of_tile(*corner, *shape, [library.sky_index])
    return of_sky.ravel() >= SKY_NEAR


def _solved(model, spectra, near, **how):
    """The LocalSolution of spectra (P, bands), those near (P,) the sky possibly partly sky."""
    if near.all():
        return solve_local(model, spectra, **how)
    kinds = [(at, partly) for at, partly in ((near, True), (~near, False)) if at.any()]
    of_each = [solve_local(model, spectra[at], partly=partly, **how) for at, partly in kinds]
    whole = {}
    for field in fields(LocalSolution):
        each = [getattr(local, field.name) for local in of_each]
        whole[field.name] = np.empty((len(spectra), *each[0].shape[1:]), each[0].dtype)
        for (at, _), a in zip(kinds, each, strict=True):
            whole[field.name][at] = a
    return LocalSolution(**whole)


def _temperature_at_sky(spectra, model, local, state, sky, other, trust):
    """T and its sigma, K, of sky pixels: of what stands before the sky, if anything, or the air."""
    energy, at = local.energy[sky], model.library.sky_index
    of_sky = energy[:, at].copy()
    energy[:, at] = np.inf
    best = energy.argmin(axis=1)
    p = np.arange(len(best))
    rim = (model.sky_share[state.row[sky]] < 1) | (energy[p, best] - of_sky < RIM_NATS)
    solid = np.exp(trust * (energy[p, best][:, None] - energy))
    solid /= solid.sum(axis=1, keepdims=True)
    each, sigmas = local.temperature_k[sky], local.sigma_k[sky]
    t = each[p, best]
    sigma = _sigma(each, sigmas, solid, t, sigmas[p, best], 1.0, other)
    air = brightness_temperature(model.wavelength_um.astype(np.float32), spectra[sky][~rim])
    t[~rim], sigma[~rim] = air.max(axis=1), AIR_SIGMA_K  # the temperature its opaque bands show
    return t, sigma


def _maps(radiance, model, local, answer, trust, threads):
    """Maps by name of radiance (bands, height, width) from the results of `physics.exact`, with log
    evidence weighted by trust."""
    state, library = answer.state, model.library
    probability = answer.probability**trust
    probability /= probability.sum(axis=1, keepdims=True)
    spectra = radiance.reshape(len(radiance), -1).T
    texture, sky_texture, residual = distill(
        model, spectra, state.row, state.temperature_k, state.thermal_lighting, threads
    )
    sky = state.material == (library.sky_index if model.environment.sky_mean is not None else -1)
    lighting = np.where(sky[:, None], 0.0, state.thermal_lighting)
    t, other = state.temperature_k.copy(), 1 - probability[np.arange(len(spectra)), state.material]
    each, sigmas = local.temperature_k, local.sigma_k
    sigma = _sigma(each, sigmas, probability, t, answer.sigma_k, residual, other)
    if sky.any():
        t[sky], sigma[sky] = _temperature_at_sky(
            spectra, model, local, state, sky, other[sky], trust
        )
    known = _known(local, state, probability, trust) & fits(residual, len(radiance)) & (t > 0)
    as_map = lambda a, dtype=np.float32: np.ascontiguousarray(
        a.reshape(*a.shape[:-1], *radiance.shape[1:]), dtype
    )
    return {
        "temperature_k": as_map(t),
        "material": as_map(state.material, np.int16),
        "thermal_lighting": as_map(lighting.T),
        "texture": as_map(texture.T),
        "sky_texture": as_map(sky_texture),
        "residual": as_map(residual),
        "log_evidence": as_map(_log_evidence(local.energy)),
        "temperature_sigma_k": as_map(sigma),
        "material_probability": as_map(probability.T),
        "unknown": as_map(~known, bool),  # so that NaN is unknown
    }


def _log_evidence(energy):
    """(P,) of all materials together, from energy (P, L)."""
    least = np.minimum(energy.min(axis=1), np.finfo(np.float32).max)  # where nothing is possible
    with np.errstate(divide="ignore"):
        return np.log(np.exp(least[:, None] - energy).sum(axis=1)) - least


def _sigma(each_k, sigmas_k, probability, temperature_k, own_k, residual, other):
    """(P,) sigma of T, K: own_k or, if larger, that over all materials' each_k and sigmas_k (P, L),
    times a misfit beyond the noise (Birge's ratio); plus OTHER_K for materials outside the library,
    weighted by other (P,)."""
    variance = (probability * (sigmas_k**2 + (each_k - temperature_k[:, None]) ** 2)).sum(1)
    variance = np.maximum(variance, own_k**2) * np.maximum(residual, 1) ** 2
    return np.sqrt(variance + OTHER_K**2 * other)


def _known(local, state, probability, trust):
    """(P,) bool: where the answer is likely enough, and not only because of the neighbours, against
    the pixel's own evidence."""
    p, materials = np.arange(len(state.material)), local.energy.shape[1]
    own = np.exp(trust * (local.energy.min(axis=1, keepdims=True) - local.energy))
    own = own[p, state.material] / own.sum(axis=1)
    least = max(OWN_PROBABILITY, min(EVEN / materials, LIKELY))
    return (probability[p, state.material] >= LIKELY) & (own >= least)
