"""Whether an environment that was given is off by kelvins, where the pixels show it.

One measured elsewhere or at another time may be; of one that was all sky, only the sky, as the
other objects come from the cube. It is taken to be off if that makes the pixels likelier by
ERROR_WORTH, and more so than a gain or an offset of the camera or curve errors. No gain, offset or
air is corrected then: all are measured against the environment.
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
# surroundings that were right to 1 K gained at most 0.07, 10 K off 0.6 and more (in a wood, which
# is all around, 0.08 to 0.4), 3 K off sometimes nothing
ERRORS_K, ERROR_WORTH = (3.0, 10.0, 30.0), 0.1


def error_of_given(cube, environment, objects, looks, library, left_out=None):
    """A Calibration, of noise or curves only, and K by which given objects of a HeatCube's
    Environment, by index (None: all), are probably off, 0 if they are not. Other arguments as in
    `calibration`.

    The misfit that such an error leaves may as well come from the library or the camera, which
    mislead likewise, so it is also noise."""
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
    if objects is None:  # measured by that camera, perhaps: else its gain is an error of the sky's
        cameras = *first_look(LEVELS), camera, *suspected
        loss = losses(all_nats | nats_of.each(cameras))
        if min(loss, key=loss.get) != likeliest:
            return as_given, 0.0
    return with_noise(RIGHT, left, cube), likeliest
