"""A glance from afar: which of the library's materials the scene holds, and where.

Patches of PATCH x PATCH pixels, one every STEP pixels (shifted to the right in every other row, so
that no post falls between them), are first answered with the whole library, each by its mean
spectrum, which has less noise.

What is not seen: a material is left out when all pixels are answered if its mean probability over
the patches is below SHARE (times the mean probability of the likeliest material) and nowhere
exceeds OWN in the mean of a few neighbouring patches. That saves time in proportion to the
materials, and keeps some rare, wrong ones out of the answer. What is left out has probability zero.
In a picture of two regions or more on a side, each region is solved only with what is seen in it or
a few patches around it (by all methods but `sgd`, which needs the whole picture at once).

What is seen: the network, which looks at pixels and their near neighbours only, is told to expect a
material according to how likely it is in the patch and in the whole picture:

    expected(m)  =  log q(m) / 2,      q(m)  =  p(m | patch) share(m)^(1/2) / their sum,

q not below LEAST. The patch has weight one half, since its evidence is mostly that of the pixels;
so has the share, the mean of q over all patches, found in a few steps like those by which Saerens
et al. (2002, "Adjusting the outputs of a classifier to new a priori probabilities") find it in
full. The network has learnt how far to heed it.

Only pixels near sky that was seen may be partly sky. Elsewhere, metal that reflects both ground and
sky would pass for ground with sky behind it.
"""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
from scipy.ndimage import maximum_filter

from physics.expected import Expected, Regions, among_all
from physics.machinery import scratch

PATCH = 2  # pixels
STEP = 4  # pixels, at most
PATCHES = 5000  # least number in a glance, picture size permitting; with fewer nothing is left out
SHARE = 0.01  # if all materials are sure; less if they are in doubt
# least side of a region, pixels; larger for networks, whose tiles also look at a halo around them
NET_REGION, REGION = 128, 96
AROUND = 2  # patches around a region whose materials also count as seen in it
NEAR, OWN = 2, 0.1  # side of a neighbourhood, patches, and a material's mean probability in it
LEAST_MATERIALS = 2  # to choose from
HALF = 0.5  # weight of what comes from the same evidence as what it is added to
LEAST, LEAST_SHARE = 1e-3, 1e-4  # lower limits, so that rare materials remain possible
# only pixels within so many patches of one with this probability of sky may be partly sky; farther
# away sky is expected with NO_SKY, which is below all others (`physics.expected.SKY_NEAR`)
SKY, BORDER, NO_SKY = 0.1, 5, 1e-4
SWEEPS = 3  # iterations for the shares


def answer(run, look, cube, materials, sky, expects):
    """Maps of a HeatCube solved with the materials that it holds, in the form of all materials.

    run        (cube, seen[, expected, regions]) -> dict of maps for the materials with indices
               seen; gets Expected if the picture is large enough for a glance, and Regions if it
               is large enough for materials to be left out
    look       the run for the glance, of which only material_probability is needed
    materials  the number of materials;  sky  the index of the sky among them, or None
    expects    whether run makes use of what is expected
    """
    every = np.arange(materials)
    step = int(math.sqrt(cube.radiance[0].size / PATCHES))
    enough = step >= PATCH
    if max(cube.shape) < 2 * PATCH or not (enough or expects):
        return run(cube, every)
    step = min(STEP, max(PATCH, step))
    probability = look(from_afar(cube, step), every)["material_probability"]
    if cube.dead.any():
        probability = np.where(_all_dead(cube, step), np.nan, probability)
    if not np.isfinite(probability).any():  # no patch was measured
        return run(cube, every)
    if not enough:
        return run(cube, every, Expected(expected(probability, sky), step))
    seen = materials_seen(probability)
    size = NET_REGION if expects else REGION
    parts = regions(probability[seen], step, cube.shape, size)
    maps = run(cube, seen, Expected(expected(probability, sky)[seen], step), parts)
    return among_all(maps, np.isin(every, seen))


def from_afar(cube, step):
    """HeatCube of the mean spectra of patches, one every step pixels."""
    means = np.stack([_patches(band, step) for band in scratch.parts(cube.radiance)])
    pixels = math.prod(min(PATCH, size) for size in cube.shape)
    dead = _all_dead(cube, step)
    netd_k = cube.netd_k / math.sqrt(pixels)
    return replace(cube, radiance=means, netd_k=netd_k, dead=None if dead.all() else dead)


def _all_dead(cube, step):
    """(h, w) bool: patches in which no pixel was measured."""
    return _patches(cube.dead, step) == 1


def _patches(band, step):
    """(h, w) means over patches of a band (height, width), all inside it."""
    down, right = (min(PATCH, size) for size in band.shape)
    row, column = np.ogrid[0 : band.shape[0] : step, 0 : band.shape[1] : step]
    column = np.minimum(column + row // step % 2 * (step - PATCH), band.shape[1] - right)
    row = np.minimum(row + (step - PATCH) // 2, band.shape[0] - down)
    total = sum(
        band[row + i, column + j].astype(np.float64) for i in range(down) for j in range(right)
    )
    return (total / (down * right)).astype(np.float32)


def materials_seen(probability):
    """Ascending indices of the materials seen, from probability (materials, h, w); patches that are
    NaN are ignored."""
    probability = np.where(np.isfinite(probability), probability, 0)
    rows, columns = (min(NEAR, size) for size in probability.shape[1:])
    # the last of an odd number is paired with the one before
    odd = [(0, -n % min(NEAR, n)) for n in probability.shape[1:]]
    padded = np.pad(probability, [(0, 0), *odd], mode="reflect")
    height, width = padded.shape[1:]
    near = padded.reshape(len(padded), height // rows, rows, width // columns, columns)
    own = near.mean(axis=(2, 4)).max(axis=(1, 2))
    share = probability.mean(axis=(1, 2))
    sure = probability.max(axis=0).mean()
    seen = (share > SHARE * sure) | (own > OWN)
    seen[np.argsort(-share, kind="stable")[:LEAST_MATERIALS]] = True
    return np.flatnonzero(seen)


def regions(probability, step, shape, least):
    """Regions, at least so many pixels on a side, of a picture of that shape, from probability
    (materials, h, w) at its patches."""
    cuts = tuple(
        tuple(i * size // parts // STEP * STEP for i in range(parts)) + (size,)
        for size, parts in ((size, max(1, size // least)) for size in shape)
    )
    rows, columns = (
        [slice(max(0, a // step - AROUND), -(-b // step) + AROUND) for a, b in pairwise(c)]
        for c in cuts
    )
    held = np.zeros((len(rows), len(columns), len(probability)), bool)
    for i, j in np.ndindex(held.shape[:2]):
        part = probability[:, rows[i], columns[j]]
        if np.isfinite(part).any():
            held[i, j, materials_seen(part)] = True
        else:  # no patch was measured there, though pixels between patches may have been
            held[i, j] = True
    return Regions(cuts, held)


def expected(probability, sky=None):
    """(materials, h, w) float32 nats by which materials are expected, from probability (materials,
    h, w), in which patches that are NaN are ignored; sky is its index, if any."""
    weight, rows = np.ones(len(probability)), range(probability.shape[1])
    says = np.isfinite(probability).all(axis=0)
    for _ in range(SWEEPS if says.any() else 0):
        share = sum(_weighted(probability[:, i, says[i]], weight).sum(axis=1) for i in rows)
        weight = np.maximum(share / np.count_nonzero(says), LEAST_SHARE) ** HALF
    nats = scratch.zeros(probability.shape, np.float32)
    for i in rows:
        nats[:, i] = HALF * np.log(np.maximum(_weighted(probability[:, i], weight), LEAST))
    if sky is not None:
        of_sky = np.where(says, probability[sky], 1)  # anything may be where nothing was measured
        nats[sky, maximum_filter(of_sky, 2 * BORDER + 1) < SKY] = HALF * np.log(NO_SKY)
    return nats


def _weighted(probability, weight):
    """q (materials, n) of probability (materials, n)."""
    q = np.where(np.isfinite(probability), probability, 1) * weight[:, None]
    return q / q.sum(axis=0)
