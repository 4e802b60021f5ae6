"""Eq. 7: why a thermal image is blurry, as three pictures.

    dS = dT e B'(T) + de (B(T) - X) + dX (1 - e)

Each term is the part of the contrast between neighbouring pixels that temperature,
material and texture cause. In a thermal image the first two drown the third.
"""

import numpy as np

from .errors import InputError
from .planck import planck, planck_derivative


def contrast_terms(temperature_k, emissivity, texture, wavelength_um):
    """The three terms of Eq. 7 between vertical and horizontal neighbours.

    temperature_k  (height, width)         K
    emissivity     (bands, height, width)  0..1
    texture        (bands, height, width)  X, W m-2 sr-1 um-1
    wavelength_um  (bands,)                um

    Returns {"temperature", "material", "texture"}, each (2, bands, height, width) in
    W m-2 sr-1 um-1: central differences down and across, one-sided at the border.
    Their sum is the gradient of S to first order. Raises InputError where there are no
    neighbours: of fewer than two rows or columns.
    """
    if min(np.shape(temperature_k)) < 2:
        raise InputError(
            f"contrast: need at least two rows and columns, got {np.shape(temperature_k)}."
        )
    w = np.asarray(wavelength_um)[:, None, None]
    d = lambda a: np.stack(np.gradient(a, axis=(-2, -1)))
    return {
        "temperature": d(temperature_k)[:, None] * emissivity * planck_derivative(w, temperature_k),
        "material": d(emissivity) * (planck(w, temperature_k) - texture),
        "texture": d(texture) * (1 - emissivity),
    }
