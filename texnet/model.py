"""The whole answer to a cube in one module: evidence, network, refinement, texture.

This is `net+sgd`, and what `export` writes into an ONNX file. The network proposes: log
probabilities of all materials, T, V.
Refinement solves Eq. 6 from there for the likeliest hypotheses (material, pure or partly sky), and
what a hypothesis loses by V's bounds, by Planck's law and by T's distance from what is usual counts
against it as much as the network trusts the pixel's evidence:

    log p(h)  <-  log p_net(h) - a E_h

so a material may change. T and V are the best hypothesis's; sigma of T holds the doubt about m.
What light that leaves (`texture`) comes last.
"""

from functools import partial
from typing import NamedTuple

import torch
from torch import nn

from physics.evidence import components, likeliest
from physics.hypotheses import COMPARED, Blocks, Hypotheses, part_of
from physics.known import Known
from physics.refinement import STEPS, TYPICAL_K, Refined, of_rows, one_hot, refine

from .chunks import SEEN, SOLVED, TEXTURED, by_chunks, chunks_of
from .network import TeXNet, log_add, material_of, pure_and_mixed, stem
from .texture import Chosen, textured
from .uncertainty import NET_LIKELY, OWN_PROBABILITY, RIM_NATS

CLOSE_NATS = 5.0  # behind the first, once that is refined; farther ones are not (`_refined`)
NEVER_NATS, AFTER_ALL_NATS = 1e9, 1e6  # what cannot be; what comes after all others that can


class TeX(NamedTuple):
    """Maps (height, width); float32 unless said.

    material_probability (materials, ...); material int64; temperature_k K, of sky that of
    what stands before it, if any, or the air's; temperature_sigma_k K; thermal_lighting
    (k, ...), of sky zero or that of what may stand before it; texture X (bands, ...) W m-2 sr-1
    um-1, of sky likewise; sky_texture band mean of its sky-lit part, or, where no object is sky,
    residual; residual root mean square in noise units; log_evidence nats, of all hypotheses
    together; unknown bool.
    """

    material_probability: torch.Tensor
    material: torch.Tensor
    temperature_k: torch.Tensor
    temperature_sigma_k: torch.Tensor
    thermal_lighting: torch.Tensor
    texture: torch.Tensor
    sky_texture: torch.Tensor
    residual: torch.Tensor
    log_evidence: torch.Tensor
    unknown: torch.Tensor


class PixelInputs(NamedTuple):
    """Of P pixels, P the last axis everywhere: their spectra (bands, P), what they say by
    themselves, and what the network says."""

    spectra: torch.Tensor
    air: torch.Tensor
    log_evidence: torch.Tensor
    log_pure: torch.Tensor
    log_mixed: torch.Tensor
    log_material: torch.Tensor
    trust: torch.Tensor
    temperature_k: torch.Tensor
    log_lighting: torch.Tensor


class TeXModel(nn.Module):
    """What is known of a scene and radiance (bands, height, width) W m-2 sr-1 um-1 -> TeX.

    scene         tensors by name, of `physics.hypotheses.set_up`
    steps         of refinement; 0 answers with what the network and the evidence say
    log_expected  (materials, height, width) nats by which a material is expected, as `glance` has
                  them, for what lies beyond the network's sight; of all 0 if None
    inner         (4,) int64 top, left, height, width of the part of the image that is answered,
                  the rest being there only to be looked at; all of it if None
    """

    def __init__(self, network: TeXNet, steps=STEPS):
        super().__init__()
        self.network, self.steps = network, steps

    @torch.no_grad()
    def forward(self, scene, radiance, log_expected=None, inner=None) -> TeX:
        shape, spectra = radiance.shape[1:], radiance.flatten(1)
        known, h, b = (part_of(scene, kind) for kind in (Known, Hypotheses, Blocks))
        code = self.network.encode(known)

        if log_expected is None:
            log_expected = radiance.new_zeros(known.is_sky.shape[0], *shape)
        expected = log_expected.flatten(1)

        def see(spectra, expected):
            s = stem(known, h, spectra)
            air = s.brightness.amax(0)  # as warm as its opaque bands look
            own = self.network.own(known, code, s, expected)
            return own, s.t, s.lighting, air, s.log_evidence, s.log_pure, s.log_mixed

        chunks = partial(chunks_of, spectra.shape[1], known.is_sky.shape[0])
        own, t, lighting, air, log_evidence, log_pure, log_mixed = by_chunks(
            see, (spectra, expected), chunks(SEEN)
        )
        net = self.network.look_around(known, code, own, log_evidence, expected, t, lighting, shape)
        net = tuple(a.flatten(-2) for a in net)
        seen = (spectra, air, log_evidence, log_pure, log_mixed, *net)
        if inner is not None:
            seen, shape = _cut(seen, shape, inner)
        solve, distill = partial(_solved, known, h, b, self.steps), partial(textured, known, h)
        # of a part too: torch knows only the tile's size
        p, material, log_evidence, *chosen = by_chunks(solve, seen, chunks(SOLVED))
        (spectra, air, *_), in_bands = seen, chunks_of(spectra.shape[1], spectra.shape[0], TEXTURED)
        *maps, unknown = by_chunks(distill, (spectra, air, *chosen), in_bands)
        tex = TeX(p, material, *maps, log_evidence, unknown)
        return TeX(*(a.unflatten(-1, shape) for a in tex))


def _solved(known, h, b, steps, *seen):
    """Of pixels, of their PixelInputs: TeX's material_probability, material and log_evidence, and
    then what is Chosen."""
    seen = PixelInputs(*seen)
    materials, sky = known.is_sky.shape[0], known.is_sky
    log_row = _proposed(known, h, seen)
    score, row = log_row.topk(COMPARED, dim=0)
    z = components(h, seen.spectra / known.sigma[:, None])
    x = likeliest(h, z)
    x = x.gather(0, row[:, None].expand(-1, x.shape[1], -1))
    of_sky = torch.cat([sky, sky])[row]
    r = _refined(known, b, x, row, score, seen, of_sky > 0, steps)
    log_evidence = _own_evidence(h, seen, row, r)
    log_row = _after(log_row, row, score, seen.trust * r.energy)
    score = log_row.gather(0, row)
    p = torch.softmax(log_add(*pure_and_mixed(log_row, materials, NEVER_NATS)), dim=0)

    best = score.argmax(0, keepdim=True)
    material = material_of(row.gather(0, best)[0], materials)
    is_sky = sky[material] > 0
    # what stands before the sky, where that may be anything
    solid = score - AFTER_ALL_NATS * of_sky
    of_solid, at = solid.max(0, keepdim=True)
    empty = is_sky & ((score.amax(0) - of_solid[0]) > RIM_NATS)
    before = torch.where(is_sky, at, best)
    v = r.lighting.gather(1, before.expand(r.lighting.shape[0], -1, -1))[:, 0]
    t, variance = _t_and_variance(known, r, before, solid)
    final = torch.where(empty, best, before)
    of_m = lambda a: a.gather(0, material[None])[0]
    own = of_m(torch.softmax(seen.log_evidence, 0))
    chosen = Chosen(
        row=row.gather(0, final)[0],
        x=x.gather(0, final[:, None].expand(-1, x.shape[1], -1))[0],
        t=t, variance=variance, lighting=v, probability=of_m(p), empty=empty,
        likely=(of_m(p) >= NET_LIKELY) & (own >= OWN_PROBABILITY),
    )  # fmt: skip
    return p, material, log_evidence, *chosen


def _proposed(known, h, seen):
    """(R, P) log probability of all hypotheses, of the network and the pixel together."""
    never = NEVER_NATS * known.is_sky * (known.sky_mean.max() <= 0)  # sky where none is in view
    return _by_hypothesis(h, seen.log_material - never[:, None], seen)


def _by_hypothesis(h, log_m, seen):
    """(R, P) of the materials' (M, P), pure and, if any is, mixed."""
    log_row = torch.cat([log_m + seen.log_pure, log_m + seen.log_mixed])
    return log_row[: h.offset.shape[0]]


def _own_evidence(h, seen, row, r):
    """(P,) log evidence of all hypotheses together, of which row (C, P) were Refined."""
    log_row = _by_hypothesis(h, seen.log_evidence, seen)
    log_row = _after(log_row, row, log_row.gather(0, row), r.energy)
    most = log_row.amax(0)
    return most + torch.log(torch.exp(log_row - most).sum(0))


def _t_and_variance(known, r, before, solid):
    """T (P,) of the hypotheses before (1, P), in the prior's units, and its variance, K^2: the
    hypothesis's own or, if more, that among all Refined, weighted by their scores solid (C, P)."""
    t, sigma = r.t.gather(0, before)[0], r.sigma.gather(0, before)[0]
    weight = torch.softmax(solid, dim=0)
    doubt = (weight * (r.sigma**2 + (r.t - t) ** 2)).sum(0)
    return t, torch.maximum(sigma**2, doubt) * known.prior_k[1] ** 2


def _after(log_row, row, score, energy):
    """log_row (R, P) after the refinement of the hypotheses row (C, P), of score (C, P), which it
    cost energy (C, P); the others would lose at least as much as the best of these, if anything:
    E is below 0 where T is so far from usual that the closed-form evidence means nothing."""
    return (log_row - energy.amin(0).clamp(min=0)).scatter(0, row, score - energy)


def _cut(arrays, shape, inner):
    """Arrays (..., P) of an image of that shape, cut to its inner part; and the part's shape."""
    top, left, height, width = inner.tolist()
    for n in (top, left, height, width):
        torch._check(n >= 0)
    torch._check(top + height <= shape[0])
    torch._check(left + width <= shape[1])
    cut = lambda a: a.unflatten(-1, shape).narrow(-2, top, height).narrow(-1, left, width)
    return tuple(cut(a).flatten(-2) for a in arrays), (height, width)


def _refined(known, b, x, row, score, seen, is_sky, steps):
    """Refined (..., C, P) of the C likeliest hypotheses, of which is_sky (C, P) says which are sky;
    as the network proposes them, if steps is 0.

    Those too far behind the first to catch up are not refined; they take its T, sigma, V and E.
    """
    t = (seen.temperature_k - known.prior_k[0]) / known.prior_k[1]
    guess, width = seen.log_lighting.exp(), TYPICAL_K / known.prior_k[1]
    if not steps:
        return _unrefined(b, row, t, guess, width)
    pixel = torch.arange(t.shape[0], device=t.device).repeat(row.shape[0] - 1)
    usual = known.usual_lighting
    first = refine(b, x[0], row[0], t, guess, usual, width, steps)
    behind = score[0] - seen.trust * first.energy.clamp(min=0) - score[1:]
    # where sky is first, T may be that of the best of those that are not: all are refined, or none
    of_solid = (behind + AFTER_ALL_NATS * is_sky[1:]).amin(0)
    too_far = torch.where(is_sky[0], of_solid - RIM_NATS, behind - CLOSE_NATS)
    close = (too_far < 0).flatten().nonzero()[:, 0]
    at = pixel[close]
    x_close = x[1:].transpose(0, 1).flatten(1)[:, close]
    more = refine(b, x_close, row[1:].flatten()[close], t[at], guess[:, at], usual, width, steps)
    again = lambda a: torch.cat([a] * (row.shape[0] - 1), -1)
    return Refined(*(
        torch.cat([a, again(a).index_copy(-1, close, c)], -1).unflatten(-1, row.shape)
        for a, c in zip(first, more, strict=True)
    ))  # fmt: skip


def _unrefined(b, row, t, lighting, width):
    """The network's own T and V, for every hypothesis the same; sigma as if V had no bounds, by
    the prior that refinement has."""
    known = (torch.linalg.inv(b.tt)[:, 0] ** 2).sum(1) ** -1 - 1 + width**-2
    sigma = of_rows(known**-0.5, one_hot(row, known.shape[0]))
    lighting = lighting[:, None].expand(-1, *row.shape)
    return Refined(
        t=t.expand(row.shape), sigma=sigma, lighting=lighting, energy=torch.zeros_like(sigma)
    )
