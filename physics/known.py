"""What a model is told about a scene: numpy arrays from a cube, a library and an environment."""

from typing import NamedTuple

import numpy as np

from .errors import InputError
from .planck import noise_sigma, planck
from .prior import MIN_TEMPERATURE_SPREAD_K, SampledSpectra, usual_temperature

TERMS = 5  # of the series of Planck's law in `hypotheses`
MAX_COMPONENTS = 24  # of the basis: up to 0.8 % fewer pixels right outdoors than by 54 bands
COLDEST_PRIOR_K = 30.0
# the hottest pixel but a few is at most so many prior deviations from the mean, where MAX_T allows
HOT_SIGMAS = 5.0
# times the 99.5 % quantile of the distance from the mean: a pixel beyond it (a fire, a defect) is
# left to itself, since what the prior must span for it would blur all others
FAR = 1.5
MAX_T = 6.0  # prior deviations that an answer may lie from the mean
LIBRARY_SHARE = 0.1  # of the library's covariance beside the pixels'


class Known(NamedTuple):
    """What is known about a scene besides its pixels: float32 arrays or tensors.

    nodes_um (bands, n) um, quadrature nodes of every band; sigma (bands,) its noise;
    emissivity (materials, bands, n) at the nodes; is_sky (materials,) 1 for the sky, else 0;
    environment (k, bands), and light (k, bands, n), the same at the nodes;
    sky_object (k,) 1 for the objects that stand for the sky; usual_lighting (k,) the usual V;
    spread, skylight_spread, curve_spread, sky_spread (d, bands) and error (bands,) as in
    Environment;
    sky_mean (bands,), or zeros if no sky is in view;
    quiet (bands,) as in HeatCube;
    prior_k (2,) K: mean and standard deviation of T's prior: what is usual in the scene, and
    wide enough for all but a few in a hundred pixels;
    basis (d, bands) orthogonal directions of noise-scaled spectra, each divided by about the
    standard deviation that spectra have along it.
    All other spectra in W m-2 sr-1 um-1.
    """

    nodes_um: np.ndarray
    sigma: np.ndarray
    emissivity: np.ndarray
    is_sky: np.ndarray
    environment: np.ndarray
    light: np.ndarray
    sky_object: np.ndarray
    usual_lighting: np.ndarray
    spread: np.ndarray
    skylight_spread: np.ndarray
    curve_spread: np.ndarray
    sky_spread: np.ndarray
    error: np.ndarray
    sky_mean: np.ndarray
    quiet: np.ndarray
    prior_k: np.ndarray
    basis: np.ndarray


def known_arrays(cube, library, environment):
    """The fields of Known as a dict of float32 arrays.

    Raises InputError if the library or the environment does not fit the cube's bands, or the
    library holds a single material.
    """
    environment.check_bands(cube.wavelength_um)
    if len(library) < 2:
        raise InputError(
            "library: the network chooses between materials and needs two; take method local."
        )
    nodes = cube.nodes_um
    curves = library.at(nodes)
    pixels = SampledSpectra.of(cube)
    t, mean = pixels.brightness_k.mean(axis=1), usual_temperature(cube, environment, pixels)
    off = np.abs(t - mean)
    far = FAR * np.quantile(off, 0.995, method="lower")
    near = off <= far
    spread = max(MIN_TEMPERATURE_SPREAD_K, t[near].std(), off[near].max() / HOT_SIGMAS)
    spread = min(spread, (mean - COLDEST_PRIOR_K) / MAX_T)  # no answer is colder
    sky_object = np.zeros(len(environment))
    sky_object[list(environment.sky)] = 1
    sky_mean = environment.sky_mean if environment.sky_mean is not None else np.zeros(cube.bands)
    s = pixels.spectra[near] / cube.sigma
    basis = _basis(s, cube, curves.mean(axis=-1), environment, mean, spread)
    arrays = dict(
        nodes_um=nodes, sigma=cube.sigma, emissivity=curves, is_sky=library.is_sky,
        environment=environment.radiance, light=environment.at_nodes(nodes),
        sky_object=sky_object, usual_lighting=environment.usual, spread=environment.spread,
        skylight_spread=environment.skylight_spread, curve_spread=environment.curve_spread,
        sky_spread=environment.sky_spread,
        error=noise_sigma(cube.wavelength_um, environment.known_error_k), sky_mean=sky_mean,
        quiet=cube.quiet, prior_k=np.array([mean, spread]), basis=basis,
    )  # fmt: skip
    return {name: np.asarray(a, np.float32) for name, a in arrays.items()}


def bytes_per_pixel(known):
    """Approximate memory per pixel, at most, given known_arrays, besides the chunk being worked on:
    its spectrum in several layouts, maps of all materials, and the network's channels."""
    materials, bands, _ = known["emissivity"].shape
    return 16 * bands + 40 * materials + 700


def _basis(s, cube, emissivity, environment, mean_k, spread_k):
    """(d, bands) the directions in which noise-scaled spectra differ most, over their deviation:
    those of some pixels s (n, bands), and those that any material of the library at any T,
    under any light, may have."""
    s = s - s.mean(axis=0)
    t = np.maximum(mean_k + spread_k * np.array([[-1], [0], [1]]), COLDEST_PRIOR_K)
    glow = planck(cube.wavelength_um, t)
    light = np.concatenate([
        environment.radiance - environment.radiance.mean(axis=0), environment.spread,
        environment.skylight_spread,
    ])  # fmt: skip
    e = emissivity[:, None]
    usual = environment.usual @ environment.radiance
    mean = e[:, 0] * glow[1] + (1 - e[:, 0]) * usual
    of_library = np.concatenate([
        e * (glow[2] - glow[0]) / 2, (1 - e) * light, (mean - mean.mean(axis=0))[:, None]
    ], axis=1).reshape(-1, cube.bands) / cube.sigma  # fmt: skip
    covariance = s.T @ s / len(s) + LIBRARY_SHARE / len(e) * of_library.T @ of_library
    variance, direction = np.linalg.eigh(covariance)
    scaled = direction / np.sqrt(1 + variance)
    return scaled.T[::-1][:MAX_COMPONENTS]
