"""A camera's Calibration, and correcting a cube and its environment with it.

A camera of gain g, band gains g_b and offset o shows g g_b S'_b + o, where S'_b is the radiance
before it: that of the scene, S_b, or what air makes of it (`physics.air`). The bands b may lie at
other wavelengths than stated.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from physics.air import Air
from physics.cube.heat_cube import MAX_NETD_K
from physics.machinery import scratch
from physics.planck import noise_sigma, planck_derivative

DARKEST = 0.05  # least share of a radiance that a correction leaves
STEP = 0.1  # of ln metres, if each pixel has its own distance


class Calibration(NamedTuple):
    """Errors of a camera, and the air before it.

    gain, offset_k  of all bands together, the offset in K at 300 K
    shift_um  by which wavelengths are stated too long
    noise    factor on the stated NETD
    misfit   residual of the best-fitting quarter of the pixels, in stated noise units, at least 1
    shared   error that all bands may therefore share, in stated noise units
    suspected_k  change in T, K, if errors that are likelier but not certain were corrected
    curves   error of the library's emissivity that is allowed for
    bands    relative gains of the bands; () if they agree
    air      Air between scene and camera; None if there is too little to tell
    air_error  one standard deviation of its optical depth in each band, as a fraction of it
    contrast_k  K by which half of the ground behind it differs from it; used with air_error only
    air_error_k  change in T, K, if that much of it were off in many bands together
    error_at  Air of whose optical depth air_error is a fraction; None: its own
    """

    gain: float = 1.0
    offset_k: float = 0.0
    shift_um: float = 0.0
    noise: float = 1.0
    misfit: float = 1.0
    shared: float = 0.0
    suspected_k: float = 0.0
    curves: float = 0.0
    bands: tuple[float, ...] = ()
    air: Air | None = None
    air_error: float = 0.0
    contrast_k: float = 0.0
    air_error_k: float = 0.0
    error_at: Air | None = None

    @property
    def keeps_cube(self):
        """Whether there is nothing to correct in a cube."""
        return self._replace(suspected_k=0.0, curves=0.0) == RIGHT

    @property
    def keeps_radiance(self):
        """Whether nothing is wrong except noise, wavelengths and the library's curves."""
        return self._replace(shift_um=0.0, noise=1.0, misfit=1.0, shared=0.0).keeps_cube

    def of_bands(self, n):
        """(n,) relative gains of n bands."""
        return np.array(self.bands) if self.bands else np.ones(n)


RIGHT = Calibration()


class Distances(NamedTuple):
    """metres (height, width) of Air before each pixel; far, those before a far one."""

    metres: np.ndarray
    far: float


def corrected(cube, c, distances=None):
    """The HeatCube that a perfect camera would have shown, given a Calibration, and the Distances
    of what each pixel shows (None: the length of its Air for all).

    The noise is the same for all pixels but not for all bands: in a band that transmits a tenth it
    is ten times as much. With several distances it is that of a far one, whose opaque bands would
    mislead, while those of a near one say little anyway. An air_error adds as much noise as it
    changes half of the ground."""
    if c.shift_um:
        cube = cube.moved(c.shift_um)
    w = cube.wavelength_um
    far = c if distances is None else behind(c, distances.far, cube.nodes_um)
    _, gains = _offset_and_gain(w, far)
    # equally informative uniform noise (relative band gains are 1 in the mean)
    mean = math.sqrt(np.mean((gains / c.of_bands(cube.bands)) ** 2))
    netd_k = min(cube.netd_k * c.noise / mean, MAX_NETD_K)
    quiet = cube.quiet / c.noise**2  # pixels do scatter by what the noise is raised for
    if c.keeps_radiance:
        return replace(cube, netd_k=netd_k, quiet=quiet)
    at, some = 0, [c]
    if distances is not None:
        at, some = _by_distance(distances.metres, c, cube.nodes_um)
    all_of = np.array([_offset_and_gain(w, each) for each in some], np.float32)
    radiance = scratch.zeros(cube.radiance.shape, np.float32)
    for b, band in enumerate(scratch.parts(cube.radiance)):
        offset, gain = all_of[at, 0, b], all_of[at, 1, b]
        radiance[b] = _corrected(band, offset, gain)
        scratch.release(radiance)
    radiance.setflags(write=False)
    relative_noise = cube.relative_noise * mean / gains
    if far.air and far.air_error:
        more = _absorption_noise(far, w) / noise_sigma(w, netd_k)
        relative_noise = np.hypot(relative_noise, more)
    return replace(
        cube, radiance=radiance, netd_k=netd_k, relative_noise=relative_noise, quiet=quiet
    )


def _absorption_noise(c, wavelength_um):
    """(bands,) change of S, where it differs by a Calibration's contrast_k from its air, if the
    optical depth is off by air_error: S' = t S + (1 - t) B changes by (S - B) dt, and
    S = (S' - (1 - t) B) / t by that over t.
    """
    slope = planck_derivative(wavelength_um, c.air.temperature_k)
    t = np.array((c.error_at or c.air).transmittance)
    of_shown = c.air_error * -t * np.log(t) * slope * c.contrast_k
    return of_shown / np.array(c.air.transmittance)


def _by_distance(metres, c, nodes_um):
    """Indices (height, width) into a list of Calibrations, and that list, with the length of Air
    before each pixel, to STEP."""
    steps = np.round(np.log(metres / c.air.metres) / STEP).astype(int)
    numbers = range(steps.min(), steps.max() + 1)
    some = [behind(c, c.air.metres * math.exp(STEP * n), nodes_um) for n in numbers]
    return steps - numbers[0], some


def behind(c, metres, nodes_um):
    """A Calibration with so many metres of its Air, for bands with nodes (bands, n) in um."""
    air = Air.of(metres, c.air.temperature_k, nodes_um, c.air.absorption)
    return c._replace(air=air)


def corrected_environment(environment, c):
    """The Environment corrected likewise. There is no air before the sky that lights it from
    overhead, and a sky not in view was not seen by the camera."""
    environment = replace(environment, wavelength_um=environment.wavelength_um - c.shift_um)
    offset, gain = _offset_and_gain(environment.wavelength_um, c)
    before_sky = c._replace(air=None) if environment.sky_mean is not None else RIGHT
    own_offset, own_gain = _offset_and_gain(environment.wavelength_um, before_sky)
    radiance, sky = _corrected(environment.radiance, offset, gain), list(environment.sky)
    radiance[sky] = _corrected(environment.radiance[sky], own_offset, own_gain)
    mean = environment.sky_mean
    environment = replace(
        environment, radiance=radiance, spread=environment.spread / gain,
        skylight_spread=environment.skylight_spread / own_gain,
        curve_spread=environment.curve_spread / gain, sky_spread=environment.sky_spread / gain,
        sky_mean=None if mean is None else _corrected(mean, offset, gain),
    )  # fmt: skip
    return environment.with_curves_off_by(c.curves) if c.curves else environment


def _offset_and_gain(wavelength_um, c):
    """(bands,) each, acting on S."""
    offset, gain = noise_sigma(wavelength_um, c.offset_k), c.gain * c.of_bands(len(wavelength_um))
    if c.air is None:
        return offset, gain
    return offset + gain * np.array(c.air.path_radiance), gain * np.array(c.air.transmittance)


def _corrected(radiance, offset, gain):
    # the sky overhead, not in view, may be darker than an offset
    return np.maximum((radiance - offset) / gain, DARKEST * radiance)


def lifted_nats(cube, c):
    """(height, width) nats against a HeatCube being so dark that a Calibration would make it darker
    than DARKEST, which `corrected` prevents and so hides."""
    nats = np.zeros(cube.shape)
    if c.keeps_radiance:
        return nats
    offset, gain = _offset_and_gain(cube.wavelength_um - c.shift_um, c)
    for band, o, g, sigma in zip(cube.radiance, offset, gain, cube.sigma * c.noise, strict=True):
        lifted = np.maximum(DARKEST * g * band - (band - o), 0)
        nats += (lifted / sigma) ** 2 / 2
    return nats
