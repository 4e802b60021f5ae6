"""What the network learns from: one scene as some instrument and some library would see it.

From a clean Record at 100 narrow bands, each draw makes other bands (3 to 100, equidistant
over part of 8-14 um with or without gaps, or any), other noise (10 to 200 mK), another number
of environment objects (1 to 8, estimated from the noisy cube itself, like the sky's share of the
light) and another library: the scene's own materials among others, in any order, each curve
a little wrong. Nearly half of the draws have 9 bands or fewer, where spectra say least and
the surroundings most, and half are mirror images of the scene. Half come with a glance from afar at
the whole scene, whose answer the network then expects; the others teach it to answer a glance.
"""

from typing import NamedTuple

import numpy as np
import torch

from physics.cube.heat_cube import HeatCube
from physics.estimate import estimate_environment
from physics.evidence import tensors
from physics.expected import Expected
from physics.hypotheses import Hypotheses, hypotheses_of, set_up
from physics.known import Known, known_arrays
from physics.library import SKY, MaterialLibrary
from physics.lighting import with_usual_lighting
from physics.simulator.sensor import add_noise
from texnet.glance import PATCH, STEP, expected, from_afar
from texnet.model import TeXModel
from texnet.network import stem

BANDS, NETD_K, OBJECTS = (3, 100), (0.01, 0.2), (1, 8)
MATERIALS = 6  # least number in a library
ANY_BANDS = 0.2  # share of the draws with bands that are not equidistant
CURVE_ERROR = 0.01  # largest standard deviation of a library's error


class Glance(NamedTuple):
    """A whole scene, of which a Sample is a part, seen from afar.

    scene, radiance (bands, h, w)  of its patches, one every step pixels, as TeXModel takes them
    top, left                      pixel at which the Sample begins;  turned: it is mirrored
    """

    scene: dict[str, torch.Tensor]
    radiance: torch.Tensor
    step: int
    top: int
    left: int
    turned: bool


class Sample(NamedTuple):
    """Input and truth, or its substitute, for height x width pixels.

    known, radiance (bands, height, width)   as the network takes them
    material (height, width) int64 index into the library, temperature_k (height, width) K,
    texture (bands, height, width) W m-2 sr-1 um-1, sky_view (height, width) 0..1,
    ground (height, width) bool: not sky
    glance                                   at the scene around it, if any
    """

    known: Known
    radiance: torch.Tensor
    material: torch.Tensor
    temperature_k: torch.Tensor
    texture: torch.Tensor
    sky_view: torch.Tensor
    ground: torch.Tensor
    glance: Glance | None = None


def draw(record, rng, side=None) -> Sample:
    """A random Sample of a Record, by a numpy Generator.

    side   pixels of a random square of it, half of them with a glance; if None the whole scene,
           with one. What is known of a scene always comes from all of it.
    """
    weight, centre, width = _bands(record.wavelength_um, rng)
    netd_k = float(np.exp(rng.uniform(*np.log(NETD_K))))
    k = int(rng.integers(OBJECTS[0], OBJECTS[1] + 1))
    library, order = _library(record, rng)
    clean = np.tensordot(weight, record.radiance, 1).astype(np.float32)
    cube = HeatCube(add_noise(clean, centre, netd_k, rng), centre, width, netd_k)
    environment = estimate_environment(cube, library, k, seed=int(rng.integers(2**31)))
    environment = with_usual_lighting(environment, cube, library)
    height, width = cube.shape
    side = side or max(height, width)
    top, left = (int(rng.integers(max(0, n - side) + 1)) for n in (height, width))
    turn = 1 if rng.random() < 0.5 else -1
    glance, step = None, int(rng.integers(PATCH, STEP + 1))
    if side >= max(height, width) or rng.random() < 0.5:
        afar = from_afar(cube, step)
        scene = tensors(set_up(known_arrays(afar, library, environment)))
        glance = Glance(scene, torch.from_numpy(afar.radiance.copy()), step, top, left, turn < 0)
    of = lambda a: torch.from_numpy(
        np.array(a[..., top : top + side, left : left + side][..., ::turn])
    )
    return Sample(
        Known(**tensors(known_arrays(cube, library, environment))),
        of(cube.radiance),
        of(order[record.material]),
        of(record.temperature_k),
        of(np.tensordot(weight, record.texture.astype(np.float32), 1).astype(np.float32)),
        of(record.sky_view),
        of(np.array(record.names)[record.material] != SKY),
        glance,
    )


@torch.no_grad()
def features(known, radiance):
    """The Stem of radiance (bands, height, width), a tensor on the CPU like those of Known."""
    h = hypotheses_of({name: a.numpy() for name, a in known._asdict().items()})
    return stem(known, Hypotheses(**tensors(h._asdict())), radiance.flatten(1))


def expected_by(network, sample):
    """Nats (materials, pixels) by which a network expects materials in a Sample after a glance at
    its scene; 0 without one."""
    known, shape, glance = sample.known, sample.radiance.shape[1:], sample.glance
    if glance is None:
        return sample.radiance.new_zeros(len(known.is_sky), shape[0] * shape[1])
    p = TeXModel(network)(glance.scene, glance.radiance).material_probability
    seen = Expected(expected(p.cpu().numpy()), glance.step)
    nats = seen.of_tile(glance.top, glance.left, *shape)
    nats = nats[..., ::-1] if glance.turned else nats
    return torch.from_numpy(nats.copy()).to(p.device).flatten(1)


def _bands(fine_um, rng):
    """Weights (bands, fine) of box bands made of fine ones, centres and widths (bands,) um."""
    fine, step = len(fine_um), fine_um[1] - fine_um[0]
    least, most = np.log(BANDS)
    n = min(fine, round(float(np.exp(least + (most - least) * rng.random() ** 1.5))))
    if n < fine and rng.random() < ANY_BANDS:
        pick = np.sort(rng.choice(fine, n, replace=False))
        return np.eye(fine)[pick], fine_um[pick], np.full(n, step)
    span = min(fine, max(n, int(fine * rng.uniform(0.6, 1.2))))
    edges = np.linspace(0, span, n + 1) + rng.integers(fine - span + 1)
    filled = 1.0 if rng.random() < 0.5 else rng.uniform(0.4, 1.0)  # of a band, by its filter
    middle = 0.5 * (edges[1:] + edges[:-1])
    half = 0.5 * max(filled * span / n, 1.0)
    i = np.arange(fine)
    overlap = np.minimum(middle[:, None] + half, i + 1) - np.maximum(middle[:, None] - half, i)
    weight = np.clip(overlap, 0, 1)
    weight /= weight.sum(axis=1, keepdims=True)
    return weight, weight @ fine_um, np.full(n, 2 * half * step)


def _library(record, rng):
    """A library with the scene's materials, and (materials of the record,) their indices in it."""
    names = np.array(record.names)
    needed = np.union1d(np.unique(record.material), np.flatnonzero(names == SKY))
    others = rng.permutation(np.setdiff1d(np.arange(len(names)), needed))
    least = min(max(0, MATERIALS - len(needed)), len(others))
    extra = rng.integers(least, len(others) + 1)
    chosen = rng.permutation(np.concatenate([needed, others[:extra]]))
    w, step = record.wavelength_um, record.wavelength_um[1] - record.wavelength_um[0]
    curves = record.curves[chosen].astype(np.float64)
    if rng.random() < 0.5:
        knots = np.linspace(w[0], w[-1], 12)
        error = rng.uniform(0, CURVE_ERROR) * rng.normal(size=(len(chosen), len(knots)))
        error[names[chosen] == SKY] = 0
        curves += np.stack([np.interp(w, knots, row) for row in error])
    # bands reach half a fine band beyond the outermost centres
    w = np.concatenate([[w[0] - step], w, [w[-1] + step]])
    curves = np.clip(np.pad(curves, ((0, 0), (1, 1)), mode="edge"), 0.01, 1)
    order = np.full(len(names), -1)
    order[chosen] = np.arange(len(chosen))
    return MaterialLibrary(tuple(names[chosen]), w, curves), order
