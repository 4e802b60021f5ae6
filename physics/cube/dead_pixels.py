"""Pixels without a measurement: found by values that no scene has in a band that shows the scene,
and given the spectrum of the nearest pixel that is not dead.

That spectrum is no measurement, so the answer for such a pixel must be called unknown. Every
detector has a few dead pixels. A band in which more pixels are dead is itself dead, and says
nothing about any pixel. Beyond the edges of an orthorectified picture nothing was seen: there every
band holds zero, NaN or infinity, in however many pixels.
"""

import numpy as np

from ..errors import Implausible
from ..machinery import scratch
from ..planck import planck

FEW = 0.05  # of the pixels that hold anything may be dead; more are a wrong calibration
HOTTEST_K = 1e4  # of any pixel; beyond it a detector is dead
# of a band's median: noise around no light, what then stands for it, and what a pixel that is so
# shows in another band, at least
FAINT, FLOOR, SHOWN = 0.1, 1e-3, 0.3
MANY = 8  # pixels of a band that are so


def lit(radiance):
    """Where radiance is finite and positive."""
    return (radiance > 0) & (radiance < np.inf)


def lifted(radiance):
    """radiance (bands, height, width) whose values around zero are positive: a sky so cold that
    noise takes some of its bands below, though others show it. Itself if there are none, else a
    read-only copy."""
    if not any(_below_zero(band) for band in scratch.parts(radiance)):
        return radiance
    usual, shown = np.zeros(len(radiance)), np.zeros(radiance.shape[1:], bool)
    for b, band in enumerate(scratch.parts(radiance)):
        light = band[lit(band)]
        if light.size:
            usual[b] = np.median(light)
            shown |= lit(band) & (band > SHOWN * usual[b])
    copy = scratch.zeros(radiance.shape, np.float32)
    for to, band, m in zip(copy, scratch.parts(radiance), usual, strict=True):
        faint = shown & (band < 0) & (band > -FAINT * m)
        alone = np.count_nonzero(faint) < MANY  # as a detector is that is stuck
        to[:] = band if alone else np.where(faint, np.float32(FLOOR * m), band)
        scratch.release(copy)
    copy.setflags(write=False)
    return copy


def dead_pixels(radiance, wavelength_um, stated=False):
    """Of radiance (bands, height, width), W m-2 sr-1 um-1: (height, width) bool, the dead pixels;
    (bands,) bool, the dead bands; and whether any of these holds numbers that look like radiance.

    stated  (height, width) bool: pixels that are known to be dead, however many

    Raises InputError where more than half of the bands are dead, or more than FEW of the pixels
    that hold anything, or none holds anything.
    """
    limit = planck(wavelength_um, HOTTEST_K)
    empty, suspect = np.ones(radiance.shape[1:], bool), np.zeros(len(radiance), bool)
    for b, band in enumerate(scratch.parts(radiance)):
        empty &= (band == 0) | ~np.isfinite(band)
        suspect[b] = _bad(band, limit[b]).any()
    empty |= stated
    of = empty.size - np.count_nonzero(empty)
    if not of:
        raise Implausible("cube: all of its pixels are zero, NaN or infinite in every band.")
    dead, share, misleads = empty.copy(), np.zeros(len(radiance)), False
    for b in np.flatnonzero(suspect):
        bad = _bad(radiance[b], limit[b]) & ~empty
        share[b] = np.count_nonzero(bad) / of
        if share[b] <= FEW:
            dead |= bad
        else:
            misleads |= lit(radiance[b]).any()
        scratch.release(radiance)
    half = float(np.quantile(share, 0.5, method="lower"))
    dead_of_them = np.count_nonzero(dead & ~empty) / of
    if max(half, dead_of_them) > FEW:
        b = np.flatnonzero(share > FEW if half > FEW else (share > 0) & (share <= FEW))[0]
        row, column = np.argwhere(_bad(radiance[b], limit[b]) & ~empty)[0]
        raise Implausible(
            f"cube: {max(half, dead_of_them):.0%} of its pixels are dead (zero, negative, NaN, "
            f"infinite or hotter than {HOTTEST_K:.0f} K), the first at {wavelength_um[b]:.5g} um, "
            f"row {row}, column {column} ({radiance[b, row, column]:.4g}), and at most {FEW:.0%} "
            "may be, not counting those without data in any band; cut edges off, leave bands out, "
            "check interleave, byte order, lines, samples and the calibration, or set missing "
            "values to NaN (ENVI: data ignore value)."
        )
    return dead, share > FEW, misleads


def gaps(dead):
    """Of dead pixels (height, width): those in areas of three pixels and more across, as beyond the
    edge of a picture. Smaller clusters are the detector's, and are filled by their neighbours."""
    from scipy.ndimage import binary_opening  # few cubes need it

    if not dead.any():
        return dead
    beyond = np.pad(dead, 1, mode="edge")
    return binary_opening(beyond, np.ones((3, 3)))[1:-1, 1:-1]


def filled(radiance, dead, dark):
    """radiance (bands, height, width) whose dead pixels (height, width) hold the spectrum of the
    nearest that is not dead, and whose dark bands (bands,) hold NaN; itself if it is so already,
    else a read-only copy."""
    row, column = _nearest(dead)

    def right(band, blank):
        return not lit(band).any() if blank else np.array_equal(band[dead], band[row, column])

    if all(right(*of) for of in zip(scratch.parts(radiance), dark, strict=True)):
        return radiance
    return _copy(radiance, dead, lambda band: band[row, column], dark)


def without_dead(radiance, dead):
    """A copy of radiance, read-only, whose dead pixels are NaN."""
    return _copy(radiance, dead, lambda band: np.nan, np.zeros(len(radiance), bool))


def _below_zero(band):
    least = band.min()  # several times faster than looking at each
    return least < 0 or (np.isnan(least) and (band < 0).any())


def _bad(band, limit):
    return ~((band > 0) & (band <= limit))  # so of a NaN


def _nearest(dead):
    """Rows and columns of the sound pixels nearest to the dead ones, in their order."""
    from scipy.ndimage import distance_transform_edt  # few cubes need it

    return distance_transform_edt(dead, return_distances=False, return_indices=True)[:, dead]


def _copy(radiance, dead, by, dark):
    copy = scratch.zeros(radiance.shape, np.float32)
    for to, band, blank in zip(copy, scratch.parts(radiance), dark, strict=True):
        to[:] = band
        to[dead] = by(band)
        if blank:
            to[:] = np.nan
        scratch.release(copy)
    copy.setflags(write=False)
    return copy
