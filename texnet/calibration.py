"""Gains or offset of the camera, and its noise, where the scene itself shows them.

A camera of gain g and offset o shows g S + o. Of Eq. 1 only the glow is known beforehand; the
light that is reflected was seen by the same camera, so that with e, T and V as they are it shows

    g S + o = e (g B(T) + o) + (1 - e) X',       X' = g X + o

g B(T) is B at no other T. One pixel's V may make up for that, but in many pixels V would have to
leave the simplex. An offset shows less: what it adds to a body at 300 K looks like another T, and
only colder surfaces tell them apart.

Of all gains alone and all offsets alone that one is taken by which the pixels are likeliest, if it
is by far, if not one of the other kind does nearly as well, if with it they fit, and if it is not
the last that was tried; an offset only where the sky is in view. A pixel counts at most ENOUGH
nats: what the library does not explain has no more to say.

What nothing in the library fits at the noise that is stated shows less than one would think: wrong
materials make up for wrong curves and bands, mirrors above all. At more noise they have less
to make up for, and their evidence loses. So the noise is first taken to be FIRST times as much as
stated (of few bands MORE times: at so much noise they tell no materials), and then MORE times what
is left even of the pixels that fit best, until that does not change (`_left`). If it is the noise
that was stated, all is well. If not, it may be the bands among each other, if with gains of their
own (`band_gains`) nothing else is left. Else it is the library's curves, or k is too small: MORE
times what is left (MORE_OF_FEW, of few bands) is taken for noise, by and by from where it just
fits, because what is wrong is so in many bands and pixels alike and misleads more than noise.

The constants were found on scenes of no test with 9 and 54 bands: right cameras, gains and offsets
off by 1 to 10 % and 1 to 3 K, bands off by 0.1 to 1 % among each other, libraries whose curves are
1 to 5 % wrong or that lack a common material, little sky in view, wavelengths off by a tenth of a
band.
"""

from typing import NamedTuple

import numpy as np

from physics import scratch
from physics.errors import InputError
from physics.heat_cube import MAX_NETD_K, HeatCube
from physics.planck import brightness_temperature, radiance_derivative
from physics.planck import radiance as planck

from .band_gains import FIRST, band_gains, ground
from .correction import RIGHT, Calibration, corrected, corrected_environment

LEAST_PIXELS, LEAST_GROUND = 100, 20  # in all; that are not sky
LEAST_BANDS = 6  # fewer say too little: a library's errors look like a gain's
LEAST_FOR_GAINS = 12  # of the bands; T, V and the material explain too much of fewer
LEAST_OBJECTS = 2  # likewise: what one object misses, it misses in all materials
SAMPLES, FAR_K = 500, 50.0  # pixels; above the hottest fiftieth of them
ENOUGH = 5.0  # nats above the typical pixel's
LEAD = 0.25  # nats per pixel over the best of the other kind
QUARTER = 0.25  # of the pixels: those that fit best
JUST, PER_BAND = 1.03, 3.0  # noise units left of a right camera: JUST + PER_BAND / bands at most
RISE = 0.1  # more than that, and it is not right
RAMP = 0.3  # so much more, and all that is left is noise
MORE, MORE_OF_FEW = 4.0, 2.8  # times the noise
LESS, LOOKS = 0.9, 24  # of the noise, and no longer the same; at most
# what a calibration so found may still be off by, at 300 K, and as a share of the bands' gains
DOUBT_K, SHARE = 0.25, 0.7


class Kind(NamedTuple):
    """What may be wrong: of(error) is its Calibration; the steps of the search and how far it
    goes; which errors are looked at first; the least that counts, and the nats per pixel that it
    must gain."""

    of: object
    step: float
    most: float
    first: tuple[float, ...]
    least: float
    worth: float


class Best(NamedTuple):
    """The error of a kind by which the pixels are likeliest, with half a step to both sides."""

    kind: Kind
    error: float
    around: tuple[Calibration, Calibration, Calibration]

    @property
    def at_end(self):
        """Whether the search ended there."""
        return abs(self.error) > self.kind.most - self.kind.step / 2


GAIN = Kind(lambda error: Calibration(gain=1 + error), 0.01, 0.15, (0.01, 0.03, 0.1), 0.0075, 1.0)
OFFSET = Kind(lambda error: Calibration(offset_k=error), 0.5, 4.0, (1.0,), 0.5, 2.0)
KINDS = GAIN, OFFSET


def calibration(cube, environment, look, library, left_out=None):
    """Calibration of a HeatCube with its NETD, of whose scene environment is the Environment.

    look      (Environment, HeatCube, seen, expected, regions, alike) -> maps of its pixels by a
              method, as `pipeline` has them
    left_out  (height, width) bool: pixels that say nothing, being saturated or dead
    """
    part = _sample(cube, left_out)
    if cube.bands < LEAST_BANDS or part.radiance[0].size < LEAST_PIXELS:
        return RIGHT
    every = np.arange(len(library))

    def answer(surroundings, part, alike=None):
        return look(surroundings, part, every, None, None, alike)

    def quarter(maps):
        residual = maps["residual"][ground(maps, library) & np.isfinite(maps["residual"])]
        return float(np.quantile(residual, QUARTER)) if residual.size >= LEAST_GROUND else 0.0

    nats, alike = {}, {}

    def see(all_of):
        for c in all_of:
            if c not in nats:
                try:
                    maps = answer(corrected_environment(environment, c), corrected(part, c), alike)
                    of_all = -maps["log_evidence"].ravel()
                except InputError:  # nothing looks like that
                    of_all = np.full(part.radiance[0].size, np.inf)
                nats[c] = np.where(np.isfinite(of_all), of_all, np.inf).astype(np.float64)

    def left(c):
        """_left of what is corrected by a Calibration."""
        stated = corrected(part, c).netd_k

        def at(noise):
            noisy = c._replace(noise=noise)
            taken = corrected(part, noisy)
            return quarter(answer(corrected_environment(environment, noisy), taken)) * (
                taken.netd_k / stated
            )

        return _left(at, rises=few)

    few = cube.bands < LEAST_FOR_GAINS
    just = JUST + PER_BAND / cube.bands
    found = _gain_or_offset(environment, see, nats)
    misfit = left(found)
    if misfit > just + RISE and found != RIGHT:
        found, misfit = RIGHT, left(RIGHT)
    if misfit > just + RISE and not few and len(environment) >= LEAST_OBJECTS:
        evened = band_gains(part, environment, answer, library, quarter)
        if evened is not None and (less := left(evened)) <= just + RISE:
            found, misfit = evened, less
    if misfit <= just:
        return found
    # no step, for what lies just beside it
    more = MORE_OF_FEW if few else MORE
    noise = (more * misfit) ** min((misfit - just) / RAMP, 1.0)
    noise = min(round(noise, 3), MAX_NETD_K / cube.netd_k)
    return found._replace(noise=noise, misfit=misfit) if noise > 1 else found


def _left(at, rises):
    """What is left even of the pixels that fit best, in noise units as stated; at(noise) is that
    where the noise is taken to be so many times as much, from FIRST down or from MORE up."""
    noise = MORE if rises else FIRST
    left = at(noise)
    for _ in range(LOOKS):
        last, noise = noise, min(MORE * max(left, 1.0), FIRST)
        if (noise < last / LESS) if rises else (noise > LESS * last):
            break
        before, left = left, at(noise)
        if rises and left / before >= noise / last:  # it is the noise that is assumed, no more
            return before
    return left


def _gain_or_offset(environment, see, nats):
    """The Calibration that see, which fills nats, finds best; RIGHT if none is by far.

    A first look at a few errors tells whether there is anything to find. Then all steps of both
    kinds are tried, half a step around the best of each, and the lowest of a parabola there.
    """
    see([RIGHT, *(k.of(sign * error) for k in KINDS for error in k.first for sign in (-1, 1))])
    loss = _losses(nats, np.median(nats[RIGHT]))
    if min(loss, key=loss.get) == RIGHT:
        return RIGHT
    best = [_best_of(kind, see, nats) for kind in KINDS]
    loss = _losses(nats)
    one, other = sorted(best, key=lambda b: loss[b.around[1]])
    gained, lead = loss[RIGHT] - loss[one.around[1]], loss[other.around[1]] - loss[one.around[1]]
    if gained < one.kind.worth or lead < LEAD:
        return RIGHT
    if one.at_end or (other.at_end and lead < gained / 2):  # what is right may lie beyond
        return RIGHT
    if one.kind is OFFSET and environment.sky_mean is None:  # a sky that was missed looks like one
        return RIGHT
    error = one.error + one.kind.step / 2 * _lowest(*(loss[c] for c in one.around))
    if abs(error) < one.kind.least:
        return RIGHT
    return one.kind.of(round(error, 4))


def _best_of(kind, see, nats):
    """The Best of all steps of a Kind."""
    n = round(kind.most / kind.step)
    errors = {kind.of(kind.step * i): kind.step * i for i in range(-n, n + 1) if i}
    see(errors)
    loss = _losses(nats)
    error = errors[min(errors, key=loss.get)]
    around = tuple(kind.of(error + side * kind.step / 2) for side in (-1, 0, 1))
    see(around)
    return Best(kind, error, around)


def doubt_k(c, cube):
    """By how much the radiance of a corrected cube may still be off in all pixels together, K at
    300 K: where bands are wrong among each other by about what was called noise, and by a share of
    what they were corrected by."""
    noise = cube.netd_k * (1 - 1 / c.noise)
    if c.keeps_radiance:
        return noise
    w = cube.wavelength_um
    off = (c.of_bands(cube.bands) - 1) * planck(w, 300.0) / radiance_derivative(w, 300.0)
    return float(np.sqrt(DOUBT_K**2 + SHARE**2 * np.mean(off**2) + noise**2))


def _sample(cube, left_out=None):
    """A HeatCube of about SAMPLES of its pixels, in rows and columns. Those that are left out or
    far hotter than all others, for whose sake T would have to be sought far away, are replaced by
    a usual one."""
    height, width = cube.shape
    down = min(max(1, int((height * width / SAMPLES) ** 0.5)), height)
    across = max(1, -(-height // down) * width // SAMPLES)
    bands = scratch.parts(cube.radiance)
    radiance = np.stack([band[::down, ::across] for band in bands])
    t = brightness_temperature(cube.wavelength_um[:, None, None], radiance).mean(axis=0)
    bad = t > np.quantile(t, 0.98) + FAR_K
    if left_out is not None:
        bad |= left_out[::down, ::across]
    usual = np.argsort(np.where(bad, np.inf, t), axis=None)[(t.size - np.count_nonzero(bad)) // 2]
    radiance[:, bad] = radiance.reshape(cube.bands, -1)[:, usual, None]
    return HeatCube(radiance, cube.wavelength_um, cube.fwhm_um, cube.netd_k)


def _losses(all_nats, typical=None):
    """{Calibration: nats per pixel} of {Calibration: nats (P,)}, typical being those of the typical
    pixel: of the likeliest Calibration if None."""
    if typical is None:
        typical = min(np.median(nats) for nats in all_nats.values())
    return {c: np.minimum(nats, typical + ENOUGH).mean() for c, nats in all_nats.items()}


def _lowest(below, at, above):
    """Where a parabola through values at -1, 0 and 1 is least, within these."""
    bend = below - 2 * at + above
    return float(np.clip(0.5 * (below - above) / bend, -1, 1)) if bend > 0 else 0.0
