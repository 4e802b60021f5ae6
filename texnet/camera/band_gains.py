"""Gains of a camera's bands relative to each other, where all pixels agree on them.

A camera whose bands have gains g_b shows g_b S_b for every pixel, so that the fit of Eq. 1 leaves
the same relative residual in all spectra,

    S_b / S~_b - 1  ~  g_b - 1,

less what T, V and the deviations of the surroundings absorb in the fit. That residual is taken out,
the rest fitted again, and so on, as long as it helps. What looks like a change of T is not left by
any fit, and stays: of a gain common to all bands nothing can be said where these are off.

A wrong curve in the library leaves a residual in its own material only, and so does a wrong name.
So each material is represented by the median of its pixels, and the gains by the median of the
materials, equally weighted; at least two materials must remain in the end.

Wrong bands make wrong materials fit, which then explain the error. So the noise is first taken to
be FIRST times the stated one, and then, step by step, TIMES what is left. Gains are believed up to
BELIEVED times what is left at the first step, where materials can hardly be told apart and explain
little: larger ones were asked for by a material that is not there.
"""

import numpy as np

from physics.eq1 import heat_signal
from physics.planck import planck

from .correction import DARKEST, Calibration, corrected, corrected_environment
from .pixels import LEAST_KINDS, LEAST_OF_KIND

FIRST, TIMES = 32.0, (8.0, 4.0, 2.0, 1.0)
HELPS = 0.97  # of the least residual so far; after a step that leaves more, the next of TIMES
STEPS = 24  # at most
FITTING = 0.7  # share of the pixels used; the others, mostly mixed, say nothing
MOST = 0.15  # magnitude of a gain's logarithm, at most
# on eleven scenes used for tuning, with 12 to 54 bands off by 0 to 3 %, helpful gains were 0.4 to
# 2.4 times that, and those that made T worse by 0.7 K and more 1.9 to 18 times (when the noise was
# first taken to be twice FIRST, and the mean of the materials was used)
BELIEVED = 2.0


def band_gains(cube, environment, solve, library, quartile, doubted=False):
    """Calibration of a HeatCube with the gains of its bands; None if only one material remains or
    they are not believed.

    solve  (Environment, HeatCube) -> maps, of which material, temperature_k, texture and
             residual are used
    quartile  maps -> the residual of the best-fitting pixels, in noise units
    doubted  whether to return gains that are not believed, too
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
        if left > least:  # take the step back
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
    """(materials, bands) by which share the radiance of each exceeds what Eq. 1 yields."""
    pixels = (maps["material"] != library.sky_index) & np.isfinite(maps["residual"])
    if pixels.any():
        pixels &= maps["residual"] <= np.quantile(maps["residual"][pixels], FITTING)
    material, t = maps["material"][pixels], maps["temperature_k"][pixels]
    texture, measured = maps["texture"][:, pixels].T, cube.radiance[:, pixels].T
    nodes = cube.nodes_um
    curves = library.at(nodes)[material]
    rendered = heat_signal(t, curves, texture, nodes)
    able = (rendered > DARKEST * measured).all(axis=1)  # exclude those where X fell below 0
    material, more = material[able], measured[able] / rendered[able] - 1
    kinds, count = np.unique(material, return_counts=True)
    kinds = kinds[count >= LEAST_OF_KIND]
    return np.array([np.median(more[material == m], axis=0) for m in kinds])
