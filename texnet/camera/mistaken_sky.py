"""Whether what was taken for a little sky in view is metal that mirrors it.

It looks much the same, but the sky near the horizon, which is in view, is warmer than the one
overhead, which metal mirrors. An environment estimated from metal as if it were sky fits little.
"""

from .correction import RIGHT
from .misfit import fits
from .missing_sky import SKY_WORTH
from .one_error import losses
from .pixels import SampledPixels, sample

LITTLE = 0.05  # of the pixels


def mistaken_sky(cube, environment, another, looks, library, left_out=None):
    """Whether the pixels of a HeatCube do not fit in an Environment, and are likelier by SKY_WORTH
    in another(), an Environment found without sky in view; other arguments as in `calibration`."""
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
