"""What the network learns from without truth: crops of somebody's own cubes.

The environment is estimated from the whole cube, once for each number of objects; a draw takes
one of them and a random crop, most of which was measured, if that is easily found.
"""

from typing import NamedTuple

import numpy as np
import torch
from torch.utils.data import Dataset

from physics import estimate
from physics.cube.heat_cube import HeatCube
from physics.evidence import tensors
from physics.known import Known, known_arrays
from physics.lighting import as_lit
from physics.machinery.blas import no_blas_threads
from physics.sky import Atmosphere

from .samples import OBJECTS, Sample, features

TRIES, MOST_DEAD = 50, 0.1  # crops to choose from; of a crop's pixels


class CalibratedCube(NamedTuple):
    """A HeatCube, prepared (`physics.cube.prepared`); the Atmosphere of a sky that is assumed over
    it, if one is; by how much all of the library's curves may be off
    (`Environment.with_curves_off_by`); and (height, width) bool, the dead ones if None: pixels that
    say nothing of what lights them."""

    cube: HeatCube
    assumed_air: Atmosphere | None = None
    curve_error: float = 0.0
    left_out: np.ndarray | None = None


class Crops(Dataset):
    """Draw number i of some CalibratedCubes, each in its turn: an unlabelled Sample and its Stem,
    of at most side x side pixels.

    The Sample has `known` and `radiance`; the rest, truth and a glance, is None. Raises InputError
    where the library does not cover a cube's bands.
    """

    def __init__(self, seen, library, seed, side):
        self.seed, self.side, self.cubes = seed, side, []
        self.stream = 2  # of random numbers
        for cube, air, off, left_out in seen:
            most = min(OBJECTS[1], cube.measured_count)
            with no_blas_threads():
                sample = estimate.Sample(cube, library)
                around = (sample.environment(k, air) for k in range(OBJECTS[0], most + 1))
                around = (as_lit(e, cube, library, left_out, curves=off) for e in around)
                known = [known_arrays(cube, library, e) for e in around]
            # one tensor a cube: worker processes share each by an open file
            radiance = torch.from_numpy(cube.radiance.copy())
            self.cubes.append((radiance, cube.dead.copy(), known))

    def __len__(self):
        return len(self.cubes)

    def __getitem__(self, i):
        radiance, dead, known = self.cubes[i % len(self)]
        rng = np.random.default_rng([self.seed, self.stream, i])
        known = Known(**tensors(known[rng.integers(len(known))]))
        side = self.side
        for _ in range(TRIES):
            top, left = (int(rng.integers(max(1, n - side + 1))) for n in dead.shape)
            at = slice(top, top + side), slice(left, left + side)
            if dead[at].mean() <= MOST_DEAD:
                break
        radiance = radiance[:, *at]
        return Sample(known, radiance), features(known, radiance)
