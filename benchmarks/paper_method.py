"""The paper's TeX-SGD as it is written, for comparison: least squares and smoothness only.

    Eq. 5  S_1 ... S_k   the centres of K-means over all the cube's pixels
    Eq. 6  T, V          of every material minimise |S~ - S|^2, V on the simplex
           m             is the material with the least residual, sky like any other
    then   the same sum with a penalty on jumps of T and m between neighbours

It uses the project's own solvers without anything that the paper lacks: no evidence except the
residual, no extrapolated sky, no deviations of the surroundings, no pixels at the sky's edge, no
shares of materials. The paper leaves open how residuals become the probabilities of its cross
entropy: here they are those of white noise as strong as the typical residual of the best material,
so that what the k objects leave unexplained makes no answer too certain.
"""

from dataclasses import replace

import numpy as np
from sklearn.cluster import KMeans

from physics.environment import Environment
from physics.exact.local import solve_local
from physics.exact.reduced import groups, reduce_model
from physics.exact.semiglobal import Objective, smoothed, unsmoothed
from physics.library import SKY
from physics.prior import V_PRECISION
from texnet.pipeline import Decomposition

# of the solvers' priors: so weak that they matter only where nothing else gives information
LEFT_OF_V_PRIOR, PRIOR_SIGMA_K = 1e-4, 1e3


def kmeans_environment(cube, k, seed=0):
    """The k centres of K-means over all pixels of a HeatCube, as Environment."""
    fit = KMeans(k, n_init=3, random_state=seed).fit(cube.spectra.astype(np.float64))
    return Environment(fit.cluster_centers_, cube.wavelength_um)


def halves_environment(cube):
    """The means of the upper and the lower half, as Environment; the upper one is the sky."""
    half = cube.shape[0] // 2
    parts = cube.radiance[:, :half], cube.radiance[:, half:]
    means = np.stack([p.mean(axis=(1, 2), dtype=float) for p in parts])
    return Environment(means, cube.wavelength_um, sky=(0,))


def paper_decompose(cube, library, environment):
    """Eq. 6 for a HeatCube -> Decomposition; unknown is False everywhere.

    If the environment does not say which objects are sky, they are those whose nearest pixels
    mostly came out as sky; only the sky-lit texture depends on it.
    """
    # under another name the sky is a material like the others
    plain = replace(library, names=[n.replace(SKY, "the sky") for n in library.names])
    objective = _objective(cube, plain, environment)
    alone = unsmoothed(objective.local)
    misfit = _misfit(cube, objective, alone.state)
    loud = replace(cube, netd_k=cube.netd_k * max(1.0, float(np.median(misfit))))
    objective = _objective(loud, plain, environment)
    answer = smoothed(objective, objective.local_state())

    state, radiance = answer.state, environment.radiance
    is_sky = state.material == library.sky_index
    objects = environment.sky or _sky_objects(cube.spectra, radiance, is_sky)
    lighting = state.thermal_lighting
    of_sky = lighting[:, list(objects)] @ radiance[list(objects)].mean(axis=1)
    maps = lambda a, dtype=np.float32: np.asarray(a, dtype).reshape(*a.shape[:-1], *cube.shape)
    return Decomposition(
        temperature_k=maps(state.temperature_k),
        material=maps(state.material, np.int16),
        material_names=library.names,
        thermal_lighting=maps(lighting.T),
        environment=radiance,
        sky=objects,
        texture=maps(radiance.T @ lighting.T),
        sky_texture=maps(of_sky),
        residual=maps(_misfit(cube, objective, state)),
        temperature_sigma_k=maps(answer.sigma_k),
        material_probability=maps(answer.probability.T),
        unknown=np.zeros(cube.shape, bool),
        saturated=np.zeros(cube.shape, bool),
        dead=cube.dead,
        hot=np.zeros(cube.shape, bool),
        wavelength_um=cube.wavelength_um,
        emissivity=library.of_bands(cube.nodes_um),
        hue_deg=library.hue_deg,
        camera_netd_k=cube.netd_k,
        netd_k=cube.netd_k,
        objective=answer.objective,
    )


def _objective(cube, library, environment):
    """Eq. 6 with smoothness of T and m, after the exact fit of every pixel and material."""
    model = reduce_model(cube, library, environment)
    gram, v = model.gram.copy(), np.arange(model.terms, model.terms + model.k)
    gram[:, v, v] -= (1 - LEFT_OF_V_PRIOR) * V_PRECISION * model.k
    model = replace(
        model, gram=gram, offset=LEFT_OF_V_PRIOR * model.offset,
        occam=np.zeros_like(model.occam), prior_sigma_k=PRIOR_SIGMA_K,
    )  # fmt: skip
    objective = Objective(model, cube, solve_local(model, cube.spectra))
    objective.log_share[:], objective.unary = 0.0, objective.local.energy
    return objective


def _misfit(cube, objective, state):
    """(P,) root mean square of S~ - S in noise units."""
    model, misfit = objective.model, np.empty(len(state.row))
    for r, index in groups(state.row):
        s = model.rendered(r, state.temperature_k[index], state.thermal_lighting[index])
        misfit[index] = np.sqrt(((cube.spectra[index] / model.sigma - s) ** 2).mean(axis=1))
    return misfit


def _sky_objects(spectra, radiance, is_sky):
    """Indices of the objects whose nearest pixels mostly are sky."""
    distance = [((spectra - s) ** 2).sum(axis=1) for s in radiance]
    nearest, k = np.argmin(distance, axis=0), len(radiance)
    pixels, of_sky = np.bincount(nearest, minlength=k), np.bincount(nearest[is_sky], minlength=k)
    return tuple(np.flatnonzero(2 * of_sky > pixels).tolist())
