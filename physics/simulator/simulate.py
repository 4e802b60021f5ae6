"""A scene goes in; a heat cube and its truth come out, from the same traced paths.

Each block of pixels is traced when its turn to be shaded comes and dropped afterwards, so
memory holds a few blocks of paths however large the picture.
"""

from dataclasses import replace

import numpy as np

from ..bands import BOX
from ..errors import InputError
from ..library import MaterialLibrary
from .sensor import Bands
from .traced import trace_on_demand


def simulate(
    scene, *, wavelength_um, fwhm_um, size, spp=64, netd_k=0.05, seed=0, library=None,
    progress=None, response=BOX,
):  # fmt: skip
    """Path-trace a scene -> (HeatCube, Truth).

    scene          Scene
    wavelength_um  (bands,) centres in um, ascending
    fwhm_um        (bands,) full widths at half maximum in um, 0 for a narrow band
    size           (height, width) in pixels
    spp            paths per pixel
    netd_k         sensor noise in K at 300 K; 0 leaves it out
    seed           same seed, same result
    library        MaterialLibrary; the starter library if None
    progress       called as progress(done, total) between blocks of pixels
    response       of the bands: "box" or "gaussian"

    Raises InputError where the scene, the library and the bands do not fit together, or
    where rays leave a scene without atmosphere.
    """
    library = MaterialLibrary.starter() if library is None else library
    bands = Bands.of(wavelength_um, fwhm_um, response)
    first = (bands.fine_um - bands.cell_um / 2).min()
    last = (bands.fine_um + bands.cell_um / 2).max()
    if not library.covers([first, last]).all():  # said in terms of bands: there is no cube yet
        low, high = library.wavelength_um[[0, -1]]
        raise InputError(
            f"bands: they reach from {first:.4g} to {last:.4g} um, but the library's curves from "
            f"{low:g} to {high:g} um; use bands within these."
        )
    fine_um = np.unique(bands.fine_um)
    # The roulette need not heed what the curves do outside the bands.
    at_bands = replace(library, wavelength_um=fine_um, emissivity=library.at(fine_um))
    traced = trace_on_demand(scene, size, spp, seed, at_bands)
    return traced.shade(
        library, wavelength_um, fwhm_um, netd_k, progress=progress, response=response
    )
