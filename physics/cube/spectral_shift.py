"""Wavelengths that are all stated too long or too short by the same amount: found by the sky's
ozone.

Ozone glows from 9.4 to 9.9 um in an otherwise clear window, everywhere on Earth, which makes it a
spectral reference. The stated wavelengths are shifted until a sky of `physics.sky`, with some air
mass, vapour, ozone and temperature, has the same steps from band to band as the pixels whose bands
differ most, which are sky or mirror it. Steps are used because they exclude the slow differences
between one sky and another.

If no shift makes these pixels fit a clear sky much better than a grey body, no sky is in view.
"""

from dataclasses import replace

import numpy as np

from ..planck import brightness_temperature, planck, planck_derivative
from ..sky import MOST_WATER_CM, sky_along, usual_atmosphere
from .hot import split_hot

LOW_UM, HIGH_UM = 8.5, 11.0  # the bands that are looked at, ozone well inside
EDGE_UM = 0.25  # they reach as near to LOW_UM and HIGH_UM
# from band to band, and where some are left out. Of skies made at random 0.17 um hid the ozone of
# some that were humid and low: wavelengths that were right would have been moved by 0.1 um
COARSEST_UM, GAP_UM = 0.15, 0.4
TINY_UM = 1e-5  # as wavelengths are rounded in files
FARTHEST_UM, STEP_UM = 0.45, 0.01  # of the search
LEAST_UM, LEAST_SPACINGS = 0.03, 0.25  # a shift less than these changes little
LIKE_SKY, BETTER = 0.8, 0.8  # misfit over that of a grey body, and over that as stated
CONTRAST_K = 10.0  # of brightness temperature between bands, of a clear sky at least
WARMEST_K = 330.0  # of air
MOST_CONTRAST = 0.8  # of the pixels that are looked at, over the most (but for 2 %: defects)
SAMPLES = 2000
AIR_EXCESS_K = np.linspace(-2, 12, 15)[:, None, None]  # of the air over what the warmest band shows
GREYS = np.linspace(0.02, 1, 50)[:, None]
# skies that are tried: air masses, vapour over the usual, and Dobson units
MASSES, WATER, OZONE_DU = np.geomspace(1, 38, 9), (0.3, 1.0, 2.5), (220.0, 320.0, 450.0)
FINE_STEP_UM = 0.01
FINE_UM = np.arange(LOW_UM - 0.7, HIGH_UM + 0.7, FINE_STEP_UM)  # at which they are computed


def registered(cube, library):
    """A HeatCube at the wavelengths that its sky shows, without the bands that thereby leave the
    library, and by how much they are less than stated, um (negative: more); itself and 0 where the
    cube cannot say."""
    shift = spectral_shift(cube, library)
    if not shift:
        return cube, 0.0

    def inside(either):
        return library.covers(either.nodes_um).all(axis=1)

    stated, cube = cube, cube.moved(shift)
    # a library for other bands is an error
    kept = inside(cube) | ~inside(stated)
    return cube if kept.all() else cube.only(kept), shift


def spectral_shift(cube, library):
    """um by which the wavelengths of a HeatCube without bad bands are stated too long (too short
    if negative); 0 where they are right to a quarter of a band or the cube cannot say."""
    here = (cube.wavelength_um > LOW_UM) & (cube.wavelength_um < HIGH_UM)
    w = cube.wavelength_um[here]
    if library.sky_index is None or not _spans_ozone(w):
        return 0.0
    s = split_hot(cube)[0].sample(SAMPLES)  # a fire's bands differ more than a sky's
    contrast = np.ptp(brightness_temperature(cube.wavelength_um, s), axis=1)
    most = np.quantile(contrast, 0.98, method="lower")
    s = s[(contrast <= most) & (contrast >= MOST_CONTRAST * most)].mean(axis=0)[here]
    warmest = brightness_temperature(w, s).max()
    if most < CONTRAST_K or warmest > WARMEST_K:
        return 0.0
    air_k = warmest + AIR_EXCESS_K
    nodes, skies = cube.nodes_um[here], _opacities(warmest)

    def misfit(models):
        off = (models - s) / planck_derivative(w, 300.0)
        return float((np.diff(off) ** 2).mean(axis=-1).min() ** 0.5)

    def as_sky(shift):
        # wide bands reach beyond, where the last is as good
        steps = np.clip((nodes - shift - FINE_UM[0]) / FINE_STEP_UM, 0, len(FINE_UM) - 1.001)
        below, share = steps.astype(int), steps % 1
        at = ((1 - share) * skies[:, below] + share * skies[:, below + 1]).mean(axis=-1)
        return misfit(planck(w - shift, air_k) * at)

    farthest = round(FARTHEST_UM / STEP_UM)
    misfits = [as_sky(STEP_UM * i) for i in range(-farthest, farthest + 1)]
    best, least = int(np.argmin(misfits)) - farthest, min(misfits)
    if abs(best) == farthest or abs(best) * STEP_UM < max(LEAST_UM, LEAST_SPACINGS * _spacing(w)):
        return 0.0
    like_sky = least < LIKE_SKY * misfit(planck(w, air_k) * GREYS)
    return STEP_UM * best if like_sky and least < BETTER * misfits[farthest] else 0.0


def _opacities(air_k):
    """(skies, n) of what is tried, at FINE_UM: radiance over B(T_air)."""
    usual = usual_atmosphere(air_k)
    airs = [
        replace(usual, water_cm=min(more * usual.water_cm, MOST_WATER_CM), ozone_du=ozone_du)
        for more in WATER
        for ozone_du in OZONE_DU
    ]
    skies = np.concatenate([sky_along(FINE_UM, MASSES, air) for air in airs])
    return skies / planck(FINE_UM, usual.air_temperature_k)


def _spacing(w):
    return float(np.median(np.diff(w)))


def _spans_ozone(w):
    """Whether bands at w, off by FARTHEST_UM or not, tell where ozone begins and ends."""
    if len(w) < 2 or _spacing(w) > COARSEST_UM + TINY_UM or np.diff(w).max() > GAP_UM + TINY_UM:
        return False
    return w[0] < LOW_UM + EDGE_UM and w[-1] > HIGH_UM - EDGE_UM
