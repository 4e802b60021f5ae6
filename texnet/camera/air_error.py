"""How far the air found may absorb differently from usual air, and what that does to T.

Usual air is a guess: any absorption is taken to be off by the least of AIR_ERRORS, as a share of
each band's optical depth, and more if the air does not fit otherwise (`absorbing_otherwise`). Each
band gets as much extra noise as that error changes the ground (`correction`). As it also changes
many bands alike, T may be off by the change that causes (`air_error_k`).
"""

import math

import numpy as np

from physics.air import Air
from physics.prior import MIN_TEMPERATURE_SPREAD_K

from .misfit import fits

# share of the optical depth, in each band independently, which stands for a smaller error common to
# many bands. On ten scenes used for tuning, behind 100 to 1000 m of usual and of other air, T of
# local was off by 1.7 and 1.2 K with none, by 1.1 and 1.2 with 0.4; of net+sgd by 1.2 and 1.0, and
# 0.9 and 1.0 (0.3 and 0.5 did as well)
AIR_ERRORS = 0.4, 0.8
SHAPES = 4  # cosines along the wavelengths


def absorbing_otherwise(pixels, c, left, noise):
    """c, a Calibration with Air that leaves left of pixels, with the least of AIR_ERRORS that makes
    them fit (or, if none does, leaves least); and what is then left. Distances are the
    likeliest at a noise. What is left is measured with the noise raised by MORE but not the air
    error, so that more of it is taken than just fits: as for noise, because errors common to all
    pixels mislead more."""
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
    """Change of T of pixels, K, if the absorption of a Calibration's Air were off by its air_error
    in many bands together: the root of the sum of squares over SHAPES cosines along the
    wavelengths, which together have that size, but at most a scene's prior uncertainty of T.
    Distances, each pixel's on its own, are the likeliest at a noise."""
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
