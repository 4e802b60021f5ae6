"""When an answer should not be trusted, and what is said where only sky is seen.

Found on 24 random scenes of no split, in 4, 9, 18 and 54 bands, whole libraries and libraries that
lack one of the scene's three commonest materials, so that of such a material's pixels 90 % are
unknown or have a sigma that covers the error, and few others are unknown.
"""

import numpy as np

from physics.machinery import scratch
from physics.machinery.threads import in_threads, usual_threads
from physics.planck import noise_sigma, planck, planck_and_derivative, planck_derivative
from physics.prior import MIN_TEMPERATURE_SPREAD_K

CHI2_SIGMAS = 8.0  # beyond which nothing in the library fits
# of the answer, below which it is unknown. Of what a network says is 0.3 to 0.5 likely 40 to 67 %
# is right with 54 bands, but with fewer than FEW_BANDS (3 to 18 were tried) 7 to 53 %
LIKELY, NET_LIKELY, FEW_BANDS = 0.5, 0.3, 20
SURE = 0.7  # likewise where what is wrong was called noise, of which probabilities know too little
# or where curves are off by so much, or the optical depth of air; in between where by less
CURVES_OFF, AIR_OFF = 0.01, 0.8
OWN_PROBABILITY = 0.02  # of the answer from the pixel's own evidence, below which it is unknown
EVEN = 2.0  # likewise in local and sgd, times what each material has of a pixel that says nothing
# What a model leaves out, it leaves out in many bands at once, and in neighbours alike: in local
# and sgd log evidence of n bands counts only this times n^-1/2, so that answers are right about as
# often as their probability says; in local at most once; in sgd, whose neighbours share what few
# bands leave in doubt, at most so much times n^2 (a limit below four bands)
LOCAL_TRUST, SGD_TRUST, SGD_TRUST_OF_FEW = 2.0, 1.2, 0.06
# error of T beyond what the library's other materials say, if the material is wrong: added in
# quadrature, weighted by the chance of that; a network's probabilities, which hold what `glance`
# expects, leave out more of it
OTHER_K, NET_OTHER_K = 1.3, 2.0
# in local and sgd, times the error of curves that is found, which is mostly half of the true one
# (twice as much names fewer wrong, but T of a scene of mirrors was 7 instead of 1.4 K off)
OWN_CURVES = 1.5
AIR_SIGMA_K = 5.0  # of the air's temperature from the sky's brightness
RIM_NATS = 10.0  # evidence for pure sky below which something may stand before it
# sigma's least share of how T scatters over a pixel and its eight neighbours: a pixel on an edge
# mixes what lies on both sides, which the model does not know (it knows of sky behind a rim); more
# where the neighbours are of other materials
SCATTER, SCATTER_OF_MATERIALS = 0.1, 0.5
# what a calibration that was found may still be off by, at 300 K, as a share of bands' gains, and
# of an offset (the most that those of 3 to 15 K were off by in scenes used for tuning)
FOUND_K, SHARE, OFFSET_SHARE = 0.25, 0.7, 0.08
ROWS = 256  # at once
LEAST_E = 0.02  # mean emissivity; below it T is not known anyway
GRID_K = 0.5  # of T, between which the slope of Planck's law is taken to be a straight line


def local_trust(bands):
    """What log evidence of so many bands counts in local."""
    return min(LOCAL_TRUST * bands**-0.5, 1.0)


def smooth_trust(bands):
    """The same in sgd."""
    return min(SGD_TRUST * bands**-0.5, SGD_TRUST_OF_FEW * bands**2)


def fits(residual, bands):
    """Whether something in the library explains pixels of a residual, an array or tensor in noise
    units: chi^2 is not far beyond its spread. Not where it is no number."""
    return residual**2 <= 1 + CHI2_SIGMAS * (2 / bands) ** 0.5


def unreliable(maps, c, bands):
    """Which pixels (height, width) of maps by name are unknown because of so few bands, or of what
    a Calibration says of noise, curves and air: what fits clearly worse than the pixels that fit
    best, though not for noise, or is not likely enough."""
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
    """sigma (height, width) K of a map of T, K, and material, with the doubt that edges add."""
    out = scratch.zeros(sigma.shape, np.float32)
    height = len(sigma)
    for top in range(0, height, ROWS):
        bottom = min(top + ROWS, height)
        above, below = max(top - 1, 0), min(bottom + 1, height)
        pad = ((above - top + 1, bottom + 1 - below), (1, 1))
        t, m = (np.pad(a[above:below], pad, mode="edge") for a in (temperature, material))
        good = t[np.isfinite(t)]
        if good.size:  # small, so that its squares are precise enough
            t = t - good.mean(dtype=np.float64)
        mean = _over_nine(np.add, t) / 9
        variance = np.maximum(_over_nine(np.add, t * t) / 9 - mean**2, 0)
        edge = _over_nine(np.maximum, m) != _over_nine(np.minimum, m)
        share = SCATTER**2 + edge * SCATTER_OF_MATERIALS**2
        out[top:bottom] = np.sqrt(sigma[top:bottom] ** 2 + share * variance)
    return out


def shared_error_k(c, cube):
    """By how much the radiance of a corrected cube may still be off in all pixels together, K at
    300 K: by what fitted nothing, and a share of what bands and offset were corrected by."""
    unfit = c.shared * cube.netd_k / c.noise
    if c.keeps_radiance:
        return unfit
    w = cube.wavelength_um
    off = (c.of_bands(cube.bands) - 1) * planck(w, 300.0) / planck_derivative(w, 300.0)
    of_offset = OFFSET_SHARE * c.offset_k
    return float(np.sqrt(FOUND_K**2 + SHARE**2 * np.mean(off**2) + of_offset**2 + unfit**2))


def with_calibration_error(sigma, temperature, wavelength_um, error_k, emissivity=None):
    """sigma (height, width) K of a map of T, K, where all radiance may be off by error_k, K at
    300 K, be that an offset or a gain: what moves T more, which below 300 K is an offset. Light
    that is reflected was measured by the same camera: T moves as much whatever the emissivity;
    unless it was given, of surfaces of an emissivity (height, width), mean of the bands: by Eq. 1 T
    then moves by 1 / e as much, though no more than is known of it beforehand.
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
    """sigma (height, width) K of a map of T, of maps by name, where a material's whole curve may be
    off by the MaterialLibrary's level_sigma, and by what all curves are taken to be: by Eq. 7 that
    moves T by -de (B - X) / (e B'), though by no more than is known of a scene's T beforehand. Of
    sky it moves none."""
    level = np.where(library.is_sky, 0.0, np.hypot(library.level_sigma, curve_error))
    if not level.any():
        return sigma
    level, curves = level.astype(np.float32), library.of_bands(cube.nodes_um).astype(np.float32)
    # of Python's numbers, which leave float32 what it is
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
    """(height, width) of (height + 2, width + 2): of every pixel and its neighbours."""
    rows = of(of(padded[:-2], padded[1:-1]), padded[2:])
    return of(of(rows[:, :-2], rows[:, 1:-1]), rows[:, 2:])
