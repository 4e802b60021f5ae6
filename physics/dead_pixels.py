"""Pixels without a measurement, of which every detector has some: found by values that no scene
has in a band that shows the scene, and given the spectrum of the nearest pixel that is not dead.

That spectrum is no measurement: what a pixel so filled is answered is to be called unknown. A band
in which more than a few pixels are so is itself dead, and says nothing of any pixel.
"""

import numpy as np

from . import scratch
from .errors import InputError
from .planck import radiance as planck

MOST = 0.05  # of the pixels; more are an edge without data, or a wrong calibration
MAX_K = 1e4  # of any pixel; beyond it a detector is dead


def lit(radiance):
    """Where radiance is finite and positive."""
    return (radiance > 0) & (radiance < np.inf)


def dead_pixels(radiance, wavelength_um):
    """Of radiance (bands, height, width), W m-2 sr-1 um-1: (height, width) bool, the dead pixels;
    (bands,) bool, the dead bands; and whether any of these holds numbers that look like radiance.

    Raises InputError where more than half of the bands are dead, or more than MOST of the pixels.
    """
    dead, share = np.zeros(radiance.shape[1:], bool), np.zeros(len(radiance))
    first, misleads = [(0, 0)] * len(radiance), False
    for b, limit in enumerate(planck(wavelength_um, MAX_K)):
        bad = ~((radiance[b] > 0) & (radiance[b] <= limit))  # so of a NaN
        share[b] = bad.mean()
        if share[b]:
            first[b] = tuple(np.argwhere(bad)[0])
        if share[b] <= MOST:
            dead |= bad
        else:
            misleads |= lit(radiance[b]).any()
        scratch.release(radiance)
    half = float(np.quantile(share, 0.5, method="lower"))
    if max(half, dead.mean()) > MOST:
        b = np.flatnonzero(share if half > MOST else (share > 0) & (share <= MOST))[0]
        row, column = first[b]
        raise InputError(
            f"cube: {max(half, dead.mean()):.0%} of its pixels are dead (zero or negative, NaN or "
            f"infinite, or hotter than {MAX_K:.0f} K), the first at {wavelength_um[b]:.5g} um, row "
            f"{row}, column {column} ({radiance[b, row, column]:.4g}), and at most {MOST:.0%} may "
            "be; cut edges off, leave bands out, or check the calibration."
        )
    return dead, share > MOST, misleads


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


def _nearest(dead):
    """Rows and columns of the sound pixels nearest to the dead ones, in their order."""
    from scipy.ndimage import binary_dilation  # few cubes need it
    from scipy.spatial import KDTree

    # one step from the nearest towards the dead pixel, all is dead: it touches one
    edge = np.argwhere(binary_dilation(dead, np.ones((3, 3))) & ~dead)
    return edge[KDTree(edge).query(np.argwhere(dead))[1]].T


def _copy(radiance, dead, by, dark):
    copy = scratch.empty(radiance.shape, np.float32)
    for to, band, blank in zip(copy, scratch.parts(radiance), dark, strict=True):
        to[:] = band
        to[dead] = by(band)
        if blank:
            to[:] = np.nan
        scratch.release(copy)
    copy.setflags(write=False)
    return copy
