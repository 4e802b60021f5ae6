"""Whether an environment that was given is off by kelvins, where the pixels show it.

One that was taken elsewhere or at another time may be; of one that was all sky that alone, as the
other objects are the cube's own. It is taken to be if so the pixels are likelier by ERROR_WORTH,
and more than by a gain or an offset of the camera or by curves that are off. No gain, offset or air
is looked for then: all are measured against the environment.
"""

from functools import partial

import numpy as np

from .calibration import explained
from .correction import RIGHT
from .misfit import with_noise
from .nats import NegativeLogEvidence
from .one_error import LEVELS, first_look, losses, one_error
from .pixels import SampledPixels, sample

# K that are tried, and nats per pixel: in ten scenes outside the test sets, with 54 and nine bands,
# surroundings that were right to 1 K gained 0.07 at most, 10 K off 0.6 and more (in a wood, which
# is all around, 0.08 to 0.4), 3 K off now and then nothing
ERRORS_K, ERROR_WORTH = (3.0, 10.0, 30.0), 0.1


def error_of_given(cube, environment, objects, looks, library, left_out=None):
    """A Calibration, of noise or curves alone, and K by which objects of a HeatCube's Environment
    that were given, by index (None: all), are likely off, 0 if they are not. Other arguments as of
    `calibration`.

    What an error of it does not explain may as well be of the library or the camera, which mislead
    likewise, so it is noise, too."""
    part = sample(cube, left_out)
    if part is None:
        return RIGHT, 0.0
    may_be = {k: environment.off_by(k, objects) for k in (0.0, *ERRORS_K)}
    of = {k: SampledPixels(part, e, library, looks) for k, e in may_be.items()}
    look, left = looks(), of[0.0].left(RIGHT)
    nats_of = NegativeLogEvidence(partial(of[0.0].nats, look), look.at_once)
    all_nats = NegativeLogEvidence(lambda k: of[k].nats(look, RIGHT), look.at_once).each(of)
    camera, suspected = one_error(nats_of, environment.sky_mean is not None, LEVELS)
    as_given = explained(of[0.0], nats_of, RIGHT, left, (camera, *suspected))
    others = nats_of.each([as_given]) if as_given.curves else {}
    loss = losses(all_nats | others)
    likeliest = min(loss, key=loss.get)
    worth = loss[0.0] - loss[likeliest] if np.isfinite(loss[likeliest]) else 0.0
    if likeliest in others or worth < ERROR_WORTH:
        return as_given, 0.0
    if objects is None:  # by that camera, perhaps: else a gain of it is an error of the sky's
        cameras = *first_look(LEVELS), camera, *suspected
        loss = losses(all_nats | nats_of.each(cameras))
        if min(loss, key=loss.get) != likeliest:
            return as_given, 0.0
    return with_noise(RIGHT, left, cube), likeliest
