"""Fine-tuning: adapting a trained network to a library or an instrument that it never saw.

With scenes   the light paths of training scenes are shaded again with the new curves (`reshade`),
              and training continues as in `train`, for a few epochs at a lower learning rate.
With cubes    it is trained on a user's own cubes, without truth, to reach from half of the bands
              what it so far answers from all of them (`crops`), after the camera errors found are
              corrected.

Zero-shot is neither: the network takes any library as it is.
"""

import copy
import json
import time
from importlib.metadata import version
from pathlib import Path

import numpy as np
import torch
from torch.utils.data import Subset

from physics.errors import InputError
from physics.estimate import USUAL_OBJECTS
from physics.machinery.provenance import fingerprint
from texnet.circumstances import circumstances
from texnet.files.library_io import with_sky
from texnet.learned import check_device, torch_model
from texnet.methods import by_network
from texnet.pipeline import answered

from .crops import CalibratedCube, Crops, learned
from .reshade import ReshadedSet
from .train import SIDE, TOGETHER, VALIDATION_SEED, Draws, Training, fit, run_name

LEARNING_RATE = 5e-4  # a quarter of training's
CUBES_LEARNING_RATE = 1e-4  # low, because its own answers are not the truth
PER_EPOCH = 160  # draws
SCENES, EPOCHS = 48, 3  # 3 % of the scenes and of the draws of `train`
HELD_OUT = 8  # validation scenes, or least number of crops of the cubes, at least one from each


def finetune(
    network, library, cache, *, scenes=SCENES, epochs=EPOCHS, cubes=(), seed=0, device="cpu",
    progress=None,
):  # fmt: skip
    """Adapt a TeXNet to a library -> (another TeXNet, history).

    network   TeXNet to start from; it is not changed
    library   MaterialLibrary; one without sky gets the starter library's for training
    cache     folder for light paths and checkpoints; existing ones are used, so a stopped run
              resumes from its last epoch with the same result
    scenes    number to shade again and train on, if there are no cubes
    epochs    of 160 draws each
    cubes     HeatCubes of 4 bands or more; if any, training uses only these
    seed      same seed, same weights
    device    "cpu" or "cuda", for the network
    progress  called as progress(done, total, what) after each scene and each draw

    history is a dict of plain values: settings, minutes, what the training set was, and under
    "before" and "after" the metrics on held-out scenes; with cubes, on other crops of them,
    against the answers of the original network.
    Raises InputError if library and cubes or 8-14 um do not fit together, or the library has only
    one material.
    """
    check_device(device)
    if len(library) < 2:
        raise InputError(
            "library: the network chooses between materials and needs two (one may be the sky); it "
            f"holds only {library.names[0]}."
        )
    network = copy.deepcopy(network).train()
    start = time.perf_counter()
    if cubes:
        terms, rate = "supervised", CUBES_LEARNING_RATE
        whole = with_sky(library)
        data = [
            (
                fingerprint(c.radiance, c.wavelength_um, c.nodes_um, c.dead, c.relative_noise),
                c.netd_k,
            )
            for c in cubes
        ]
        taken = []
        for i, cube in enumerate(cubes, 1):
            try:
                taken.append(calibrated(cube, whole, network, device))
            except InputError as e:
                which = f"cube {i} of {len(cubes)}: " if len(cubes) > 1 else ""
                raise InputError(f"{which}{e}") from e
        draws = Crops(taken, whole, seed, SIDE)
        held_out = copy.copy(draws)  # other crops of the same cubes
        held_out.stream += 1
    else:
        terms, rate = "both", LEARNING_RATE
        sets = [
            ReshadedSet(cache, split, count, library, seed)
            for split, count in (("train", scenes), ("validation", HELD_OUT))
        ]
        for s in sets:
            s.make(progress=lambda n, of: progress and progress(n, of, "scenes"))
        draws = Draws(sets[0], seed, SIDE)
        held_out = Draws(Subset(sets[1], range(HELD_OUT)), VALIDATION_SEED)  # each once
        data = [sets[0].folder.name, scenes]
    seconds = time.perf_counter() - start

    settings = dict(
        terms=terms, data=data, library=fingerprint(library.wavelength_um, library.emissivity),
        materials=library.names, network=fingerprint(*network.state_dict().values()), epochs=epochs,
        per_epoch=PER_EPOCH, learning_rate=rate, seed=seed, device=device,
    )  # fmt: skip
    module = Training(network, epochs * PER_EPOCH // TOGETHER, terms, rate)
    before = _measure(module, held_out)
    fit(
        module, draws, None, Path(cache) / "runs" / run_name(settings), epochs=epochs,
        per_epoch=PER_EPOCH, device=device, progress=progress,
    )  # fmt: skip
    history = json.loads(json.dumps(settings)) | {
        "version": version("texnet"), "torch": torch.__version__,
        "sky": "the library's" if library.sky_index is not None else "the starter library's",
        "before": before, "after": _measure(module.cpu(), held_out),
        "minutes": {"scenes": round(seconds / 60, 2), "training": round(module.seconds / 60, 2)},
    }  # fmt: skip
    return network.cpu().eval(), history


def calibrated(cube, library, network, device="cpu"):
    """A CalibratedCube: the HeatCube as corrected by `decompose` with a TeXNet and USUAL_OBJECTS
    before any pixel is solved, and then the answer to its informative pixels. Raises InputError as
    that does.
    """
    way = by_network(library, torch_model(network, device=device))
    of = circumstances(cube, library, way.looks, k=min(USUAL_OBJECTS, cube.measured_count))
    answer = answered(of._replace(cube=learned(of.cube, of.left_out)), library, way)
    return CalibratedCube(of.cube, answer, of.assumed_air, of.found.curves, of.left_out)


def _measure(module, draws):
    """Means of the module's measures over draws of each scene or cube, as floats."""
    with torch.no_grad():
        rows = [module.measures(*draws[i]) for i in range(max(HELD_OUT, len(draws)))]
    return {name: float(np.mean([row[name] for row in rows])) for name in rows[0]}
