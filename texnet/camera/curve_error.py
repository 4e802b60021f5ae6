"""How far the library's curves may be off, where half of the scene's materials ask for it.

Curves measured elsewhere are off by a per cent or so, smoothly, which under a cold sky exceeds a
camera's noise: a wrong material, or a mirror, then fits better than the right one. If all curves
may be off by de (`Environment.with_curves_off_by`), every pixel pays for that freedom, and those
that need it gain. Some de are tried, and the one that makes the pixels likeliest is taken, if it
gains WORTH, if no rival, such as a suspected gain, makes them likelier, and if it is not the last
one tried. Wrong materials that fit by chance ask for less than the right ones need, so the largest
de that is as likely to within NEARLY is taken. It may still be less than the true error.

Pixels of a material that the library lacks ask for it too, and all others pay: so half of the
materials must gain (`asked_by_half`) if more is left than noise leaves (`what_noise_leaves`).
"""

from typing import NamedTuple

import numpy as np

from .correction import Calibration
from .pixels import LEAST_KINDS, LEAST_OF_KIND

ERRORS = 0.0025, 0.005, 0.01, 0.02, 0.04, 0.08  # de, one standard deviation
FIRST = 0.0025, 0.01  # tried first; if neither is likelier than none, the search ends
MOST = 20.0  # nats that a pixel counts: those of a mixed one mean nothing
NOTHING = 1e9  # nats, or more: nothing looks like that
WORTH, NEARLY = 0.25, 0.5  # nats per pixel


class Off(NamedTuple):
    """found    Calibration with an error of the curves
    gained   (P,) nats by which the likeliest error makes pixels likelier than none
    """

    found: Calibration
    gained: np.ndarray


def likeliest_curves(nats_of, found, rivals=()):
    """Off, with a Calibration found and the largest of ERRORS that makes pixels as likely as the
    best one, to within NEARLY; None if the best one gains too little, is the last, or a rival is
    likelier.

    nats_of  NegativeLogEvidence of the pixels (P,), corrected by a Calibration
    rivals   Calibrations that may be right instead
    """
    for some in (FIRST, ERRORS):
        off = [found._replace(curves=e) for e in some]
        nats = nats_of.each([found, *off, *rivals])
        least = np.minimum(np.min(list(nats.values()), axis=0), NOTHING)
        loss = {c: np.minimum(n - least, MOST) for c, n in nats.items()}
        best = min(off, key=lambda c: loss[c].mean())
        gained = loss[found] - loss[best]
        if gained.mean() <= 0:
            return None
    likelier = any(loss[c].mean() < loss[best].mean() for c in rivals)
    if gained.mean() < WORTH or likelier or best.curves == ERRORS[-1]:
        return None
    near = [c for c in off[:-1] if loss[c].mean() <= loss[best].mean() + NEARLY]
    return Off(near[-1], gained)


def asked_by_half(gained, material):
    """Whether half of the materials, and at least LEAST_KINDS, gain, given nats (P,) and indices of
    materials (P,) of pixels."""
    kinds, count = np.unique(material, return_counts=True)
    of_kind = [gained[material == m].mean() for m in kinds[count >= LEAST_OF_KIND]]
    gain = np.count_nonzero(np.array(of_kind) > 0)
    return gain >= max(LEAST_KINDS, len(of_kind) / 2)


def what_noise_leaves(cube, environment):
    """The residual, in noise units, expected from a HeatCube's noise alone in an Environment whose
    curves may be off, and so explain some of it. With U their curve_spread in noise units and n
    noise of unit variance, it is the root mean square of (1 + U U')^-1 n over bands."""
    u = environment.curve_spread / cube.sigma
    explained = np.zeros(cube.bands)
    explained[: min(u.shape)] = np.linalg.svd(u, compute_uv=False) ** 2
    return float(np.sqrt(np.mean((1 + explained) ** -2)))
