"""What a camera makes of spectral radiance: bands of finite width, and noise.

A band is a box response. Its radiance is the mean of S over midpoints inside the band, at
most 0.125 um apart (`physics.bands.quadrature`), so that wide bands are truly integrated;
a band of no width is evaluated at its centre. Noise is white, with the same temperature
equivalent (NETD, at 300 K) in every band; what it would push to zero or below, as it may
where a cold sky meets a coarse sensor, reads the lowest radiance of the calibration.
"""

from dataclasses import dataclass

import numpy as np

from ..bands import quadrature
from ..errors import InputError
from ..heat_cube import check_wavelength
from ..planck import noise_sigma, radiance

FLOOR_K = 100.0  # coldest black body that a reading can mean: 1e-3 of 300 K's light at most


@dataclass(frozen=True, eq=False)
class Bands:
    """Bands and the fine grid that integrates them.

    wavelength_um, fwhm_um  (bands,) centres and widths in um
    fine_um                 (n,) ascending wavelengths to shade at
    """

    wavelength_um: np.ndarray
    fwhm_um: np.ndarray
    fine_um: np.ndarray
    _members: np.ndarray

    @staticmethod
    def of(wavelength_um, fwhm_um):
        """Bands with centres (bands,) and widths (bands,) >= 0 in um; else InputError."""
        centre = check_wavelength(wavelength_um, "bands")
        width = np.array(fwhm_um, dtype=np.float64)
        if width.shape != centre.shape or not np.isfinite(width).all() or (width < 0).any():
            raise InputError("bands: fwhm_um must hold one width >= 0 in um per band.")
        if (centre <= width / 2).any():
            raise InputError("bands: a band reaches down to wavelength 0.")
        points = quadrature(centre, width)
        fine, members = np.unique(points, return_inverse=True)
        return Bands(centre, width, fine, members.reshape(points.shape))

    def average(self, spectrum):
        """(..., n) on the fine grid -> (..., bands) band means."""
        return spectrum[..., self._members].mean(axis=-1)


def add_noise(clean, wavelength_um, netd_k, rng):
    """Radiance (bands, height, width) plus white noise of NETD netd_k (K at 300 K).

    Never below B(FLOOR_K): a calibrated camera reports no zero and no negative radiance.
    """
    w = np.asarray(wavelength_um)[:, None, None]
    noisy = clean + noise_sigma(w, netd_k) * rng.standard_normal(np.shape(clean))
    return np.maximum(noisy, radiance(w, FLOOR_K))
