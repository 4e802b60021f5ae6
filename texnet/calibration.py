"""Gain or offset of the camera, where the scene itself shows it.

A camera of gain g and offset o shows g S + o. Of Eq. 1 only the glow is known beforehand; the
light that is reflected was seen by the same camera, so that with e, T and V as they are it shows

    g S + o = e (g B(T) + o) + (1 - e) X',       X' = g X + o

g B(T) is B at no other T. One pixel's V may make up for that, but in many pixels V would have to
leave the simplex. An offset shows less: what it adds to a body at 300 K looks like another T, and
only colder surfaces tell them apart.

Of all gains alone and all offsets alone that one is taken by which the pixels are likeliest, if it
is by far, and if not one of the other kind does nearly as well; an offset only where the sky is in
view. A pixel counts at most ENOUGH nats:
what the library does not explain has no more to say.

The constants were found on scenes of no test with 9 and 54 bands: right cameras, gains and offsets
off by 1 to 10 % and 1 to 3 K, libraries whose curves are 1 to 5 % wrong or that lack a common
material, little sky in view, wavelengths off by a tenth of a band.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from physics import scratch
from physics.heat_cube import HeatCube
from physics.planck import noise_sigma

LEAST_BANDS = 6  # fewer say too little: a library's errors look like a gain's
SAMPLES = 500  # pixels
ENOUGH = 5.0  # nats above the typical pixel's
LEAD = 0.25  # nats per pixel over the best of the other kind
DARKEST = 0.05  # what is left of a radiance, at least
DOUBT_K = 0.25  # what a calibration so found may still be off by, at 300 K


class Calibration(NamedTuple):
    """What a camera shows, over what there is: gain, and offset in K at 300 K."""

    gain: float = 1.0
    offset_k: float = 0.0


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


RIGHT = Calibration()
GAIN = Kind(lambda error: Calibration(gain=1 + error), 0.01, 0.15, (0.01, 0.03, 0.1), 0.0075, 1.0)
OFFSET = Kind(lambda error: Calibration(offset_k=error), 0.5, 4.0, (1.0,), 0.5, 2.0)
KINDS = GAIN, OFFSET


def calibration(cube, environment, misfit):
    """Calibration of a HeatCube with its NETD, of whose scene environment is the Environment.

    misfit  (HeatCube, Environment) -> (P,) nats, minus the log evidence of every pixel
    """
    if cube.bands < LEAST_BANDS:
        return RIGHT
    part, seen = _sample(cube), {}

    def look(kind, errors):
        for c in [RIGHT, *map(kind.of, errors)]:
            if c not in seen:
                seen[c] = misfit(corrected(part, c), corrected_environment(environment, c))

    for kind in KINDS:
        look(kind, [sign * error for error in kind.first for sign in (-1, 1)])
    if all(nats.mean() >= seen[RIGHT].mean() for nats in seen.values()):
        return RIGHT
    best = []
    for kind in KINDS:
        n = round(kind.most / kind.step)
        errors = [kind.step * i for i in range(-n, n + 1) if i]
        look(kind, errors)
        loss = _losses(seen)
        error = min(errors, key=lambda error: loss[kind.of(error)])  # noqa: B023
        around = [error - kind.step / 2, error, error + kind.step / 2]
        look(kind, around)
        best.append((kind, around))
    loss = _losses(seen)
    (kind, around), (other, beside) = sorted(best, key=lambda b: loss[b[0].of(b[1][1])])
    least = loss[kind.of(around[1])]
    if loss[RIGHT] - least < kind.worth or loss[other.of(beside[1])] - least < LEAD:
        return RIGHT
    if kind is OFFSET and environment.sky_mean is None:  # a sky that was missed looks like one
        return RIGHT
    error = around[1] + kind.step / 2 * _lowest(*(loss[kind.of(e)] for e in around))
    return kind.of(round(error, 4)) if abs(error) >= kind.least else RIGHT


def corrected(cube, c):
    """The HeatCube that a right camera would have shown, of a Calibration."""
    offset = noise_sigma(cube.wavelength_um, c.offset_k).astype(np.float32)
    radiance = scratch.empty(cube.radiance.shape, np.float32)
    for to, band, o in zip(radiance, scratch.parts(cube.radiance), offset, strict=True):
        to[:] = _corrected(band, o, np.float32(c.gain))
        scratch.release(radiance)
    radiance.setflags(write=False)
    return HeatCube(radiance, cube.wavelength_um, cube.fwhm_um, cube.netd_k / c.gain)


def corrected_environment(environment, c):
    """The Environment likewise."""
    offset = noise_sigma(environment.wavelength_um, c.offset_k)
    spectra = "radiance", "sky_mean"
    deviations = "spread", "skylight_spread", "sky_spread"
    given = {n: a for n in spectra if (a := getattr(environment, n)) is not None}
    return replace(
        environment, **{n: _corrected(a, offset, c.gain) for n, a in given.items()},
        **{n: getattr(environment, n) / c.gain for n in deviations},
    )  # fmt: skip


def _corrected(radiance, offset, gain):
    # the sky overhead, which is extrapolated, may be darker than an offset
    return np.maximum(radiance - offset, DARKEST * radiance) / gain


def _sample(cube):
    """A HeatCube of about SAMPLES of its pixels, in rows and columns."""
    step = max(1, int((cube.radiance[0].size / SAMPLES) ** 0.5))
    radiance = np.stack([band[::step, ::step] for band in scratch.parts(cube.radiance)])
    return HeatCube(radiance, cube.wavelength_um, cube.fwhm_um, cube.netd_k)


def _losses(seen):
    """{Calibration: nats per pixel} of {Calibration: misfit (P,)}."""
    most = min(np.median(nats) for nats in seen.values()) + ENOUGH
    return {c: np.minimum(nats, most).mean() for c, nats in seen.items()}


def _lowest(below, at, above):
    """Where a parabola through values at -1, 0 and 1 is least, within these."""
    bend = below - 2 * at + above
    return float(np.clip(0.5 * (below - above) / bend, -1, 1)) if bend > 0 else 0.0
