"""How far the library's curves may be off, where most materials of the scene ask for it.

Curves measured elsewhere are off by a per cent or so, smoothly, which under a cold sky is more than
a camera's noise: a wrong material, or a mirror, then fits better than the right one. If all curves
may be off by de (`Environment.with_curves_off_by`), every pixel pays for that freedom, and those
that need it gain. Of some de that is looked for by which the pixels are likeliest. They must be so
by WORTH, and half of the materials must gain: what the library lacks asks for it in its own pixels
alone, and all others pay. Since wrong materials that fit by chance ask for less than the right ones
need, the largest de is taken that gains NEARLY as much.
"""

from typing import NamedTuple

import numpy as np

from .correction import Calibration

ERRORS = 0.0025, 0.005, 0.01, 0.02, 0.04, 0.08  # de, one standard deviation
FIRST = 0.0025, 0.01  # of which one at least is likelier than none, or none is
MOST = 20.0  # nats that a pixel counts: those of a mixed one mean nothing
NOTHING = 1e9  # nats, or more: what looks like nothing
WORTH, NEARLY = 0.25, 0.8  # nats per pixel; of the most that any gains
LEAST_OF_KIND = 8  # pixels of a material


class Off(NamedTuple):
    """A Calibration with an error of the curves, and the nats (P,) by which pixels are likelier
    with the likeliest."""

    found: Calibration
    gained: np.ndarray


def likeliest_curves(nats_of, found):
    """Off, beside the Calibration found; None where no error of the curves is WORTH it.

    nats_of  Nats of the pixels, corrected by a Calibration
    """
    gained = {}
    for some in (FIRST, ERRORS):
        off = [found._replace(curves=e) for e in some]
        nats = nats_of.each([found, *off])
        least = np.minimum(np.min(list(nats.values()), axis=0), NOTHING)
        loss = {c: np.minimum(n - least, MOST) for c, n in nats.items()}
        gained = {c: loss[found] - loss[c] for c in off}
        likeliest = max(off, key=lambda c: gained[c].mean())
        most = gained[likeliest].mean()
        if most <= 0:
            return None
    if most < WORTH:
        return None
    largest = [c for c in off if gained[c].mean() >= NEARLY * most][-1]
    return Off(largest, gained[likeliest])


def asked_by_most(gained, material):
    """Whether half of the materials (P,), indices, gain nats."""
    kinds, count = np.unique(material, return_counts=True)
    of_kind = [gained[material == m].mean() for m in kinds[count >= LEAST_OF_KIND]]
    return bool(of_kind and np.median(of_kind) > 0)
