"""Iterative spectrally smooth temperature-emissivity separation (ISSTES).

A wrong T leaves the sky's lines in e(T) = (S - X) / (B(T) - X); the right T leaves a smooth
spectrum. So T is the one that minimises

    sum over bands of (e_i - (e_(i-1) + e_i + e_(i+1)) / 3)^2

(Borel 1998, Proc. IGARSS, 546; Borel 2008, Int. J. Remote Sensing 29, 5029). T is searched in a
small range around a pixel's largest brightness temperature, in ever finer steps; the range is the
one with the least error on eight scenes that are not charted (a higher T makes e smaller, and so
smoother). Exact, without noise, if the sky is all of X, e a straight line and T within the range.
"""

import numpy as np

from .band_planck import emissivity

BELOW_K, ABOVE_K = 0.5, 1.0  # of the largest brightness temperature
STEPS_K = (0.5, 0.05, 0.005)
PIXELS_PER_BLOCK = 2048  # so that intermediates stay in the processor's cache


def separate(spectra, law, sky):
    """T (pixels,) K and e (pixels, bands); see the package."""
    blocks = range(0, len(spectra), PIXELS_PER_BLOCK)
    t = np.concatenate([_smoothest(spectra[i : i + PIXELS_PER_BLOCK], law, sky) for i in blocks])
    return t, np.clip(emissivity(spectra, t, law, sky), 0.0, 1.0)


def _smoothest(spectra, law, sky):
    t = law.brightness_temperature(spectra).max(axis=-1)
    below, above = BELOW_K, ABOVE_K
    for step in STEPS_K:
        offsets = np.arange(-below, above + step / 2, step)
        rough = [_roughness(emissivity(spectra, t + d, law, sky)) for d in offsets]
        t = t + offsets[np.argmin(rough, axis=0)]
        below = above = step
    return t


def _roughness(e):
    smooth = (e[:, :-2] + e[:, 1:-1] + e[:, 2:]) / 3
    return ((e[:, 1:-1] - smooth) ** 2).sum(axis=-1)
