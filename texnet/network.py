"""TeXNet: a small network that sees each pixel's evidence and its surroundings.

Physics does what it can on its own: `physics.evidence` gives every material's evidence and T
for every pixel, for any bands, library and environment. The network learns the rest: how far to
trust that evidence, and what the neighbourhood implies. Materials and environment objects enter
as sets: kernels over wavelength encode their curves, pixels see belief-weighted means of the
codes, and a material's score is the similarity of the network's output to its code. One set of
weights therefore serves any bands, any library and any k, and permuting the library or the
environment permutes the answer.

    features   of a pixel, dimensionless: brightness temperatures, evidence, codes believed in
    trunk      dilated 3 x 3 convolutions over cells of 2 x 2 pixels; what they see of the
               surroundings is added to each pixel's own features
    material   logits = a log p(z | m) + b expected_m + q . code_m + messages from the neighbours,
               a, b and q from the trunk; expected is what a glance from afar says (`glance`),
               messages are the neighbours' own beliefs, weighted by the trunk
    T          belief-weighted mean of the materials' T, plus an offset
    V          softmax over the objects of c log V^ + r . code_j, V^ that of the likeliest material
"""

from typing import NamedTuple

import torch
from torch import nn
from torch.nn import functional

from physics.evidence import evidence
from physics.expected import SKY_NEAR
from physics.hypotheses import NEVER, Hypotheses
from physics.known import MAX_T, TERMS, Known
from physics.planck import brightness_temperature, noise_sigma
from physics.prior import is_partly_sky, lighting_scale

from .glance import STEP

CODE, LIGHT_CODE, SPECTRUM_CODE = 24, 12, 16
FREQUENCIES = 6
ONE = 0.5413  # softplus(ONE) is 1, the initial value of some weights
STRIDE = 2  # pixels to a cell of the trunk
DILATIONS = (1, 2, 4, 2)  # of its convolutions: a context of 38 x 38 pixels, before messages
EVIDENCE_FLOOR = -60.0  # nats below the best; further differences do not matter
NOISE_AT = 0.05  # K
# bands; more count as so many with less noise: told of a hundred, which it seldom met in training,
# the network named sand water, against thousands of nats
MOST_BANDS = 54
COLDEST_K = 60.0


class Stem(NamedTuple):
    """Physical quantities for P pixels and M materials, pure or mixed with sky.

    log_evidence (M, P) of pure or mixed; log_pure and log_mixed (M, P), the logarithms of their
    shares in it; t (M, P) temperature in prior deviations; lighting (k, P) of the likeliest
    hypothesis, clipped to the simplex; brightness (bands, P) brightness temperature, K.
    """

    log_evidence: torch.Tensor
    log_pure: torch.Tensor
    log_mixed: torch.Tensor
    t: torch.Tensor
    lighting: torch.Tensor
    brightness: torch.Tensor


def stem(known: Known, h: Hypotheses, spectra, expected=None):
    """Stem of spectra (bands, P) W m-2 sr-1 um-1; known and its Hypotheses h are tensors. Pixels
    where sky is expected (M, P) by less than SKY_NEAR are not partly sky."""
    k, materials = known.environment.shape[0], known.is_sky.shape[0]
    per_row, x = evidence(h, spectra / known.sigma[:, None])
    if expected is not None:
        far = (known.is_sky @ expected < SKY_NEAR).float()
        per_row = per_row - NEVER * is_partly_sky(h.sky_share).float()[:, None] * far
    pure, mixed = pure_and_mixed(per_row, materials, NEVER)
    more = mixed - pure
    log_sum = _log_1p_exp(-more.abs())  # log(pure + mixed) minus the larger of both
    log_pure, log_mixed = -(more.relu() + log_sum), -((-more).relu() + log_sum)
    # the first of the TERMS is t itself
    t = pure_and_mixed(x[:, -TERMS].clamp(-MAX_T, MAX_T), materials)
    best = per_row.argmax(dim=0)
    v = x.gather(0, best.expand(1, k, -1))[0]
    v = (v * lighting_scale(k) + known.usual_lighting[:, None]).clamp(min=0.0)
    return Stem(
        log_evidence=torch.maximum(pure, mixed) + log_sum,
        log_pure=log_pure, log_mixed=log_mixed,
        t=t[0] * log_pure.exp() + t[1] * log_mixed.exp(), lighting=v / v.sum(0).clamp(min=1e-6),
        brightness=brightness_temperature(
            known.nodes_um.mean(1)[:, None], spectra.clamp(min=1e-6)
        ),
    )  # fmt: skip


def pure_and_mixed(of_hypotheses, materials, less=0.0):
    """Hypotheses (R, P) as (M, P) each of pure and mixed; without mixed ones, the pure ones minus
    less take their place."""
    rows = of_hypotheses.shape[0]
    none_mixed = 2 - rows // materials
    return of_hypotheses[:materials], of_hypotheses[rows - materials :] - less * none_mixed


def material_of(row, materials):
    """The material's index for hypotheses row (...): row % materials, in a form ONNX supports."""
    return torch.arange(materials, device=row.device).repeat(2)[row]


def log_add(a, b):
    """log(exp a + exp b)."""
    return torch.maximum(a, b) + _log_1p_exp(-(a - b).abs())


def _log_1p_exp(x):
    """log(1 + exp x) for x <= 0; in ONNX, torch's own is far slower or overflows."""
    return torch.log(1 + torch.exp(x))


def _asinh(x):
    """asinh x, inaccurate below -100; for the same reason."""
    return torch.log((x + (x * x + 1).sqrt()).clamp(min=1e-4))


def _softplus(x):
    """log(1 + exp x); for the same reason."""
    return x.relu() + _log_1p_exp(-x.abs())


def _relative(log_evidence):
    """log p(m | z) (M, P) under a uniform prior, clamped from below; and log p(z) (P,)."""
    best = log_evidence.amax(0)
    best = best + (log_evidence - best).exp().sum(0).log()
    return (log_evidence - best).clamp(min=EVIDENCE_FLOOR), best


class Code(NamedTuple):
    """curve (M, CODE) of the materials, light (k, LIGHT_CODE) of the environment's objects and
    kernel (bands, SPECTRUM_CODE), which is applied to the pixels' spectra."""

    curve: torch.Tensor
    light: torch.Tensor
    kernel: torch.Tensor


class Prediction(NamedTuple):
    """The network's answer for height x width pixels.

    log_material (materials, height, width) log probabilities; trust (height, width), the weight a
    of the evidence; temperature_k (height, width) K; log_lighting (k, height, width).
    """

    log_material: torch.Tensor
    trust: torch.Tensor
    temperature_k: torch.Tensor
    log_lighting: torch.Tensor


class TeXNet(nn.Module):
    """The network. width is the number of channels of its trunk, whose cells are stride x stride
    pixels (1, 2 or 4); messages is the number of message rounds. Raises ValueError if any of
    these, or of dilations, is not a whole number, is too small, or is not allowed."""

    def __init__(self, width=48, dilations=DILATIONS, messages=2, stride=STRIDE):
        super().__init__()
        whole = [width, *dilations, 1 + messages, stride]
        # the parts of a large picture begin at multiples of the glance's step
        if not all(isinstance(n, int) and n > 0 for n in whole) or STEP % stride:
            raise ValueError(f"no network of {width=}, {dilations=}, {messages=}, {stride=}")
        self.config = dict(
            width=width, dilations=tuple(dilations), messages=messages, stride=stride
        )
        self.curve = SetCode(CODE)
        self.light = SetCode(LIGHT_CODE)
        self.kernel = Kernel(SPECTRUM_CODE)
        self.inlet = nn.Conv2d(SPECTRUM_CODE + 2 * CODE + LIGHT_CODE + 11, width, 1)
        self.trunk = nn.ModuleList(
            nn.Conv2d(width, width, 3, padding=d, dilation=d) for d in dilations
        )
        self.merge = nn.Conv2d(width, width, 1)
        self.heads = nn.Conv2d(width, CODE + LIGHT_CODE + 4 + 8 * messages, 1)
        for layer in self.trunk:
            nn.init.zeros_(layer.bias)
        with torch.no_grad():  # initially the answer is that of the physics
            self.heads.weight.mul_(0.1)
            self.heads.bias.zero_()

    @property
    def halo(self):
        """How far around it, in pixels, an answer depends on the image; whole cells."""
        stride, messages = self.config["stride"], self.config["messages"]
        reach = sum(self.config["dilations"]) * stride + stride - 1
        return -(-(reach + messages * (messages + 1) // 2) // stride) * stride

    def forward(self, known: Known, s: Stem, expected, shape) -> Prediction:
        """For a picture of that shape and its Stem; expected (M, P) nats, as in `glance`."""
        code = self.encode(known)
        own = self.own(known, code, s, expected)
        return self.look_around(known, code, own, s.log_evidence, expected, s.t, s.lighting, shape)

    def encode(self, known: Known) -> Code:
        """The Code of the materials, objects and bands."""
        wavelength = known.nodes_um.mean(1)
        e = known.emissivity.mean(-1)
        e = e + (1 - e) * known.is_sky[:, None]
        over = brightness_temperature(wavelength, known.environment) - known.prior_k[0]
        return Code(
            curve=self.curve(torch.asinh(20 * (1 - e)), known.is_sky, wavelength),
            light=self.light(over / 10, known.sky_object, wavelength),
            kernel=self.kernel(wavelength),
        )

    def own(self, known: Known, code: Code, s: Stem, expected):
        """(width, P) features of each pixel by itself, given expected (M, P) nats."""
        curve, light, kernel = (a.t() for a in code)
        prior, deviation = known.prior_k[0], known.prior_k[1]
        log_evidence, best = _relative(s.log_evidence)
        belief = torch.softmax(log_evidence + expected, dim=0)
        soft = torch.softmax(0.2 * log_evidence, dim=0)
        mean = s.brightness.mean(0)
        contrast = _asinh((s.brightness - mean) / 2)
        bands = known.nodes_um.shape[0]
        t = (belief * s.t).sum(0)
        usual = noise_sigma(known.nodes_um.mean(1), NOISE_AT)
        counted = torch.full_like(prior, bands).clamp(max=MOST_BANDS)
        # for noise that varies over bands, as behind air: the equally informative uniform noise
        noise = -0.5 * torch.log(((usual / known.sigma) ** 2).sum() / counted)
        scalars = torch.stack([
            (mean - prior) / 10,
            t * deviation / 10,
            (prior + t * deviation - mean) / 5,
            torch.asinh(best / known.basis.shape[0]),  # too negative for _asinh
            1 - belief.amax(0),
            -(belief * log_evidence).sum(0),
            -(belief * expected).sum(0),
            (belief * s.log_mixed.exp()).sum(0),
            known.sky_object @ s.lighting,
            0 * mean + noise,
            0 * mean + torch.log(counted / 30),
        ])  # fmt: skip
        features = torch.cat([
            kernel @ contrast / bands, curve @ belief, curve @ soft, light @ s.lighting, scalars,
        ])  # fmt: skip
        own = functional.relu(self.inlet(features[None, :, :, None]))
        return own.reshape(own.shape[1:3])

    def look_around(
        self, known: Known, code: Code, own, log_evidence, expected, t, lighting, shape
    ) -> Prediction:
        """The Prediction from own (width, P) of a whole picture, expected (M, P), and log_evidence,
        t and lighting of its Stem."""
        height, width = shape
        out = self._heads(own.reshape(1, -1, height, width))
        out = out.reshape(-1, height * width)
        n = CODE + LIGHT_CODE

        trust = _softplus(out[n] + ONE)
        heed = _softplus(out[n + 3] + ONE)
        logits = trust * _relative(log_evidence)[0] + heed * expected + code.curve @ out[:CODE]
        for i in range(self.config["messages"]):
            weight = _softplus(out[n + 4 + 8 * i : n + 12 + 8 * i] - 1.0)
            logits = logits + _messages(
                torch.softmax(logits, 0).reshape(-1, height, width),
                weight.reshape(8, height, width), 1 + i,
            ).reshape(logits.shape)  # fmt: skip
        log_material = torch.log_softmax(logits, 0)
        t = known.prior_k[0] + known.prior_k[1] * (log_material.exp() * t).sum(0)
        temperature = (t + out[n + 2]).clamp(min=COLDEST_K)
        share = _softplus(out[n + 1] + ONE)
        lighting = share * torch.log(lighting + 0.03) + code.light @ out[CODE:n]
        maps = lambda a: a.reshape(*a.shape[:-1], height, width)
        return Prediction(
            log_material=maps(log_material), trust=maps(trust), temperature_k=maps(temperature),
            log_lighting=maps(torch.log_softmax(lighting, 0)),
        )  # fmt: skip

    def _heads(self, own):
        """(1, width, height, width) -> (1, heads, height, width)."""
        stride, (height, width) = self.config["stride"], own.shape[2:]
        x = functional.avg_pool2d(own, stride, ceil_mode=True, count_include_pad=False)
        for layer in self.trunk:
            x = x + functional.relu(layer(x))
        x = own + functional.interpolate(x, scale_factor=stride)[:, :, :height, :width]
        return self.heads(x + functional.relu(self.merge(x)))


class Kernel(nn.Module):
    """n functions of wavelength, smooth enough to be sampled at any bands."""

    def __init__(self, n):
        super().__init__()
        self.mlp = nn.Sequential(nn.Linear(2 * FREQUENCIES + 1, 32), nn.ReLU(), nn.Linear(32, n))

    def forward(self, wavelength_um):
        """(bands,) um -> (bands, n)."""
        x = ((wavelength_um - 11) / 3)[:, None]
        turns = x * torch.arange(1, FREQUENCIES + 1, device=x.device) * (torch.pi / 2)
        return self.mlp(torch.cat([x, torch.sin(turns), torch.cos(turns)], dim=1))


class SetCode(nn.Module):
    """Codes of a set of spectra, each with a flag, by kernels over wavelength."""

    def __init__(self, n):
        super().__init__()
        self.kernel = Kernel(32)
        self.mlp = nn.Sequential(nn.Linear(32 + 1, 48), nn.ReLU(), nn.Linear(48, n))

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
