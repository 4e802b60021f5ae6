"""Brightness temperature: one emissivity for every object and band.

    T = mean over bands of B^-1((S - (1 - e) X) / e),   e = 0.95

as a thermal camera does that is given an emissivity and the reflected radiance. With T,
e(wavelength) follows from Eq. 1.
"""

import numpy as np

from .band_planck import emissivity

EMISSIVITY = 0.95


def separate(spectra, law, sky):
    """T (pixels,) K and e (pixels, bands); see the package."""
    emitted = (spectra - (1 - EMISSIVITY) * sky) / EMISSIVITY
    t = law.brightness_temperature(emitted).mean(axis=-1)
    return t, np.clip(emissivity(spectra, t, law, sky), 0.0, 1.0)
