"""What the network learns from without truth: crops of somebody's own cubes.

The environment is estimated from the whole cube, once for each number of objects; a draw takes
one of them and a random crop.
"""

import numpy as np
import torch
from torch.utils.data import Dataset

from physics.estimate import estimate_environment
from physics.evidence import Known
from physics.known import known_arrays
from physics.prepared import prepared

from .samples import OBJECTS, Sample, features


class Crops(Dataset):
    """Draw number i of HeatCubes, each in its turn: an unlabelled Sample and its Stem, of
    at most side x side pixels.

    The Sample has `known` and `radiance`; the rest, truth and a glance, is None. Raises InputError
    where the library does not cover a cube's bands.
    """

    def __init__(self, cubes, library, seed, side):
        self.seed, self.side, self.cubes = seed, side, []
        for cube in cubes:
            cube = prepared(cube, library).cube
            most = min(OBJECTS[1], cube.shape[0] * cube.shape[1])
            known = []
            for k in range(OBJECTS[0], most + 1):
                arrays = known_arrays(cube, library, estimate_environment(cube, library, k))
                known.append(Known.of(arrays))
            # a tensor, which worker processes share
            self.cubes.append((torch.from_numpy(cube.radiance.copy()), known))

    def __len__(self):
        return len(self.cubes)

    def __getitem__(self, i):
        radiance, known = self.cubes[i % len(self)]
        rng = np.random.default_rng([self.seed, 2, i])
        known = known[rng.integers(len(known))]
        side = self.side
        top, left = (int(rng.integers(max(1, n - side + 1))) for n in radiance.shape[1:])
        radiance = radiance[:, top : top + side, left : left + side]
        return Sample(known, radiance, *[None] * 6), features(known, radiance)
