"""Eq. 3: Planck's law per micrometre, its inverse and its derivative.

Every function takes numpy arrays or torch tensors and answers in kind, with the
usual broadcasting between its two arguments: a (bands, 1, 1) wavelength against an
(height, width) temperature gives a (bands, height, width) radiance. Wavelength is in
um, temperature in K, spectral radiance in W m-2 sr-1 um-1. With tensors the result
is differentiable in both arguments.

Everything is written in exp(-x) with x = c2 / (wavelength T), which never overflows,
so values and gradients stay finite in float32 from 1 K up.
"""

import sys

import numpy as np

C1 = 1.191042972397188e8  # 2 h c^2, W um^4 m-2 sr-1 (CODATA 2018, exact)
C2 = 14387.768775039337  # h c / k_B, um K (CODATA 2018, exact)


def _namespace(*arrays):
    """torch if any argument is a tensor, else numpy (torch is never imported here)."""
    torch = sys.modules.get("torch")
    tensor = getattr(torch, "Tensor", ())  # another thread may be importing it
    return torch if any(isinstance(a, tensor) for a in arrays) else np


def planck(wavelength_um, temperature_k):
    """Blackbody spectral radiance B(wavelength, T), Eq. 3, in W m-2 sr-1 um-1."""
    xp = _namespace(wavelength_um, temperature_k)
    x = C2 / (wavelength_um * temperature_k)
    return C1 / wavelength_um**5 * xp.exp(-x) / -xp.expm1(-x)


def planck_derivative(wavelength_um, temperature_k):
    """dB/dT in W m-2 sr-1 um-1 K-1."""
    return planck_and_derivative(wavelength_um, temperature_k)[1]


def planck_and_derivative(wavelength_um, temperature_k):
    """B and dB/dT, in no more time than the latter takes."""
    xp = _namespace(wavelength_um, temperature_k)
    x = C2 / (wavelength_um * temperature_k)
    b = planck(wavelength_um, temperature_k)
    return b, b * x / temperature_k / -xp.expm1(-x)


def brightness_temperature(wavelength_um, spectral_radiance):
    """The T with B(wavelength, T) = spectral_radiance, in K; spectral_radiance > 0."""
    xp = _namespace(wavelength_um, spectral_radiance)
    # what depends on the band alone first: spectra are many
    return C2 / wavelength_um / xp.log1p(C1 / wavelength_um**5 / spectral_radiance)


def noise_sigma(wavelength_um, netd_k):
    """Noise per band, W m-2 sr-1 um-1: NETD (K, at 300 K) times dB/dT(300 K)."""
    return netd_k * planck_derivative(wavelength_um, 300.0)
