"""Saturated pixels: values that are clipped at the highest that a band can show.

T of such a pixel is a lower bound. A band has a ceiling if its brightest value is not the end of a
tail but a pile: far more pixels have exactly that value than any other of the brightest values. If
a camera's pixels are calibrated one by one, each has its own ceiling, which cannot be seen in a
cube. Areas that are exactly uniform, as in a drawing, look saturated where they are the brightest.
"""

import numpy as np

from ..machinery import scratch

PILE = 4  # pixels at the ceiling, at least, over those of any other value
LEAST = 8  # pixels at the ceiling
BRIGHTEST = 2000  # pixels to compare with
MANY = 20  # values of theirs, fewer of which are no sensor's


def saturated(cube):
    """(height, width) bool, where any band of a HeatCube is at its ceiling; dead pixels are not."""
    pixels, seen = np.zeros(cube.shape, bool), ~cube.dead
    for band in scratch.parts(cube.radiance):
        top = seen & (band == band.max(where=seen, initial=0))
        count = np.count_nonzero(top)
        if count >= LEAST and _is_pile(band[seen & ~top], count):
            pixels |= top
    return pixels


def _is_pile(others, count):
    """Whether count pixels of one value stand out from others (n,), which are all darker."""
    if len(others) > BRIGHTEST:
        others = np.partition(others, -BRIGHTEST)[-BRIGHTEST:]
    counts = np.unique(others, return_counts=True)[1]
    return len(counts) >= MANY and count >= PILE * counts.max()
