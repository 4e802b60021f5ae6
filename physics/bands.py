"""Bands of finite width: a box response, integrated by equally spaced wavelengths."""

import numpy as np

from .errors import InputError

MAX_SPACING_UM = 0.125


def quadrature(wavelength_um, fwhm_um):
    """Wavelengths that sample each box band densely enough for library and sky spectra.

    wavelength_um, fwhm_um  (bands,) centres and widths in um
    Returns (bands, n): n midpoints per band, at most 0.125 um apart; their plain mean
    over the last axis is the band average. n = 1 (the centre) where all bands are narrow.
    """
    centre, width = np.asarray(wavelength_um, float), np.asarray(fwhm_um, float)
    n = max(1, int(np.ceil(width.max() / MAX_SPACING_UM - 1e-9)))
    offsets = (np.arange(n) + 0.5) / n - 0.5
    return centre[:, None] + width[:, None] * offsets


def band_means(spectrum, nodes_um):
    """(..., bands) means over each band's nodes (bands, n) of a spectrum, (m,) ascending um ->
    (..., m)."""
    w, at = np.unique(nodes_um, return_inverse=True)
    return spectrum(w)[..., at.reshape(nodes_um.shape)].mean(axis=-1)


def equidistant_bands(n, low_um=8.0, high_um=14.0):
    """n box bands side by side -> centres and widths, each (n,), in um."""
    if n < 1 or not 0 < low_um < high_um:
        raise InputError(f"bands: need n >= 1 and 0 < low < high, got {n}, {low_um}, {high_um}.")
    width = (high_um - low_um) / n
    return low_um + width * (np.arange(n) + 0.5), np.full(n, width)
