"""The steps after temperature-emissivity separation: a material and, with its curve, the light X.

The library curve at the smallest spectral angle to e names the material (Kruse et al. 1993, Remote
Sensing of Environment 44, 145). Least squares, where an error of T shifts all of e, names fewer
right. Then Eq. 1 gives X = (S - e_m B(T)) / (1 - e_m).
"""

import numpy as np

LEAST_REFLECTANCE = 1e-3


def nearest(e, curves):
    """(pixels,) index into curves (materials, bands) at the least angle to e (pixels, bands)."""
    return (e @ (curves / np.linalg.norm(curves, axis=1, keepdims=True)).T).argmax(axis=1)


def light(spectra, temperature_k, e, law):
    """X (pixels, bands) W m-2 sr-1 um-1 by Eq. 1, and its mean over bands (pixels,), each band
    weighted by (1 - e)^2, according to its noise in X."""
    reflectance = np.maximum(1 - e, LEAST_REFLECTANCE)
    reflected = spectra - e * law.radiance(temperature_k)
    mean = (reflectance * reflected).sum(axis=1) / (reflectance**2).sum(axis=1)
    return reflected / reflectance, mean
