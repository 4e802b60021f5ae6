"""A gain, an offset or wrong wavelengths of the camera, where the scene itself shows one of them.

A camera of gain g and offset o shows g S + o. Of Eq. 1 only the glow is known beforehand; the
light that is reflected was seen by the same camera, so that with e, T and V as they are it shows

    g S + o = e (g B(T) + o) + (1 - e) X',       X' = g X + o

g B(T) is B at no other T. One pixel's V may make up for that, but in many pixels V would have to
leave the simplex. An offset shows less: what it adds to a body at 300 K looks like another T, and
only colder surfaces tell them apart. Wavelengths off by a tenth of a band move the flanks of all
curves, and of the sky's lines, at once; a gain of half a per cent looks half like that.

Of all gains alone, all offsets alone and all shifts alone that one is taken by which the pixels are
likeliest, if it is by far, if not one of another kind does nearly as well, and if it is not the
last that was tried; an offset only where the sky is in view. A gain or an offset that is likelier
than none, but not by as much, is suspected. A pixel counts at most ENOUGH nats: what the library
does not explain has no more to say.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from .correction import RIGHT, Calibration

ENOUGH = 5.0  # nats above the typical pixel's
STRIDE = 4  # steps, where they are large
# bands under a sky that is assumed, below which nothing of all this is looked for: a gain would
# make up for what the true sky is another. Under another model's sky T was off by 0.9 to 1.6 K then
# in a third of 20 views, and by up to 0.7 K without
FEW_UNDER_SKY = 20
SUSPECT = 0.25  # nats per pixel over a right camera, and at most as many below the likeliest


class Kind(NamedTuple):
    """What may be wrong: of(error) is its Calibration; the steps of the search, how far they go,
    and how far STRIDE of them at a time; which errors are looked at first; the least that counts;
    the nats per pixel that it must gain; and its lead: of two kinds the lesser is what the likelier
    must be ahead by."""

    of: Callable
    step: float
    most: float
    farthest: float
    first: tuple[float, ...]
    least: float
    worth: float
    lead: float


class Best(NamedTuple):
    """The error of a kind by which the pixels are likeliest, and whether the search ended there."""

    kind: Kind
    error: float
    at_end: bool

    @property
    def calibration(self):
        return self.kind.of(self.error)


GAIN = Kind(
    lambda error: Calibration(gain=1 + error),
    0.01, 0.15, 0.27, (0.005, 0.01, 0.03, 0.1, 0.2), 0.0075, 1.0, 0.25,
)  # fmt: skip
OFFSET = Kind(
    lambda error: Calibration(offset_k=error),
    0.5, 4.0, 20.0, (0.5, 1.0, 10.0), 0.5, 2.0, 0.25,
)  # fmt: skip
LEVELS = GAIN, OFFSET


def shift_kind(wavelength_um):
    """The Kind of bands (bands,) in um that are all off by parts of the distance between them; half
    a step of the search is the least that is found."""
    spacing = float(np.median(np.diff(wavelength_um)))
    of = lambda error: Calibration(shift_um=round(error * spacing, 5))
    return Kind(of, 0.1, 0.6, 0.6, (0.1, 0.3), 0.05, 0.5, 0.05)


def one_error(nats_of, sky, kinds):
    """The Calibration by which the pixels are likeliest, RIGHT if none is taken; and then those of
    LEVELS that are suspected.

    nats_of  NegativeLogEvidence of the pixels, corrected by a Calibration
    sky      whether it is in view
    kinds    of errors that are looked for

    A first look at a few errors tells whether there is anything to find. Then all steps of all
    kinds are tried, those between the best of each and its neighbours if these are STRIDE away,
    half a step around the best, and the lowest of a parabola there.
    """
    tried = [RIGHT, *first_look(kinds)]
    loss = losses(nats_of.each(tried), np.median(nats_of(RIGHT)))
    if min(loss, key=loss.get) == RIGHT:
        return RIGHT, ()
    best = [_best_of(kind, tried, nats_of) for kind in kinds]
    loss = losses(nats_of.each([RIGHT, *(b.calibration for b in best)]))
    first, *others = sorted(best, key=lambda b: loss[b.calibration])
    gained = loss[RIGHT] - loss[first.calibration]
    lead = {b: loss[b.calibration] - loss[first.calibration] for b in others}
    enough = gained >= first.kind.worth and abs(first.error) >= first.kind.least
    alone = all(lead[b] >= min(first.kind.lead, b.kind.lead) for b in others)
    # what is right may lie beyond (a shift's is for the ozone to show)
    nearly = [b for b in others if b.kind in LEVELS and lead[b] < gained / 2]
    ends = first.at_end or any(b.at_end for b in nearly)
    # a sky that was missed looks like an offset
    if enough and alone and not ends and (sky or first.kind is not OFFSET):
        return first.calibration, ()
    least = min(loss[RIGHT] - SUSPECT, loss[first.calibration] + SUSPECT)
    return RIGHT, tuple(
        b.calibration
        for b in best
        if b.kind in LEVELS and not b.at_end and loss[b.calibration] <= least
    )


def first_look(kinds):
    """The Calibrations that tell whether there is anything of these kinds to find."""
    return [k.of(sign * error) for k in kinds for error in k.first for sign in (-1, 1)]


def _best_of(kind, tried, nats_of):
    """The Best of a Kind; the Calibrations of its search are added to those tried."""

    def loss_of(errors):
        of = [kind.of(error) for error in errors]
        tried.extend(of)
        loss = losses(nats_of.each(tried))
        return [loss[c] for c in of]

    def likeliest(errors):
        return errors[int(np.argmin(loss_of(errors)))]

    half = kind.step / 2
    n, last = (round(error / kind.step) for error in (kind.most, kind.farthest))
    sizes = [*range(1, n + 1), *range(n + STRIDE, last + 1, STRIDE)]
    steps = sorted(sign * kind.step * i for i in sizes for sign in (-1, 1))
    # a shift may leave the library, and each does where that reaches no farther than the bands
    nats = nats_of.each([kind.of(e) for e in steps])
    steps = [e for e in steps if np.isfinite(nats[kind.of(e)]).any()]
    if not steps:
        return Best(kind, 0.0, at_end=False)
    step = likeliest(steps)
    if step == (steps[-1] if step > 0 else steps[0]):
        return Best(kind, step, at_end=True)
    if abs(step) > kind.most - half:
        step = likeliest([step + kind.step * i for i in range(1 - STRIDE, STRIDE)])
    around = [step + side * half for side in (-1, 0, 1)]
    lowest_at = step + half * float(lowest(*loss_of(around)))
    return Best(kind, likeliest([*around, round(lowest_at, 4)]), at_end=False)


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
