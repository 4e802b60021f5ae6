"""What a glance tells a model: which materials to expect where, and which to look for."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from .errors import InputError
from .machinery import scratch

# nats by which the sky is expected wherever a pixel may be partly sky; less: no sky is near
SKY_NEAR = -4.0


class Expected(NamedTuple):
    """nats (materials, h, w) float32 by which a material is expected after the glance; point (i, j)
    stands for the step x step pixels from (step i, step j) on.
    """

    nats: np.ndarray
    step: int

    def of_tile(self, top, left, height, width, materials=slice(None)):
        """(materials, height, width) nats for some materials in the tile that begins at pixel (top,
        left); linear between the points, constant beyond them."""
        rows = _between(top, height, self.step, self.nats.shape[1])
        columns = _between(left, width, self.step, self.nats.shape[2])
        near = slice(rows[0][0], rows[1][-1] + 1)
        rows = rows[0] - near.start, rows[1] - near.start, rows[2][:, None]
        return _linear(_linear(self.nats[materials, near], columns, 2), rows, 1)


class Regions(NamedTuple):
    """The rectangular parts of a picture: cuts are the rows and columns between them, including the
    picture's borders; held (parts down, parts across, materials) bool says which materials are
    looked for in each, at least two."""

    cuts: tuple[tuple[int, ...], tuple[int, ...]]
    held: np.ndarray

    def at(self, row, column):
        """(materials,) bool: which are looked for at a pixel."""
        i, j = (
            np.searchsorted(cuts, at, "right") - 1
            for cuts, at in zip(self.cuts, (row, column), strict=True)
        )
        return self.held[i, j]

    def check(self, shape, materials, cell):
        """Raise InputError unless these are regions of a picture of that shape and so many
        materials, which begin at multiples of a cell."""
        for cuts, size in zip(self.cuts, shape, strict=True):
            grows = all(a < b for a, b in pairwise(cuts))
            if not (grows and cuts[0] == 0 and cuts[-1] == size):
                raise InputError(f"regions: cuts must ascend from 0 to {size}, got {cuts}.")
            if any(c % cell for c in cuts[:-1]):
                raise InputError(f"regions: cuts must be multiples of {cell}, got {cuts}.")
        wanted = *(len(cuts) - 1 for cuts in self.cuts), materials
        if self.held.shape != wanted:
            raise InputError(f"regions: held must be {wanted}, got {self.held.shape}.")
        if self.held.sum(axis=-1).min() < 2:
            raise InputError("regions: each must hold two materials at least.")


def only(known, held):
    """Known's fields (`physics.known`) for only the materials held, a mask or indices."""
    return known | {name: known[name][held] for name in ("emissivity", "is_sky")}


def among_all(maps, held):
    """Maps for the materials that are held, a mask, -> for all, the others with probability 0."""
    of_held = maps["material_probability"]
    every = scratch.zeros((len(held), *of_held.shape[1:]), of_held.dtype)
    for row, m in enumerate(np.flatnonzero(held)):
        every[m] = of_held[row]
        scratch.release(every)
        scratch.release(of_held)
    material = np.flatnonzero(held).astype(maps["material"].dtype)[maps["material"]]
    return maps | {"material": material, "material_probability": every}


def _between(start, count, step, points):
    """The points before and after pixels start .. start + count - 1, and how near the latter is."""
    at = np.clip((np.arange(start, start + count) + 0.5) / step - 0.5, 0, points - 1)
    before = at.astype(int)
    return before, np.minimum(before + 1, points - 1), (at - before).astype(np.float32)


def _linear(a, between, axis):
    # no matrix product: BLAS's threads would be in the way of those that work on tiles
    before, after, share = between
    return (1 - share) * a.take(before, axis) + share * a.take(after, axis)
