"""A gain, an offset or a wavelength error of the camera, where the scene itself shows one of them.

A camera of gain g and offset o shows g S + o. In Eq. 1 only the glow is known beforehand; reflected
light was seen by the same camera, so that with e, T and V unchanged it shows

    g S + o = e (g B(T) + o) + (1 - e) X',       X' = g X + o

g B(T) is B at no other T. One pixel's V may make up for that, but in many pixels V would have to
leave the simplex. An offset shows less: what it adds to a body at 300 K looks like another T, and
only colder surfaces tell them apart. Wavelengths off by a tenth of a band move the flanks of all
curves, and of the sky's lines, at once; a gain of half a per cent looks half like that.

Of all single gains, offsets and shifts, the one that makes the pixels likeliest is accepted, if by
far, if none of another kind does nearly as well, and if it is not the last one tried; an offset
only if the sky is in view. A gain or an offset that is likelier than none, but by too little, is
suspected. A pixel counts at most ENOUGH nats: what the library does not explain has no more to say.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from .correction import RIGHT, Calibration

ENOUGH = 5.0  # nats above the typical pixel's
STRIDE = 4  # steps, where the error is large
# bands under an assumed sky, below which none of this is looked for: a gain would make up for the
# difference to the true sky. Under another model's sky T was then off by 0.9 to 1.6 K in a third of
# 20 views, and by up to 0.7 K without
FEW_UNDER_SKY = 20
SUSPECT = 0.25  # nats per pixel, at least, over a perfect camera, and at most below the likeliest


class Kind(NamedTuple):
    """A kind of error: of(error) is its Calibration; step of the search; most, its limit, and
    farthest, the limit for steps of STRIDE; first, the errors looked at first; least, the smallest
    that counts; worth, the nats per pixel it must gain; lead, of which the lesser of two kinds' is
    what the likelier must be ahead by."""

    of: Callable
    step: float
    most: float
    farthest: float
    first: tuple[float, ...]
    least: float
    worth: float
    lead: float


class Best(NamedTuple):
    """The error of a kind that makes the pixels likeliest, and whether the search ended there."""

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
    """The Kind for bands (bands,) in um that are all shifted by parts of their spacing; the least
    that is found is half a step of the search."""
    spacing = float(np.median(np.diff(wavelength_um)))
    of = lambda error: Calibration(shift_um=round(error * spacing, 5))
    return Kind(of, 0.1, 0.6, 0.6, (0.1, 0.3), 0.05, 0.5, 0.05)


def one_error(nats_of, sky, kinds):
    """The Calibration that makes the pixels likeliest, RIGHT if none is accepted; and the suspected
    ones of LEVELS.

    nats_of  NegativeLogEvidence of the pixels, corrected by a Calibration
    sky      whether it is in view
    kinds    of errors that are looked for

    A first look at a few errors tells whether there is anything to find. Then all steps of all
    kinds are tried, those between the best of each and its neighbours if these are STRIDE away,
    half a step around the best, and the minimum of a parabola there.
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
    # the truth may lie beyond (a shift's is shown by the ozone)
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
    """The Calibrations that tell whether there is an error of these kinds."""
    return [k.of(sign * error) for k in kinds for error in k.first for sign in (-1, 1)]


def _best_of(kind, tried, nats_of):
    """The Best of a Kind; the Calibrations of its search are added to tried."""

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
    # a shift may leave the library; every shift does if it covers no more than the bands
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
    """{what: nats per pixel} from {what: minus log evidence of pixels (P,)}, each limited
    to ENOUGH over the typical pixel's (None: that of the likeliest)."""
    if typical is None:
        typical = min(np.median(nats) for nats in all_nats.values())
    return {c: np.minimum(nats, typical + ENOUGH).mean() for c, nats in all_nats.items()}


def lowest(below, at, above):
    """Where parabolas through values at -1, 0 and 1 have their minimum, clipped to that range; 0
    where they are straight lines, or open downwards."""
    curvature = np.asarray(below - 2 * at + above)
    minimum = np.divide(
        below - above, 2 * curvature, out=np.zeros(curvature.shape), where=curvature > 0
    )
    return np.clip(minimum, -1, 1)
