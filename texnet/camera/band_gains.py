"""Gains of a camera's bands among each other, where all pixels agree on them.

A camera whose bands are off by g_b each shows g_b S_b of every pixel, so that what Eq. 1 leaves of
its spectra is the same share in all,

    S_b / S~_b - 1  ~  g_b - 1,

less what T, V and the deviations of the surroundings make up for in the fit. That is taken out, the
rest fitted again, and so on, as long as it helps. What looks like another T is left by no fit, and
stays: of a gain of all bands nothing can be said where these are off.

A curve of the library that is wrong leaves something in its own material alone, and so does a name
that is wrong. So each material's pixels count by their median, and of the materials, all alike, the
median again; and two must be left to say so in the end.

Wrong bands make wrong materials fit, which then explain them. So the noise is first taken to be
FIRST times as much as stated, and then, step by step, TIMES as much as what is left. Gains are
believed up to BELIEVED times what is left at the first step, where materials can hardly be told and
explain little: larger ones were asked for by a material that is not there.
"""

import numpy as np

from physics.eq1 import heat_signal
from physics.planck import planck

from .correction import DARKEST, Calibration, corrected, corrected_environment
from .pixels import LEAST_KINDS, LEAST_OF_KIND

FIRST, TIMES = 32.0, (8.0, 4.0, 2.0, 1.0)
HELPS = 0.97  # what a step leaves of the residual, at most, to be followed by another like it
STEPS = 24  # at most
FITTING = 0.7  # of the pixels, of which the rest, mostly mixed, say nothing
MOST = 0.15  # that a logarithm of a gain may be
# on eleven scenes used for tuning, 12 to 54 bands off by 0 to 3 %: those that helped were 0.4 to
# 2.4 times that, those by which T was worse by 0.7 K and more 1.9 to 18 times (when the noise was
# first taken to be twice FIRST, and the mean of the materials counted)
BELIEVED = 2.0


def band_gains(cube, environment, solve, library, quartile, doubted=False):
    """Calibration of a HeatCube by the gains of its bands; None where one material alone is left or
    they are not believed.

    solve  (Environment, HeatCube) -> maps, of which material, temperature_k, texture and
             residual are used
    quartile  residual of pixels, in noise units -> that of those that fit best
    doubted  whether gains count, too, that are not believed
    """
    log_gain = kept = np.zeros(cube.bands)
    noise, least, at, first = FIRST, np.inf, 0, None
    for _ in range(STEPS):
        found = Calibration(noise=noise, bands=_gains(log_gain))
        surroundings, part = corrected_environment(environment, found), corrected(cube, found)
        maps = solve(surroundings, part)
        left = quartile(maps) * part.netd_k / cube.netd_k
        if not left:  # too little ground
            return None
        first = left if first is None else first
        at += left > HELPS * least
        if left > least:  # the step is taken back
            log_gain = kept
        else:
            least, kept, more = left, log_gain, _more(part, library, maps)
            if len(more):
                log_gain = log_gain + np.log1p(np.median(more, axis=0))
            log_gain = np.clip(log_gain - log_gain.mean(), -MOST, MOST)
        if at == len(TIMES):
            break
        noise = min(noise, TIMES[at] * max(least, 1.0))
    glow = planck(cube.wavelength_um, 300.0) / cube.sigma
    moved = np.sqrt(np.mean((kept * glow) ** 2))
    believed = moved <= BELIEVED * first and len(more) >= LEAST_KINDS
    return Calibration(bands=_gains(kept)) if believed or doubted else None


def _gains(logarithms):
    return tuple(np.exp(logarithms).tolist())


def _more(cube, library, maps):
    """(materials, bands) by how much the radiance of each is more than Eq. 1 makes of it."""
    pixels = (maps["material"] != library.sky_index) & np.isfinite(maps["residual"])
    if pixels.any():
        pixels &= maps["residual"] <= np.quantile(maps["residual"][pixels], FITTING)
    material, t = maps["material"][pixels], maps["temperature_k"][pixels]
    texture, measured = maps["texture"][:, pixels].T, cube.radiance[:, pixels].T
    nodes = cube.nodes_um
    curves = library.at(nodes)[material]
    rendered = heat_signal(t, curves, texture, nodes)
    able = (rendered > DARKEST * measured).all(axis=1)  # not where X went below 0
    material, more = material[able], measured[able] / rendered[able] - 1
    kinds, count = np.unique(material, return_counts=True)
    kinds = kinds[count >= LEAST_OF_KIND]
    return np.array([np.median(more[material == m], axis=0) for m in kinds])
