"""The light X on a pixel whose hypothesis, T and V are known, and what stays unexplained.

X = V S + D, where D is the deviation of the surroundings from the k objects that the pixel's
spectrum calls for; the sky-lit texture is the sky's part of X (`physics.exact.distill`). What Eq. 1
then leaves of the spectrum says how far to trust T.
"""

from typing import NamedTuple

import torch

from physics.evidence import components
from physics.hypotheses import Hypotheses
from physics.known import Known
from physics.planck import planck
from physics.refinement import deviations, of_rows, one_hot

from .network import material_of
from .uncertainty import AIR_SIGMA_K, NET_OTHER_K, fits


class Chosen(NamedTuple):
    """For P pixels, always the last axis: row (P,) of the hypothesis and its x^ (r, P); t (P,) in
    prior deviations and its variance (P,) K^2; lighting V (k, P); probability (P,) of the material;
    empty (P,) where nothing stands before the sky; likely (P,) where the material is likely."""

    row: torch.Tensor
    x: torch.Tensor
    t: torch.Tensor
    variance: torch.Tensor
    lighting: torch.Tensor
    probability: torch.Tensor
    empty: torch.Tensor
    likely: torch.Tensor


def textured(known: Known, h: Hypotheses, spectra, air, *chosen):
    """temperature_k, temperature_sigma_k, thermal_lighting, texture, sky_texture, residual and
    unknown, as in `model.TeX`, of spectra (bands, P), with air (P,) the brightness temperature of
    their opaque bands, K, and the fields of Chosen."""
    c = Chosen(*chosen)
    temperature = known.prior_k[0] + known.prior_k[1] * c.t
    temperature = torch.where(c.empty, air, temperature)
    z = components(h, spectra / known.sigma[:, None])
    off = deviations(h, z, c.x, c.row, c.t, c.lighting, known.usual_lighting)
    texture, sky_texture, misfit = _texture(known, h, spectra, c, temperature, off)
    # a misfit beyond the noise widens sigma (Birge's ratio)
    variance = c.variance * misfit.clamp(min=1) ** 2
    variance = variance + NET_OTHER_K**2 * (1 - c.probability).clamp(min=0)
    sigma = torch.where(c.empty, AIR_SIGMA_K, variance.sqrt())
    # written so that NaN counts as unknown
    explained = fits(misfit, known.sigma.shape[0]) | c.empty
    unknown = ~(explained & c.likely & (temperature > 0))
    visible = (~c.empty).float()
    lighting, texture, sky_texture = (a * visible for a in (c.lighting, texture, sky_texture))
    return temperature, sigma, lighting, texture, sky_texture, misfit, unknown


def _texture(known, h, spectra, c, temperature, off):
    """X (bands, P), its sky-lit band mean and the residual (P,) for Chosen pixels with deviations
    off (q - r, P)."""
    hot, materials = one_hot(c.row, h.sky_share.shape[0]), known.is_sky.shape[0]
    # sky emits like a black body
    e = known.emissivity + (1 - known.emissivity) * known.is_sky[:, None, None]
    e = of_rows(e, one_hot(material_of(c.row, materials), materials))
    share = of_rows(h.sky_share, hot)
    glow = (e * planck(known.nodes_um[..., None], temperature)).mean(1)
    n, d = known.spread.shape[0], known.spread.shape[0] + known.skylight_spread.shape[0]
    skylight = known.skylight_spread.t() @ off[n:d]
    deviation = known.spread.t() @ off[:n] + skylight
    light = (known.light.flatten(1).t() @ c.lighting).unflatten(0, known.nodes_um.shape)
    reflected = ((1 - e) * (light + deviation[:, None])).mean(1)
    texture = light.mean(1) + deviation
    curves = d + known.curve_spread.shape[0]
    of_sky = known.sky_mean[:, None] + known.sky_spread.t() @ off[curves:-1]
    rendered = (1 - share) * (glow + reflected + known.curve_spread.t() @ off[d:curves])
    rendered = rendered + share * of_sky
    rendered = rendered + of_rows(h.alpha_step, hot) * off[-1]
    misfit = (((spectra - rendered) / known.sigma[:, None]) ** 2).mean(0).sqrt()
    v_sky = c.lighting * known.sky_object[:, None]
    lit = known.environment.mean(1) @ v_sky + v_sky.sum(0) * skylight.mean(0)
    return texture, torch.where(known.sky_object.max() > 0, lit, misfit), misfit
