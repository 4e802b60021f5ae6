"""What the network learns from without truth: crops of somebody's own cubes.

What fits is no teacher. Where a pixel is of several materials, or a curve is a little off, another
material than the right one fits, in all bands alike, and training has taught the network how little
that means: by the misfit of Eq. 1, with whatever curve, or by the likelihood of bands that it was
not shown, it would learn to believe it again. So it learns from what `decompose` answers, as sure
as that is, to whole spectra, with a glance at all of the cube: to see as much in half of the bands,
half of the time without a glance. What that takes is to know how the materials there look, and
which of them lie side by side.

On 64 x 96 pixels of 18 bands, `forest` and `street` of seed 11, of them and of the next two seeds'
`net+sgd` named as many right (by 0.2 points) to 1.5 points more, by two seeds of the draws; by the
misfit of Eq. 1 1.0 to 3.6 fewer; by bands not shown 5.7 fewer to 0.2 more; of all bands instead of
half of them 1.8 fewer to 0.4 more.

The environment is estimated from the whole cube, once for each number of objects, each of which
sees another half of the bands; a draw takes one of them and a random crop, most of which was
measured, if that is easily found.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from torch.utils.data import Dataset

from physics import estimate
from physics.cube.heat_cube import HeatCube
from physics.errors import InputError
from physics.evidence import tensors
from physics.hypotheses import set_up
from physics.known import Known, known_arrays
from physics.lighting import as_lit
from physics.machinery.blas import no_blas_threads
from physics.sky import Atmosphere
from texnet.glance import PATCH, STEP, from_afar
from texnet.metrics import non_sky
from texnet.pipeline import Decomposition

from .samples import BANDS, OBJECTS, Glance, Sample, features

TRIES, MOST_DEAD = 50, 0.1  # crops to choose from; of a crop's pixels


class CalibratedCube(NamedTuple):
    """A HeatCube, prepared (`physics.cube.prepared`), and what is answered to it as `learned`; the
    Atmosphere of a sky that is assumed over it, if one is; by how much all of the library's curves
    may be off (`Environment.with_curves_off_by`); and (height, width) bool, the dead ones if None:
    pixels that say nothing of what lights them."""

    cube: HeatCube
    answer: Decomposition
    assumed_air: Atmosphere | None = None
    curve_error: float = 0.0
    left_out: np.ndarray | None = None


class View(NamedTuple):
    """What is known of a HeatCube of which some bands are seen, (bands,) bool: its Known, and a
    Glance's scene, as numpy arrays by name, radiance and step."""

    seen: np.ndarray
    known: dict[str, np.ndarray]
    scene: dict[str, np.ndarray]
    afar: np.ndarray
    step: int


class Crops(Dataset):
    """Draw number i of some CalibratedCubes, each in its turn: a Sample, in which the answer stands
    for the truth, and its Stem, of at most side x side pixels. A material is drawn by its
    probability, so that what was in doubt remains so.

    Raises InputError where the library does not cover a cube's bands, or these are too few.
    """

    def __init__(self, taken, library, seed, side):
        self.seed, self.side, self.cubes = seed, side, []
        self.stream = 2  # of random numbers
        for number, (cube, answer, air, off, left_out) in enumerate(taken):
            if cube.bands <= BANDS[0]:
                raise InputError(
                    f"cube: it has {cube.bands} bands; where no truth is known the network learns "
                    f"from bands that it is not shown, and needs {BANDS[0] + 1} or more."
                )
            rng = np.random.default_rng([seed, number])
            most = min(OBJECTS[1], cube.measured_count)
            shown = learned(cube, left_out)
            with no_blas_threads():
                sample = estimate.Sample(cube, library)
                around = (sample.environment(k, air) for k in range(OBJECTS[0], most + 1))
                around = (as_lit(e, cube, library, left_out, curves=off) for e in around)
                views = [_view(shown, library, e, rng) for e in around]
            lit = answer.thermal_lighting
            maps = (
                shown.radiance, answer.material_probability, lit,
                lit[list(answer.sky)].sum(0)[None], answer.temperature_k[None],
                non_sky(answer)[None],
            )  # fmt: skip
            # one tensor a cube: worker processes share each by an open file
            together = torch.from_numpy(np.concatenate(maps).astype(np.float32))
            sizes = [len(a) for a in maps]
            self.cubes.append((together, sizes, answer.environment, shown.dead.copy(), views))

    def __len__(self):
        return len(self.cubes)

    def __getitem__(self, i):
        maps, sizes, around, dead, views = self.cubes[i % len(self)]
        rng = np.random.default_rng([self.seed, self.stream, i])
        view = views[rng.integers(len(views))]
        known = Known(**tensors(view.known))
        side = self.side
        for _ in range(TRIES):
            top, left = (int(rng.integers(max(1, n - side + 1))) for n in dead.shape)
            at = slice(top, top + side), slice(left, left + side)
            if dead[at].mean() <= MOST_DEAD:
                break
        glance = None
        if rng.random() < 0.5:
            afar = torch.from_numpy(view.afar)
            glance = Glance(tensors(view.scene), afar, view.step, top, left, turned=False)
        radiance, p, v, sky_view, t, ground = maps[:, *at].split(sizes)
        below = torch.from_numpy(rng.random(p.shape[1:], np.float32)) * p.sum(0)
        material = (p.cumsum(0) < below).sum(0).clamp(max=len(p) - 1)  # rounding may go beyond
        light = torch.from_numpy(around[:, view.seen].astype(np.float32))
        radiance, texture = radiance[view.seen], torch.einsum("kb,khw->bhw", light, v)
        sample = Sample(
            known, radiance, material, t[0], texture, sky_view[0], ground[0] > 0, glance
        )
        return sample, features(known, radiance)


def learned(cube, left_out):
    """The HeatCube of which the network learns: pixels that say nothing are as if dead, and so like
    those beside them."""
    return cube if left_out is None else replace(cube, dead=left_out)


def _view(cube, library, environment, rng):
    """A View of a HeatCube in an Environment, of a random half of its bands and step."""
    seen = np.zeros(cube.bands, bool)
    seen[rng.permutation(cube.bands)[: max(BANDS[0], cube.bands // 2)]] = True
    cube, environment = cube.only(seen), environment.only(seen)
    step = int(rng.integers(PATCH, STEP + 1))
    afar = from_afar(cube, step)
    scene = set_up(known_arrays(afar, library, environment))
    return View(seen, known_arrays(cube, library, environment), scene, afar.radiance.copy(), step)
