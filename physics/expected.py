"""Which materials are expected where: a coarse map, read off between its points."""

from typing import NamedTuple

import numpy as np


class Expected(NamedTuple):
    """nats (materials, h, w) by which a material is expected, more or less than others, in a
    picture seen from afar: point (i, j) stands for the step x step pixels from (step i, step j) on.
    """

    nats: np.ndarray
    step: int

    def of_tile(self, top, left, height, width):
        """(materials, height, width) float32 of the tile that begins at a pixel; linear between
        the points, constant beyond them."""
        rows, down = _between(top, height, self.step, self.nats.shape[1])
        columns, across = _between(left, width, self.step, self.nats.shape[2])
        near = self.nats[:, rows, columns].astype(np.float32)
        return down @ (near @ across.T)


def _between(start, count, step, points):
    """The points near pixels start .. start + count - 1, and their weights (count, those)."""
    at = np.clip((np.arange(start, start + count) + 0.5) / step - 0.5, 0, points - 1)
    first, last = int(at[0]), int(np.ceil(at[-1]))
    weights = np.maximum(0, 1 - np.abs(at[:, None] - np.arange(first, last + 1)))
    return slice(first, last + 1), weights.astype(np.float32)
