"""What a camera makes of spectral radiance: bands of finite width, and noise.

A band is a box response. It is cut into cells at most 0.125 um wide (`physics.bands.quadrature`),
and paths are shaded once a cell, with B(T), e and the sky's radiance averaged over it at CELL_UM
and less: in a cell these hardly vary together, but the sky does so alone, up to 20 times the
noise of a 50 mK camera at ozone's edges. The inversion takes cells at their middle, and so is not
told what the simulator knows. A band of no width is a point. Noise is white, with the same
temperature equivalent (NETD, at 300 K) in every band; what it would push to zero or below, as it
may where a cold sky meets a coarse sensor, reads the lowest radiance of the calibration.
"""

from dataclasses import dataclass

import numpy as np

from ..bands import quadrature
from ..cube.heat_cube import check_wavelength
from ..errors import InputError
from ..machinery.threads import in_threads, usual_threads
from ..planck import noise_sigma, planck

CELL_UM = 0.02  # between the wavelengths that a cell is averaged over, at most
FLOOR_K = 100.0  # coldest black body that a reading can mean: 1e-3 of 300 K's light at most


@dataclass(frozen=True, eq=False)
class Bands:
    """Bands and the cells that integrate them.

    wavelength_um, fwhm_um  (bands,) centres and widths in um
    fine_um, cell_um        (n,) middles of the cells, ascending, and their widths
    """

    wavelength_um: np.ndarray
    fwhm_um: np.ndarray
    fine_um: np.ndarray
    cell_um: np.ndarray
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
        cells = np.broadcast_to(width[:, None] / points.shape[1], points.shape)
        (fine, cell), members = np.unique(
            [points.ravel(), cells.ravel()], axis=1, return_inverse=True
        )
        return Bands(centre, width, fine, cell, members.reshape(points.shape))

    def in_cells(self, spectrum):
        """(..., n) cell means of spectrum: (m,) ascending wavelengths in um -> (..., m)."""
        count = max(1, int(np.ceil(self.cell_um.max() / CELL_UM - 1e-9)))

        def at(offset):
            w, index = np.unique(self.fine_um + offset * self.cell_um, return_inverse=True)
            return spectrum(w)[..., index]

        return sum(in_threads(at, (np.arange(count) + 0.5) / count - 0.5, usual_threads())) / count

    def average(self, spectrum):
        """(..., n) of cells -> (..., bands) band means."""
        return spectrum[..., self._members].mean(axis=-1)


def add_noise(clean, wavelength_um, netd_k, rng):
    """Radiance (bands, height, width) plus white noise of NETD netd_k (K at 300 K).

    Never below B(FLOOR_K): a calibrated camera reports no zero and no negative radiance.
    """
    clean = np.asarray(clean)
    noisy = np.empty(clean.shape, np.result_type(clean, np.float32))
    # band by band: noise of a whole cube takes twice its memory
    for w, band, out in zip(wavelength_um, clean, noisy, strict=True):
        with_noise = band + noise_sigma(w, netd_k) * rng.standard_normal(band.shape)
        np.maximum(with_noise, planck(w, FLOOR_K), out=out, casting="same_kind")
    return noisy
