"""How far the air that was found may absorb otherwise than usual air, and what that does to T.

Usual air is a guess: what any absorbs is off by the least of AIR_ERRORS, as a share of each band's
optical depth, and that of air which does not fit so by more (`absorbing_otherwise`). Bands are as
much noisier as that moves the ground (`correction`), and as it moves many bands alike, too, T may
be off by as much as it would be another then (`air_error_k`).
"""

import math

import numpy as np

from physics.air import Air
from physics.prior import MIN_TEMPERATURE_SPREAD_K

from .misfit import fits

# of its optical depth, in each band by itself, which stands for less in many bands alike: on ten
# scenes used for tuning, behind 100 to 1000 m of usual and of other air, T of local was off by 1.7
# and 1.2 K with none, by 1.1 and 1.2 with 0.4, of net+sgd by 1.2 and 1.0, and 0.9 and 1.0 (0.3 and
# 0.5 did as well)
AIR_ERRORS = 0.4, 0.8
SHAPES = 4  # cosines along the wavelengths


def absorbing_otherwise(pixels, c, left, noise):
    """A Calibration with Air, by which so much is left of pixels, with the least of AIR_ERRORS by
    which they fit; if they do by none, with what leaves least; and what that leaves. Distances are
    likeliest at a noise. What is left is asked at MORE noise, but not at more of the error, so that
    more of it is taken than just fits: as with noise, because what is wrong in all pixels alike
    misleads more."""
    of = c._replace(contrast_k=pixels.contrast_k(c, noise))
    least = of._replace(air_error=AIR_ERRORS[0]), left
    for error in AIR_ERRORS:
        if fits(least[1], pixels.cube):
            break
        off = of._replace(air_error=error)
        left = pixels.left(off, pixels.distances(off, noise))
        if 0 < left < least[1]:
            least = off, left
    return least


def air_error_k(pixels, c, noise):
    """K by which T of pixels would be another, if the Air of a Calibration absorbed otherwise by
    its air_error in many bands alike: the root of the sum of squares over SHAPES cosines along the
    wavelengths, which make up that much together, though no more than is known of a scene's T
    beforehand. Distances, each pixel's by itself, are likeliest at a noise."""
    if not c.air_error:
        return 0.0
    w, nodes = pixels.cube.wavelength_um, pixels.cube.nodes_um
    along = np.pi * (w - w[0]) / (w[-1] - w[0])
    here, moved = pixels.corrected_maps(c, noise), []
    for shape in range(1, SHAPES + 1):
        wave = math.sqrt(2 / SHAPES) * np.cos(shape * along)
        absorption = tuple(np.exp(c.air_error * wave).tolist())
        other = c._replace(air=Air.of(*c.air[:2], nodes, absorption))
        moved.append(pixels.moved_k(pixels.corrected_maps(other, noise), here))
    return min(float(np.sqrt(np.sum(np.square(moved)))), MIN_TEMPERATURE_SPREAD_K)
