"""Pixels without a measurement, of which every detector has some: found by values that no scene
has in a band that shows the scene, and given the spectrum of the nearest pixel that is not dead.

That spectrum is no measurement: what a pixel so filled is answered is to be called unknown.
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
    and (bands,) bool, which bands show anything: a band that shows nothing kills no pixel.

    Raises InputError where more than MOST of the pixels are dead, or no band shows anything.
    """
    dead, alive = np.zeros(radiance.shape[1:], bool), np.zeros(len(radiance), bool)
    first = 0, 0, 0
    for b, limit in enumerate(planck(wavelength_um, MAX_K)):
        good = (radiance[b] > 0) & (radiance[b] <= limit)  # not so of a NaN
        alive[b] = good.any()
        if alive[b] and not good.all():
            if not dead.any():
                first = b, *np.argwhere(~good)[0]
            dead |= ~good
        scratch.release(radiance)
    share = dead.mean() if alive.any() else 1.0
    if share > MOST:
        b, row, column = first
        raise InputError(
            f"cube: {share:.0%} of its pixels are dead (zero or negative, NaN or infinite, or "
            f"hotter than {MAX_K:.0f} K), the first at {wavelength_um[b]:.5g} um, row {row}, "
            f"column {column} ({radiance[first]:.4g}), and at most {MOST:.0%} may be; cut edges "
            "off, leave bands out, or check the calibration."
        )
    return dead, alive


def of_neighbours(radiance, dead):
    """A copy of radiance (bands, height, width), read-only, whose dead pixels (height, width) hold
    the spectrum of the nearest that is not dead."""
    from scipy.ndimage import distance_transform_edt  # few cubes need it

    nearest = distance_transform_edt(dead, return_distances=False, return_indices=True)
    row, column = nearest[:, dead]
    del nearest
    return _filled(radiance, dead, lambda band: band[row, column])


def without_dead(radiance, dead):
    """Such a copy, whose dead pixels are NaN."""
    return _filled(radiance, dead, lambda band: np.nan)


def _filled(radiance, dead, by):
    filled = scratch.empty(radiance.shape, np.float32)
    for to, band in zip(filled, scratch.parts(radiance), strict=True):
        to[:] = band
        to[dead] = by(band)
        scratch.release(filled)
    filled.setflags(write=False)
    return filled
