"""How much air lies between scene and camera, where the scene itself shows it.

Air pulls the radiance of all that is seen through it towards its own temperature, most where it
absorbs most, as no material does. So the length in metres and the temperature of the air are chosen
that make the pixels likeliest, if they gain WORTH; at first for the whole picture alike
(`distances` tells its parts apart).

A little air hardly shows its temperature, much air shows it well, the more so the warmer and damper
it is. So the distance is doubled step by step, and at each step usual temperatures are tried as
well as some near the best of the previous step.

This needs the sky in view, whose opaque bands show roughly how warm the air is; if no band is
opaque, the air is about as warm as the scene. A best fit with the most air tried is rejected: the
truth may lie beyond, or be something else.
"""

from .correction import RIGHT
from .one_error import losses

METRES = tuple(10.0 * 2**i for i in range(9))
FINER = 2**-0.5, 1.0, 2**0.5  # factors on the distance, at the end
WARMER_K = (-2.0, 0.0, 2.0, 4.0, 6.0, 8.0)  # above about_k
STEPS_K = (1.5, 0.75)  # of the temperature, from one distance to the next, and at the end
WORTH = 0.3  # nats per pixel


def air_between(nats_of, air_of, about_k, start=RIGHT):
    """The Calibration start with the Air that makes the pixels likeliest; start if none does.

    nats_of  NegativeLogEvidence of the pixels, corrected by a Calibration
    air_of   (metres, K) -> Air
    about_k  rough temperature of the air, which may be some K warmer, K
    """
    tried = [start]

    def likeliest(metres, kelvins):
        """nats per pixel of all so far, and the best of these temperatures for so much air."""
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
    """The temperature of a Calibration's Air, and one step less and more, K."""
    return [c.air.temperature_k + i * step for i in (-1, 0, 1)]
