"""A sample of a cube's pixels, to test how well they fit a possible error of the camera."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from physics.cube.heat_cube import HeatCube
from physics.environment import Environment
from physics.errors import Implausible
from physics.library import MaterialLibrary
from physics.machinery import scratch
from physics.planck import planck, planck_derivative
from physics.prior import like_sky

from ..methods import Look
from .correction import Distances, corrected, corrected_environment, lifted_nats
from .distances import far, likeliest_octaves
from .misfit import MORE, few, just, left_of
from .nats import NegativeLogEvidence

LEAST_PIXELS, LEAST_GROUND = 100, 20  # in all; without sky
LEAST_BANDS = 6  # with fewer, errors of the library look like a gain
LEAST_OBJECTS = 2
LEAST_OF_KIND, LEAST_KINDS = 8, 2  # pixels of a material; materials that must agree
SAMPLES, MOST_SAMPLES = 500, 20_000  # usable pixels; pixels among which to find them
QUARTER = 0.25  # of the pixels: those that fit best
MOST = 0.68  # of the pixels, as of errors within one standard deviation


class SampledPixels:
    """Pixels of a HeatCube (`sample`) in an Environment, and looks of a `methods.Method`, which
    explain them with a MaterialLibrary, or with those of its materials in seen, indices."""

    def __init__(
        self,
        cube: HeatCube,
        environment: Environment,
        library: MaterialLibrary,
        looks: Callable[[], Look],
        seen: np.ndarray | None = None,
    ):
        self.cube, self.environment, self.library, self.looks = cube, environment, library, looks
        self.seen = np.arange(len(library)) if seen is None else seen
        self._distances = {}  # by (Calibration, noise), as they are needed repeatedly

    @property
    def tell_bands_from_curves(self):
        """Whether the misfit can tell wrong bands from wrong curves: with few bands too much is
        explained, and what a single object misses, it misses in all materials."""
        return not few(self.cube) and len(self.environment) >= LEAST_OBJECTS

    def maps(self, environment, cube, look=None):
        """Maps of the pixels in a HeatCube by a Look; a new one if None."""
        return (look or self.looks())(environment, cube, self.seen)

    def corrected_maps(self, c, noise):
        """Maps of the pixels corrected by a Calibration, at the distances likeliest at a noise."""
        taken = corrected(self.cube, c, self.distances(c, noise))
        return self.maps(corrected_environment(self.environment, c), taken)

    def nats_of(self):
        """NegativeLogEvidence of the pixels, corrected by a Calibration, with a new Look."""
        look = self.looks()
        return NegativeLogEvidence(partial(self.nats, look), look.at_once)

    def nats(self, look, c):
        """(P,) minus the log evidence of the pixels corrected by a Calibration, infinite if
        none."""
        try:
            surroundings, cube = corrected_environment(self.environment, c), corrected(self.cube, c)
            if not self.library.covers(cube.nodes_um).all():
                return np.full(cube.radiance[0].size, np.inf)
            nats = -self.maps(surroundings, cube, look)["log_evidence"].astype(np.float64)
            nats = (nats + lifted_nats(self.cube, c)).ravel()
        except Implausible:  # nothing looks like that
            return np.full(self.cube.radiance[0].size, np.inf)
        return np.where(np.isfinite(nats), nats, np.inf)

    def distances(self, c, noise):
        """The Distances likeliest at a noise, with a Calibration's Air; None without air."""
        if not c.air:
            return None
        if (c, noise) not in self._distances:
            octaves = likeliest_octaves(c._replace(noise=noise), self.nats_of(), self.cube)
            metres = c.air.metres * 2**octaves
            at = Distances(metres, far(metres, self.cube, self.environment))
            self._distances[c, noise] = at
        return self._distances[c, noise]

    def contrast_k(self, c, noise):
        """K by which half of the ground differs from a Calibration's Air, in the band that it
        transmits best, at the distances likeliest at a noise; 0 if all is sky."""
        ground = ~like_sky(self.cube.spectra, self.environment, self.cube.sigma)
        if not ground.any():
            return 0.0
        band, air_k = int(np.argmax(c.air.transmittance)), c.air.temperature_k
        w = self.cube.wavelength_um[band]
        s = corrected(self.cube, c, self.distances(c, noise)).radiance[band].ravel()[ground]
        return float(np.median(np.abs(s - planck(w, air_k))) / planck_derivative(w, air_k))

    def moved_k(self, maps, other):
        """K by which T differs between two maps on most of the ground."""
        moved = np.abs(maps["temperature_k"] - other["temperature_k"])
        moved = moved[(maps["material"] != self.library.sky_index) & np.isfinite(moved)]
        return float(np.quantile(moved, MOST)) if moved.size >= LEAST_GROUND else 0.0

    def quartile(self, maps):
        """The residual, in noise units, of the best-fitting ground pixels; 0 if there are too
        few to say."""
        residual = maps["residual"][maps["material"] != self.library.sky_index]
        residual = residual[np.isfinite(residual)]
        return float(np.quantile(residual, QUARTER)) if residual.size >= LEAST_GROUND else 0.0

    def left(self, c, distances=None):
        """`quartile` after correction by a Calibration at Distances, in stated noise units
        (`misfit`)."""
        at = self.left_at(c, distances)
        left, nothing = left_of(at, rises=few(self.cube)), just(self.cube)
        if left > nothing and self.environment.sky and 0 < (low := at(MORE)) <= nothing:
            return low
        return left

    def left_at(self, c, distances=None):
        """The same as a function of the factor on the noise: noise -> what is left."""
        stated = corrected(self.cube, c, distances).netd_k

        def at(noise):
            noisy = c._replace(noise=noise)
            taken = corrected(self.cube, noisy, distances)
            maps = self.maps(corrected_environment(self.environment, noisy), taken)
            return self.quartile(maps) * (taken.netd_k / stated)

        return at


def sample(cube, left_out=None, least=LEAST_PIXELS):
    """A HeatCube of about SAMPLES of its pixels, on a grid; as a list of rows without those
    left_out, (height, width) bool, if any. None with fewer than LEAST_BANDS, or fewer pixels than
    least: too few to say anything."""
    if cube.bands < LEAST_BANDS:
        return None
    height, width = cube.shape
    good = np.ones(cube.shape, bool) if left_out is None else ~left_out
    pixels = min(SAMPLES * good.size // max(1, np.count_nonzero(good)), MOST_SAMPLES)
    down = min(max(1, int((height * width / pixels) ** 0.5)), height)
    across = max(1, -(-height // down) * width // pixels)
    if across > width:  # of a narrow picture one column is enough
        down = height // pixels
    bands = scratch.parts(cube.radiance)
    radiance = np.stack([band[::down, ::across] for band in bands])
    good = good[::down, ::across]
    there = np.flatnonzero(good)
    if there.size < least:
        return None
    if there.size < good.size:
        columns = min(good.shape[1], there.size)
        there = there[: there.size // columns * columns].reshape(-1, columns)
        radiance = radiance.reshape(cube.bands, -1)[:, there]
    return replace(cube, radiance=radiance, dead=None)
