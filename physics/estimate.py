"""The environment, from the cube's own pixels (Eq. 5 and the paper's section on k).

1. Sky. Twelve K-means clusters of the spectra are compared with the library's sky: at
   air mass a and air temperature T a clear sky radiates about B(T) (1 - t^a), t being
   the zenith transmittance 1 - e_sky. A cluster is sky if this fits clearly better than
   a grey body, if in the clearest band more than half of B(T) is missing, and if it lies
   above the rest of the picture (a car's bonnet mirrors the sky; it does not hang in it).
2. The sky's object. Of the sky a camera sees the part near the horizon; a surface is lit
   from overhead, through less air. The coldest visible sky is extrapolated with the same
   law to AIR_MASS_RATIO of its air mass, band by band, and stands for the sky.
3. The others: K-means of what is not sky, cluster means, k - 1 of them (k without sky).
4. `spread`: how far pixels scatter about their cluster's mean, along its principal
   directions; and the differences between the plausible overhead skies.

Spectra are whitened (divided by the noise) first. A subsample of pixels is enough, so
the time does not grow with the cube.
"""

import numpy as np
from sklearn.cluster import KMeans

from .environment import Environment
from .errors import InputError
from .planck import brightness_temperature, radiance, radiance_derivative

SAMPLES = 10000
SKY_CLUSTERS = 12
MISSING = 0.5
AIR_MASS_RATIOS = (0.4, 0.55, 0.7, 0.85)  # 1.66 (diffusivity) over that 15-30 degrees up
AIR_EXCESS_K = (0.5, 2.0, 5.0)  # of the air over the largest brightness temperature of the sky
SPREAD_DIRECTIONS = 4
SPREAD_SCALE = 0.3  # X averages over many surroundings, which scatter less than pixels do
ERROR_K = 0.3  # of X beyond all that
SKY_SPREAD_SCALE = 2.0  # clusters cut off the sky's tails


def estimate_environment(cube, library, k=5, method="kmeans", seed=0):
    """Estimate the Environment of a HeatCube.

    k        number of objects, the sky's among them
    method   "kmeans" as above; "halves": the averages of the upper and the lower half of
             the picture (k = 2), the upper one being the sky if there is any
    seed     of the subsample and of K-means

    Raises InputError for a wrong method or k, or more objects than pixels.
    """
    if method not in ("kmeans", "halves"):
        raise InputError(f"environment: method must be kmeans or halves, got {method!r}.")
    if k < 1 or (method == "halves" and k != 2):
        raise InputError(f"environment: k must be at least 1, and 2 for halves; got {k}.")
    pixels = cube.shape[0] * cube.shape[1]
    if k > pixels:
        raise InputError(f"environment: k = {k} objects need at least {k} pixels, got {pixels}.")
    cube = cube.with_netd()
    rng = np.random.default_rng(seed)
    pick = np.sort(rng.choice(pixels, min(pixels, SAMPLES), replace=False))
    spectra = cube.spectra[pick].astype(np.float64) / cube.sigma
    row = pick // cube.shape[1] / cube.shape[0]

    sky = _sky_pixels(cube, library, spectra, row, seed)
    sky_fields = {}
    if sky.any():
        mean = spectra[sky].mean(axis=0)
        scatter = SKY_SPREAD_SCALE * _principal(spectra[sky] - mean)
        sky_fields = dict(sky_mean=mean * cube.sigma, sky_spread=scatter * cube.sigma)

    if method == "halves":
        upper = row < 0.5
        means = np.stack([spectra[upper].mean(axis=0), spectra[~upper].mean(axis=0)])
        sky_index = 0 if sky.any() else None
        return Environment(
            means * cube.sigma, cube.wavelength_um, sky_index, None, ERROR_K, **sky_fields
        )

    ground = spectra[~sky] if (~sky).any() else spectra
    with_sky = sky.any() and k > 1
    clusters = min(k - with_sky, len(ground))
    fit = KMeans(clusters, n_init=3, random_state=seed).fit(ground)
    means = fit.cluster_centers_
    spread = SPREAD_SCALE * _principal(ground - means[fit.labels_])
    if with_sky:
        cold = spectra[sky].mean(axis=1)
        seen = spectra[sky][cold <= np.quantile(cold, 0.05)].mean(axis=0) * cube.sigma
        overhead = _overhead(cube.wavelength_um, seen) / cube.sigma  # (plausible skies, bands)
        means = np.concatenate([overhead.mean(axis=0)[None], means])
        spread = np.concatenate([spread, _principal(overhead - overhead.mean(axis=0))])
    return Environment(
        means * cube.sigma, cube.wavelength_um, 0 if with_sky else None, spread * cube.sigma,
        ERROR_K, **sky_fields,
    )  # fmt: skip


def _sky_pixels(cube, library, spectra, row, seed):
    """(n,) which of the whitened spectra belong to clusters of sky."""
    sky = np.zeros(len(spectra), bool)
    if library.sky_index is None:
        return sky
    transmittance = 1 - library.at(cube.wavelength_um, cube.fwhm_um.max())[library.sky_index]
    fit = KMeans(min(SKY_CLUSTERS, len(spectra)), n_init=1, random_state=seed).fit(spectra)
    centres = fit.cluster_centers_ * cube.sigma
    scene_k = np.median(brightness_temperature(cube.wavelength_um, centres))
    for cluster, centre in enumerate(centres):
        sky[fit.labels_ == cluster] = _looks_like_sky(
            cube.wavelength_um, centre, transmittance, scene_k
        )
    if sky.any() and not sky.all() and row[sky].mean() > row[~sky].mean():
        sky[:] = False
    return sky


def _looks_like_sky(wavelength_um, spectrum, transmittance, scene_k):
    t = brightness_temperature(wavelength_um, spectrum)
    air_k = np.linspace(t.max() - 2, max(t.max() + 12, scene_k), 20)[:, None, None]
    glow = radiance(wavelength_um, air_k)
    per_kelvin = radiance_derivative(wavelength_um, 300.0)

    def best(models):
        misfit = np.sqrt((((models - spectrum) / per_kelvin) ** 2).mean(axis=-1))
        return misfit.min(), np.unravel_index(misfit.argmin(), misfit.shape)

    opacity = 1 - transmittance ** np.geomspace(0.1, 40, 60)[:, None]
    sky, (i, j) = best(glow * opacity)
    grey, _ = best(glow * np.linspace(0.02, 1, 60)[:, None])
    missing = 1 - opacity[j].min()
    return missing > MISSING and (sky < 0.7 * grey or wavelength_um.size < 3)


def _overhead(wavelength_um, seen):
    """Plausible spectra (n, bands) of the sky overhead, from the coldest visible sky.

    S = B(T_air) (1 - t^a) solved for t^a band by band, and evaluated at AIR_MASS_RATIOS of
    the air mass, for T_air a little above the largest brightness temperature.
    """
    air_k = brightness_temperature(wavelength_um, seen).max() + np.array(AIR_EXCESS_K)
    glow = radiance(wavelength_um, air_k[:, None, None])
    ratio = np.array(AIR_MASS_RATIOS)[:, None]
    return (glow * (1 - (1 - seen / glow) ** ratio)).reshape(-1, seen.size)


def _principal(deviations):
    """(d, bands) the largest principal deviations, one sigma long; sensor noise left out."""
    if len(deviations) < 2:
        return np.zeros((0, deviations.shape[1]))
    variance, axes = np.linalg.eigh(deviations.T @ deviations / len(deviations))
    signal = np.maximum(variance[::-1] - 1, 0)[:SPREAD_DIRECTIONS]
    rows = np.sqrt(signal)[:, None] * axes.T[::-1][:SPREAD_DIRECTIONS]
    return rows[signal > 0.5]
