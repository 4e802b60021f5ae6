"""Whether a sky that is not in view lights the scene, and of which air.

In a closed room none does: a sky is one more object that could light it, and makes the pixels no
likelier.

Its reflections tell which air it has: among airs of some temperatures and humidities, those near
the scene's own being usual, the one that makes all pixels together likeliest. They are told apart
best at MORE times the noise that is left (`misfit`); a few pixels tell nothing of the air. If no
such sky makes a perfect camera fit, relative gains of the bands may interfere (`band_gains`): they
are estimated under a few skies, those that make the pixels likeliest are taken, and the air is
searched again. Even doubtful gains count here, as the only question is whether there is a sky.

Mirrors do not count: they may reflect anything, even themselves, as an object that was found in the
picture has their very spectrum.
"""

from functools import partial
from itertools import product

import numpy as np

from physics.sky import HUMIDITY, usual_atmosphere

from ..glance import LEAST_MATERIALS
from .band_gains import band_gains
from .correction import RIGHT
from .misfit import MORE, fits
from .nats import NegativeLogEvidence
from .one_error import FEW_UNDER_SKY, GAIN, losses, one_error
from .pixels import LEAST_PIXELS, SampledPixels, sample

# nats per pixel; real skies gained 1.8 and more, in rooms -2 and less. A few pixels are less
# certain, but mostly right: of 30 single ones in rooms 4 passed for sky-lit, none with a wrong name
SKY_WORTH, FEWEST_PIXELS = 1.0, 1
# nats per pixel, with a perfect camera that fits, above which it need not be asked whether another
# camera explains the pixels without a sky: of 119 pictures used for tuning that fit, 71 lit by a
# sky gained 1.3 or more, the others 0.8 or less
PLAIN = 2.0
# K by which air is warmer than the scene looks, and octaves by which it is drier than half
# saturated: those tried, finer steps around the best, and those under whose skies gains are also
# estimated. UNUSUAL nats per pixel count against air one step from usual in either: with fewer,
# band errors lead to airs far from any. Found on scenes used for tuning
WARMER_K, DRIER = (-24.0, -16.0, -8.0, 0.0, 8.0), (-1.0, 0.0, 1.0, 2.0, 3.0)
DRIEST = DRIER[0], DRIER[-1]
STEPS = (8.0, 1.0), (4.0, 0.5)
USUAL, DRY = (0.0, 0.0), (-8.0, 2.0)
UNUSUAL = 0.2


def missing_sky(cube, environment, camera, usual, under_sky, looks, library, left_out=None):
    """The Atmosphere whose sky makes the pixels of a HeatCube without sky in view likelier by
    SKY_WORTH than an Environment without one, whether the camera is right or not; else None.

    camera     camera() is the Calibration found without a sky, which takes long
    usual      Atmosphere as warm as the scene looks
    under_sky  Atmosphere -> the Environment with its sky

    Other arguments as in `calibration`. Without a sky, band gains do not count if a perfect camera
    fits under one: they make up for what a sky does."""
    part = sample(cube, left_out, FEWEST_PIXELS)
    seen = np.flatnonzero(~library.is_mirror(cube.wavelength_um))
    if part is None or len(seen) < LEAST_MATERIALS:
        return None
    skies = _Skies(part, usual, under_sky, looks, library, seen)
    inside = SampledPixels(part, environment, library, looks, seen)
    enough = part.radiance[0].size >= LEAST_PIXELS

    def worth(at, off, cameras):
        """Nats per pixel."""
        nats = {c: inside.nats(skies.look, c) for c in cameras} | {at: skies.nats(at, off)}
        loss = losses(nats)
        return min(loss[c] for c in cameras) - loss[at]

    at, off = skies.likeliest_air(RIGHT) if enough else USUAL, RIGHT
    fit = enough and skies.fit(at)
    if enough and not fit and skies.tell_gains(at):
        off = skies.likeliest_gains((at, USUAL, DRY))
        at = at if off == RIGHT else skies.likeliest_air(off)
    else:
        of_right = worth(at, RIGHT, [RIGHT])
        if of_right < SKY_WORTH:  # another camera would not make it more
            return None
        if fit and of_right >= PLAIN:
            return skies.air(at)
    found = camera()._replace(noise=1.0, misfit=1.0, shared=0.0, curves=0.0)
    cameras = (found._replace(bands=()),) if off == RIGHT else (found, off)
    return skies.air(at) if worth(at, off, cameras) >= SKY_WORTH else None


class _Skies:
    """Skies of air that is so many K warmer and so many octaves drier than usual, and pixels (a
    HeatCube) under them; seen are the materials that count; other arguments as above."""

    def __init__(self, part, usual, under_sky, looks, library, seen):
        self.part, self.usual, self.under_sky = part, usual, under_sky
        self.looks, self.library, self.seen = looks, library, seen
        self.look = looks()

    def air(self, at):
        """The Atmosphere."""
        warmer_k, drier = at
        return usual_atmosphere(self.usual.air_temperature_k + warmer_k, HUMIDITY * 2.0**-drier)

    def pixels(self, at, seen):
        """The SampledPixels, with the materials seen."""
        environment = self.under_sky(self.air(at))
        return SampledPixels(self.part, environment, self.library, self.looks, seen)

    def nats(self, at, c):
        """(P,) minus their log evidence, corrected by a Calibration."""
        return self.pixels(at, self.seen).nats(self.look, c)

    def likeliest(self, some, c):
        """The one of some airs that makes pixels corrected by a Calibration likeliest."""
        nats_of = NegativeLogEvidence(lambda at: self.nats(at, c), self.look.at_once)
        loss = losses(nats_of.each(some))
        (k, octaves), *_ = STEPS
        unusual = lambda at: UNUSUAL * ((at[0] / k) ** 2 + (at[1] / octaves) ** 2)
        return min(some, key=lambda at: loss[at] + unusual(at))

    def likeliest_air(self, c):
        """The one of all airs."""
        every = [(warmer_k, drier) for warmer_k in WARMER_K for drier in DRIER]
        best = self.likeliest(every, c._replace(noise=MORE))
        noise = MORE * max(self.pixels(best, self.seen).left_at(c)(MORE), 1.0)
        for k, octaves in STEPS:
            warmer = [best[0] + i * k for i in (-1, 0, 1)]
            drier = [float(np.clip(best[1] + i * octaves, *DRIEST)) for i in (-1, 0, 1)]
            best = self.likeliest([*product(warmer, drier)], c._replace(noise=noise))
        return best

    def fit(self, at):
        """Whether the pixels fit."""
        return fits(self.pixels(at, self.seen).left(RIGHT), self.part)

    def tell_gains(self, at):
        """Whether they can reveal gains of the bands."""
        return self.pixels(at, self.seen).tell_bands_from_curves

    def likeliest_gains(self, some):
        """Calibration with the gain or the band gains, found under the skies of some airs, that
        make pixels likeliest."""
        nats = {RIGHT: self.nats(some[0], RIGHT)}
        of_all = (GAIN,) if self.part.bands >= FEW_UNDER_SKY else ()
        for at in some:
            under, every = self.pixels(at, self.seen), self.pixels(at, None)
            nats_of = NegativeLogEvidence(partial(under.nats, self.look), self.look.at_once)
            gain, _ = one_error(nats_of, False, of_all)
            bands = band_gains(
                self.part, every.environment, every.maps, self.library, every.quartile, doubted=True
            )
            for c in (gain, bands or RIGHT):
                if c != RIGHT:
                    nats[c] = nats_of(c)
        loss = losses(nats)
        return min(loss, key=loss.get)
