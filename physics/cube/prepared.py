"""A cube ready to be decomposed: without bad bands, with known noise (at least what k objects leave
unexplained), at the wavelengths that its sky shows, and within the library."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from .bad_bands import without_bad_bands
from .heat_cube import LEAST_NETD_K, HeatCube
from .spectral_shift import registered


class Prepared(NamedTuple):
    """cube, and what was done to it: left_out {wavelength_um: why} of bands, and shift_um by which
    the others were stated too long; stated_um (bands,) where they were said to lie; camera_netd_k
    the camera's own noise, K at 300 K."""

    cube: HeatCube
    left_out: dict
    shift_um: float
    stated_um: np.ndarray
    camera_netd_k: float

    def moved(self, shift_um):
        """The Prepared whose bands are taken to be so many um less than they were."""
        shift = round(self.shift_um + shift_um, 5)
        return self._replace(cube=self.cube.moved(shift_um), shift_um=shift)


def prepared(cube, library):
    """The Prepared of a HeatCube for a MaterialLibrary. Raises InputError where the noise is not
    known and cannot be estimated."""
    cube, left_out = without_bad_bands(cube)
    whole = cube.wavelength_um
    cube, shift = registered(cube.with_netd(), library)
    there = np.isin(whole - shift, cube.wavelength_um)
    beyond = dict.fromkeys(whole[~there].tolist(), "beyond the library")
    left_out = dict(sorted((left_out | beyond).items()))
    camera_netd_k = cube.netd_k
    own = camera_netd_k * cube.relative_noise
    if (own < LEAST_NETD_K).any():
        netd_k = max(camera_netd_k, LEAST_NETD_K)
        noise = np.maximum(own, LEAST_NETD_K)
        quiet = 1 - (1 - cube.quiet) * (own / noise) ** 2
        cube = replace(cube, netd_k=netd_k, relative_noise=noise / netd_k, quiet=quiet)
    return Prepared(cube, left_out, shift, whole[there], camera_netd_k)
