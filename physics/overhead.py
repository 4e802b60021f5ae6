"""The sky overhead, from the sky in view: the curve of growth that its own pixels show.

A camera sees the part of the sky near the horizon; a surface is lit from overhead, through less
air. In a band a clear sky along air mass a radiates about

    S = B(T_air) (1 - exp(-tau)),    tau = tau_1 a^b

b is 1 for a continuum; where spectral lines saturate it falls towards 1/2 (Goody and Yung,
Atmospheric Radiation, 1989, ch. 4: the curve of growth), so the windows clear up overhead and the
flanks do not. The visible sky spans a range of air masses; across its pixels log tau of a band goes
with slope b against log tau of all bands (the clearest band having 1). With tau_1 a^b known for the
clearest sky in view, a smaller air mass follows. Where T_air's doubt or the noise leaves b open,
b is near what transmittance at the zenith suggests.

How far it is from the sky in view to the zenith, the windows say: by how many times their optical
depth is more than that of usual air overhead, which is as warm.
"""

import numpy as np

from .bands import band_means, quadrature
from .planck import brightness_temperature, planck, planck_derivative
from .sky import usual_atmosphere, zenith_optical_depth

AIR_EXCESS_K = (0.5, 2.0, 5.0)  # of T_air over what most of the visible sky's opaque band shows
OPAQUE_QUANTILE = 0.95  # that most
AIR_DOUBT_K = 6.0  # of a band's own T_air: bands see air of different heights
OPAQUE_GROWTH, GROWTH_DOUBT = 0.5, 0.15  # b of an opaque band, and how well b is known beforehand
DARKEST, CLEAREST = 0.02, 0.999  # transmittances between which log tau can be told
CLEAR_QUANTILE = 0.9  # of the bands' b: that of the windows, 1 by definition
LEAST_GROWTH, MOST_GROWTH = 0.3, 1.05
WINDOWS = 0.3  # of the bands, the clearest
OVERHEAD = 0.6  # air masses of the clearest sky: less than 1, as the air may be drier than usual
NEAREST, FARTHEST = 3.0, 20.0  # air masses of the sky in view; what seems nearer is drier air


def overhead(wavelength_um, sky, noise, seen, ratios, zenith_transmittance, least_k=0.0):
    """Skies (excess, ratios, bands) at air masses of ratios times that of a visible one.

    wavelength_um (bands,) um; sky (n, bands) spectra of the visible sky's pixels, noise (bands,)
    their standard deviation and seen (bands,) the spectrum to start from, W m-2 sr-1 um-1;
    zenith_transmittance (bands,) approximate; least_k K, below which the air is not. One sky per
    AIR_EXCESS_K.
    """
    air_k = max(air_temperature(wavelength_um, sky, seen), least_k)
    skies = []
    for excess in AIR_EXCESS_K:
        glow = planck(wavelength_um, air_k + excess)
        b = growth(wavelength_um, sky, noise, air_k + excess, zenith_transmittance)
        tau = -np.log1p(-seen / glow)
        skies.append(glow * -np.expm1(-tau * np.array(ratios)[:, None] ** b))
    return np.array(skies)


def air_temperature(wavelength_um, sky, seen):
    """K, of what most of the sky (n, bands), and seen (bands,), shows in its opaque bands."""
    warmest = brightness_temperature(wavelength_um, sky).max(axis=1)
    return max(
        np.quantile(warmest, OPAQUE_QUANTILE), brightness_temperature(wavelength_um, seen).max()
    )


def least_ratio(wavelength_um, fwhm_um, sky, seen, scene_k):
    """Of the clearest sky's air mass over that of the sky seen; arguments as of `overhead`.

    scene_k is about as warm as the air, which shows in the sky only where that is opaque.
    """
    air_k = max(air_temperature(wavelength_um, sky, seen), scene_k)
    nodes = quadrature(wavelength_um, fwhm_um)
    air = usual_atmosphere(air_k)
    zenith = -np.log(band_means(lambda w: np.exp(-zenith_optical_depth(w, air)), nodes))
    tau = -np.log1p(-seen / planck(wavelength_um, air_k + AIR_EXCESS_K[1]))
    clear = tau <= np.quantile(tau, WINDOWS)
    return OVERHEAD / np.clip(np.median(tau[clear] / zenith[clear]), NEAREST, FARTHEST)


def growth(wavelength_um, sky, noise, air_k, zenith_transmittance):
    """b (bands,) of the visible sky's pixels; arguments as of `overhead`, air_k in K."""
    glow = planck(wavelength_um, air_k)
    t = 1 - sky / glow
    told = (t > DARKEST) & (t < CLEAREST)
    t = np.clip(t, DARKEST, CLEAREST)
    tau = -np.log(t)
    precision = np.where(told, (glow * t * tau / noise) ** 2, 0.0)  # of log tau, for noise
    # d log tau / d T_air
    sensitivity = -(1 - t) / (t * tau) * (planck_derivative(wavelength_um, air_k) / glow)
    weight = precision / (1 + precision * (AIR_DOUBT_K * sensitivity) ** 2)
    weight = weight.sum(axis=0) / max(weight.sum(), 1e-30)
    abscissa = np.log(tau) @ weight
    slope, variance = _slope(abscissa, np.log(tau), precision, weight)
    variance = variance + (AIR_DOUBT_K * _slope(abscissa, sensitivity, precision)[0]) ** 2
    prior = OPAQUE_GROWTH + (1 - OPAQUE_GROWTH) * zenith_transmittance
    prior = prior / np.quantile(prior, CLEAR_QUANTILE)
    clear = 1.0
    for _ in range(3):  # the prior's scale is that of the clear bands, which it hardly moves
        known, guessed = 1 / variance, (GROWTH_DOUBT * clear) ** -2
        b = (slope * known + clear * prior * guessed) / (known + guessed)
        clear = np.quantile(b, CLEAR_QUANTILE)
    return np.clip(b / clear, LEAST_GROWTH, MOST_GROWTH)


def _slope(x, y, precision, share=None):
    """Least-squares slopes of y (n, bands) against x (n,), and their variances.

    With share (bands,), x is y @ share: its noise, which would pass for slope 1 of its own bands
    and lower all others', is taken out of the moments (errors in variables: Fuller 1987, ch. 1).
    """
    total = np.maximum(precision.sum(axis=0), 1e-30)
    off = x[:, None] - (precision * x[:, None]).sum(axis=0) / total
    across = (precision * off * y).sum(axis=0)
    signal = square = np.maximum((precision * off**2).sum(axis=0), 1e-30)
    if share is not None:
        noise = (share**2 / np.maximum(precision, 1e-30)).sum(axis=1, where=precision > 0)
        signal = square - (precision * noise[:, None]).sum(axis=0)
        across = across - share * np.count_nonzero(precision, axis=0)
        signal = np.maximum(signal, 1e-3 * square)
    return across / signal, square / signal**2
