"""What a camera makes of spectral radiance: bands of finite width, and noise.

A band's response is a box, or a Gaussian up to CUT_SIGMAS. It is divided into cells at most 0.125
um wide (half of that for a Gaussian), and paths are shaded once a cell, with B(T), e and the sky's
radiance averaged over it in steps of CELL_UM or less: within a cell these hardly covary, but the
sky alone varies, by up to 20 times the noise of a 50 mK camera at ozone's edges. The inversion
evaluates cells at their middle, and so does not share the simulator's knowledge. A band without
width is a point. Noise is white, with the same temperature equivalent (NETD, at 300 K) in every
band; values that it would push to zero or below, as it may for a cold sky and a coarse sensor, read
the lowest radiance of the calibration.
"""

from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from ..bands import BOX, SIGMAS, quadrature
from ..cube.heat_cube import check_response, check_wavelength
from ..errors import InputError
from ..machinery.threads import in_threads, usual_threads
from ..planck import noise_sigma, planck

CUT_SIGMAS = 3.0
CELL_UM = 0.02  # between the wavelengths that a cell is averaged over, at most
FLOOR_K = 100.0  # coldest black body that a reading can mean: 1e-3 of 300 K's light at most


@dataclass(frozen=True, eq=False)
class Bands:
    """Bands and the cells that integrate them.

    wavelength_um, fwhm_um  (bands,) centres and full widths at half maximum in um
    response                "box" or "gaussian"
    fine_um, cell_um        (n,) middles of the cells, ascending, and their widths
    """

    wavelength_um: np.ndarray
    fwhm_um: np.ndarray
    response: str
    fine_um: np.ndarray
    cell_um: np.ndarray
    _members: np.ndarray
    _shares: np.ndarray

    @staticmethod
    def of(wavelength_um, fwhm_um, response=BOX):
        """Bands with centres (bands,) and widths (bands,) >= 0 in um; else InputError."""
        centre = check_wavelength(wavelength_um, "bands")
        width = np.array(fwhm_um, dtype=np.float64)
        if width.shape != centre.shape or not np.isfinite(width).all() or (width < 0).any():
            raise InputError("bands: fwhm_um must hold one width >= 0 in um per band.")
        check_response(response, "bands")
        whole = width if response == BOX else 2 * CUT_SIGMAS / SIGMAS * width
        if (centre <= whole / 2).any():
            raise InputError("bands: a band reaches down to wavelength 0.")
        n = quadrature(centre, whole if response == BOX else 2 * whole).shape[1]
        edges = np.linspace(-0.5, 0.5, n + 1)
        points = centre[:, None] + whole[:, None] * (edges[1:] + edges[:-1]) / 2
        cells = np.broadcast_to(whole[:, None] / n, points.shape)
        shares = np.full(n, 1 / n)
        if response != BOX:
            shares = np.diff([NormalDist().cdf(2 * CUT_SIGMAS * edge) for edge in edges])
        (fine, cell), members = np.unique(
            [points.ravel(), cells.ravel()], axis=1, return_inverse=True
        )
        members = members.reshape(points.shape)
        return Bands(centre, width, response, fine, cell, members, shares / shares.sum())

    def in_cells(self, spectrum):
        """(..., n) cell means of spectrum: (m,) ascending wavelengths in um -> (..., m)."""
        count = max(1, int(np.ceil(self.cell_um.max() / CELL_UM - 1e-9)))

        def at(offset):
            w, index = np.unique(self.fine_um + offset * self.cell_um, return_inverse=True)
            return spectrum(w)[..., index]

        return sum(in_threads(at, (np.arange(count) + 0.5) / count - 0.5, usual_threads())) / count

    def average(self, spectrum):
        """(..., n) of cells -> (..., bands) band means."""
        return spectrum[..., self._members] @ self._shares.astype(spectrum.dtype)


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
