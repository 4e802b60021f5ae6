"""A cube ready to be explained: without bad bands, of known noise, at the wavelengths that its sky
shows, within the library."""

from typing import NamedTuple

import numpy as np

from .bad_bands import without_bad_bands
from .heat_cube import HeatCube
from .spectral_shift import registered


class Prepared(NamedTuple):
    """cube, and what was done to it: left_out {wavelength_um: why} of bands, and shift_um by which
    the others were stated too long; stated_um (bands,) where they were said to lie."""

    cube: HeatCube
    left_out: dict
    shift_um: float
    stated_um: np.ndarray


def prepared(cube, library):
    """The Prepared of a HeatCube for a MaterialLibrary."""
    cube, left_out = without_bad_bands(cube)
    whole = cube.wavelength_um
    cube, shift = registered(cube.with_netd(), library)
    there = np.isin(whole - shift, cube.wavelength_um)
    beyond = dict.fromkeys(whole[~there].tolist(), "beyond the library")
    return Prepared(cube, dict(sorted((left_out | beyond).items())), shift, whole[there])
