"""The model in torch, tile by tile, as `pipeline` calls it: the twin of `runtime`."""

from contextlib import contextmanager
from copy import deepcopy
from functools import cache, partial
from importlib.resources import as_file, files
from queue import SimpleQueue
from threading import Lock

import torch

from physics.errors import InputError
from physics.evidence import tensors
from physics.machinery.tiles import MOST_AT_ONCE, TILE_BYTES
from physics.refinement import STEPS

from .by_tiles import by_tiles
from .files.weights import load_network
from .methods import WEIGHTS
from .model import TeX, TeXModel

ON_GPU = 2  # tiles at once: launching the work takes longer than doing it
_ONE_RUN = Lock()


def torch_model(network=None, *, steps=STEPS, device="cpu"):
    """run(radiance, known, progress, expected, regions, refined) -> dict of TeX's maps, in numpy.

    network   a TeXNet; the shipped one if None.  device    "cpu" or "cuda", where it runs
    radiance  (bands, height, width);  known   dict of arrays as from `physics.known.known_arrays`
    expected  physics.expected.Expected of the materials, or None
    regions   physics.expected.Regions of the picture, or None: all materials everywhere
    refined   True: net+sgd, with so many steps; False: net, the network's unrefined proposal
    """
    check_device(device)
    network, gpu = shipped_network() if network is None else network, device == "cuda"
    # one device for all threads
    there = torch.device("cuda", torch.cuda.current_device()) if gpu else torch.device("cpu")
    network = deepcopy(network).to(there)
    models = {refined: TeXModel(network, steps if refined else 0) for refined in (True, False)}
    streams = SimpleQueue()
    for _ in range(ON_GPU if gpu else 0):
        streams.put(torch.cuda.Stream(there))

    def answer(model, *inputs):
        scene, tile, log_expected, inner = inputs
        tile, log_expected = (torch.from_numpy(a).to(there) for a in (tile, log_expected))
        tex = model(tensors(scene, there), tile, log_expected, torch.from_numpy(inner))
        return {name: a.cpu().numpy() for name, a in zip(TeX._fields, tex, strict=True)}

    def answer_beside_others(*inputs):
        stream = streams.get()
        try:
            with torch.cuda.stream(stream):
                return answer(*inputs)
        except torch.OutOfMemoryError as e:
            raise InputError("device: the GPU has too little memory; take --device cpu.") from e
        finally:
            streams.put(stream)

    def run(radiance, known, progress=None, expected=None, regions=None, refined=True):
        of_tile = partial(answer_beside_others if gpu else answer, models[refined])
        with _ONE_RUN, _exact():  # torch's threads and precision are set for the whole process
            threads = torch.get_num_threads()
            at_once = ON_GPU if gpu else min(threads, MOST_AT_ONCE)
            tile_bytes = TILE_BYTES / at_once
            if gpu:  # where a tile is processed at once, not in chunks
                tile_bytes = min(TILE_BYTES, torch.cuda.mem_get_info(there)[0] / (10 * at_once))
            torch.set_num_threads(max(1, threads // at_once))  # many threads on a tile waste more
            try:
                return by_tiles(
                    of_tile, radiance, known, expected, regions,
                    halo=network.halo, cell=network.config["stride"], tile_bytes=tile_bytes,
                    at_once=at_once, progress=progress,
                )  # fmt: skip
            finally:
                torch.set_num_threads(threads)

    return run


@contextmanager
def _exact():
    """Keep float32 exact whatever the process has set: TF32 and bfloat16 change materials."""
    backends = torch.backends
    of = (
        backends.cuda.matmul, backends.cudnn.conv, backends.mkldnn.matmul, backends.mkldnn.conv,
    )  # fmt: skip
    before = [b.fp32_precision for b in of]
    for b in of:
        b.fp32_precision = "ieee"
    try:
        yield
    finally:
        for b, was in zip(of, before, strict=True):
            b.fp32_precision = was


def check_device(device):
    """Raise InputError unless device is "cpu" or "cuda", and torch can compute on it."""
    if device not in ("cpu", "cuda"):
        raise InputError(f"device: need cpu or cuda, got {device!r}.")
    if device == "cpu":
        return
    if not torch.cuda.is_available():
        raise InputError("device: torch finds no CUDA GPU here; take --device cpu.")
    try:
        # also loads linear algebra, which two threads must not load at once
        torch.linalg.inv(torch.eye(2, device="cuda")).sum().item()
    except (RuntimeError, AssertionError) as e:  # too old, or full
        why = str(e).splitlines()[0]
        raise InputError(f"device: torch cannot use the GPU ({why}); take --device cpu.") from e


@cache
def shipped_network():
    """The TeXNet whose weights come with the package."""
    with as_file(files("texnet") / "data" / WEIGHTS) as path:
        return load_network(path)[0]
