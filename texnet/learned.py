"""The model in torch, tile by tile, as `pipeline` calls it: the twin of export's runtime."""

from functools import cache
from importlib.resources import as_file, files

import numpy as np
import torch

from physics.evidence import Known
from physics.known import bytes_per_pixel
from physics.refinement import STEPS
from physics.tiles import run_tiled

from .model import TeX, TeXModel
from .weights import load_network

WEIGHTS = "texnet.safetensors"  # in texnet/data
TILE_BYTES = 1e9  # about


def torch_model(refined=True, network=None, steps=STEPS):
    """run(radiance, known, progress) -> dict of TeX's maps as numpy arrays.

    refined   net+sgd, of so many steps; else net.  network   a TeXNet; the shipped one if None
    radiance  (bands, height, width);  known   dict of arrays as from `physics.known.known_arrays`
    """
    network = network or shipped_network()
    model = TeXModel(network, steps if refined else 0)

    def run(radiance, known, progress=None):
        tensors = Known(**{name: torch.from_numpy(a) for name, a in known.items()})

        def tile(part, inner):
            part = torch.from_numpy(np.array(part))  # the cube is read-only
            answer = model(tensors, part, torch.from_numpy(inner))
            maps = {name: a.numpy() for name, a in zip(TeX._fields, answer, strict=True)}
            return maps | {"material": maps["material"].astype("int16")}

        cell = network.config["stride"]
        pixels = TILE_BYTES / bytes_per_pixel(known)
        return run_tiled(tile, radiance, network.halo, pixels, progress, cell)

    return run


@cache
def shipped_network():
    """The TeXNet whose weights come with the package."""
    with as_file(files("texnet") / "data" / WEIGHTS) as path:
        return load_network(path)[0]
