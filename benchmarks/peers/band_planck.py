"""Planck's law averaged over box bands, and its inverse, by table lookup as in ground segments.

With a few wide bands the result would otherwise be off by tenths of a kelvin, which is no method's
fault.
"""

import numpy as np

from physics.bands import quadrature
from physics.planck import planck

COLDEST_K, HOTTEST_K, STEP_K = 100.0, 800.0, 0.1


class BandPlanck:
    """B(T) for bands with centres and widths (bands,) in um.

    Linear between entries STEP_K apart, which is good to 1e-4 K; clipped to 100-800 K.
    """

    def __init__(self, wavelength_um, fwhm_um):
        self.temperatures_k = np.arange(COLDEST_K, HOTTEST_K + STEP_K / 2, STEP_K)
        nodes = quadrature(wavelength_um, fwhm_um)
        self.table = np.stack(
            [planck(nodes, t).mean(axis=-1) for t in self.temperatures_k]
        )  # (temperatures, bands)

    def radiance(self, temperature_k):
        """(...) K -> (..., bands) W m-2 sr-1 um-1."""
        at = (np.asarray(temperature_k, float) - COLDEST_K) / STEP_K
        at = np.clip(at, 0, len(self.table) - 1)
        i = np.minimum(at.astype(int), len(self.table) - 2)
        part = (at - i)[..., None]
        return (1 - part) * self.table[i] + part * self.table[i + 1]

    def brightness_temperature(self, spectral_radiance):
        """(..., bands) W m-2 sr-1 um-1 -> the T of every band, (..., bands) K."""
        s = np.moveaxis(np.asarray(spectral_radiance, float), -1, 0)
        t = [np.interp(x, b, self.temperatures_k) for x, b in zip(s, self.table.T, strict=True)]
        return np.stack(t, axis=-1)


def emissivity(spectra, temperature_k, law, sky):
    """e = (S - X) / (B(T) - X) by Eq. 1 with X the sky: (pixels, bands); a wrong T takes it
    beyond 0..1.

    Where B(T) = X a pixel shows nothing of its emissivity; then e = 1.
    """
    contrast = law.radiance(temperature_k) - sky
    known = np.abs(contrast) > 1e-9
    return np.divide(spectra - sky, contrast, out=np.ones_like(contrast), where=known)
