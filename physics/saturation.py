"""Saturated pixels: what is brighter than a band can show is shown as bright as it can.

Such a pixel's T is a lower bound. A band has a ceiling where its brightest value is not a tail's
end but a pile: far more pixels have that very value than any other. A camera whose pixels are
calibrated one by one has a ceiling for each, which cannot be seen in a cube.
"""

import numpy as np

from . import scratch

SAMPLES = 5000  # pixels
PILE = 4  # pixels of these at the ceiling, at least, and times those of any other value
MANY = 100  # values, fewer of which are no sensor's


def saturated(cube):
    """(height, width) bool, where any band of a HeatCube is at its ceiling."""
    spectra = cube.sample(SAMPLES).astype(np.float32)
    pixels = np.zeros(cube.shape, bool)
    for some, band in zip(spectra.T, scratch.parts(cube.radiance), strict=True):
        if np.count_nonzero(some == some.max()) >= PILE:
            count = np.unique(some, return_counts=True)[1]
            if len(count) >= MANY and count[-1] >= PILE * count[:-1].max():
                pixels |= band == some.max()
    return pixels
