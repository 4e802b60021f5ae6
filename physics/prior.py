"""What is known of a scene's temperatures, lighting and mixed pixels before any is solved."""

from typing import NamedTuple

import numpy as np

from .planck import brightness_temperature

MIN_TEMPERATURE_SPREAD_K = 15.0  # a scene's temperatures are never known better a priori
SAMPLES = 20_000  # pixels to look at
# within which a pixel looks like the sky's: per band, and of each of the sky's deviations, along
# which air as warm as the ground may lie
SKY_CHI2, SKY_SIGMAS = 9.0, 2.5
# where fewer than FEW of the pixels look unlike the sky, noise may hide the rest of the ground; if
# those few are FAR_K warmer than all others, they are not what is usual
FEW, FAR_K = 0.05, 15.0
# where the colder half are mirrors, the usual T is at most WARMER_K below the quantile 1 - WARM.
# They are if their bands differ by UNEVEN_K more than those of the WARM: on 59 scenes outside the
# test sets mirrors' did by 13 K and more, and where that would have moved the T of others, by 4
WARM, WARMER_K, UNEVEN_K = 0.1, 12.0, 10.0
# share of sky in a mixed pixel, mean and standard deviation, below and above one half
MIXED_MATERIAL, MIXED_SKY = (0.25, 0.15), (0.75, 0.15)
MIXED_SHARE = 0.1  # of all pixels, a priori
V_PRECISION = 3.0  # times k: of a Dirichlet distribution of total concentration 2


def lighting_scale(k):
    """Standard deviation of each of k lighting factors."""
    return (V_PRECISION * k) ** -0.5


class Mixtures(NamedTuple):
    """What a pixel may be: R hypotheses, every material filling the pixel and, if sky is in view
    and among the materials, every material sharing it with sky. All fields are (R,).

    material is the index of the material; sky_share and share_sigma are mean and standard deviation
    of alpha, the sky's share in the pixel; prior is the share of all pixels that are pure, or
    mixed, if sky is in view, whether it is among the materials or not.
    """

    material: np.ndarray
    sky_share: np.ndarray
    share_sigma: np.ndarray
    prior: np.ndarray

    @staticmethod
    def of(is_sky, in_view):
        """Those of materials with is_sky (materials,), the sky being in view or not; the pure ones
        come first."""
        sky = np.asarray(is_sky, bool)
        kinds = [(1.0 * sky, 0.0, 1 - MIXED_SHARE * in_view)]
        if in_view and sky.any():
            kinds += [(*np.where(sky[:, None], MIXED_SKY, MIXED_MATERIAL).T, MIXED_SHARE)]
        rows = [np.broadcast_arrays(np.arange(len(sky)), *kind) for kind in kinds]
        return Mixtures(*map(np.concatenate, zip(*rows, strict=True)))


def deviations(of, reflected, around, alpha_step, sigma):
    """(R, d, bands) directions in which spectra of Mixtures may deviate, each one standard
    deviation long, in noise units sigma (bands,): by the surroundings, the library's curves, the
    sky in view, and its share in the pixel.

    reflected   (R, bands) share of the surroundings' light that is reflected, (1 - alpha)(1 - e)
    around      an Environment, or what has its deviations, W m-2 sr-1 um-1
    alpha_step  (R, bands) effect of one standard deviation of alpha, W m-2 sr-1 um-1
    """
    share, reflected = of.sky_share[:, None, None], reflected[:, None]
    rows = [
        reflected * around.spread, reflected * around.skylight_spread,
        (1 - share) * around.curve_spread, share * around.sky_spread, alpha_step[:, None],
    ]  # fmt: skip
    return np.concatenate(rows, axis=1) / sigma


def among(material, sky_share, is_sky, held, partly=True):
    """(R,) bool: which hypotheses are considered if only the materials held (materials,) bool are:
    none that is partly sky if the sky is not held, or partly is false."""
    return held[material] & (~is_partly_sky(sky_share) | (partly and (held & is_sky).any()))


def is_partly_sky(sky_share):
    """Which hypotheses have a sky_share (R,), an array or a tensor, that is neither 0 nor 1."""
    return (sky_share > 0) & (sky_share < 1)


class SampledSpectra(NamedTuple):
    """Spectra (n, bands) of a regular subsample of a HeatCube's pixels, and their brightness
    temperatures (n, bands) in K."""

    spectra: np.ndarray
    brightness_k: np.ndarray

    @staticmethod
    def of(cube):
        s = cube.sample(SAMPLES)
        return SampledSpectra(s, brightness_temperature(cube.wavelength_um, s))


def usual_temperature(cube, environment, pixels):
    """The usual temperature of a scene, K: the median brightness temperature of a HeatCube's
    SampledSpectra, without the Environment's sky, in the band in which they look warmest, the most
    opaque one. There most objects show their temperature whatever they are made of, since even a
    mirror looks nearly as warm as the others if the sky is opaque.

    It is not below the brightness temperature of the sky in view in that band, about that of the
    air, because mirrors of the clear sky overhead look colder than the sky in view. If no band is
    opaque, mirrors look much colder than they are; if they make up the colder half of the pixels,
    as three bands or more can tell, it is not far below the warmest tenth.
    """
    t = pixels.brightness_k
    if environment.sky_mean is None:
        return _usual(t)
    ground = ~like_sky(pixels.spectra, environment, cube.sigma)
    air = brightness_temperature(cube.wavelength_um, environment.sky_mean).max()
    usual = _usual(t[ground] if ground.any() else t)
    if ground.mean() < FEW and usual > np.quantile(_opaque(t), 1 - FEW) + FAR_K:
        usual = _usual(t)
    return max(float(air), usual)


def like_sky(spectra, environment, sigma):
    """(n,) bool: which spectra (n, bands), of noise sigma (bands,), look like the sky that is in
    view in an Environment."""
    if environment.sky_mean is None:
        return np.zeros(len(spectra), bool)
    off, u = (spectra - environment.sky_mean) / sigma, environment.sky_spread / sigma
    left = np.linalg.solve(np.eye(len(sigma)) + u.T @ u, off.T).T
    near = (np.abs(left @ u.T) <= SKY_SIGMAS).all(axis=1)  # the likeliest deviations
    return near & ((off * left).sum(axis=1) <= SKY_CHI2 * len(sigma))


def _opaque(t):
    """(n,) of brightness temperatures t (n, bands): in the band in which half look warmest."""
    return t[:, np.median(t, axis=0).argmax()]


def _usual(t):
    """K, of brightness temperatures t (n, bands)."""
    uneven, t = np.ptp(t, axis=1), _opaque(t)
    half, warm = np.quantile(t, [0.5, 1 - WARM])
    if np.median(uneven[t <= half]) < np.median(uneven[t >= warm]) + UNEVEN_K:
        return float(half)
    return float(max(half, warm - WARMER_K))
