"""Texture distillation: what a pixel would look like if only the sky shone on it.

In daylight the sky lights the scene; at night every object does. So, after inverting
Eq. 1, only the sky's lighting is kept (the paper's section on TeX-SGD),

    X_sky = sum of V_j S_j over the objects j that stand for the sky,

and fused with the residual S - S~, which holds the light of true surroundings that
deviate from the k spectra. Along `Environment.spread` and `skylight_spread` the deviation
D = c [spread, skylight_spread] has, given the residual, a Gaussian posterior (c ~ N(0, I)
before it, U as in `reduced`) with mean

    c = (I + U' U)^-1 U' (S - S~) / sigma,

the error in each band by itself, which evidence knows too, left out: with it X is no better.

X = V S + D, the mean over each band, then is the texture, and X_sky gains V_sky times the
skylight's part of D: the rest of the residual is the light of other objects. Without sky among the
objects X is not daylight, and the residual alone (its root mean square in noise units) shows the
texture.
"""

import numpy as np

from ..machinery.threads import in_threads
from .reduced import groups


def distill(model, spectra, row, temperature_k, thermal_lighting, threads):
    """Forward Eq. 1 at an answer, and distil it. For P pixels:

    spectra (P, bands) W m-2 sr-1 um-1; row (P,) hypotheses of the reduced model;
    temperature_k (P,) K; thermal_lighting (P, k); threads to work in.

    Returns texture X (P, bands) W m-2 sr-1 um-1, sky-lit texture (P,) W m-2 sr-1 um-1 as a
    band mean (both are zero for sky), and the residual (P,) as a root mean square in noise
    units, what C explains besides the sensor's noise taken out.
    """
    environment = model.environment
    objects, n = list(environment.sky), len(environment.spread)
    directions = np.concatenate([environment.spread, environment.skylight_spread])
    directions, radiance = (a.astype(np.float32) for a in (directions, environment.radiance))
    texture = np.empty((len(model.sigma), len(row)), np.float32).T
    lit, residual = np.zeros((2, len(row)), np.float32)

    @np.errstate(invalid="ignore")  # OpenBLAS now and then says so of small, finite matrices
    def of_group(group):
        r, index = group
        u, v = model.deviation[r], thermal_lighting[index]
        off = spectra[index] / model.sigma - model.rendered(r, temperature_k[index], v)
        to_c = model.to_deviation[r]
        # what is left has few digits that count
        off, u, v, to_c = (a.astype(np.float32) for a in (off, u, v, to_c))
        c = off @ to_c
        residual[index] = np.sqrt(((off - c @ u.T) ** 2).mean(axis=1))
        if model.library.is_sky[model.material[r]]:
            texture[index] = 0.0
            return
        deviation = c[:, : len(directions)] @ directions
        texture[index] = v @ radiance + deviation
        of_sky = c[:, n : len(directions)] @ directions[n:].mean(axis=1)
        v = v[:, objects]
        lit[index] = v @ radiance[objects].mean(axis=1) + v.sum(axis=1) * of_sky

    in_threads(of_group, groups(row), threads)
    return texture, lit if objects else residual, residual
