"""Texture distillation: what a pixel would look like if only the sky shone on it.

In daylight the sky lights the scene; at night every object does. So, after inverting
Eq. 1, only the sky's lighting is kept (the paper's section on TeX-SGD),

    X_sky = sum of V_j S_j over the objects j that stand for the sky,

and fused with the residual S - S~, which holds the light of true surroundings that
deviate from the k spectra. Along `Environment.spread` and `skylight_spread` the deviation
D = c [spread, skylight_spread] has, given the residual, a Gaussian posterior (c ~ N(0, I)
before it, U as in `reduced`) with mean

    c = (I + U' U)^-1 U' (S - S~) / sigma.

X = V S + D then is the texture, and X_sky gains V_sky times the skylight's part of D: the
rest of the residual is the light of other objects. Without sky among the objects X is not
daylight, and the residual alone (its root mean square in noise units) shows the texture.
"""

import numpy as np

from .planck import radiance


def distill(model, spectra, row, temperature_k, thermal_lighting):
    """Forward Eq. 1 at an answer, and distil it. For P pixels:

    spectra (P, bands) W m-2 sr-1 um-1; row (P,) hypotheses of the reduced model;
    temperature_k (P,) K; thermal_lighting (P, k).

    Returns texture X (P, bands) W m-2 sr-1 um-1, sky-lit texture (P,) W m-2 sr-1 um-1 as a
    band mean (both are zero for sky), and the residual (P,) as a root mean square in noise
    units, what C explains besides the sensor's noise taken out.
    """
    environment, share, e = model.environment, model.sky_share[row, None], model.emissivity[row]
    texture = thermal_lighting @ environment.radiance
    rendered = e * radiance(model.wavelength_um, temperature_k[:, None]) + (1 - e) * texture
    rendered = (1 - share) * rendered
    if share.any():
        rendered += share * environment.sky_mean
    r = (spectra - rendered) / model.sigma
    u = model.deviation[row]  # (P, bands, d)
    c = np.linalg.solve(np.eye(u.shape[2]) + u.transpose(0, 2, 1) @ u,
                        u.transpose(0, 2, 1) @ r[:, :, None])  # fmt: skip
    residual = np.sqrt(((r - (u @ c)[..., 0]) ** 2).mean(axis=1))
    n = len(environment.spread)
    of_sky = c[:, n : n + len(environment.skylight_spread), 0] @ environment.skylight_spread
    texture = texture + c[:, :n, 0] @ environment.spread + of_sky
    sky = model.material[row] == model.library.sky_index
    texture[sky] = 0.0
    if not environment.sky:
        return texture, residual, residual
    objects = list(environment.sky)
    v = thermal_lighting[:, objects]
    lit = v @ environment.radiance[objects].mean(axis=1) + v.sum(axis=1) * of_sky.mean(axis=1)
    return texture, np.where(sky, 0.0, lit), residual
