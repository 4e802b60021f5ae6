"""What the network is told of a scene: numpy arrays from a cube, a library, an environment."""

import numpy as np

from physics.bands import quadrature
from physics.errors import InputError
from physics.evidence import MAX_COLUMNS, TERMS
from physics.planck import noise_sigma
from physics.reduced import MIN_TEMPERATURE_SPREAD_K, scene_temperatures

HOT_SIGMAS = 5.0  # the hottest pixel is at most so many prior deviations from the mean


def known_arrays(cube, library, environment):
    """The fields of physics.evidence.Known as a dict of float32 arrays.

    Raises InputError where library or environment are not for the cube's bands, where the
    library is a single material, or where the environment has more objects and deviations than
    the model's factorisation holds.
    """
    environment.check_bands(cube.wavelength_um)
    if len(library) < 2:
        raise InputError(
            "library: the network chooses between materials and needs two; take method local."
        )
    columns = 1 + TERMS + len(environment) + sum(
        len(a) for a in (environment.spread, environment.skylight_spread, environment.sky_spread)
    )  # fmt: skip
    if columns > MAX_COLUMNS:
        raise InputError(
            f"environment: objects and deviations make {columns} columns, but the network takes "
            f"{MAX_COLUMNS}; give fewer deviations, or take method local or sgd."
        )
    nodes = quadrature(cube.wavelength_um, cube.fwhm_um)
    curves = library.at(nodes.ravel()).reshape(len(library), *nodes.shape)
    t = scene_temperatures(cube)
    mean = np.median(t)
    spread = max(MIN_TEMPERATURE_SPREAD_K, t.std(), np.abs(t - mean).max() / HOT_SIGMAS)
    is_sky = np.zeros(len(library))
    if library.sky_index is not None:
        is_sky[library.sky_index] = 1
    sky_object = np.zeros(len(environment))
    sky_object[list(environment.sky)] = 1
    sky_mean = environment.sky_mean if environment.sky_mean is not None else np.zeros(cube.bands)
    arrays = dict(
        nodes_um=nodes, sigma=cube.sigma, emissivity=curves, is_sky=is_sky,
        environment=environment.radiance, sky_object=sky_object, spread=environment.spread,
        skylight_spread=environment.skylight_spread, sky_spread=environment.sky_spread,
        error=noise_sigma(cube.wavelength_um, environment.error_k), sky_mean=sky_mean,
        prior_k=np.array([mean, spread]),
    )  # fmt: skip
    return {name: np.asarray(a, np.float32) for name, a in arrays.items()}
