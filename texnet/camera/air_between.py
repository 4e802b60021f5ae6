"""How much air lies between scene and camera, where the scene itself shows it.

Air pulls all that is seen through it towards its own temperature, most where it absorbs most: no
material does that. So metres of air and its temperature are taken by which the pixels are
likeliest, if they are by WORTH, of the whole picture alike at first (`distances` tells its parts
apart).

A little air shows hardly how warm it is, much of it very well, the more so the warmer and damper it
is. So the distance is doubled step by step, and temperatures are tried at each that are usual, and
that are near the last one's best.

Only where the sky is in view, whose opaque bands say about how warm the air is; where no band is
opaque, it is about as warm as the scene. What is best with the most air that is tried is not taken:
what is right may lie beyond, or be something else.
"""

from .correction import RIGHT
from .one_error import losses

METRES = tuple(10.0 * 2**i for i in range(9))
FINER = 2**-0.5, 1.0, 2**0.5  # of the distance, in the end
WARMER_K = (-2.0, 0.0, 2.0, 4.0, 6.0, 8.0)  # than what shows how warm it is
STEPS_K = (1.5, 0.75)  # of the temperature, from one distance to the next, and in the end
WORTH = 0.3  # nats per pixel


def air_between(nats_of, air_of, about_k, start=RIGHT):
    """The Calibration of start with the Air by which the pixels are likeliest; start if none is.

    nats_of  NegativeLogEvidence of the pixels, corrected by a Calibration
    air_of   (metres, K) -> Air
    about_k  what the air is about as warm as, or some K warmer, K
    """
    tried = [start]

    def likeliest(metres, kelvins):
        """nats per pixel of all so far, and which of so much air of these temperatures is best."""
        able = [k for k in kelvins if k >= about_k + WARMER_K[0]]
        some = [start._replace(air=air_of(metres, k)) for k in able]
        tried.extend(some)
        loss = losses(nats_of.each(tried))
        return loss, min(some, key=loss.get)

    usual, near = [about_k + k for k in WARMER_K], []
    for metres in METRES:
        _, here = likeliest(metres, usual + near)
        loss, here = likeliest(metres, _around(here, STEPS_K[1]))
        if loss[here] > loss[start]:
            break
        near = _around(here, STEPS_K[0])
    best = min(loss, key=loss.get)
    if best == start or best.air.metres == METRES[-1]:
        return start
    for finer in FINER:
        loss, _ = likeliest(best.air.metres * finer, _around(best, STEPS_K[1] / 2))
    best = min(loss, key=loss.get)
    return best if loss[start] - loss[best] >= WORTH else start


def _around(c, step):
    """Temperatures of the Air of a Calibration, and so much less and more, K."""
    return [c.air.temperature_k + i * step for i in (-1, 0, 1)]
