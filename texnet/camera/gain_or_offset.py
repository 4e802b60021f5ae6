"""A gain or an offset of the camera, where the scene itself shows one.

A camera of gain g and offset o shows g S + o. Of Eq. 1 only the glow is known beforehand; the
light that is reflected was seen by the same camera, so that with e, T and V as they are it shows

    g S + o = e (g B(T) + o) + (1 - e) X',       X' = g X + o

g B(T) is B at no other T. One pixel's V may make up for that, but in many pixels V would have to
leave the simplex. An offset shows less: what it adds to a body at 300 K looks like another T, and
only colder surfaces tell them apart.

Of all gains alone and all offsets alone that one is taken by which the pixels are likeliest, if it
is by far, if not one of the other kind does nearly as well, and if it is not the last that was
tried; an offset only where the sky is in view. A pixel counts at most ENOUGH nats: what the library
does not explain has no more to say.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from .correction import RIGHT, Calibration

ENOUGH = 5.0  # nats above the typical pixel's
LEAD = 0.25  # nats per pixel over the best of the other kind


class Kind(NamedTuple):
    """What may be wrong: of(error) is its Calibration; the steps of the search and how far it
    goes; which errors are looked at first; the least that counts, and the nats per pixel that it
    must gain."""

    of: Callable
    step: float
    most: float
    first: tuple[float, ...]
    least: float
    worth: float


class Best(NamedTuple):
    """The error of a kind by which the pixels are likeliest, with half a step to both sides."""

    kind: Kind
    error: float
    around: tuple[Calibration, Calibration, Calibration]

    @property
    def at_end(self):
        """Whether the search ended there."""
        return abs(self.error) > self.kind.most - self.kind.step / 2


GAIN = Kind(lambda error: Calibration(gain=1 + error), 0.01, 0.15, (0.01, 0.03, 0.1), 0.0075, 1.0)
OFFSET = Kind(lambda error: Calibration(offset_k=error), 0.5, 4.0, (1.0,), 0.5, 2.0)
KINDS = GAIN, OFFSET


def gain_or_offset(nats_of, sky):
    """The Calibration by which the pixels are likeliest; RIGHT if none is by far.

    nats_of  Calibration -> (P,) minus the pixels' log evidence, corrected by it; infinite where
             nothing looks like that; remembered
    sky      whether it is in view

    A first look at a few errors tells whether there is anything to find. Then all steps of both
    kinds are tried, half a step around the best of each, and the lowest of a parabola there.
    """
    tried = [RIGHT, *first_look()]
    loss = losses({c: nats_of(c) for c in tried}, np.median(nats_of(RIGHT)))
    if min(loss, key=loss.get) == RIGHT:
        return RIGHT
    best = [_best_of(kind, tried, nats_of) for kind in KINDS]
    loss = losses({c: nats_of(c) for c in tried})
    one, other = sorted(best, key=lambda b: loss[b.around[1]])
    gained, lead = loss[RIGHT] - loss[one.around[1]], loss[other.around[1]] - loss[one.around[1]]
    if gained < one.kind.worth or lead < LEAD:
        return RIGHT
    if one.at_end or (other.at_end and lead < gained / 2):  # what is right may lie beyond
        return RIGHT
    if one.kind is OFFSET and not sky:  # a sky that was missed looks like one
        return RIGHT
    error = one.error + one.kind.step / 2 * float(lowest(*(loss[c] for c in one.around)))
    if abs(error) < one.kind.least:
        return RIGHT
    return one.kind.of(round(error, 4))


def first_look():
    """The Calibrations that tell whether there is anything to find."""
    return [k.of(sign * error) for k in KINDS for error in k.first for sign in (-1, 1)]


def _best_of(kind, tried, nats_of):
    """The Best of all steps of a Kind; what it takes is added to the Calibrations tried."""
    n = round(kind.most / kind.step)
    errors = {kind.of(kind.step * i): kind.step * i for i in range(-n, n + 1) if i}
    tried.extend(errors)
    loss = losses({c: nats_of(c) for c in tried})
    error = errors[min(errors, key=loss.get)]
    around = tuple(kind.of(error + side * kind.step / 2) for side in (-1, 0, 1))
    tried.extend(around)
    return Best(kind, error, around)


def losses(all_nats, typical=None):
    """{what: nats per pixel} of {what: minus log evidence of pixels (P,)}, of which none counts
    more than ENOUGH over the typical pixel's: that of the likeliest if None."""
    if typical is None:
        typical = min(np.median(nats) for nats in all_nats.values())
    return {c: np.minimum(nats, typical + ENOUGH).mean() for c, nats in all_nats.items()}


def lowest(below, at, above):
    """Where parabolas through values at -1, 0 and 1 are least, within these; 0 where they are
    straight lines, or the wrong way up."""
    curvature = np.asarray(below - 2 * at + above)
    minimum = np.divide(
        below - above, 2 * curvature, out=np.zeros(curvature.shape), where=curvature > 0
    )
    return np.clip(minimum, -1, 1)
