"""Which pixels of a cube are sky: spectra that a sky explains better than anything else does.

Twelve K-means clusters of the spectra, each by its mean. A cluster is sky if

1. a clear sky explains it: the library's, which at air mass a and air temperature T radiates about
   B(T) (1 - t^a), t being the zenith transmittance, 1 - e_sky; or that of `sky`, through air as
   warm as the scene, dry to humid, along any path; or, if no cluster is like that, an overcast one;
2. much better than any grey body does (or no cluster does much better), and better than what the
   library has of materials that mirror little: e B(T) + (1 - e) X, X being such a sky, something of
   one temperature, or some of both;
3. about as much of B(T) is missing in its clearest band as in the clearest cluster's;
4. it is in no band colder than sky above it (metal mirrors the clear sky overhead);
5. it lies in the picture's upper half (a car's bonnet mirrors the sky, but from below), and all
   such clusters together well above the rest; or, as where there are but leaves before the sky, the
   coldest of all such pixels warm up steadily from the top down, as the sky does and seldom what
   mirrors it.

Spectra are in units of the noise; misfits in K at 300 K.
"""

import math
from dataclasses import replace
from functools import partial

import numpy as np
from sklearn.cluster import KMeans
from threadpoolctl import threadpool_limits

from .bands import band_means
from .machinery.blas import no_blas_threads
from .planck import brightness_temperature, planck, planck_derivative
from .sky import sky_along, usual_atmosphere

CLUSTERS = 12
# misfit of the best sky over that of the best grey body, at most: on scenes of no split skies come
# to 0.02 to 0.4, metal that mirrors them beside other things to 0.25 and more. Where the best grey
# body is so far off, K, there is a sky, be it of another shape than any here; and beyond CLOSE, so
# many times the ratio of the best of all clusters, at most
SKY_OVER_GREY, UNLIKE_GREY_K, SKY_OVER_GREY_OF_UNLIKE = 0.5, 8.0, 0.8
CLOSE, TIMES_BEST = 0.4, 4.0
# cm-1 between bands below which they show lines of water vapour that no sky here has (`sky` is
# smooth over 20 cm-1): neighbours are then joined until they are so far apart, unless fewer than so
# many would be left
NARROW_CM, SMOOTH_CM, LEAST_JOINED = 8.5, 15.0, 12
AIR_MASSES = np.geomspace(0.1, 40, 60)  # of the library's sky, one for all gases here
# of skies by `sky`: vapour over what air that warm can hold, and air masses
HUMIDITIES, MASSES = (0.1, 0.2, 0.35, 0.5, 0.7, 0.9, 1.1, 1.3), np.geomspace(1, 38, 24)
# of overcast skies, which are looked for where no clear one is: leaves before a clear sky look much
# like them, and on scenes of no split metal that mirrors it (its misfit is 0.16 and more of that of
# the best grey body, a cloud's less than 0.2). Lower clouds look like any cold wall
BASES_KM, OVERCAST_OVER_GREY = (2.0, 4.0, 7.0), 0.25
OF_SCENE = 0.9  # of the pixels look colder than the scene: sky may fill most of the picture
TELLING = 3  # bands, at least: two cannot tell a sky from anything else
SOLID = 0.5  # e in the mean of what mirrors little; what mirrors more may show the sky itself
# what it mirrors: skies of these air masses, as such shares of the light, the rest being as warm as
# the scene; and light of one temperature, over the scene's
MIRRORED_MASSES, MIRRORED_SHARES = np.geomspace(1, 16, 9), np.array([0.25, 0.5, 0.75, 1.0])
MIRRORED_K = np.array([-40.0, -25.0, -12.0, 8.0])
# of B(T_air) in the clearest band, for a cluster to be sky: a humid sky misses little near the
# horizon; with one band or two, where a grey body cannot be told from one, it must be more
MISSING, MISSING_OF_FEW = 0.09, {1: 0.2, 2: 0.26}
MISSING_RATIO = 0.41  # and of what the clearest cluster misses: below it, sky is mixed with leaves
# of the picture's height, which sky lies above all else in the mean: on scenes of no split 0.33 and
# more; what passed for sky from straight above, as snow at 220 K and metal, mostly less
ABOVE = 0.3
# or, in so many parts from top to bottom, with as many pixels each, the mean of so many of the
# coldest, in the clearest band, follows a parabola that rises by so many K, but for so much of the
# rise. On 38 scenes of no split with metal for their commonest materials it was off by 0.09 and
# more; sky, in crops of these scenes with and without ground, by less than 0.06 nine times of ten
PARTS, COLDEST, WARMER_K, UNSTEADY = 8, 0.05, 2.0, 0.06
# sky is nowhere colder, in K at 300 K, than sky that lies above it. On 69 scenes of no split (44 of
# them once more with metal for their commonest material), with 4 to 54 bands, of the pixels of two
# clusters of which one is colder the colder lies below in 0.67 of all pairs at most if it is sky,
# and in 0.75 and more if it is metal. The one above is to be at least LEAST_ABOVE of the pixels,
# and of these so many are to lie amid what is like sky: leaves before the sky fill its windows
COLDER_K, MOSTLY_BELOW, LEAST_ABOVE, LEAST_AMID = 2.0, 0.7, 0.01, 0.7
LEAST_DOWN = 0.4  # of the picture's height: higher up it may be clear sky below a thin cloud
ENOUGH = 30  # pixels with sky all around, to tell the sky overhead from them alone


@no_blas_threads()
def sky_in_view(cube, library, spectra, pick, row, seed, overcast=False):
    """(n,) bool each: which pixels are sky, and which of these have sky all around, or all of them
    if fewer than ENOUGH have. Clear sky, or, where there is none, or if it is known to be overcast,
    a cloudy one.

    spectra (n, bands)  of pixels (n,) of the cube, by their index pick, in noise units
    row     (n,)        how far down the measured part of its column each lies, 0..1
    """
    fit, of_sky = _sky_clusters(cube, library, spectra, pick, row, seed, overcast)
    sky = of_sky[fit.labels_]
    inner = sky.copy()
    if sky.any():
        amid = _amid(of_sky, fit, cube, pick[sky])
        if amid.sum() >= ENOUGH:
            inner[sky] = amid
    return sky, inner


def _sky_clusters(cube, library, spectra, pick, row, seed, overcast):
    """Clusters of the whitened spectra of the picked pixels, and (clusters,) which are sky."""
    fit = clusters(spectra, CLUSTERS, 1, seed)
    skies = _Skies(cube, library, fit.cluster_centers_ * cube.sigma, spectra * cube.sigma)
    above = partial(_in_view, fit=fit, cube=cube, spectra=spectra, pick=pick, row=row)
    clear = above(skies.missing(skies.clear()))
    if clear.any() and not overcast or cube.bands < TELLING:
        return fit, clear
    cloudy = above(skies.missing(skies.overcast(), OVERCAST_OVER_GREY))
    return fit, max(clear, cloudy, key=lambda of_sky: of_sky[fit.labels_].sum())


def _in_view(missing, fit, cube, spectra, pick, row):
    """(clusters,) bool: which are sky, given how far below B(T_air) they fall, missing (clusters,),
    0 if they are like none, which is overwritten."""
    height = np.array([row[fit.labels_ == c].mean() for c in range(len(missing))])
    least = MISSING_OF_FEW.get(cube.bands, MISSING)
    missing[_mirrors(missing > least, fit, cube, pick, row)] = 0.0
    of_sky = missing > max(least, MISSING_RATIO * missing.max())
    sky = of_sky[fit.labels_]
    if not _lies_above(sky, row) and _warms_downwards(cube, spectra[sky], row[sky]):
        return of_sky
    like = (missing > least)[fit.labels_]
    below = 1.0 if like.all() else row[~like].mean()
    # sky lies below the middle where it fills more than half, or it is metal that mirrors sky
    for lowest in (max(row.mean(), min(like.mean(), below)), row.mean()):
        high = np.where(height > lowest, 0.0, missing)
        of_sky = high > max(least, MISSING_RATIO * high.max())
        sky = of_sky[fit.labels_]
        if _lies_above(sky, row):
            return of_sky
    return np.zeros_like(of_sky)


def _lies_above(sky, row):
    """Whether what is sky, (n,) bool, lies well above the rest, if any is."""
    # many rows are a half in the mean, those of hot pixels, which are not here, included
    return not sky.any() or 0.5 - row[sky].mean() >= ABOVE * (1 - sky.mean())


def _warms_downwards(cube, spectra, row):
    """Whether the coldest of spectra (n, bands) in rows (n,) warm up steadily from the top down."""
    if len(row) < ENOUGH or len(np.unique(row)) < PARTS:
        return False
    kelvin = brightness_temperature(cube.wavelength_um, spectra * cube.sigma)
    kelvin = kelvin[:, kelvin.mean(axis=0).argmin()]
    parts = np.array_split(np.argsort(row, kind="stable"), PARTS)
    coldest = [np.sort(kelvin[p])[: math.ceil(COLDEST * len(p))].mean() for p in parts]
    part, rise = np.arange(PARTS), coldest[-1] - coldest[0]
    off = coldest - np.polyval(np.polyfit(part, coldest, 2), part)
    return rise > WARMER_K and off.std() < UNSTEADY * rise


class _Skies:
    """What some spectra (n, bands) of a cube, whose pixels are (p, bands), may be: skies, grey
    bodies, materials."""

    def __init__(self, cube, library, spectra, pixels):
        self.join, self.nodes = _joined(cube.wavelength_um), cube.nodes_um
        self.w, self.spectra, pixels = map(self.join, (cube.wavelength_um, spectra, pixels))
        self.per_kelvin = planck_derivative(self.w, 300.0)
        kelvin = brightness_temperature(self.w, pixels).mean(axis=1)
        self.scene_k = np.quantile(kelvin, OF_SCENE)
        self.grey = np.tile(np.linspace(0.02, 1, 60)[:, None], len(self.w))
        self.library = library
        self.solids = self.mirrored = np.zeros((0, len(self.w)))
        if len(self.w) >= TELLING:
            e = self.join(library.at(self.nodes).mean(axis=-1))
            self.solids = e[~library.is_sky & (e.mean(axis=-1) > SOLID)]
            self.mirrored = self._mirrored()

    def clear(self):
        """(skies, bands) share of B(T_air) of clear skies."""
        of_library = self._of_library()
        if self.w.size < TELLING:
            return of_library
        return np.concatenate([of_library, *self._of_air(MASSES)])

    def overcast(self):
        """(skies, bands) the same of skies with a cloud."""
        skies = [self._of_air(MASSES[::2], km) for km in BASES_KM]
        return np.concatenate(skies).reshape(-1, self.w.size)

    def missing(self, opacity, most=math.inf):
        """(n,) how far below B(T_air) each falls in its clearest band, 0..1; 0 if it is no sky of
        such opacity (skies, bands), or its misfit is more than most of the best grey body's."""
        missing, over_grey = np.array([self._missing(s, opacity) for s in self.spectra]).T
        best = over_grey.min(where=missing > 0, initial=np.inf)
        missing[over_grey > min(most, max(CLOSE, TIMES_BEST * best))] = 0.0
        return missing

    def _missing(self, s, opacity):
        """The same of one, and the misfit of its best sky over that of its best grey body."""
        t = brightness_temperature(self.w, s).max()
        glow = planck(self.w, np.linspace(t - 2, max(t + 12, self.scene_k), 40)[:, None])
        of_skies = self._misfit(-s, glow, opacity)
        sky, clearest = of_skies.min(), opacity[of_skies.argmin()].min()
        if self.w.size >= TELLING:
            grey = self._misfit(-s, glow, self.grey).min()
            unlike = grey > UNLIKE_GREY_K
            if sky >= (SKY_OVER_GREY_OF_UNLIKE if unlike else SKY_OVER_GREY) * grey:
                return 0.0, 1.0
            for e in self.solids:
                if self._misfit(e * glow - s, 1 - e, self.mirrored).min() <= sky:
                    return 0.0, 1.0
            return 1 - clearest, sky / grey
        return 1 - clearest, 0.0

    def _misfit(self, a, b, c):
        """(j,) K at 300 K: root mean square over the bands of a_i + b_i c_j, where i suits best."""
        a, b = a / self.per_kelvin, b / self.per_kelvin
        square = (a * a).sum(axis=-1)[..., None] + 2 * (a * b) @ c.T + (b * b) @ (c * c).T
        return np.sqrt(np.maximum(square.min(axis=0), 0) / self.w.size)

    def _of_library(self):
        """(AIR_MASSES, bands) share of B(T_air) of the library's sky; a wide band may hold a strong
        line and yet be clear."""
        transmittance = 1 - self.library.at(self.nodes)[self.library.sky_index]
        return 1 - self.join((transmittance ** AIR_MASSES[:, None, None]).mean(axis=-1))

    def _of_air(self, masses, cloud_base_km=math.inf):
        """(HUMIDITIES, masses, bands) the same of air as warm as the scene, below any cloud."""
        skies = []
        for humidity in HUMIDITIES:
            air = usual_atmosphere(self.scene_k, humidity)
            air = replace(air, cloud_base_km=cloud_base_km)
            radiance = band_means(lambda w, air=air: sky_along(w, masses, air), self.nodes)
            glow = planck(self.nodes, air.air_temperature_k).mean(axis=-1)
            skies.append(self.join(radiance) / self.join(glow))
        return np.array(skies)

    def _mirrored(self):
        """(n, bands) light that a surface may mirror."""
        of_scene = planck(self.w, self.scene_k)
        share = MIRRORED_SHARES[:, None, None, None]
        skies = (1 - share + share * self._of_air(MIRRORED_MASSES)) * of_scene
        even = planck(self.w, self.scene_k + MIRRORED_K[:, None])
        return np.concatenate([skies.reshape(-1, len(self.w)), even])


def _joined(wavelength_um):
    """What takes (..., bands) to means of neighbours, of as many as show no single lines."""
    nu = 1e4 / wavelength_um
    if len(nu) < 2 or np.median(-np.diff(nu)) >= NARROW_CM:
        return lambda a: a
    first = [0]
    for i in range(1, len(nu)):
        if nu[first[-1]] - nu[i] >= SMOOTH_CM:
            first.append(i)
    if len(first) < LEAST_JOINED:
        return lambda a: a
    many = np.diff([*first, len(nu)])
    return lambda a: np.add.reduceat(a, first, axis=-1) / many


def _mirrors(like, fit, cube, pick, row):
    """(clusters,) which of the clusters that are like sky are colder, in a band, than sky above."""
    rows = [np.sort(row[fit.labels_ == c]) for c in range(len(like))]
    low = like & (np.array([r.mean() for r in rows]) > LEAST_DOWN)
    kelvin = fit.cluster_centers_ * cube.sigma / planck_derivative(cube.wavelength_um, 300.0)
    mirrors = np.zeros_like(like)
    for above in np.flatnonzero(like):
        if len(rows[above]) < LEAST_ABOVE * len(row):
            continue
        below = [np.searchsorted(rows[above], r).mean() / len(rows[above]) for r in rows]
        colder = (kelvin[above] - kelvin).max(axis=1) > COLDER_K
        these = low & colder & (np.array(below) > MOSTLY_BELOW)
        if these.any() and _amid(like, fit, cube, pick[fit.labels_ == above]).mean() > LEAST_AMID:
            mirrors |= these
    return mirrors


def _amid(of_sky, fit, cube, pixels):
    """(n,) which of the pixels (n,) have nothing but some clusters, (clusters,) bool, around."""
    around = _neighbours(pixels, cube.shape)
    near = fit.predict(cube.pixels(around.ravel()) / cube.sigma)
    return of_sky[near].reshape(around.shape).all(axis=0)


def _neighbours(pixel, shape):
    """(8, n) indices of the neighbours of pixels (n,); beyond the border, the nearest within."""
    row, column = np.divmod(pixel, shape[1])
    step = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1) if (i, j) != (0, 0)]
    rows = np.clip([row + i for i, _ in step], 0, shape[0] - 1)
    return rows * shape[1] + np.clip([column + j for _, j in step], 0, shape[1] - 1)


def clusters(spectra, k, starts, seed):
    """K-means, with no more clusters than there are different spectra."""
    k = min(k, len(np.unique(spectra, axis=0)))
    with threadpool_limits(1, "openmp"):  # on so little, many threads wait for each other
        return KMeans(k, n_init=starts, random_state=seed).fit(spectra)
