"""The model in torch, tile by tile, as `pipeline` calls it: the twin of export's runtime."""

from copy import deepcopy
from functools import cache
from importlib.resources import as_file, files
from threading import Lock

import torch

from physics.by_tiles import by_tiles
from physics.errors import InputError
from physics.evidence import Known
from physics.refinement import STEPS
from physics.tiles import MOST_AT_ONCE, TILE_BYTES

from .model import TeX, TeXModel
from .weights import load_network

WEIGHTS = "texnet.safetensors"  # in texnet/data
ON_GPU = 2  # tiles at once: a GPU has less to do than there is to tell it
_ONE_RUN = Lock()


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

    def answer(*inputs):
        known, tile, log_expected, inner = inputs
        with torch.cuda.stream(torch.cuda.Stream() if device == "cuda" else None):
            there = Known.of(known, device)
            tile, log_expected = (torch.from_numpy(a).to(device) for a in (tile, log_expected))
            tex = model(there, tile, log_expected, torch.from_numpy(inner))
            return {name: a.cpu().numpy() for name, a in zip(TeX._fields, tex, strict=True)}

    def run(radiance, known, progress=None, expected=None, regions=None):
        # torch's threads are those of the process, and so is how exactly it convolves on a GPU
        with _ONE_RUN, torch.backends.cudnn.flags(enabled=True, allow_tf32=False):
            threads = torch.get_num_threads()
            at_once = min(threads, MOST_AT_ONCE) if device == "cpu" else ON_GPU
            bytes_each = TILE_BYTES / (at_once if device == "cpu" else 1)
            torch.set_num_threads(max(1, threads // at_once))  # many on one tile waste more
            try:
                return by_tiles(
                    answer, radiance, known, expected, regions, halo=network.halo,
                    cell=network.config["stride"], tile_bytes=bytes_each,
                    at_once=at_once, progress=progress,
                )  # fmt: skip
            finally:
                torch.set_num_threads(threads)

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
