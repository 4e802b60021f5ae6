"""The sky overhead, from the sky in view: through which air would it look as it does?

A camera sees the part of the sky near the horizon; a surface is lit from overhead, through less
air. Of the clearest sky in view air temperature, vapour, ozone and air mass are found by
Gauss-Newton steps on `physics.sky`, with what is usual as Gaussian priors: the amount of carbon
dioxide is known, so its flanks tell the air mass, and the windows then how much vapour there is.
Where a cloud behind that air explains the sky by far better, its base is a fifth unknown (tau then
is that of a layer as warm as the air that would look the same).
What is left, the sky in view has in common with the sky overhead: a band's optical depth tau is
taken to be so many times as much as the model's, at all air masses alike, as far as the spectrum
tells tau (of an opaque band it does not). With that a sky at air mass a radiates

    S = B(T_air) (1 - exp(-tau(a))).

How far it may be off comes as skies of other air that fits as well: the 2 n sigma points of the n
unknowns, which have their means and covariance (Julier and Uhlmann 1997).
"""

import math
from typing import NamedTuple

import numpy as np

from .bands import at_nodes, band_means
from .planck import brightness_temperature, planck, planck_derivative
from .sky import HIGHEST_CLOUD_KM, MOST_WATER_CM, Atmosphere, sky_along, usual_atmosphere

OPAQUE_QUANTILE = 0.95  # of the visible sky's pixels, by which the air's temperature is told
# of T_air: where a band is opaque, relative to how much warmer than any band looks it is, and where
# all that is known is the scene
AIR_DOUBT_K, EXCESS_DOUBT, SCENE_DOUBT_K = 2.0, 0.5, 8.0
MASS_DOUBT, WATER_DOUBT, OZONE_DOUBT, BASE_DOUBT = 0.7, 0.7, 0.25, 0.5  # of their logarithms
USUAL_MASS = 8.0  # of the clearest sky in view
USUAL_BASE_KM = 2.5  # of a cloud
# of the least sum of squares: what a cloud must be ahead by, and leave at most. On scenes used for
# tuning with 9 and 54 bands clear skies leave 2 to 4, and 90 and more with a cloud; clouds 2 to 7
# km high 15 to 182 without and 0.5 to 8 with one
CLOUDY, CLOUDY_SHARE = 10.0, 0.5
GLOW_ERROR_K, DEPTH_ERROR = 0.5, 0.1  # of the model's B(T_air), and of its optical depth, relative
# of Gauss-Newton, at most, and their lengths in standard deviations of the priors; halved while
# they lead uphill, as they may where the sky is nearly opaque
STEPS, LONGEST, SHORTEST, HALVINGS = 60, 1.0, 1e-4, 8
DIFFERENCE = 1e-3  # likewise, for derivatives
MOST_DEPTH = 20.0


class _Air(NamedTuple):
    """What is looked for: K, and natural logarithms of the air mass, of cm, of Dobson units and,
    of an overcast sky, of km."""

    temperature_k: float
    mass: float
    water: float
    ozone: float
    cloud_base: float = math.inf

    def atmosphere(self):
        base_km = min(float(np.exp(self.cloud_base)), HIGHEST_CLOUD_KM)
        return Atmosphere(
            float(np.clip(self.temperature_k, 220, 330)),
            float(min(np.exp(self.water), MOST_WATER_CM)), float(min(np.exp(self.ozone), 1000)),
            cloud_base_km=math.inf if self.cloud_base == math.inf else base_km,
        )  # fmt: skip


class SeenSky(NamedTuple):
    """What is found of the clearest sky in view, seen (bands,): its _Air is at mean + scale x, x
    having a covariance, spread spread'; and whether it is overcast."""

    seen: np.ndarray
    mean: np.ndarray
    scale: np.ndarray
    x: np.ndarray
    spread: np.ndarray

    @property
    def overcast(self):
        return len(self.x) == len(_Air._fields)

    def air(self, x):
        """The _Air at other x."""
        return _Air(*(self.mean + self.scale * x))


def seen_sky(wavelength_um, nodes_um, noise, seen, air_k, air_doubt_k, may_be_cloud=True):
    """The SeenSky that is likeliest: clear, unless with a cloud, if it may be one, it is by far.

    wavelength_um, nodes_um  (bands,) and (bands, n) um, as a HeatCube has them
    noise, seen             (bands,) standard deviation and spectrum of the clearest sky in view
    air_k, air_doubt_k      K of the air, and its standard deviation (`air_temperature`)
    """
    of_air = usual_atmosphere(air_k)
    usual = np.log([USUAL_MASS, of_air.water_cm, of_air.ozone_du, USUAL_BASE_KM])
    mean = np.array([air_k, *usual])
    scale = np.array([air_doubt_k, MASS_DOUBT, WATER_DOUBT, OZONE_DOUBT, BASE_DOUBT])

    def deviation(x):
        """Of the model from the sky in view, in standard deviations of either."""
        air = _Air(*(mean[: len(x)] + scale[: len(x)] * x))
        sky = _skies(nodes_um, air, np.zeros(1))[0].mean(axis=-1)
        return (sky - seen) / _error(wavelength_um, seen, noise, air.temperature_k)

    n, (clear, *found) = 4, _most_likely(deviation, 4)
    if may_be_cloud:
        cloudy, *of_cloud = _most_likely(deviation, 5)
        if cloudy < min(clear - CLOUDY, CLOUDY_SHARE * clear):
            n, found = 5, of_cloud
    return SeenSky(seen, mean[:n], scale[:n], *found)


def overhead(wavelength_um, nodes_um, sky, shares):
    """Skies (sigma points, shares, bands), W m-2 sr-1 um-1, equally likely, from a SeenSky; and
    the model's own (shares, bands, n) at the nodes of each band.

    wavelength_um, nodes_um  (bands,) and (bands, n) um, as a HeatCube has them
    shares  of the way to the zenith, by the logarithm of the air mass: 0 is the sky in view, 1 the
            zenith
    """
    n, shares = len(sky.x), np.asarray(shares)
    points = sky.x + n**0.5 * np.concatenate([sky.spread.T, -sky.spread.T])
    from_view = np.array([0.0, *shares])

    def through(air):
        own = _skies(nodes_um, air, from_view).mean(axis=-1)
        return _through(wavelength_um, sky.seen, air.temperature_k, own)

    skies = [through(sky.air(p)) for p in points]
    return np.array(skies), _skies(nodes_um, sky.air(sky.x), shares)


def _skies(nodes, air, shares):
    """(shares, bands, n) of the model."""
    mass = np.exp(max(air.mass, 0.0) * (1 - shares))
    return at_nodes(lambda w: sky_along(w, mass, air.atmosphere()), nodes)


def _error(wavelength_um, seen, noise, air_k):
    glow = planck(wavelength_um, air_k)
    clear = np.clip(1 - seen / glow, np.exp(-MOST_DEPTH), 1)
    of_depth = DEPTH_ERROR * glow * clear * -np.log(clear)
    of_glow = GLOW_ERROR_K * planck_derivative(wavelength_um, air_k)
    return np.sqrt(noise**2 + of_depth**2 + of_glow**2)


def _most_likely(deviation, n):
    """The least |deviation|^2 + |x|^2, its x (n,) and the square root (n, n) of its covariance."""
    x, at = np.zeros(n), deviation(np.zeros(n))
    for _ in range(STEPS):
        slope = np.stack(
            [(deviation(x + d) - at) / DIFFERENCE for d in DIFFERENCE * np.eye(n)], axis=1
        )
        precision = slope.T @ slope + np.eye(n)
        step = -np.linalg.solve(precision, slope.T @ at + x)
        step = step / max(1.0, np.linalg.norm(step) / LONGEST)
        for _ in range(HALVINGS):
            there = deviation(x + step)
            if there @ there + (x + step) @ (x + step) < at @ at + x @ x:
                x, at = x + step, there
                break
            step = step / 2
        else:
            break
        if np.linalg.norm(step) < SHORTEST:
            break
    return at @ at + x @ x, x, np.linalg.cholesky(np.linalg.inv(precision))


def _through(wavelength_um, seen, air_k, skies):
    """Skies (n, bands), from the model's own: at the air mass of seen, and at n others."""
    air_k = max(air_k, brightness_temperature(wavelength_um, np.vstack([skies, seen])).max() + 0.1)
    glow = planck(wavelength_um, air_k)
    depth = lambda s: np.clip(-np.log1p(-s / glow), np.exp(-MOST_DEPTH), MOST_DEPTH)
    tau, own = depth(seen), depth(skies)
    # of log tau, for a glow that is off: d tau / dB = -S / (B (B - S))
    off = GLOW_ERROR_K * planck_derivative(wavelength_um, air_k)
    doubt = off * seen / (glow * (glow - seen)) / tau
    more = np.log(tau / own[0]) / (1 + (doubt / DEPTH_ERROR) ** 2)
    return glow * -np.expm1(-own[1:] * np.exp(more))


def air_temperature(wavelength_um, nodes_um, sky, seen, scene_k):
    """K, of the air, and its standard deviation: of what most of the sky (n, bands), and seen
    (bands,), show in the most opaque band, and as much more as usual air is warmer than it looks
    there; and, where no band is opaque, of scene_k, what the scene looks like."""
    warmest = brightness_temperature(wavelength_um, sky).max(axis=1)
    shown = max(
        np.quantile(warmest, OPAQUE_QUANTILE), brightness_temperature(wavelength_um, seen).max()
    )
    usual = usual_atmosphere(max(shown, scene_k))
    (s,) = band_means(lambda w: sky_along(w, np.array([USUAL_MASS]), usual), nodes_um)
    excess = usual.air_temperature_k - brightness_temperature(wavelength_um, s).max()
    k = np.array([shown + excess, scene_k])
    precision = np.array([np.hypot(AIR_DOUBT_K, EXCESS_DOUBT * excess), SCENE_DOUBT_K]) ** -2.0
    return float(k @ precision / precision.sum()), float(precision.sum() ** -0.5)
