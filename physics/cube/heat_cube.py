"""HeatCube: what a thermal hyperspectral camera measured, checked once, then trusted."""

import math
from dataclasses import dataclass, field, replace

import numpy as np

from ..bands import BOX, RESPONSES, quadrature
from ..errors import Implausible, InputError
from ..machinery import scratch
from ..machinery.read_only import ReadOnly
from ..planck import brightness_temperature, noise_sigma
from .dead_pixels import dead_pixels, filled, lifted, without_dead
from .netd import estimated_netd

TYPICAL_K = (110.0, 1000.0)  # of half a scene; beyond, its unit is wrong
MIN_NETD_K, MAX_NETD_K = 1e-3, 10.0  # of an estimate, at least; beyond the other, it is in mK
# what k objects leave out of a scene's light, whatever the camera's noise. On scenes outside the
# test sets a camera of 5 mK was answered no better than at 20, with up to a quarter unknown
LEAST_NETD_K = 0.02


def numbers(values, what):
    """values as an array of real numbers; InputError, which starts with what, if they are not."""
    if np.ma.is_masked(values):
        raise InputError(f"{what} must not be masked anywhere; fill masked values or crop them.")
    try:
        array = np.asarray(values)
    except ValueError:  # lists of different lengths
        array = np.array(None)
    if array.dtype.kind not in "fiu":
        raise InputError(f"{what} must be real numbers.")
    return array


def check_wavelength(wavelength_um, what):
    """A validated (n,) float64 wavelength axis in um; InputError says what is wrong."""
    w = numbers(wavelength_um, f"{what}: wavelengths").astype(np.float64)
    if w.ndim != 1 or w.size == 0:
        raise InputError(f"{what}: wavelengths must be one list of numbers, got shape {w.shape}.")
    if not np.isfinite(w).all() or (w <= 0).any():
        raise InputError(f"{what}: wavelengths must be finite and positive.")
    if w.max() > 100:
        raise InputError(
            f"{what}: wavelengths reach {w.max():g}, which looks like nm or cm-1; give them in um."
        )
    if (np.diff(w) <= 0).any():
        done = ", as texnet import does" * (what == "cube")
        raise InputError(f"{what}: wavelengths must ascend without repeats; sort them{done}.")
    w.setflags(write=False)
    return w


def sampling_step(shape, at_least):
    """The stride over row-major pixels that picks at_least so many of them, and of all columns
    equally: it shares no factor with the width."""
    step = max(1, shape[0] * shape[1] // at_least)
    while math.gcd(step, shape[1]) > 1:
        step -= 1
    return step


def check_response(response, what):
    """InputError unless it is one of `bands.RESPONSES`."""
    if response not in RESPONSES:
        raise InputError(f"{what}: response must be {' or '.join(RESPONSES)}, got {response!r}.")


@dataclass(frozen=True, eq=False, repr=False)
class HeatCube(ReadOnly):
    """A heat cube S, immutable.

    radiance       (bands, height, width) float32, W m-2 sr-1 um-1, finite and positive, but for
                   bands that hold nothing (`bad_bands` finds them), and pixels that are dead, few
                   or beyond a picture's edge, which are given a neighbour's (`dead_pixels`);
                   copied unless it is read-only, and then never to be written to
    wavelength_um  (bands,) band centres in um, ascending
    fwhm_um        (bands,) full width of each band at half maximum, in um; zeros if narrow
    response       of the bands, "box" or "gaussian", of which that is the width
    netd_k         noise as a temperature difference at 300 K, in K; None if not known
    dead           (height, width) bool, pixels that were not measured, as the camera's maker may
                   say; those that are found are added
    relative_noise  (bands,) noise of each band over that which netd_k says, where a camera's bands
                   differ, or as air leaves it that was taken out (`texnet.camera.correction`);
                   1 of all if None; not kept in files
    quiet          (bands,) share of that noise's variance, 0 to 1, that is the model's error and
                   not the camera's noise, so that pixels do not scatter by it (`prepared`); 0 of
                   all if None; not kept in files

    Raises InputError, in one sentence, where the data are not that.
    """

    radiance: np.ndarray
    wavelength_um: np.ndarray
    fwhm_um: np.ndarray | None = None
    netd_k: float | None = None
    dead: np.ndarray | None = None
    relative_noise: np.ndarray | None = field(default=None, kw_only=True)
    quiet: np.ndarray | None = field(default=None, kw_only=True)
    response: str = field(default=BOX, kw_only=True)

    def __post_init__(self):
        given = numbers(self.radiance, "cube: radiance")
        with np.errstate(over="ignore"):  # infinite, and so said to be
            s = np.asarray(given, dtype=np.float32)
        if s.flags.writeable and np.may_share_memory(s, given):
            s = s.copy()
        w = check_wavelength(self.wavelength_um, "cube")
        if s.ndim != 3 or 0 in s.shape:
            raise InputError(f"cube: radiance must be (bands, height, width), got {s.shape}.")
        if s.shape[0] != w.size:
            raise InputError(
                f"cube: {s.shape[0]} bands of radiance but {w.size} wavelengths; give one "
                "wavelength per band, bands first (texnet import --unit converts such files)."
            )
        stated = np.zeros(s.shape[1:], bool) if self.dead is None else np.asarray(self.dead)
        if stated.shape != s.shape[1:] or stated.dtype != bool or stated.all():
            raise InputError("cube: dead must be (height, width) bool, and not all true.")
        s = lifted(s)
        dead, dark, misleads = dead_pixels(s, w, stated)
        if misleads or dead.any():
            s = filled(s, dead, dark)
        some = np.quantile(np.flatnonzero(~dark), [0, 0.5, 1], method="lower")
        typical_k = np.median([brightness_temperature(w[b], np.median(s[b])) for b in some])
        low, high = TYPICAL_K
        if not low <= typical_k <= high:
            raise Implausible(
                f"cube: half of it looks {'hotter' if typical_k > high else 'colder'} than "
                f"{typical_k:.0f} K; give radiance in W m-2 sr-1 um-1 (1 microflick is 0.01 of "
                "it), as texnet import --unit does."
            )
        width = np.zeros_like(w)
        if self.fwhm_um is not None:
            width = numbers(self.fwhm_um, "cube: fwhm_um").astype(np.float64)
        if width.shape != w.shape or not np.isfinite(width).all() or (width < 0).any():
            raise InputError("cube: fwhm_um must hold one width >= 0 in um per band.")
        if (width > w).any():
            raise InputError(
                f"cube: fwhm_um reaches {width.max():g}, more than its band's wavelength; give it "
                "in um."
            )
        check_response(self.response, "cube")
        netd = numbers(1.0 if self.netd_k is None else self.netd_k, "cube: NETD")
        if netd.ndim or not 0 < netd <= MAX_NETD_K:
            raise InputError(
                f"cube: NETD must be above 0 and at most {MAX_NETD_K:g} K, got {self.netd_k}; "
                "give it in K, not in mK."
            )
        relative, quiet = np.ones_like(w), np.zeros_like(w)
        if self.relative_noise is not None:
            relative = numbers(self.relative_noise, "cube: relative_noise").astype(np.float64)
        if relative.shape != w.shape or not (np.isfinite(relative) & (relative > 0)).all():
            raise InputError("cube: relative_noise must hold one number above 0 per band.")
        if self.quiet is not None:
            quiet = numbers(self.quiet, "cube: quiet").astype(np.float64)
        if quiet.shape != w.shape or not ((quiet >= 0) & (quiet <= 1)).all():
            raise InputError("cube: quiet must hold one number from 0 to 1 per band.")
        self._set(
            radiance=s, wavelength_um=w, fwhm_um=width, dead=dead, relative_noise=relative,
            quiet=quiet, netd_k=None if self.netd_k is None else float(netd),
        )  # fmt: skip

    def __repr__(self):
        w, (height, width) = self.wavelength_um, self.shape
        netd = "not known"
        if self.netd_k is not None:
            netd = f"{1e3 * self.netd_k:.3g} mK" if self.netd_k < 1 else f"{self.netd_k:.3g} K"
        return (
            f"<HeatCube of {height} x {width} pixels, {self.bands} bands at {w[0]:.4g}-{w[-1]:.4g} "
            f"um, NETD {netd}>"
        )

    @property
    def bands(self):
        return self.radiance.shape[0]

    @property
    def shape(self):
        """(height, width)"""
        return self.radiance.shape[1:]

    @property
    def nodes_um(self):
        """(bands, n) um, wavelengths whose plain mean is each band's (`bands.quadrature`)."""
        return quadrature(self.wavelength_um, self.fwhm_um, self.response)

    @property
    def measured_count(self):
        """How many pixels are not dead."""
        return self.dead.size - np.count_nonzero(self.dead)

    @property
    def spectra(self):
        """(height * width, bands) float32, one row per pixel, row-major; a view."""
        return self.radiance.reshape(self.bands, -1).T

    def sample(self, at_least):
        """(n, bands) float64 spectra of a regular subsample of about at_least so many pixels, if
        there are, and a few times that at most; none of them dead."""
        return self.pixels(self.regular_pixels(at_least))

    def regular_pixels(self, at_least):
        """(n,) ascending indices into `spectra` of the pixels of `sample`."""
        step = sampling_step(self.shape, at_least * self.dead.size // self.measured_count)
        at = np.arange(0, self.dead.size, step)
        at = at[~self.dead.reshape(-1)[at]]
        if 2 * len(at) < min(at_least, self.measured_count):  # the dead lie as regularly
            at = self.random_pixels(np.random.default_rng(0), at_least)
        return at

    def random_pixels(self, rng, at_most):
        """(n,) ascending indices into `spectra` of at_most pixels at random, none of them dead."""
        pick = rng.choice(self.measured_count, min(self.measured_count, at_most), replace=False)
        return np.sort(np.flatnonzero(~self.dead)[pick] if self.dead.any() else pick)

    def pixels(self, index):
        """(n, bands) float64 spectra of the pixels that index picks from `spectra`."""
        bands = scratch.parts(self.radiance)
        return np.stack([band.reshape(-1)[index].astype(np.float64) for band in bands], axis=1)

    def moved(self, shift_um):
        """The HeatCube whose bands lie so many um lower than they were said to."""
        return replace(self, wavelength_um=self.wavelength_um - shift_um)

    def only(self, good):
        """The HeatCube of some of its bands, (bands,) bool."""
        radiance = scratch.zeros((np.count_nonzero(good), *self.shape), np.float32)
        for to, b in zip(radiance, np.flatnonzero(good), strict=True):
            to[:] = self.radiance[b]
            scratch.release(self.radiance)
            scratch.release(radiance)
        radiance.setflags(write=False)
        return replace(
            self, radiance=radiance, wavelength_um=self.wavelength_um[good],
            fwhm_um=self.fwhm_um[good], relative_noise=self.relative_noise[good],
            quiet=self.quiet[good],
        )  # fmt: skip

    def measured(self):
        """radiance, but NaN where a pixel is dead."""
        return without_dead(self.radiance, self.dead) if self.dead.any() else self.radiance

    @property
    def sigma(self):
        """(bands,) noise standard deviation, W m-2 sr-1 um-1; needs netd_k."""
        if self.netd_k is None:
            raise InputError("cube: its NETD is not known; set netd_k or call with_netd().")
        return self.sigma_at(self.netd_k)

    def sigma_at(self, netd_k):
        """The same, were its NETD that, K at 300 K."""
        return noise_sigma(self.wavelength_um, netd_k) * self.relative_noise

    def with_netd(self):
        """This cube, with the NETD that its own pixels show where it is not known (`netd`).

        Raises InputError where there are too few pixels.
        """
        if self.netd_k is not None:
            return self
        netd_k = float(np.clip(estimated_netd(self), MIN_NETD_K, MAX_NETD_K))
        return replace(self, netd_k=netd_k)
