"""A camera's Calibration, and what a right camera would have shown instead.

A camera of gain g, bands' gains g_b and offset o shows g g_b S_b + o of a radiance S_b.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from physics import scratch
from physics.heat_cube import MAX_NETD_K
from physics.planck import noise_sigma

DARKEST = 0.05  # what is left of a radiance, at least


class Calibration(NamedTuple):
    """What is wrong with a camera.

    gain, offset_k  of all bands together, the offset in K at 300 K
    noise    factor on the stated NETD
    misfit   residual of the quarter of the pixels that fit best, in stated noise units, at least 1
    doubt    error that all bands may share for it, in stated noise units
    bands    their gains among each other; () if they agree
    """

    gain: float = 1.0
    offset_k: float = 0.0
    noise: float = 1.0
    misfit: float = 1.0
    doubt: float = 0.0
    bands: tuple[float, ...] = ()

    @property
    def keeps_radiance(self):
        """Whether nothing is wrong but the noise."""
        return self._replace(noise=1.0, misfit=1.0, doubt=0.0) == RIGHT

    def of_bands(self, n):
        """(n,) the gains among each other of so many bands."""
        return np.array(self.bands) if self.bands else np.ones(n)


RIGHT = Calibration()


def corrected(cube, c):
    """The HeatCube that a right camera would have shown, of a Calibration."""
    netd_k = min(cube.netd_k * c.noise / c.gain, MAX_NETD_K)
    if c.keeps_radiance:
        return replace(cube, netd_k=netd_k)
    offset, gain = (a.astype(np.float32) for a in _offset_and_gain(cube.wavelength_um, c))
    radiance = scratch.empty(cube.radiance.shape, np.float32)
    for to, band, o, g in zip(radiance, scratch.parts(cube.radiance), offset, gain, strict=True):
        to[:] = _corrected(band, o, g)
        scratch.release(radiance)
    radiance.setflags(write=False)
    return replace(cube, radiance=radiance, netd_k=netd_k)


def corrected_environment(environment, c):
    """The Environment likewise."""
    offset, gain = _offset_and_gain(environment.wavelength_um, c)
    spectra = "radiance", "sky_mean"
    deviations = "spread", "skylight_spread", "sky_spread"
    given = {n: a for n in spectra if (a := getattr(environment, n)) is not None}
    return replace(
        environment, **{n: _corrected(a, offset, gain) for n, a in given.items()},
        **{n: getattr(environment, n) / gain for n in deviations},
    )  # fmt: skip


def _offset_and_gain(wavelength_um, c):
    """(bands,) each."""
    return noise_sigma(wavelength_um, c.offset_k), c.gain * c.of_bands(len(wavelength_um))


def _corrected(radiance, offset, gain):
    # the sky overhead, which is extrapolated, may be darker than an offset
    return np.maximum(radiance - offset, DARKEST * radiance) / gain
