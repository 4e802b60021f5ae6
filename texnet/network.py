"""TeXNet: a small network that sees each pixel's evidence and its surroundings.

Physics does what it can do alone: `physics.evidence` gives every material's evidence and T
for every pixel, whatever the bands, the library and the environment. What is left to learn is
how far to trust it, and what the neighbourhood says. Materials and environment objects enter
as sets: their curves are encoded by kernels over wavelength, pixels see belief-weighted means
of the codes, and what the network answers about a material is a similarity to its code. So
one set of weights serves any bands, any library and any k, and permuting the library or the
environment permutes the answer.

    features   of a pixel, dimensionless: brightness temperatures, evidence, codes believed in
    trunk      3 x 3 convolutions with growing dilation
    material   logits = a log p(s | m) + q . code_m + messages from the neighbours, a and q
               from the trunk; messages are the neighbours' own beliefs, weighted by the trunk
    T          belief-weighted mean of the materials' T, plus an offset
    V          softmax over the objects of b log V^ + r . code_j, V^ the likeliest material's
"""

from typing import NamedTuple

import torch
from torch import nn
from torch.nn import functional

from physics.evidence import TERMS, Known, evidence, hypotheses, lighting_scale
from physics.planck import brightness_temperature, noise_sigma
from physics.refinement import MAX_T

CODE, LIGHT_CODE, SPECTRUM_CODE = 24, 12, 16
FREQUENCIES = 6
DILATIONS = (1, 2, 4, 8, 4)  # a context of 39 x 39 pixels
EVIDENCE_FLOOR = -60.0  # nats: what is hopeless is hopeless
NOISE_AT = 0.05  # K
COLDEST_K = 60.0


class Stem(NamedTuple):
    """What physics says of P pixels, M materials (2 M hypotheses, see Hypotheses).

    log_evidence (P, 2 M) and y (P, 2 M, q) of `evidence`; t (P, M) temperature in prior
    deviations; lighting (P, k) of the likeliest hypothesis, clipped to the simplex; brightness
    (P, bands) brightness temperature, K. float32 but for y.
    """

    log_evidence: torch.Tensor
    y: torch.Tensor
    t: torch.Tensor
    lighting: torch.Tensor
    brightness: torch.Tensor


def stem(known: Known, radiance):
    """Stem of radiance (bands, height, width) W m-2 sr-1 um-1, and its Hypotheses."""
    k, h = known.environment.shape[0], hypotheses(known)
    spectra = radiance.flatten(1).T
    log_evidence, y = evidence(h, spectra.double() / known.sigma.double())
    # the likeliest coefficients are L'^-1 y, and L'^-1 is triangular
    t = (y[:, :, -TERMS:] * h.inverse[:, -TERMS, -TERMS:]).sum(-1).float().clamp(-MAX_T, MAX_T)
    log_evidence = log_evidence.float()
    pure = torch.softmax(log_evidence.reshape(-1, 2, known.is_sky.shape[0]), dim=1)
    best = log_evidence.argmax(dim=1)
    own = y.gather(1, best[:, None, None].expand(-1, 1, y.shape[2]))[:, 0, -(k + TERMS) :, None]
    v = h.inverse[:, -(k + TERMS) : -TERMS, -(k + TERMS) :].index_select(0, best) @ own
    v = (v[..., 0].float() * lighting_scale(k) + 1 / k).clamp(min=0.0)
    return Stem(
        log_evidence, y, (pure * t.reshape(pure.shape)).sum(1),
        v / v.sum(1, keepdim=True).clamp(min=1e-6),
        brightness_temperature(known.nodes_um.mean(1), spectra.clamp(min=1e-6)),
    ), h  # fmt: skip


class Prediction(NamedTuple):
    """The network's answer for height x width pixels.

    log_material (materials, height, width) log probabilities; trust (height, width) of the
    evidence, a above; temperature_k (height, width) K; log_lighting (k, height, width).
    """

    log_material: torch.Tensor
    trust: torch.Tensor
    temperature_k: torch.Tensor
    log_lighting: torch.Tensor


class TeXNet(nn.Module):
    """The network; width is the number of channels of its trunk, messages how many rounds of
    them are passed."""

    def __init__(self, width=48, dilations=DILATIONS, messages=2):
        super().__init__()
        self.config = dict(width=width, dilations=tuple(dilations), messages=messages)
        self.curve = SetCode(1, CODE)
        self.light = SetCode(1, LIGHT_CODE)
        self.kernel = Kernel(SPECTRUM_CODE)
        self.inlet = nn.Conv2d(SPECTRUM_CODE + 2 * CODE + LIGHT_CODE + 10, width, 1)
        self.trunk = nn.ModuleList(
            nn.Conv2d(width, width, 3, padding=d, dilation=d) for d in dilations
        )
        self.heads = nn.Conv2d(width, CODE + LIGHT_CODE + 3 + 8 * messages, 1)
        for layer in self.trunk:
            nn.init.zeros_(layer.bias)
        with torch.no_grad():  # at first: what physics says
            self.heads.weight.mul_(0.1)
            self.heads.bias.zero_()

    @property
    def halo(self):
        """How many pixels around itself an answer depends on."""
        messages = self.config["messages"]
        return sum(self.config["dilations"]) + messages * (messages + 1) // 2

    def forward(self, known: Known, s: Stem, shape) -> Prediction:
        height, width = shape
        wavelength = known.nodes_um.mean(1)
        prior, deviation = known.prior_k[0], known.prior_k[1]
        e = known.emissivity.mean(-1)
        e = e + (1 - e) * known.is_sky[:, None]
        curve = self.curve(torch.asinh(20 * (1 - e)), known.is_sky, wavelength)
        over = brightness_temperature(wavelength, known.environment) - prior
        light = self.light(over / 10, known.sky_object, wavelength)

        per_row = s.log_evidence.reshape(-1, 2, s.t.shape[1])
        log_evidence = torch.logsumexp(per_row, dim=1)
        log_evidence = torch.log_softmax(log_evidence, dim=1).clamp(min=EVIDENCE_FLOOR)
        mixed = torch.sigmoid(per_row[:, 1] - per_row[:, 0])
        belief = log_evidence.exp()
        soft = torch.softmax(0.2 * log_evidence, dim=1)
        mean = s.brightness.mean(1, keepdim=True)
        contrast = torch.asinh((s.brightness - mean) / 2)
        bands = wavelength.shape[0]
        best = torch.logsumexp(s.log_evidence, dim=1, keepdim=True)
        t = (belief * s.t).sum(1, keepdim=True)
        scalars = torch.cat([
            (mean - prior) / 10,
            t * deviation / 10,
            (prior + t * deviation - mean) / 5,
            torch.asinh(best / bands),
            1 - belief.amax(1, keepdim=True),
            -(belief * log_evidence).sum(1, keepdim=True),
            (belief * mixed).sum(1, keepdim=True),
            s.lighting @ known.sky_object[:, None],
            0 * mean + torch.log((known.sigma / noise_sigma(wavelength, NOISE_AT)).mean()),
            0 * mean + torch.log(torch.full_like(prior, bands) / 30),
        ], dim=1)  # fmt: skip
        features = torch.cat(
            [contrast @ self.kernel(wavelength) / bands, belief @ curve, soft @ curve,
             s.lighting @ light, scalars], dim=1,
        )  # fmt: skip
        x = functional.relu(self.inlet(features.T.reshape(1, -1, height, width)))
        for layer in self.trunk:
            x = x + functional.relu(layer(x))
        out = self.heads(x)[0].reshape(-1, height * width)
        n = CODE + LIGHT_CODE

        trust = functional.softplus(out[n] + 0.5413)  # 1 at first
        logits = trust * log_evidence.T + curve @ out[:CODE]
        for i in range(self.config["messages"]):
            weight = functional.softplus(out[n + 3 + 8 * i : n + 11 + 8 * i] - 1.0)
            logits = logits + _messages(
                torch.softmax(logits, 0).reshape(-1, height, width),
                weight.reshape(8, height, width), 1 + i,
            ).reshape(logits.shape)  # fmt: skip
        log_material = torch.log_softmax(logits, 0)
        t = (log_material.exp() * s.t.T).sum(0)
        temperature = (prior + deviation * t + out[n + 2]).clamp(min=COLDEST_K)
        share = functional.softplus(out[n + 1] + 0.5413)
        lighting = share * torch.log(s.lighting.T + 0.03) + light @ out[CODE:n]
        maps = lambda a: a.reshape(*a.shape[:-1], height, width)  # noqa: E731
        return Prediction(
            maps(log_material), maps(trust), maps(temperature),
            maps(torch.log_softmax(lighting, 0)),
        )  # fmt: skip


class Kernel(nn.Module):
    """Functions of wavelength, n of them, smooth enough to be sampled at any bands."""

    def __init__(self, n):
        super().__init__()
        self.mlp = nn.Sequential(nn.Linear(2 * FREQUENCIES + 1, 32), nn.ReLU(), nn.Linear(32, n))

    def forward(self, wavelength_um):
        """(bands,) um -> (bands, n)."""
        x = ((wavelength_um - 11) / 3)[:, None]
        turns = x * torch.arange(1, FREQUENCIES + 1) * (torch.pi / 2)
        return self.mlp(torch.cat([x, torch.sin(turns), torch.cos(turns)], dim=1))


class SetCode(nn.Module):
    """Codes of the spectra of a set, each by itself, by kernels over wavelength."""

    def __init__(self, flags, n):
        super().__init__()
        self.kernel = Kernel(32)
        self.mlp = nn.Sequential(nn.Linear(32 + flags, 48), nn.ReLU(), nn.Linear(48, n))

    def forward(self, spectra, flag, wavelength_um):
        """(set, bands), (set,), (bands,) -> (set, n)."""
        x = spectra @ self.kernel(wavelength_um) / spectra.shape[1]
        return self.mlp(torch.cat([x, flag[:, None]], dim=1))


def _messages(belief, weight, distance):
    """Sum over the 8 neighbours at a distance of their belief (M, H, W) times weight (8, H, W)."""
    height, width = belief.shape[1:]
    d = distance
    padded = functional.pad(belief, (d, d, d, d))
    total, i = 0.0, 0
    for y in (0, d, 2 * d):
        for x in (0, d, 2 * d):
            if (y, x) != (d, d):
                total = total + weight[i] * padded[:, y : y + height, x : x + width]
                i += 1
    return total
