"""The whole answer to a cube in one module: evidence, network, refinement, texture.

This is `net+sgd`, and what `export` writes into an ONNX file. The network proposes log
probabilities of all materials, T and V. From there, refinement solves Eq. 6 for the likeliest
hypotheses (material, pure or partly sky). The energy E_h that V's bounds, Planck's law and T's
distance from its usual value cost a hypothesis h counts against it in proportion to the network's
trust a in the pixel's evidence:

    log p(h)  <-  log p_net(h) - a E_h

so the material may change. T and V are those of the best hypothesis; sigma of T includes the doubt
about m. The light that this leaves is computed last (`texture`).
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

CLOSE_NATS = 5.0  # behind the first once that is refined; farther ones are not refined (`_refined`)
NEVER_NATS, AFTER_ALL_NATS = 1e9, 1e6  # rules a hypothesis out; ranks it after all possible ones


class TeX(NamedTuple):
    """Maps (height, width), float32 unless stated otherwise.

    material_probability (materials, ...); material int64; temperature_k K, for sky that of what
    stands before it, if anything, or of the air; temperature_sigma_k K; thermal_lighting (k, ...),
    for sky zero or that of what may stand before it; texture X (bands, ...) W m-2 sr-1 um-1, for
    sky likewise; sky_texture band mean of its sky-lit part, or, if no object is sky, residual;
    residual root mean square in noise units; log_evidence nats, of all hypotheses together;
    unknown bool.
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
    """For P pixels, always the last axis: their spectra (bands, P), what each pixel says by itself,
    and what the network says."""

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
    """Maps a scene and its radiance (bands, height, width) W m-2 sr-1 um-1 to TeX.

    scene         tensors by name, from `physics.hypotheses.set_up`
    steps         of refinement; 0 answers with what the network and the evidence say
    log_expected  (materials, height, width) nats by which a material is expected because of what
                  lies beyond the network's sight, as in `glance`, and where pixels may be partly
                  sky (`physics.expected.SKY_NEAR`); all 0 if None
    inner         (4,) int64 top, left, height, width of the part of the image to answer, the rest
                  serving as context only; all of it if None
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
            s = stem(known, h, spectra, expected)
            air = s.brightness.amax(0)  # the temperature that its opaque bands show
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
        # as many chunks for a part: torch knows only the tile's size
        p, material, log_evidence, *chosen = by_chunks(solve, seen, chunks(SOLVED))
        (spectra, air, *_), in_bands = seen, chunks_of(spectra.shape[1], spectra.shape[0], TEXTURED)
        *maps, unknown = by_chunks(distill, (spectra, air, *chosen), in_bands)
        tex = TeX(p, material, *maps, log_evidence, unknown)
        return TeX(*(a.unflatten(-1, shape) for a in tex))


def _solved(known, h, b, steps, *seen):
    """For pixels given as PixelInputs: TeX's material_probability, material and log_evidence,
    followed by the fields of Chosen."""
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
    # what stands before the sky, where anything may
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
    """(R, P) log probability of all hypotheses, from the network and the pixel together."""
    never = NEVER_NATS * known.is_sky * (known.sky_mean.max() <= 0)  # no sky if none is in view
    return _by_hypothesis(h, seen.log_material - never[:, None], seen)


def _by_hypothesis(h, log_m, seen):
    """(R, P) from the materials' (M, P): pure and, if there are any, mixed."""
    log_row = torch.cat([log_m + seen.log_pure, log_m + seen.log_mixed])
    return log_row[: h.offset.shape[0]]


def _own_evidence(h, seen, row, r):
    """(P,) log evidence of all hypotheses together, after those of row (C, P) were Refined."""
    log_row = _by_hypothesis(h, seen.log_evidence, seen)
    log_row = _after(log_row, row, log_row.gather(0, row), r.energy)
    most = log_row.amax(0)
    return most + torch.log(torch.exp(log_row - most).sum(0))


def _t_and_variance(known, r, before, solid):
    """T (P,) of the hypotheses before (1, P), in the prior's units, and its variance, K^2: the
    hypothesis's own or, if larger, that among all Refined, weighted by the scores solid (C, P)."""
    t, sigma = r.t.gather(0, before)[0], r.sigma.gather(0, before)[0]
    weight = torch.softmax(solid, dim=0)
    doubt = (weight * (r.sigma**2 + (r.t - t) ** 2)).sum(0)
    return t, torch.maximum(sigma**2, doubt) * known.prior_k[1] ** 2


def _after(log_row, row, score, energy):
    """log_row (R, P) after refining the hypotheses row (C, P), which had score (C, P) and cost
    energy (C, P); the others would lose at least as much as the best of these, if anything: E is
    below 0 where T is so far from usual that the closed-form evidence means nothing."""
    return (log_row - energy.amin(0).clamp(min=0)).scatter(0, row, score - energy)


def _cut(arrays, shape, inner):
    """Arrays (..., P) of an image of that shape, cut to its inner part; and that part's shape."""
    top, left, height, width = inner.tolist()
    for n in (top, left, height, width):
        torch._check(n >= 0)
    torch._check(top + height <= shape[0])
    torch._check(left + width <= shape[1])
    cut = lambda a: a.unflatten(-1, shape).narrow(-2, top, height).narrow(-1, left, width)
    return tuple(cut(a).flatten(-2) for a in arrays), (height, width)


def _refined(known, b, x, row, score, seen, is_sky, steps):
    """Refined (..., C, P) of the C likeliest hypotheses, where is_sky (C, P) marks those of sky; if
    steps is 0, as the network proposes them.

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
    # where sky is first, T may be that of the best solid hypothesis: all are refined, or none
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
    """The network's own T and V, the same for every hypothesis; sigma as if V were unbounded, with
    the prior used in refinement."""
    known = (torch.linalg.inv(b.tt)[:, 0] ** 2).sum(1) ** -1 - 1 + width**-2
    sigma = of_rows(known**-0.5, one_hot(row, known.shape[0]))
    lighting = lighting[:, None].expand(-1, *row.shape)
    return Refined(
        t=t.expand(row.shape), sigma=sigma, lighting=lighting, energy=torch.zeros_like(sigma)
    )
