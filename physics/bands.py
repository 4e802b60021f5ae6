"""Bands of finite width: their response, integrated by wavelengths of equal weight."""

from statistics import NormalDist

import numpy as np

from .errors import InputError

BOX, GAUSSIAN = RESPONSES = ("box", "gaussian")
MAX_SPACING_UM = 0.125  # where a band responds most
SIGMAS = 2 * np.sqrt(2 * np.log(2))  # in the full width of a Gaussian at half maximum
NARROW_UM = 1e-4  # the least width of a mean


def quadrature(wavelength_um, fwhm_um, response=BOX):
    """Wavelengths that sample each band densely enough for library and sky spectra.

    wavelength_um, fwhm_um  (bands,) centres and full widths at half maximum in um
    response                "box" or "gaussian"
    Returns (bands, n), ascending in each: of n parts of a band to which it responds equally, their
    means; of a Gaussian, stretched so that its variance comes out. The plain mean over the last
    axis is the band average, of boxes at wavelengths at most 0.125 um apart, as in the middle of
    Gaussians. n = 1 (the centre) where all bands are narrow.
    """
    centre, width = np.asarray(wavelength_um, float), np.asarray(fwhm_um, float)
    spread = 1.0 if response == BOX else np.sqrt(2 * np.pi) / SIGMAS  # area over height, in widths
    n = max(1, int(np.ceil(spread * width.max() / MAX_SPACING_UM - 1e-9)))
    offsets = (np.arange(n) + 0.5) / n - 0.5
    if response == GAUSSIAN and n > 1:
        normal = NormalDist()
        edges = [0, *(normal.pdf(normal.inv_cdf(i / n)) for i in range(1, n)), 0]
        offsets = -np.diff(edges)
        offsets /= offsets.std() * SIGMAS
    return centre[:, None] + width[:, None] * offsets


def at_nodes(spectrum, nodes_um):
    """(..., bands, n) a spectrum, (m,) ascending um -> (..., m), at the nodes (bands, n)."""
    w, at = np.unique(nodes_um, return_inverse=True)
    return spectrum(w)[..., at.reshape(nodes_um.shape)]


def band_means(spectrum, nodes_um):
    """(..., bands) the same, averaged over each band."""
    return at_nodes(spectrum, nodes_um).mean(axis=-1)


def means_of_samples(wavelength_um, spectra, centre_um, fwhm_um):
    """(k, bands) means over box bands of spectra, linear between their samples and constant beyond:
    exact, be the samples fine or coarse.

    wavelength_um, spectra  (n,) in um, ascending, and (k, n)
    centre_um, fwhm_um      (bands,) centres and widths in um
    """
    half = np.maximum(fwhm_um, NARROW_UM) / 2
    low, high = centre_um - half, centre_um + half
    w = np.union1d(wavelength_um, [low, high])
    s = np.stack([np.interp(w, wavelength_um, spectrum) for spectrum in spectra])
    steps = (s[:, 1:] + s[:, :-1]) / 2 * np.diff(w)
    area = np.pad(np.cumsum(steps, axis=1), ((0, 0), (1, 0)))
    at_low, at_high = np.searchsorted(w, low), np.searchsorted(w, high)
    return (area[:, at_high] - area[:, at_low]) / (w[at_high] - w[at_low])


def equidistant_bands(n, low_um=8.0, high_um=14.0):
    """n box bands side by side -> centres and widths, each (n,), in um."""
    if not (n >= 1 and float(n).is_integer() and 0 < low_um < high_um < np.inf):
        raise InputError(
            f"bands: need a whole n >= 1 and 0 < low < high, got {n}, {low_um}, {high_um}."
        )
    width = (high_um - low_um) / n
    return low_um + width * (np.arange(n) + 0.5), np.full(n, width)
