"""Which materials are expected where: a coarse map, read off between its points."""

from typing import NamedTuple

import numpy as np


class Expected(NamedTuple):
    """nats (materials, h, w) float32 by which a material is expected from afar: point (i, j)
    stands for the step x step pixels from (step i, step j) on.
    """

    nats: np.ndarray
    step: int

    def of_tile(self, top, left, height, width):
        """(materials, height, width) of the tile that begins at a pixel; linear between
        the points, constant beyond them."""
        rows = _between(top, height, self.step, self.nats.shape[1])
        columns = _between(left, width, self.step, self.nats.shape[2])
        near = slice(rows[0][0], rows[1][-1] + 1)
        rows = rows[0] - near.start, rows[1] - near.start, rows[2][:, None]
        return _linear(_linear(self.nats[:, near], columns, 2), rows, 1)


def _between(start, count, step, points):
    """The points before and after pixels start .. start + count - 1, and how near the latter is."""
    at = np.clip((np.arange(start, start + count) + 0.5) / step - 0.5, 0, points - 1)
    before = at.astype(int)
    return before, np.minimum(before + 1, points - 1), (at - before).astype(np.float32)


def _linear(a, between, axis):
    # no matrix product: BLAS's threads would be in the way of those that work on tiles
    before, after, share = between
    return (1 - share) * a.take(before, axis) + share * a.take(after, axis)
