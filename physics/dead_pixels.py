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
    """(height, width) bool, the dead pixels of radiance (bands, height, width), W m-2 sr-1 um-1;
    and (bands,) the share of pixels that are so in each band, of which those above MOST are dead.

    Raises InputError where more than half of the bands are dead, or more than MOST of the pixels.
    """
    dead, share = np.zeros(radiance.shape[1:], bool), np.zeros(len(radiance))
    first = [(0, 0)] * len(radiance)
    for b, limit in enumerate(planck(wavelength_um, MAX_K)):
        bad = ~((radiance[b] > 0) & (radiance[b] <= limit))  # so of a NaN
        share[b] = bad.mean()
        if share[b]:
            first[b] = tuple(np.argwhere(bad)[0])
        if share[b] <= MOST:
            dead |= bad
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
    return dead, share


def of_neighbours(radiance, dead, share):
    """A copy of radiance (bands, height, width), read-only, whose dead pixels (height, width) hold
    the spectrum of the nearest that is not dead, and whose dead bands hold NaN, by their share."""
    from scipy.ndimage import distance_transform_edt  # few cubes need it

    nearest = distance_transform_edt(dead, return_distances=False, return_indices=True)
    row, column = nearest[:, dead]
    del nearest
    return _filled(radiance, dead, lambda band: band[row, column], share > MOST)


def without_dead(radiance, dead):
    """Such a copy, whose dead pixels are NaN."""
    return _filled(radiance, dead, lambda band: np.nan, np.zeros(len(radiance), bool))


def _filled(radiance, dead, by, blank):
    filled = scratch.empty(radiance.shape, np.float32)
    for to, band, dark in zip(filled, scratch.parts(radiance), blank, strict=True):
        to[:] = np.nan if dark else band
        to[dead] = np.nan if dark else by(band)
        scratch.release(filled)
    filled.setflags(write=False)
    return filled
