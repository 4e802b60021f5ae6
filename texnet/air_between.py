"""How much air lies between scene and camera, where the scene itself shows it.

Air pulls all that is seen through it towards its own temperature, most where it absorbs most: no
material does that. So metres of air and its temperature are taken by which the pixels are
likeliest, if they are by WORTH. They are so of the whole picture alike: what is nearer than most
is taken for farther, and what is farther for nearer.

A little air shows hardly how warm it is, much of it very well. So the distance is doubled step by
step, and the temperature followed from one step to the next.

Only where the sky is in view, whose opaque bands say about how warm the air is.
"""

from .correction import RIGHT, Calibration
from .gain_or_offset import losses

METRES = tuple(10.0 * 2**i for i in range(8))
FINER = 2**-0.5, 1.0, 2**0.5  # of the distance, in the end
WARMER_K = (-2.0, 0.0, 2.0, 4.0, 6.0, 8.0)  # than the sky's opaque bands are in the mean
STEPS_K = (1.5, 0.75)  # of the temperature, from one distance to the next, and in the end
WORTH = 0.3  # nats per pixel


def air_between(nats_of, air_of, sky_k):
    """The Calibration, of the Air alone, by which the pixels are likeliest; RIGHT if none is.

    nats_of  Calibration -> (P,) minus the pixels' log evidence, corrected by it; infinite where
             nothing looks like that
    air_of   (metres, K) -> Air
    sky_k    brightness temperature of the sky's opaque bands, K
    """
    nats = {RIGHT: nats_of(RIGHT)}

    def likeliest(metres, kelvins):
        """nats per pixel of all so far, and which of so much air of these temperatures is best."""
        some = [Calibration(air=air_of(metres, k)) for k in kelvins if k >= sky_k + WARMER_K[0]]
        nats.update({c: nats_of(c) for c in some if c not in nats})
        loss = losses(nats)
        return loss, min(some, key=loss.get)

    kelvins = [sky_k + k for k in WARMER_K]
    for metres in METRES:
        _, here = likeliest(metres, kelvins)
        loss, here = likeliest(metres, _around(here, STEPS_K[1]))
        if loss[here] > loss[RIGHT]:
            break
        kelvins = _around(here, STEPS_K[0])
    best = min(loss, key=loss.get)
    if best == RIGHT:
        return RIGHT
    for finer in FINER:
        loss, _ = likeliest(best.air.metres * finer, _around(best, STEPS_K[1] / 2))
    best = min(loss, key=loss.get)
    return best if loss[RIGHT] - loss[best] >= WORTH else RIGHT


def _around(c, step):
    """Temperatures of the Air of a Calibration, and so much less and more, K."""
    return [c.air.temperature_k + i * step for i in (-1, 0, 1)]
