"""The environment, from the cube's own pixels (S_1 ... S_k of Eq. 1; the paper's section on k).

1. Which pixels are sky (`sky_in_view`).
2. The sky's objects. A camera sees the part of the sky near the horizon; a surface is lit
   from overhead, through less air. From the clearest sky in view follows what is seen through less
   of its air (`overhead`): up to three objects (one for k = 2). Of the sky's pixels only those
   count whose neighbours are sky, too: leaves in a pixel fill the windows, as no air does.
   Where none is in view, one can be assumed all the same: that of air that is given or usual
   (`Sample.usual_air`), and how others deviate from it.
3. The others: K-means of what is not sky, cluster means, k in all.
4. `spread`: how far pixels scatter about their cluster's mean, along its principal
   directions, and what far hotter pixels add (`cube.hot`); `skylight_spread`: how skies of
   other air, which fit the sky in view as well, differ overhead.

Spectra are whitened (divided by the noise) first. A subsample of pixels is enough, so
the time does not grow with the cube; none of them is dead, far hotter than the rest (`cube.hot`)
or, unless many are, saturated.
"""

from copy import copy
from dataclasses import replace
from functools import partial

import numpy as np

from .bands import at_nodes
from .cube.dead_pixels import FEW, lit
from .cube.heat_cube import HeatCube
from .cube.hot import split_hot, spread_of_hot
from .cube.saturation import saturated
from .environment import Environment
from .errors import InputError
from .machinery.blas import no_blas_threads
from .overhead import air_temperature, overhead, seen_sky
from .planck import brightness_temperature
from .sky import HUMIDITY, sky_radiance, usual_atmosphere
from .sky_in_view import clusters, sky_in_view

USUAL_OBJECTS = 5  # of an environment, where the sky is in view
SAMPLES = 6000
# the sky's objects, 0 being the clearest sky in view and 1 the zenith, by the logarithm of the air
# mass; for k = 1, 2, 3 or 4, 5 and more. Found on fifteen scenes of no split, with 9 and 54 bands
SKY_OBJECTS = ((), (0.7,), (0.85, 0.2), (0.85, 0.2), (1.0, 0.4, 0.0))
EXTREMES = 0.005  # of the pixels, brightest and darkest, stay out of the clusters
SPREAD_DIRECTIONS = 6
# of a sky that is assumed: by how many K its air may be warmer, times how humid it may be, and the
# cosine of the zenith angle, 0.6 being like a whole hemisphere (Elsasser 1942); first what is
# likeliest
ASSUMED = (
    (0.0, 1.0, 0.6), (-15.0, 1.0, 0.6), (10.0, 1.0, 0.6), (0.0, 0.4, 0.6), (0.0, 2.0, 0.6),
    (0.0, 1.0, 1.0), (0.0, 1.0, 0.3),
)  # fmt: skip
# of the upper half of the sky in view: what lies lower may be a roof, in which a clearer sky is
# mirrored than any in view
CLEAREST = 0.1
LEAST_CLOUD = 0.02  # of the pixels, to be one: a little that is like sky may be metal
ERROR_K, ASSUMED_ERROR_K = 0.3, 0.5  # of X beyond all that, and under a sky that is assumed
BESIDE_SKY = 2  # objects, at least, where the sky was measured
SKY_SPREAD_SCALE = 2.0  # clusters cut off the sky's tails


@no_blas_threads()
def estimate_environment(cube, library, k=USUAL_OBJECTS, seed=0, assume_sky=None):
    """Estimate the Environment of a HeatCube.

    k        number of objects, the sky's among them; fewer come where spectra differ less
    seed     of the subsample and of K-means
    assume_sky  Atmosphere whose sky is one of the objects, if k is 2 or more and the library has a
             sky: what looks like one in view is none

    Raises InputError for a wrong k, more objects than pixels (a sky that is assumed needs none),
    or a band without light (`cube.bad_bands` leaves such bands out).
    """
    return Sample(cube, library, seed).environment(k, assume_sky)


def completed(environment, cube, library, seed=0):
    """An Environment that was measured, with what that leaves to a HeatCube to show: the other
    objects, if all that was measured is sky (`objects_completed`); how far true surroundings
    deviate from all of them, if it does not say (error_k); and the sky's own pixels, their mean and
    how they scatter, if it does not say how, and there are any."""
    k, alone = objects_completed(environment), len(environment.sky) == len(environment)
    unsaid = alone or environment.error_k is None
    unseen = environment.sky and (environment.sky_mean is None or not len(environment.sky_spread))
    if not unsaid and not unseen:
        return environment
    sample, own = Sample(cube, library, seed), {}
    if alone:
        found = sample.environment(k, skies=environment.radiance)
        own = dict(radiance=found.radiance, usual_lighting=None)
    if unsaid:
        spread = np.concatenate([environment.spread, sample.spread(k - len(environment.sky))])
        own |= dict(spread=spread, error_k=max(environment.known_error_k, ERROR_K))
    if unseen:
        own |= sample.of_sky()
    return replace(environment, **own)


def objects_completed(environment):
    """How many objects an Environment has, or, if all it has is sky, will have: USUAL_OBJECTS, and
    at least BESIDE_SKY more than it has."""
    sky = len(environment.sky) == len(environment)
    return max(USUAL_OBJECTS, len(environment) + BESIDE_SKY) if sky else len(environment)


class Sample:
    """Pixels of a HeatCube that environments of any k are estimated from: spectra (n, bands) in
    noise units, row (n,) how far down its column each lies, 0..1, sky (n,) which of them are sky,
    and inner (n,) which of these have sky all around; all that are sky, if fewer than ENOUGH have.

    split is that of the cube (`cube.hot`), if it was made already. Raises InputError for a band
    without light.
    """

    def __init__(self, cube, library, seed=0, split=None):
        self.cube, _, self.hot = split or split_hot(cube.with_netd())
        self.library, self.seed = library, seed
        pick = self.cube.random_pixels(np.random.default_rng(seed), SAMPLES)
        radiance = self.cube.pixels(pick)
        if not lit(radiance).all():
            raise InputError(
                "environment: the cube has bands or pixels without light; leave such bands out, as "
                "physics.cube.bad_bands.without_bad_bands does."
            )
        tell = _not_saturated(radiance, cube.wavelength_um)
        pick, spectra = pick[tell], radiance[tell] / self.cube.sigma
        # K-means begins with what comes first: in this order, that is no matter of where pixels lie
        order = np.argsort(spectra.mean(axis=1), kind="stable")
        self.spectra, pick = spectra[order], pick[order]
        self.row = _row(cube.dead, pick)
        self.sky, self.inner, self._seen = *np.zeros((2, len(pick)), bool), None
        self._clusters = {}  # by their number, which many skies are tried with
        if library.sky_index is None:
            return
        of = self.cube, library, self.spectra, pick, self.row, seed
        self.sky, self.inner = sky_in_view(*of)
        self._seen = self._clearest()
        if self.overcast:
            self.sky, self.inner = sky_in_view(*of, overcast=True)
            self._seen = self._clearest()

    def without_sky(self):
        """The same Sample if no pixel is sky."""
        other = copy(self)
        other.sky, other.inner, other._seen = *np.zeros((2, len(self.sky)), bool), None
        other._clusters = {}
        return other

    @property
    def may_assume_sky(self):
        """Whether one can be: the library has a sky, of which there is none in view."""
        return self.library.sky_index is not None and not self.sky.any()

    @property
    def overcast(self):
        """Whether what is sky is a cloud."""
        return self._seen is not None and self._seen.overcast

    def usual_air(self):
        """Atmosphere that is about as warm as the scene, as what it looks in its warmest bands."""
        cube = self.cube
        t = brightness_temperature(cube.wavelength_um, self.spectra * cube.sigma).max(axis=1)
        return usual_atmosphere(np.median(t))

    def environment(self, k, assume_sky=None, skies=None):
        """Environment of k objects by K-means, those of the sky first: skies (n, bands), if they
        were measured. Raises InputError for a wrong k, or more objects than pixels (a sky that is
        assumed needs none)."""
        if not isinstance(k, (int, np.integer)) or k < 1:
            raise InputError(f"environment: k must be a whole number, at least 1; got {k!r}.")
        if assume_sky is not None and self.sky.any():
            return self.without_sky().environment(k, assume_sky)
        cube, pixels = self.cube, self.cube.measured_count + self.hot.shape[1]
        assumed = assume_sky is not None and k > 1 and self.may_assume_sky
        if skies is None and k - assumed > pixels:
            raise InputError(
                f"environment: k = {k} objects{', a sky among them,' if assumed else ''} need at "
                f"least {k - assumed} pixels, got {pixels}."
            )
        none = np.zeros((0, cube.bands))
        deviations, error_k, within = none, ERROR_K, None
        if skies is not None:
            skies = skies / cube.sigma
        elif self.sky.any() and k > 1:
            skies, deviations, within = self._skies_overhead(k)
        elif assumed:
            skies, deviations, within = self._assumed_sky(assume_sky)
            error_k = ASSUMED_ERROR_K
        else:
            skies = none
        n = k - len(skies)
        return Environment(
            np.concatenate([skies, self._others(n)[0]]) * cube.sigma, cube.wavelength_um,
            tuple(range(len(skies))), self.spread(n), _principal(deviations, 0.0) * cube.sigma,
            error_k, within=within, **self.of_sky(),
        )  # fmt: skip

    def spread(self, n):
        """(d, bands) `Environment.spread` about n objects that are no sky."""
        pixels = self.cube.measured_count + self.hot.shape[1]
        return np.concatenate([self._others(n)[1], spread_of_hot(self.hot, pixels)])

    def _others(self, n):
        """Means (n, bands) of the clusters of what is not sky, in noise units; and how its pixels
        scatter about them, (d, bands) W m-2 sr-1 um-1."""
        if n in self._clusters:
            return self._clusters[n]
        ground = self.spectra[~self.sky] if not self.sky.all() else self.spectra
        # one small hot object shall not take an environment object from all others
        cut = int(EXTREMES * len(ground))
        ground = ground[np.argsort(ground.mean(axis=1))[cut : len(ground) - cut]]
        fit = clusters(ground, n, 3, self.seed)
        off = ground - fit.cluster_centers_[fit.labels_]
        found = fit.cluster_centers_, _principal(off, 1.0) * self.cube.sigma
        return self._clusters.setdefault(n, found)

    def _skies_overhead(self, k):
        """The sky's objects among k and their deviations, (n, bands) each, from the sky in view;
        and the objects within each band."""
        cube, shares = self.cube, SKY_OBJECTS[min(k - 1, len(SKY_OBJECTS) - 1)]
        skies, within = overhead(cube.wavelength_um, cube.nodes_um, self._seen, shares)
        mean = skies.mean(axis=0)
        deviations = (skies - mean) / cube.sigma
        return mean / cube.sigma, deviations.reshape(-1, cube.bands), within

    def _clearest(self):
        """The SeenSky of the clearest sky in view; None if there is none."""
        if not self.sky.any():
            return None
        cube, w = self.cube, self.cube.wavelength_um
        row = self.row[self.inner]
        inner = self.spectra[self.inner][row <= np.median(row)]
        visible, cold = inner * cube.sigma, inner.mean(axis=1)
        seen = visible[cold <= np.quantile(cold, CLEAREST)].mean(axis=0)
        scene_k = np.median(brightness_temperature(w, self.spectra * cube.sigma))
        air = air_temperature(w, cube.nodes_um, visible, seen, scene_k)
        large = self.sky.mean() >= LEAST_CLOUD
        return seen_sky(w, cube.nodes_um, cube.sigma, seen, *air, may_be_cloud=large)

    def _assumed_sky(self, air):
        """The same of a sky that is not in view, which is one object, of an Atmosphere."""
        cube, skies, k = self.cube, [], air.air_temperature_k
        humidity = HUMIDITY * air.water_cm / usual_atmosphere(k).water_cm
        for warmer_k, wetter, cosine in ASSUMED:
            other = usual_atmosphere(k + warmer_k, wetter * humidity)
            other = replace(air, air_temperature_k=other.air_temperature_k, water_cm=other.water_cm)
            above = partial(sky_radiance, cos_zenith=[cosine], atmosphere=other)
            skies.append(at_nodes(above, cube.nodes_um)[0])
        within = np.array(skies)
        skies = within.mean(axis=-1) / cube.sigma
        return skies[:1], skies - skies[0], within[:1]

    def of_sky(self):
        """What an Environment has of the sky's own pixels, by name; nothing if there are none."""
        if not self.sky.any():
            return {}
        sky, sigma = self.spectra[self.sky], self.cube.sigma
        mean = sky.mean(axis=0)
        scatter = SKY_SPREAD_SCALE * _principal(sky - mean, 1.0)
        return dict(sky_mean=mean * sigma, sky_spread=scatter * sigma)


def _row(dead, pick):
    """(n,) how far down the measured part of its column each of the picked pixels lies, 0..1: a
    strip may be askew."""
    down, column = np.divmod(pick, dead.shape[1])
    if not dead.any():
        return down / len(dead)
    measured = np.cumsum(~dead, axis=0)
    return (measured[down, column] - 1) / measured[-1, column]


def _not_saturated(radiance, wavelength_um):
    """(n,) bool: which pixels of radiance (n, bands) are not, unless more than a few are."""
    full = saturated(HeatCube(radiance.T[:, None], wavelength_um)).ravel()
    return ~full if full.mean() <= FEW else np.ones(len(full), bool)


def _principal(deviations, noise):
    """(d, bands) the largest principal deviations, one sigma long, less a variance of noise."""
    if len(deviations) < 2:
        return np.zeros((0, deviations.shape[1]))
    variance, axes = np.linalg.eigh(deviations.T @ deviations / len(deviations))
    signal = np.maximum(variance[::-1] - noise, 0)[:SPREAD_DIRECTIONS]
    rows = np.sqrt(signal)[:, None] * axes.T[::-1][:SPREAD_DIRECTIONS]
    return rows[signal > 0.5]
