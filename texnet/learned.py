"""The model in torch, tile by tile, as `pipeline` calls it: the twin of export's runtime."""

from copy import deepcopy
from functools import cache
from importlib.resources import as_file, files

import numpy as np
import torch

from physics.errors import InputError
from physics.evidence import Known
from physics.expected import among_all, only
from physics.known import bytes_per_pixel
from physics.refinement import STEPS
from physics.tiles import TILE_BYTES, run_tiled

from .model import TeX, TeXModel
from .weights import load_network

WEIGHTS = "texnet.safetensors"  # in texnet/data


def torch_model(refined=True, network=None, *, steps=STEPS, device="cpu"):
    """run(radiance, known, progress, expected, regions) -> dict of TeX's maps as numpy arrays.

    refined   net+sgd, of so many steps; else net.  network   a TeXNet; the shipped one if None
    device    "cpu" or "cuda", where it is computed
    radiance  (bands, height, width);  known   dict of arrays as from `physics.known.known_arrays`
    expected  physics.expected.Expected of the materials, or None
    regions   physics.expected.Regions of the picture, or None: all materials everywhere
    """
    check_device(device)
    network = network or shipped_network()
    model = TeXModel(deepcopy(network).to(device), steps if refined else 0)

    def run(radiance, known, progress=None, expected=None, regions=None):
        known = {name: torch.from_numpy(a).to(device) for name, a in known.items()}
        materials, cell = len(known["is_sky"]), network.config["stride"]
        if regions is not None:
            regions.check(radiance.shape[1:], materials, cell)

        def tile(part, inner, corner):
            held = regions.at(*(corner + inner[:2])) if regions else np.ones(materials, bool)
            part, log_expected = torch.from_numpy(part).to(device), None
            if expected is not None:
                log_expected = expected.of_tile(*corner, *part.shape[1:], held)
                log_expected = torch.from_numpy(log_expected).to(device)
            there = Known(**only(known, torch.from_numpy(held).to(device)))
            answer = model(there, part, log_expected, torch.from_numpy(inner))
            maps = {name: a.cpu().numpy() for name, a in zip(TeX._fields, answer, strict=True)}
            return among_all(maps | {"material": maps["material"].astype("int16")}, held)

        pixels, cuts = TILE_BYTES / bytes_per_pixel(known), regions and regions.cuts
        return run_tiled(tile, radiance, network.halo, pixels, progress, cell, cuts=cuts)

    return run


def check_device(device):
    """Raise InputError if torch cannot compute on a device, "cpu" or "cuda"."""
    if device == "cuda" and not torch.cuda.is_available():
        raise InputError("device: torch finds no CUDA GPU here; take --device cpu.")


@cache
def shipped_network():
    """The TeXNet whose weights come with the package."""
    with as_file(files("texnet") / "data" / WEIGHTS) as path:
        return load_network(path)[0]
