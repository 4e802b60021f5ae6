"""Whether what was taken for a little sky in view is metal that mirrors it.

It looks much the same, but the sky near the horizon, which is in view, is warmer than that overhead
which metal mirrors, and an environment is estimated from it: where it is metal, little fits then.
"""

from .correction import RIGHT
from .misfit import fits
from .missing_sky import SKY_WORTH
from .one_error import losses
from .pixels import SampledPixels, sample

LITTLE = 0.05  # of the pixels


def mistaken_sky(cube, environment, another, looks, library, left_out=None):
    """Whether the pixels of a HeatCube do not fit in an Environment, and are likelier by SKY_WORTH
    in another, that of another(), which found no sky in view; other arguments as of
    `calibration`."""
    part = sample(cube, left_out)
    if part is None:
        return False
    look = looks()
    taken = SampledPixels(part, environment, library, looks)
    if fits(taken.left(RIGHT), part):
        return False
    other = SampledPixels(part, another(), library, looks)
    loss = losses({of: of.nats(look, RIGHT) for of in (taken, other)})
    return bool(loss[taken] - loss[other] >= SKY_WORTH)
