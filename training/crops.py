"""What the network learns from without truth: crops of somebody's own cubes.

The environment is estimated from the whole cube, once for each number of objects; a draw takes
one of them and a random crop, most of which was measured, if that is easily found.
"""

import numpy as np
import torch
from torch.utils.data import Dataset

from physics import estimate
from physics.evidence import tensors
from physics.known import Known, known_arrays
from physics.machinery.blas import no_blas_threads

from .samples import OBJECTS, Sample, features

TRIES, MOST_DEAD = 50, 0.1  # crops to choose from; of a crop's pixels


class Crops(Dataset):
    """Draw number i of HeatCubes, prepared (`physics.cube.prepared`), each in its turn: an
    unlabelled Sample and its Stem, of at most side x side pixels. Where assume_sky says so of a
    cube, a usual sky is assumed.

    The Sample has `known` and `radiance`; the rest, truth and a glance, is None. Raises InputError
    where the library does not cover a cube's bands.
    """

    def __init__(self, cubes, assume_sky, library, seed, side):
        self.seed, self.side, self.cubes = seed, side, []
        self.stream = 2  # of random numbers
        for cube, assume in zip(cubes, assume_sky, strict=True):
            most = min(OBJECTS[1], cube.measured_count)
            with no_blas_threads():
                sample = estimate.Sample(cube, library)
                known = [
                    known_arrays(cube, library, sample.environment(k, assume))
                    for k in range(OBJECTS[0], most + 1)
                ]
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
        return Sample(known, radiance, *[None] * 6), features(known, radiance)
