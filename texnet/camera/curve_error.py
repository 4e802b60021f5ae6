"""How far the library's curves may be off, where most materials of the scene ask for it.

Curves measured elsewhere are off by a per cent or so, smoothly, which under a cold sky is more than
a camera's noise: a wrong material, or a mirror, then fits better than the right one. If all curves
may be off by de (`Environment.with_curves_off_by`), every pixel pays for that freedom, and those
that need it gain. So of some de that is taken by which the pixels are likeliest, if they are so by
WORTH, and if half of the materials gain: what the library lacks asks for it in its own pixels
alone, and all others would pay.
"""

from typing import NamedTuple

import numpy as np

from .correction import Calibration

ERRORS = 0.0025, 0.005, 0.01, 0.02, 0.04, 0.08  # de, one standard deviation
FIRST = 0.0025, 0.01  # of which one at least is likelier than none, or none is
MOST = 20.0  # nats that a pixel counts: those of a mixed one mean nothing
NOTHING = 1e9  # nats, or more: what looks like nothing
WORTH = 0.25  # nats per pixel
LEAST_OF_KIND = 8  # pixels of a material


class Off(NamedTuple):
    """A Calibration with an error of the curves, and the nats (P,) by which pixels are likelier."""

    found: Calibration
    gained: np.ndarray


def likeliest_curves(nats_of, found):
    """Off, of the error of curves by which pixels are likeliest, beside the Calibration found; None
    where they are not so by WORTH.

    nats_of  Nats of the pixels, corrected by a Calibration
    """
    loss = {}
    for some in (FIRST, ERRORS):
        off = [found._replace(curves=e) for e in some]
        nats = nats_of.each([found, *off])
        least = np.minimum(np.min(list(nats.values()), axis=0), NOTHING)
        loss = {c: np.minimum(n - least, MOST) for c, n in nats.items()}
        best = min(loss, key=lambda c: loss[c].mean())
        if best == found:
            return None
    gained = loss[found] - loss[best]
    return Off(best, gained) if gained.mean() >= WORTH else None


def asked_by_most(gained, material):
    """Whether half of the materials (P,), indices, gain nats."""
    kinds, count = np.unique(material, return_counts=True)
    of_kind = [gained[material == m].mean() for m in kinds[count >= LEAST_OF_KIND]]
    return bool(of_kind and np.median(of_kind) > 0)
