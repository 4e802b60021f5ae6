"""When an answer should not be trusted, and what is said where only sky is seen.

Tuned on 24 random scenes outside all splits, with 4, 9, 18 and 54 bands, and with libraries that
are complete or lack one of the scene's three commonest materials, so that 90 % of the pixels of
such a material are unknown or have a sigma that covers the error, and few others are unknown.
"""

import numpy as np

from physics.machinery import scratch
from physics.machinery.threads import in_threads, usual_threads
from physics.planck import noise_sigma, planck, planck_and_derivative, planck_derivative
from physics.prior import MIN_TEMPERATURE_SPREAD_K

CHI2_SIGMAS = 8.0  # beyond which nothing in the library fits
# probability of the answer below which it is unknown. Of network answers with probability 0.3 to
# 0.5, 40 to 67 % are right with 54 bands, but 7 to 53 % with fewer than FEW_BANDS (3 to 18 tried)
LIKELY, NET_LIKELY, FEW_BANDS = 0.5, 0.3, 20
SURE = 0.7  # the same where errors were taken for noise, which probabilities do not fully reflect,
# or where curves or the air's optical depth are off by this much; proportionally less below it
CURVES_OFF, AIR_OFF = 0.01, 0.8
OWN_PROBABILITY = 0.02  # the same of the answer's probability from the pixel's own evidence
EVEN = 2.0  # the same in local and sgd, as a multiple of a uniform probability
# A model's errors are shared by many bands and by neighbours: in local and sgd log evidence of n
# bands is weighted by this times n^-1/2, so that answers are right about as often as their
# probability says; in local at most by 1; in sgd, whose neighbours share what few bands leave in
# doubt, at most by the last times n^2 (which limits it below four bands)
LOCAL_TRUST, SGD_TRUST, SGD_TRUST_OF_FEW = 2.0, 1.2, 0.06
# error of T if the material is wrong, beyond what the library's other materials imply: added in
# quadrature, weighted by the probability of that; larger for networks, whose probabilities, which
# include what `glance` expects, leave out more of it
OTHER_K, NET_OTHER_K = 1.3, 2.0
# in local and sgd, factor on the curve error found, which is mostly half the true one (a factor 2
# names fewer wrong, but in a scene of mirrors T was then 7 instead of 1.4 K off)
OWN_CURVES = 1.5
AIR_SIGMA_K = 5.0  # of the air's temperature from the sky's brightness
RIM_NATS = 10.0  # evidence for pure sky below which something may stand before it
# least ratio of sigma to the scatter of T over a pixel and its eight neighbours: a pixel on an edge
# mixes both sides, which the model does not know (except for sky behind a rim); larger where the
# neighbours are of other materials
SCATTER, SCATTER_OF_MATERIALS = 0.1, 0.5
# remaining error of a calibration that was found, at 300 K, and as a share of bands' gains and of
# an offset (the largest for offsets of 3 to 15 K in scenes used for tuning)
FOUND_K, SHARE, OFFSET_SHARE = 0.25, 0.7, 0.08
ROWS = 256  # at once
LEAST_E = 0.02  # mean emissivity; below it T is not known anyway
GRID_K = 0.5  # spacing of T for interpolating the slope of Planck's law


def local_trust(bands):
    """Weight of log evidence of so many bands in local."""
    return min(LOCAL_TRUST * bands**-0.5, 1.0)


def smooth_trust(bands):
    """The same in sgd."""
    return min(SGD_TRUST * bands**-0.5, SGD_TRUST_OF_FEW * bands**2)


def fits(residual, bands):
    """Whether the library explains pixels with this residual, an array or tensor in noise units:
    chi^2 is not far beyond its spread. False for NaN."""
    return residual**2 <= 1 + CHI2_SIGMAS * (2 / bands) ** 0.5


def unreliable(maps, c, bands):
    """Which pixels (height, width) of maps by name are unknown because of few bands, or of what a
    Calibration says of noise, curves and air: those that fit clearly worse than the best-fitting
    pixels, beyond noise, or are not likely enough."""
    out = scratch.zeros(maps["material"].shape, bool)
    off = max(c.noise - 1, c.curves / CURVES_OFF, c.air_error / AIR_OFF)
    least = SURE * min(off, 1.0)  # no step
    least = max(least, LIKELY * (bands < FEW_BANDS))
    for top in range(0, len(out), ROWS):
        part = slice(top, top + ROWS)
        material = maps["material"][None, part].astype(np.intp)
        likely = np.take_along_axis(maps["material_probability"][:, part], material, axis=0)[0]
        worse = ~fits(maps["residual"][part] * (c.noise / c.misfit), bands)
        out[part] = worse | ~(likely >= least)
        for map_ in (maps["material_probability"], maps["residual"]):
            scratch.release(map_)
    return out


def sigma_among_neighbours(sigma, temperature, material):
    """sigma (height, width) K of maps of T, K, and material, with the doubt added by edges."""
    out = scratch.zeros(sigma.shape, np.float32)
    height = len(sigma)
    for top in range(0, height, ROWS):
        bottom = min(top + ROWS, height)
        above, below = max(top - 1, 0), min(bottom + 1, height)
        pad = ((above - top + 1, bottom + 1 - below), (1, 1))
        t, m = (np.pad(a[above:below], pad, mode="edge") for a in (temperature, material))
        good = t[np.isfinite(t)]
        if good.size:  # keeps T small, so that its squares are precise enough
            t = t - good.mean(dtype=np.float64)
        mean = _over_nine(np.add, t) / 9
        variance = np.maximum(_over_nine(np.add, t * t) / 9 - mean**2, 0)
        edge = _over_nine(np.maximum, m) != _over_nine(np.minimum, m)
        share = SCATTER**2 + edge * SCATTER_OF_MATERIALS**2
        out[top:bottom] = np.sqrt(sigma[top:bottom] ** 2 + share * variance)
    return out


def shared_error_k(c, cube):
    """Possible remaining radiance error of a corrected cube, common to all pixels, K at 300 K: what
    fitted nothing, and a share of the corrections of bands and offset."""
    unfit = c.shared * cube.netd_k / c.noise
    if c.keeps_radiance:
        return unfit
    w = cube.wavelength_um
    off = (c.of_bands(cube.bands) - 1) * planck(w, 300.0) / planck_derivative(w, 300.0)
    of_offset = OFFSET_SHARE * c.offset_k
    return float(np.sqrt(FOUND_K**2 + SHARE**2 * np.mean(off**2) + of_offset**2 + unfit**2))


def with_calibration_error(sigma, temperature, wavelength_um, error_k, emissivity=None):
    """sigma (height, width) K of a map of T, K, if all radiance may be off by error_k, K at 300 K,
    as an offset or as a gain, whichever moves T more (below 300 K an offset). Reflected light was
    measured by the same camera, so T moves by the same amount for any emissivity. If the light was
    given instead, pass emissivity (height, width), the band mean: by Eq. 1 T then moves by 1 / e as
    much, though by no more than its prior uncertainty.
    """
    if not np.isfinite(temperature).any():
        return sigma
    t = np.arange(max(np.nanmin(temperature), 1.0), np.nanmax(temperature) + GRID_K, GRID_K)
    off, slope = noise_sigma(wavelength_um, error_k), planck_derivative(wavelength_um, t[:, None])
    gain = off / planck(wavelength_um, 300.0) * planck(wavelength_um, t[:, None])
    moved = np.maximum((off / slope).mean(axis=1), (gain / slope).mean(axis=1))
    out = scratch.zeros(sigma.shape, np.float32)
    for top in range(0, len(sigma), ROWS):
        part = slice(top, top + ROWS)
        k = np.interp(temperature[part], t, moved)
        if emissivity is not None:
            most = np.maximum(k, MIN_TEMPERATURE_SPREAD_K)
            k = np.minimum(k / np.maximum(emissivity[part], LEAST_E), most)
        out[part] = np.hypot(sigma[part], k)
    return out


def with_level_error(sigma, maps, library, cube, curve_error=0.0):
    """sigma (height, width) K of T in maps by name, if a material's whole curve may be off by the
    MaterialLibrary's level_sigma, and all curves by curve_error: by Eq. 7 that moves T by
    -de (B - X) / (e B'), though by no more than its prior uncertainty in a scene. Sky is exempt."""
    level = np.where(library.is_sky, 0.0, np.hypot(library.level_sigma, curve_error))
    if not level.any():
        return sigma
    level, curves = level.astype(np.float32), library.of_bands(cube.nodes_um).astype(np.float32)
    # Python floats, which keep float32 arrays float32
    bands = list(zip(cube.wavelength_um.tolist(), cube.sigma.tolist(), strict=True))
    out = scratch.zeros(sigma.shape, np.float32)

    def work(top):
        part = slice(top, top + ROWS)
        material = maps["material"][part].astype(np.intp)
        t = np.maximum(maps["temperature_k"][part], 1, dtype=np.float32)
        along, square = np.zeros_like(t), np.full_like(t, np.finfo(np.float32).tiny)
        for b, (w, noise) in enumerate(bands):
            glow, slope = planck_and_derivative(w, t)
            slope *= curves[:, b][material] / noise
            along += slope * (glow - maps["texture"][b, part]) / noise
            square += slope**2
        moved = np.minimum(np.abs(level[material] * along / square), MIN_TEMPERATURE_SPREAD_K)
        out[part] = np.hypot(sigma[part], np.where(level[material] > 0, moved, 0.0))
        scratch.release(maps["texture"])

    in_threads(work, range(0, len(sigma), ROWS), usual_threads())
    return out


def _over_nine(of, padded):
    """(height, width) of (height + 2, width + 2): of applied to each pixel and its neighbours."""
    rows = of(of(padded[:-2], padded[1:-1]), padded[2:])
    return of(of(rows[:, :-2], rows[:, 1:-1]), rows[:, 2:])
