"""The whole answer to a cube in one module: evidence, network, refinement, texture.

This is `net+sgd`, and what `export` writes into an ONNX file. The network proposes: log
probabilities of all materials, T, V. Refinement solves Eq. 6 from there for the likeliest
hypotheses (material, pure or partly sky), and what a hypothesis loses by V's bounds and by
Planck's law counts against it as much as the network trusts the pixel's evidence:

    log p(h)  <-  log p_net(h) - a E_h

so a material may change. T and V are the best hypothesis's; sigma of T holds the doubt about
m. X = V S + D, D being the deviation of the surroundings from the k objects that the rest of
the pixel's spectrum speaks for, and the sky-lit texture is the sky's part of it (`distill`).
"""

from typing import NamedTuple

import torch
from torch import nn

from physics.evidence import TERMS, Known
from physics.planck import radiance as planck
from physics.refinement import STEPS, Refined, blocks, deviations, of_rows, refine

from .network import TeXNet, stem

HYPOTHESES = 3  # refined per pixel
CHI2_SIGMAS = 6.0  # beyond which nothing in the library fits
OWN_PROBABILITY = 0.2  # of the answer from the pixel's own evidence, below which it is unknown
AIR_SIGMA_K = 5.0  # of the air's temperature from the sky's brightness
RIM_NATS = 10.0  # evidence for pure sky below which something may stand before it


class TeX(NamedTuple):
    """Maps (height, width); float32 unless said.

    material_probability (materials, ...); material int64; temperature_k K, of sky that of
    what stands before it, if any, or the air's; temperature_sigma_k K; thermal_lighting
    (k, ...), zero for sky; texture X (bands, ...) W m-2 sr-1 um-1, zero for sky; sky_texture
    band mean of its sky-lit part; residual root mean square in noise units; unknown bool.
    """

    material_probability: torch.Tensor
    material: torch.Tensor
    temperature_k: torch.Tensor
    temperature_sigma_k: torch.Tensor
    thermal_lighting: torch.Tensor
    texture: torch.Tensor
    sky_texture: torch.Tensor
    residual: torch.Tensor
    unknown: torch.Tensor


class TeXModel(nn.Module):
    """Known and radiance (bands, height, width) W m-2 sr-1 um-1 -> TeX.

    steps   of refinement; 0 answers with what the network and the evidence say
    """

    def __init__(self, network: TeXNet, steps=STEPS):
        super().__init__()
        self.network, self.steps = network, steps

    @torch.no_grad()
    def forward(self, known: Known, radiance) -> TeX:
        shape, k = radiance.shape[1:], known.environment.shape[0]
        materials = known.is_sky.shape[0]
        s, h = stem(known, radiance)
        b = blocks(h, k)
        net = self.network(known, s, shape)
        log_m, trust = net.log_material.flatten(1).T, net.trust.reshape(-1, 1)

        # the likeliest hypotheses, refined
        per_row = s.log_evidence.reshape(-1, 2, materials)
        log_row = log_m[:, None] + torch.log_softmax(per_row, dim=1)
        log_row = log_row - 1e9 * known.is_sky * (known.sky_mean.max() <= 0)  # none in view
        log_row = log_row.reshape(-1, 2 * materials)
        score, row = log_row.topk(HYPOTHESES, dim=1)
        y = _pick(s.y[:, :, -(k + TERMS) :], row)
        t = (net.temperature_k.reshape(-1) - known.prior_k[0]) / known.prior_k[1]
        guess = net.log_lighting.flatten(1).T.exp()
        if self.steps:
            r = refine(b, y, row, t, guess, self.steps)
        else:
            r = _unrefined(b, row, t, guess)
        score = score - trust * r.energy
        # those that were not refined would lose at least as much as the best of these
        log_row = log_row - trust * r.energy.amin(1, keepdim=True)
        log_row = log_row.scatter(1, row, score)
        log_p = torch.logsumexp(log_row.reshape(-1, 2, materials), dim=1)
        p = torch.softmax(log_p, dim=1)

        best = score.argmax(1, keepdim=True)
        chosen = row.gather(1, best)[:, 0]
        material = _material(chosen, materials)
        is_sky = known.is_sky[material] > 0
        # what stands before the sky, where that may be anything
        solid = score - 1e6 * known.is_sky[_material(row, materials)]
        of_solid, at = solid.max(1, keepdim=True)
        sky_gap = score.amax(1, keepdim=True) - of_solid
        empty = is_sky & (sky_gap[:, 0] > RIM_NATS)
        before = torch.where(is_sky[:, None], at, best)
        final = torch.where(empty, chosen, row.gather(1, before)[:, 0])
        t, own = r.t.gather(1, before), r.sigma.gather(1, before)
        v = r.lighting.gather(1, before[..., None].expand(-1, -1, k))[:, 0]
        weight = torch.softmax(solid, dim=1)
        doubt = (weight * (r.sigma**2 + (r.t - t) ** 2)).sum(1, keepdim=True)
        sigma = torch.maximum(own**2, doubt).sqrt()[:, 0] * known.prior_k[1]
        temperature = (known.prior_k[0] + known.prior_k[1] * t)[:, 0]
        # the air is as warm as its opaque bands look
        temperature = torch.where(empty, s.brightness.amax(1), temperature)
        sigma = torch.where(empty, AIR_SIGMA_K, sigma)

        z = deviations(b, _pick(s.y, final[:, None])[:, 0].float(), final, t[:, 0], v)
        texture, sky_texture, misfit = _texture(known, h, radiance, final, temperature, v, z)
        visible = (~empty).float()
        own = torch.softmax(torch.logsumexp(per_row, dim=1), dim=1)
        of_m = lambda a: a.gather(1, material[:, None])[:, 0]  # noqa: E731
        bands = radiance.shape[0]
        unknown = (misfit**2 > 1 + CHI2_SIGMAS * (2 / bands) ** 0.5) & ~empty
        unknown = unknown | (of_m(p) < 0.5) | (of_m(own) < OWN_PROBABILITY)
        maps = lambda a: a.reshape(*a.shape[:-1], *shape)  # noqa: E731
        return TeX(
            maps(p.T), maps(material), maps(temperature), maps(sigma),
            maps((v * visible[:, None]).T), maps((texture * visible[:, None]).T),
            maps(sky_texture * visible), maps(misfit), maps(unknown),
        )  # fmt: skip


def _unrefined(b, row, t, lighting):
    """The network's own T and V, for every hypothesis the same; sigma as if V had no bounds."""
    sigma = (b.tt_solve[:, 0] ** 2).sum(1).sqrt()
    shape = row.shape
    return Refined(
        t[:, None].expand(shape), of_rows(sigma, row),
        lighting[:, None].expand(*shape, lighting.shape[1]), torch.zeros(shape),
    )  # fmt: skip


def _texture(known, h, radiance, row, temperature, v, z):
    """X (P, bands), its sky-lit band mean (P,) and the residual (P,) of hypotheses row (P,)."""
    materials, sky = known.is_sky.shape[0], known.is_sky
    m, share = _material(row, materials), of_rows(h.share, row)[:, None]
    e = known.emissivity + (1 - known.emissivity) * sky[:, None, None]
    glow = (of_rows(e, m) * planck(known.nodes_um, temperature[:, None, None])).mean(-1)
    n, d = known.spread.shape[0], known.spread.shape[0] + known.skylight_spread.shape[0]
    skylight = z[:, n:d] @ known.skylight_spread
    texture = v @ known.environment + z[:, :n] @ known.spread + skylight
    of_sky = known.sky_mean + z[:, d:-1] @ known.sky_spread
    rendered = (1 - share) * (glow + (1 - of_rows(h.emissivity, m)) * texture) + share * of_sky
    rendered = rendered + of_rows(h.rim, row) * z[:, -1:]
    misfit = (((radiance.flatten(1).T - rendered) / known.sigma) ** 2).mean(1).sqrt()
    of_sky = v * known.sky_object
    lit = of_sky @ known.environment.mean(1) + of_sky.sum(1) * skylight.mean(1)
    return texture, torch.where(known.sky_object.max() > 0, lit, misfit), misfit


def _material(row, materials):
    return torch.arange(materials).repeat(2)[row]  # row % materials, as ONNX can have it


def _pick(y, row):
    """y (P, R, q) at row (P, C) -> (P, C, q)."""
    return y.gather(1, row[..., None].expand(-1, -1, y.shape[2]))
