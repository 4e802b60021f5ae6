"""The X that a user would measure or model: the downwelling sky, or a room's mean light."""

import numpy as np

from physics.simulator.sensor import Bands
from physics.sky import sky_radiance
from texnet.metrics import non_sky


def surroundings(traced, truth, wavelength_um, fwhm_um):
    """(bands,) W m-2 sr-1 um-1 for a traced scene's box bands: its whole sky or, in a room, the
    mean of the true X."""
    if traced.atmosphere is None:
        return truth.texture[:, non_sky(truth)].mean(axis=1).astype(float)
    return downwelling(traced.atmosphere, wavelength_um, fwhm_um)


def downwelling(atmosphere, wavelength_um, fwhm_um):
    """(bands,) for box bands, W m-2 sr-1 um-1: the radiance of the whole sky, each direction
    weighted by how much it lights a level surface."""
    bands = Bands.of(wavelength_um, fwhm_um)
    node, weight = np.polynomial.legendre.leggauss(64)
    cosine = (node + 1) / 2
    # integral of 2 cos d(cos) over 0..1; the nodes' weights sum to 2
    lit = bands.in_cells(lambda w: sky_radiance(w, cosine, atmosphere))
    return bands.average(weight * cosine @ lit)
