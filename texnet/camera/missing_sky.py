"""Whether a sky that is not in view lights the scene.

In a closed room none does: a sky is one more object that could light it, and the pixels are no
likelier with it.
"""

import numpy as np

from ..glance import LEAST_MATERIALS
from .correction import RIGHT
from .one_error import losses
from .pixels import SampledPixels, sample

# nats per pixel; right ones were worth 1.8 and more, in rooms -2 and less. A few pixels tell less
# surely, but mostly: of 30 single ones of rooms 4 passed for lit by a sky, none with a wrong name
SKY_WORTH, FEWEST_PIXELS = 1.0, 1


def sky_is_likelier(cube, environment, found, under_sky, looks, library, left_out=None):
    """Whether the pixels of a HeatCube without sky in view are likelier by SKY_WORTH in an
    Environment with a sky that is assumed than in the one without, in which the camera was found
    to be of a Calibration; other arguments as of `calibration`.

    Mirrors do not count: they may be of anything, even of themselves, as an object that was found
    in the picture has their very spectrum."""
    part = sample(cube, left_out, FEWEST_PIXELS)
    if part is None:
        return False
    look, found = looks(), found._replace(noise=1.0, misfit=1.0, shared=0.0, curves=0.0)
    seen = np.flatnonzero(~library.is_mirror(cube.wavelength_um))
    if len(seen) < LEAST_MATERIALS:
        return False
    without, under = losses({
        of: SampledPixels(part, of, library, looks, seen).nats(look, c)
        for of, c in ((environment, found), (under_sky, RIGHT))
    }).values()  # fmt: skip
    return bool(without - under >= SKY_WORTH)
