"""Wavelengths that are all stated too long or too short by as much: found by the sky's ozone.

Ozone glows from 9.3 to 9.9 um in an otherwise clear window, and it does so everywhere on Earth;
what is registered against the atmosphere is registered there. Seen along air mass a at air
temperature T a sky radiates about B(T) (1 - t^a), t being the zenith transmittance 1 - e_sky of the
library's sky. The wavelengths as stated are moved until that has the same steps from band to band
as the pixels whose bands differ most, which are sky or mirror it. Steps, because the slow
differences between one sky and another stay out of them.

If no move makes a clear sky of these pixels much rather than a grey body, none is in view.
"""

import numpy as np

from .bands import quadrature
from .planck import brightness_temperature, radiance, radiance_derivative

LOW_UM, HIGH_UM = 8.5, 11.0  # the bands that are looked at, ozone well inside
COARSEST_UM = 0.25  # from band to band, lest ozone fall between them
FARTHEST_UM, STEP_UM = 0.45, 0.01  # of the search
LEAST_UM, LEAST_BANDS = 0.03, 0.25  # what is less changes little
LIKE_SKY = 0.8  # misfit of a sky over that of a grey body
CONTRAST_K = 10.0  # of brightness temperature between bands, of a clear sky at least
MOST_CONTRAST = 0.8  # of the pixels that are looked at, over the most (but for 2 %: defects)
SAMPLES = 2000
AIR_MASSES = np.geomspace(0.1, 40, 40)
AIR_EXCESS_K = np.linspace(-2, 12, 15)[:, None, None]  # of the air over what the warmest band shows
GREYS = np.linspace(0.02, 1, 50)[:, None]


def spectral_shift(cube, library):
    """um by which a HeatCube's wavelengths are stated too long (too short if negative); 0 where
    they are right to half a band, or the cube cannot say."""
    here = (cube.wavelength_um > LOW_UM) & (cube.wavelength_um < HIGH_UM)
    w = cube.wavelength_um[here]
    if library.sky_index is None or not _spans_ozone(w):
        return 0.0
    s = cube.sample(SAMPLES)
    contrast = np.ptp(brightness_temperature(cube.wavelength_um, s), axis=1)
    most = np.quantile(contrast, 0.98)
    if most < CONTRAST_K:
        return 0.0
    s = s[contrast >= MOST_CONTRAST * most].mean(axis=0)[here]
    air_k = brightness_temperature(w, s).max() + AIR_EXCESS_K
    nodes = quadrature(w, cube.fwhm_um[here])
    of_sky = 1 - library.emissivity[library.sky_index]

    def misfit(models):
        off = (models - s) / radiance_derivative(w, 300.0)
        return float((np.diff(off) ** 2).mean(axis=-1).min() ** 0.5)

    def as_sky(shift):
        clear = np.interp(nodes - shift, library.wavelength_um, of_sky)
        clear = (clear ** AIR_MASSES[:, None, None]).mean(axis=-1)
        return misfit(radiance(w - shift, air_k) * (1 - clear))

    shifts = _shifts(cube, library)
    misfits = [as_sky(shift) for shift in shifts]
    shift = float(shifts[np.argmin(misfits)])
    if abs(shift) < max(LEAST_UM, LEAST_BANDS * np.diff(w).max()):
        return 0.0
    return shift if min(misfits) < LIKE_SKY * misfit(radiance(w, air_k) * GREYS) else 0.0


def _spans_ozone(w):
    """Whether bands at w, off by FARTHEST_UM or not, tell where ozone begins and ends."""
    if len(w) < 2 or np.diff(w).max() > COARSEST_UM:
        return False
    return w[0] < LOW_UM + COARSEST_UM and w[-1] > HIGH_UM - COARSEST_UM


def _shifts(cube, library):
    """Those that leave all bands where the library's curves are."""
    nodes = quadrature(cube.wavelength_um, cube.fwhm_um)
    low, high = library.wavelength_um[[0, -1]]
    most = round(FARTHEST_UM / STEP_UM)
    shifts = STEP_UM * np.arange(-most, most + 1)
    inside = (nodes.min() - shifts >= low) & (nodes.max() - shifts <= high)
    return shifts[inside] if inside.any() else np.zeros(1)
