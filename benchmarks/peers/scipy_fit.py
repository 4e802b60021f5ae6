"""Eq. 6 by a bounded scipy.optimize.least_squares per pixel and material, in one thread, as the
published MATLAB code is ported. It minimises the same J as `physics.exact.local`."""

import numpy as np

from physics.bands import quadrature
from physics.planck import planck
from physics.prior import V_PRECISION

SUM_WEIGHT = 1e4  # of the constraint that V sums to 1, which scipy's bounds cannot express


def pure_hypotheses(model):
    """The rows of a ReducedModel that are pure materials, neither sky nor partly sky."""
    return np.flatnonzero((model.sky_share == 0) & ~model.library.is_sky[model.material])


def fit(model, spectrum, r, fwhm_um):
    """J + occam in nats, T in K and V (k,) for a pixel (bands,) and hypothesis r.

    fwhm_um (bands,) are the bands' widths: Eq. 1 is averaged over them as in `reduce_model`.
    """
    from scipy.optimize import least_squares

    k, residual = model.k, _residuals(model, spectrum, r, fwhm_um)

    def with_sum(x):
        return np.append(residual(x), SUM_WEIGHT * (x[1:].sum() - 1))

    start = np.concatenate([[model.prior_mean_k], np.full(k, 1 / k)])
    low, high = np.zeros(k + 1), np.ones(k + 1)
    low[0], high[0] = model.mid_k - model.half_k, model.mid_k + model.half_k
    best = least_squares(with_sum, start, bounds=(low, high))
    return best.cost + model.occam[r], best.x[0], best.x[1:]


def cost(model, spectrum, r, fwhm_um, temperature_k, lighting):
    """J + occam in nats for a hypothesis at T in K and V (k,), with Planck's law itself instead of
    the series in `physics.exact.local`; other arguments as in `fit`."""
    x = np.append(temperature_k, lighting)
    return 0.5 * (_residuals(model, spectrum, r, fwhm_um)(x) ** 2).sum() + model.occam[r]


def _residuals(model, spectrum, r, fwhm_um):
    """A function of (T, V_1 .. V_k) whose half square is J."""
    library, k = model.library, model.k
    nodes = quadrature(model.wavelength_um, fwhm_um)
    curve = np.interp(nodes, library.wavelength_um, library.emissivity[model.material[r]])
    lit = ((1 - curve) * model.environment.at_nodes(nodes)).mean(axis=-1)
    scale, d = model.scale[r], model.deflate[:, r]
    root = np.linalg.cholesky(np.diag(scale**2) - d @ d.T).T  # P = root' root

    def residual(x):
        t, v = x[0], x[1:]
        s = (curve * planck(nodes, t)).mean(axis=-1) + v @ lit
        return np.concatenate([
            root @ ((spectrum - s) / model.sigma),
            [(t - model.prior_mean_k) / model.prior_sigma_k],
            (V_PRECISION * k) ** 0.5 * (v - model.environment.usual),
        ])  # fmt: skip

    return residual


def fit_all(model, spectrum, fwhm_um):
    """Material, T in K and V (k,) of the hypothesis with the least J + occam."""
    rows = pure_hypotheses(model)
    fits = [fit(model, spectrum, r, fwhm_um) for r in rows]
    best = int(np.argmin([cost for cost, _, _ in fits]))
    return model.material[rows[best]], *fits[best][1:]
