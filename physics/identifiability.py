"""What a pixel can tell: Fisher information of (T, V) given m, and the Cramer-Rao bound.

In noise units Eq. 1 depends on its unknowns by

    j_T = e B'(T) / sigma,    j_V = (1 - e) (S_j - S_k) / sigma,  j = 1 ... k - 1

(V sums to 1, so k - 1 of it are free; bounds on V are not counted, so an estimate at a bound may
do better). No unbiased estimate of T has a smaller standard deviation than

    sigma_T = 1 / |P j_T|,    P: what is orthogonal to all j_V

which is 1 / |j_T| where e = 1 and grows where j_T is nearly a combination of the j_V: a grey
body among grey surroundings. V enters Eq. 1 linearly, so its value does not matter.
"""

import numpy as np

from .planck import planck_derivative


def jacobian(wavelength_um, noise, emissivity, environment, temperature_k):
    """(P, bands, k): how far a unit of T (K) and of V_1 ... V_{k-1} moves S~, in noise units.

    wavelength_um (bands,) um; noise (bands,) W m-2 sr-1 um-1; emissivity (P, bands);
    environment (k, bands) W m-2 sr-1 um-1; temperature_k (P,) K.
    """
    j_t = emissivity * planck_derivative(wavelength_um, temperature_k[:, None])
    between = environment[:-1] - environment[-1]
    j_v = (1 - emissivity)[:, None] * between
    return np.moveaxis(np.concatenate([j_t[:, None], j_v], axis=1) / noise, 1, 2)


def cramer_rao(wavelength_um, noise, emissivity, environment, temperature_k):
    """Least standard deviation (P,) of T in K, V unknown; inf where T cannot be told.

    Arguments as of `jacobian`.
    """
    j = jacobian(wavelength_um, noise, emissivity, environment, temperature_k)
    j_t, j_v = j[..., 0], j[..., 1:]
    # lengths of j_V are immaterial: what is far below noise is still a direction V may take
    u, s, _ = np.linalg.svd(j_v, full_matrices=False)
    u = u * (s > 1e-9 * s.max(axis=1, keepdims=True, initial=0) + 1e-30)[:, None]
    rest = j_t - np.einsum("pbk,pk->pb", u, np.einsum("pbk,pb->pk", u, j_t))
    length = np.linalg.norm(rest, axis=1)
    known = length > 1e-9 * np.linalg.norm(j_t, axis=1)
    return np.divide(1.0, length, out=np.full(len(length), np.inf), where=known)
