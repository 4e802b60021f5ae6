"""A glance from afar: which of the library's materials the scene holds at all.

A few pixels, every STEP-th of every STEP-th row (of the next such row, those one to the right, so
that no post falls between them), are first answered with the whole library. A
material with less than SHARE of the probability there, and nowhere with OWN of a whole patch's, is
left out when all pixels are answered. That takes less time, in proportion to the materials, and
spares the answer some that are rare and wrong. What is left out has probability zero.
"""

import math

import numpy as np

from physics import scratch
from physics.heat_cube import HeatCube

STEP = 4  # at most
PIXELS = 5000  # of a glance, at least; smaller pictures are answered with all materials at once
SHARE = 0.01
PATCH, OWN = 2, 0.1  # pixels of the glance on a side, and a material's probability there
LEAST = 2  # materials to choose from


def answer(run, look, cube, materials):
    """Maps of a HeatCube by the materials that it holds, as if by all.

    run, look  (cube, seen) -> dict of maps by the materials of these indices; look of the
               glance, of which material_probability is wanted alone
    materials  how many there are
    """
    every = np.arange(materials)
    step = min(STEP, int(math.sqrt(cube.radiance[0].size / PIXELS)))
    if step < 2:
        return run(cube, every)
    afar = np.stack([_from_afar(band, step) for band in scratch.parts(cube.radiance)])
    afar = HeatCube(afar, cube.wavelength_um, cube.fwhm_um, cube.netd_k)
    seen = materials_seen(look(afar, every)["material_probability"])
    maps = run(cube, seen)
    maps["material"] = seen.astype(maps["material"].dtype)[maps["material"]]
    maps["material_probability"] = _among_all(maps["material_probability"], seen, materials)
    return maps


def _from_afar(band, step):
    height, width = band.shape
    row, column = np.ogrid[0:height:step, 0:width:step]
    return band[row, np.minimum(column + row // step % step, width - 1)]


def materials_seen(probability):
    """Ascending indices of the materials seen, of probability (materials, height, width)."""
    height, width = (size - size % PATCH for size in probability.shape[1:])
    patches = probability[:, :height, :width].reshape(
        len(probability), height // PATCH, PATCH, width // PATCH, PATCH
    )
    own = patches.mean(axis=(2, 4)).max(axis=(1, 2), initial=0.0)
    share = probability.mean(axis=(1, 2))
    seen = (share > SHARE) | (own > OWN)
    seen[np.argsort(-share, kind="stable")[:LEAST]] = True
    return np.flatnonzero(seen)


def _among_all(probability, seen, materials):
    """probability of the materials seen -> (materials, height, width), zero for the others."""
    every = scratch.empty((materials, *probability.shape[1:]), probability.dtype)
    row = dict(zip(seen, range(len(seen)), strict=True))
    for m in range(materials):
        every[m] = probability[row[m]] if m in row else 0.0
        scratch.release(every)
        scratch.release(probability)
    return every
