"""A glance from afar: which of the library's materials the scene holds, and where.

A few patches of PATCH x PATCH pixels, one every STEP pixels (in every other row of them to the
right, so that no post falls between them), are first answered with the whole library, each by its
mean spectrum, of which noise is the less.

What is not seen: a material with less than SHARE of the probability there, and nowhere with OWN of
some neighbouring patches', is left out when all pixels are answered. That takes less time, in
proportion to the materials, and spares the answer some that are rare and wrong. What is left out
has probability zero.

What is seen: how likely a material is, there and in the whole picture, is what a network expects
that looks at pixels and their near neighbours. Most of it is the same evidence again, so both
count HALF:

    log expected(m)  =  log max(q(m), LEAST) / 2,      q(m)  ~  p(m | patch) share(m)^(1/2)

with the shares from q itself, by expectation maximisation (Saerens et al. 2002, "Adjusting the
outputs of a classifier to new a priori probabilities").
"""

import math

import numpy as np

from physics import scratch
from physics.expected import Expected
from physics.heat_cube import HeatCube

PATCH = 2  # pixels
STEP = 4  # at most
PATCHES = 5000  # of a glance, at least, if the picture allows; by fewer nothing is left out
SHARE = 0.005
NEAR, OWN = 2, 0.1  # patches on a side, and a material's probability there
LEAST_MATERIALS = 2  # to choose from
HALF, LEAST, SWEEPS = 0.5, 0.01, 3


def answer(run, look, cube, materials):
    """Maps of a HeatCube by the materials that it holds, as if by all.

    run        (cube, seen, expected) -> dict of maps by the materials of these indices, of which
               that is Expected; or None where the picture is too small to be seen from afar
    look       run of the glance, of which material_probability is wanted alone
    materials  how many there are
    """
    every = np.arange(materials)
    if min(cube.shape) < 2 * PATCH:
        return run(cube, every, None)
    step = int(math.sqrt(cube.radiance[0].size / PATCHES))
    step, enough = min(STEP, max(PATCH, step)), step >= PATCH
    probability = look(_from_afar(cube, step), every, None)["material_probability"]
    seen = materials_seen(probability) if enough else every
    maps = run(cube, seen, Expected(expected(probability)[seen], step))
    if not enough:
        return maps
    maps["material"] = seen.astype(maps["material"].dtype)[maps["material"]]
    maps["material_probability"] = _among_all(maps["material_probability"], seen, materials)
    return maps


def _from_afar(cube, step):
    """HeatCube of the patches' means."""
    means = np.stack([_patches(band, step) for band in scratch.parts(cube.radiance)])
    return HeatCube(means, cube.wavelength_um, cube.fwhm_um, cube.netd_k / PATCH)


def _patches(band, step):
    """(h, w) means of patches of a band (height, width)."""
    height, width = band.shape
    row, column = np.ogrid[0:height:step, 0:width:step]
    column = column + row // step % 2 * (step - PATCH)
    row = row + (step - PATCH) // 2
    total = 0.0
    for down in range(PATCH):
        for right in range(PATCH):
            at = np.minimum(row + down, height - 1), np.minimum(column + right, width - 1)
            total = total + band[at].astype(np.float64)
    return (total / PATCH**2).astype(np.float32)


def materials_seen(probability):
    """Ascending indices of the materials seen, of probability (materials, h, w)."""
    height, width = (size - size % NEAR for size in probability.shape[1:])
    near = probability[:, :height, :width].reshape(
        len(probability), height // NEAR, NEAR, width // NEAR, NEAR
    )
    own = near.mean(axis=(2, 4)).max(axis=(1, 2), initial=0.0)
    share = probability.mean(axis=(1, 2))
    seen = (share > SHARE) | (own > OWN)
    seen[np.argsort(-share, kind="stable")[:LEAST_MATERIALS]] = True
    return np.flatnonzero(seen)


def expected(probability):
    """(materials, h, w) float32 log expected, nats, of probability (materials, h, w)."""
    weight = np.ones(len(probability))
    for _ in range(SWEEPS):
        q = probability * weight[:, None, None]
        share = (q / q.sum(axis=0)).mean(axis=(1, 2))
        weight = np.maximum(share, LEAST**2) ** HALF
    q = probability * weight[:, None, None]
    return (HALF * np.log(np.maximum(q / q.sum(axis=0), LEAST))).astype(np.float32)


def _among_all(probability, seen, materials):
    """probability of the materials seen -> (materials, height, width), zero for the others."""
    every = scratch.empty((materials, *probability.shape[1:]), probability.dtype)
    row = dict(zip(seen, range(len(seen)), strict=True))
    for m in range(materials):
        every[m] = probability[row[m]] if m in row else 0.0
        scratch.release(every)
        scratch.release(probability)
    return every
