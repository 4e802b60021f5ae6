"""What the network learns from without truth: crops of a user's own cubes.

A good fit is no teacher. If a pixel contains several materials, or a curve is a little off, a wrong
material fits better than the right one, in all bands alike, and training has taught the network how
little that means. The misfit of Eq. 1, with any curve, or the likelihood of bands that it was not
shown, would teach it to believe the fit again. So it learns from what `decompose` answers to whole
spectra with a glance at the whole cube, with that answer's probabilities: to see as much in half of
the bands, half of the time without a glance. That takes knowledge of how the materials there look,
and which of them lie side by side.

With 64 x 96 pixels of 18 bands, `forest` and `street` of seed 11, `net+sgd` named as many pixels
right (to 0.2 points) to 1.5 points more, in these and in the next two seeds, for two seeds of the
draws; with the misfit of Eq. 1 1.0 to 3.6 fewer; with bands not shown 5.7 fewer to 0.2 more; with
all bands instead of half of them 1.8 fewer to 0.4 more.

The environment is estimated from the whole cube, once for each number of objects, each time with
another half of the bands; a draw takes one of them and a random crop, most of which was measured,
if one is easily found.
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

TRIES, MOST_DEAD = 50, 0.1  # crops to choose from; dead share of a crop's pixels


class CalibratedCube(NamedTuple):
    """A HeatCube, prepared (`physics.cube.prepared`), and what is answered to it as `learned`; the
    Atmosphere of an assumed sky, if any; by how much all curves of the library may be off
    (`Environment.with_curves_off_by`); and (height, width) bool, pixels that say nothing of what
    lights them; the dead ones if None."""

    cube: HeatCube
    answer: Decomposition
    assumed_air: Atmosphere | None = None
    curve_error: float = 0.0
    left_out: np.ndarray | None = None


class View(NamedTuple):
    """What is known of a HeatCube of which only some bands, (bands,) bool, are seen: its Known, and
    a Glance's scene, as numpy arrays by name, radiance and step."""

    seen: np.ndarray
    known: dict[str, np.ndarray]
    scene: dict[str, np.ndarray]
    afar: np.ndarray
    step: int


class Crops(Dataset):
    """Draw number i from some CalibratedCubes in turn: a Sample, with the answer as its truth, and
    its Stem, of at most side x side pixels. A material is drawn by its probability, so that what
    was in doubt remains so.

    Raises InputError if the library does not cover a cube's bands, or these are too few.
    """

    def __init__(self, taken, library, seed, side):
        self.seed, self.side, self.cubes = seed, side, []
        self.stream = 2  # number of the random stream
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
            # one tensor per cube: worker processes share each through an open file
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
        material = (p.cumsum(0) < below).sum(0).clamp(max=len(p) - 1)  # rounding may exceed it
        light = torch.from_numpy(around[:, view.seen].astype(np.float32))
        radiance, texture = radiance[view.seen], torch.einsum("kb,khw->bhw", light, v)
        sample = Sample(
            known, radiance, material, t[0], texture, sky_view[0], ground[0] > 0, glance
        )
        return sample, features(known, radiance)


def learned(cube, left_out):
    """The HeatCube from which the network learns: pixels that say nothing are treated as dead, and
    so as similar to their neighbours."""
    return cube if left_out is None else replace(cube, dead=left_out)


def _view(cube, library, environment, rng):
    """A View of a random half of a HeatCube's bands in an Environment, with a random step."""
    seen = np.zeros(cube.bands, bool)
    seen[rng.permutation(cube.bands)[: max(BANDS[0], cube.bands // 2)]] = True
    cube, environment = cube.only(seen), environment.only(seen)
    step = int(rng.integers(PATCH, STEP + 1))
    afar = from_afar(cube, step)
    scene = set_up(known_arrays(afar, library, environment))
    return View(seen, known_arrays(cube, library, environment), scene, afar.radiance.copy(), step)
