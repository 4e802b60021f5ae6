"""What fine-tuning is worth on a library whose materials were never seen in training.

    python -m benchmarks.finetune --out DIR [--cache DIR] [--model FILE] [--parts PART ...]

Parts, each of which may be run alone, interrupted and run again; finished work is kept:

    zero-shot   the shipped weights, as they are
    scenes      fine-tuned on 48 training scenes, shaded again with the new library
    cubes       fine-tuned on 12 cubes without truth
    scratch     trained from scratch as `texnet train` does, each scene shaded once

All are measured on test scenes (other geometry, temperatures, skies) made of the new library, as
`decompose` answers them: 54 bands, NETD 50 mK, environment estimated from the cube, k = 5; by the
network alone and with refinement. DIR gets PART.safetensors, PART.json and, for all parts there,
finetune.csv.

Minutes for scenes are extrapolated from a few (TIMED), because most are cached; minutes of training
are those measured, possibly on a busy machine, unlike the number of draws. Shading counts as
training, except for scratch, where it is left out.
"""

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytorch_lightning as lightning

from benchmarks import SHIPPED
from benchmarks.accuracy import NETD_K, K
from benchmarks.rows import settings, write_csv
from physics import starter
from physics.bands import equidistant_bands
from physics.errors import InputError
from physics.library import MaterialLibrary
from physics.machinery.provenance import fingerprint
from physics.machinery.whole_file import whole_file
from physics.starter import AIR, Recipe
from texnet.files.weights import load_network, save_network
from texnet.learned import torch_model
from texnet.methods import NETS, WEIGHTS
from texnet.metrics import evaluate
from texnet.network import TeXNet
from texnet.pipeline import decompose
from texnet.progress import progress_bar
from training import finetune as recipe
from training import train
from training.reshade import ReshadedSet
from training.scenes import Record

BANDS = 54
TEST_SCENES, CUBES = 12, 12
TIMED = 4  # scenes
PARTS = ("zero-shot", "scenes", "cubes", "scratch")
SCORES = ("material_accuracy", "cross_entropy", "temperature_rmse_k", "texture_correlation")

# Pages of refractiveindex.info that the starter library does not use.
SUBSTANCES = {
    "polyimide": ("other/Kapton/Zhang",),
    "silicone": ("organic/polydimethylsiloxane/Zhang-10-1",),
    "polyetherimide": ("organic/polyetherimide/Zhang",),
    "diethyl phthalate": ("organic/diethyl_phthalate/Querry-IR",),
    "toluene": ("organic/toluene/Myers",),
    "propanol": ("organic/propanol/Sani",),
    "silicon carbide": ("main/SiC/Larruquert",),
    "boron carbide": ("main/B4C/Larruquert",),
    "silicon monoxide": ("main/SiO/Herguedas",),
    "hafnia": ("main/HfO2/Franta",),
    "niobia": ("main/Nb2O5/Franta",),
    "tantala": ("main/Ta2O5/Franta-2025",),
    "garnet": ("main/Y3Al5O12/Franta",),
    "aluminium nitride": ("main/AlN/Beliaev2",),
    "magnesium fluoride": ("main/MgF2/Franta",),
    "vanadium dioxide": ("main/VO2/Beaini-25C",),
    "graphite": ("main/C/Querry-DixonKS2",),
    "brass": ("other/Cu-Zn/Querry-Cu70Zn30",),
    "titanium": ("main/Ti/Ordal",),
}


def _recipe(name, recollision, *facets):
    return Recipe(name, 0.0, (0.4, 0.4, 0.4), facets, recollision, "Never seen in training.")


RECIPES = (
    _recipe("polyimide", 0.1, (1.0, {"polyimide": 1.0})),
    _recipe("silicone", 0.2, (1.0, {"silicone": 1.0})),
    _recipe("polyetherimide", 0.1, (1.0, {"polyetherimide": 1.0})),
    _recipe("lacquer", 0.1, (1.0, {"diethyl phthalate": 0.7, "toluene": 0.3})),
    _recipe("felt", 0.5, (0.7, {"propanol": 0.8, AIR: 0.2}), (0.3, {"polyimide": 1.0})),
    _recipe("carborundum", 0.4, (1.0, {"silicon carbide": 0.8, AIR: 0.2})),
    _recipe("boron_carbide", 0.3, (1.0, {"boron carbide": 1.0})),
    _recipe("slag", 0.3, (0.8, {"silicon monoxide": 1.0}), (0.2, {"vanadium dioxide": 1.0})),
    _recipe("hafnia", 0.3, (1.0, {"hafnia": 0.7, AIR: 0.3})),
    _recipe("niobia", 0.3, (1.0, {"niobia": 0.8, AIR: 0.2})),
    _recipe("tantala", 0.2, (1.0, {"tantala": 1.0})),
    _recipe("garnet", 0.3, (1.0, {"garnet": 1.0})),
    _recipe("nitride", 0.2, (1.0, {"aluminium nitride": 0.9, AIR: 0.1})),
    _recipe("fluoride", 0.3, (1.0, {"magnesium fluoride": 1.0})),
    _recipe("graphite", 0.5, (1.0, {"graphite": 1.0})),
    _recipe("brass", 0.3, (0.9, {"brass": 1.0}), (0.1, {"niobia": 1.0})),
    _recipe("titanium", 0.4, (0.7, {"titanium": 1.0}), (0.3, {"tantala": 1.0})),
)


def new_library():
    """MaterialLibrary of 17 materials by the starter's recipe steps, and the starter's sky."""
    with patch.dict(starter.SUBSTANCES, SUBSTANCES):
        solid = [starter.emissivity(r) for r in RECIPES]
    old = MaterialLibrary.starter()
    sky = old.at(starter.WAVELENGTH_UM)[old.sky_index]
    return MaterialLibrary(
        ["sky", *(r.name for r in RECIPES)], starter.WAVELENGTH_UM, np.stack([sky, *solid])
    )


def measure(network, scenes, method):
    """Mean scores over scenes of a TeXNet, by a method, on the first turn of a ReshadedSet, and
    seconds per scene for the network's part."""
    model, rows, seconds = torch_model(network), [], 0.0
    for i in range(scenes.count):
        cube, truth = scenes.shade(i, *equidistant_bands(BANDS), NETD_K)
        d = decompose(cube, scenes.library, method=method, k=K, model=model)
        seconds += d.seconds["network"]
        scores = evaluate(d, truth)
        rows.append([scores[name] for name in SCORES])
    means = dict(zip(SCORES, map(float, np.nanmean(rows, axis=0)), strict=True))
    return means | {"seconds_per_scene": seconds / len(rows)}


class Shaded:
    """The first turn of a ReshadedSet, kept on disk, in the form that `texnet train` uses."""

    def __init__(self, scenes, folder, report):
        self.paths = [folder / f"{i:04d}.npz" for i in range(scenes.count)]
        folder.mkdir(parents=True, exist_ok=True)
        for i, path in enumerate(self.paths):
            report(i, len(self), "shading")
            if not path.exists():
                scenes[i].save(path)

    def __len__(self):
        return len(self.paths)

    def __getitem__(self, i):
        return Record.load(self.paths[i])


def _network(part, args, library, report):
    """(network, number of scenes, number of draws, minutes of training) of a part."""
    if part == "scratch":
        scenes = ReshadedSet(args.cache, "train", args.scratch_scenes, library)
        scenes.make(progress=lambda n, of: report(n, of, "scenes"))
        folder = f"{scenes.folder.name}-{fingerprint(library.wavelength_um, library.emissivity)}"
        scenes = Shaded(scenes, args.cache / "shaded" / folder, report)
        lightning.seed_everything(0, verbose=False)
        steps = args.scratch_epochs * train.PER_EPOCH // train.TOGETHER
        module = train.Training(TeXNet(), steps)
        what = ["scratch", folder, args.scratch_scenes, args.scratch_epochs]
        train.fit(
            module, train.Draws(scenes, 0, train.SIDE), None,
            args.cache / "runs" / train.run_name(what), epochs=args.scratch_epochs,
            progress=report,
        )  # fmt: skip
        draws = args.scratch_epochs * train.PER_EPOCH
        return module.network.eval(), args.scratch_scenes, draws, module.seconds / 60
    network, _ = load_network(args.model)
    if part == "zero-shot":
        return network, 0, 0, 0.0
    cubes = []
    if part == "cubes":
        seen = ReshadedSet(args.cache, "validation", CUBES, library)
        seen.make(progress=lambda n, of: report(n, of, "scenes"))
        cubes = [seen.shade(i, *equidistant_bands(BANDS), NETD_K)[0] for i in range(CUBES)]
    network, history = recipe.finetune(
        network, library, args.cache, scenes=args.scenes, epochs=args.epochs, cubes=cubes,
        progress=report,
    )  # fmt: skip
    draws = args.epochs * recipe.PER_EPOCH
    return network, 0 if cubes else args.scenes, draws, history["minutes"]["training"]


def _seconds_per_scene(library):
    with tempfile.TemporaryDirectory() as folder:
        scenes = ReshadedSet(folder, "train", TIMED, library)
        start = time.perf_counter()
        scenes.make()
        return (time.perf_counter() - start) / TIMED


def run(part, args, library):
    """Make a part's network and measure it; keep both in args.out, with their provenance."""
    with progress_bar() as report:
        network, scenes, draws, minutes = _network(part, args, library, report)
        test = ReshadedSet(args.cache, "test", args.test_scenes, library)
        test.make(progress=lambda n, of: report(n, of, "test scenes"))
    tracing = scenes * _seconds_per_scene(library) if scenes else 0.0
    cost = {
        "draws": draws, "minutes_scenes": round(tracing / 60, 2),
        "minutes_training": round(minutes, 2),
    }  # fmt: skip
    save_network(network, args.out / f"{part}.safetensors", {"benchmark": part} | cost)
    rows = [
        {"part": part, "method": method, "test_scenes": args.test_scenes}
        | measure(network, test, method) | cost
        for method in NETS
    ]  # fmt: skip
    with whole_file(args.out / f"{part}.json") as path:
        made = {"made": settings(args.model), "rows": rows}
        path.write_text(json.dumps(made, indent=1), encoding="utf-8")


def table(out, model):
    """Write finetune.csv of all parts made by this code from a model, and return it as text."""
    paths = {p: out / f"{p}.json" for p in PARTS}
    done = {p: json.loads(f.read_text("utf-8")) for p, f in paths.items() if f.exists()}
    made = settings(model)
    others = [p for p, of in done.items() if of["made"] != made]
    rows = [row for of in done.values() if of["made"] == made for row in of["rows"]]
    write_csv(out / "finetune.csv", rows, made)
    lines = [f"{'part':10s} method   accuracy  entropy  T rmse K  texture r  draws  minutes"]
    for r in rows:
        minutes = f"{r['minutes_scenes']:.1f} + {r['minutes_training']:.1f}"
        lines.append(
            f"{r['part']:10s} {r['method']:7s}  {r['material_accuracy']:8.4f}"
            f"  {r['cross_entropy']:7.3f}  {r['temperature_rmse_k']:8.3f}"
            f"  {r['texture_correlation']:9.3f}  {r['draws']:5d}  {minutes}"
        )
    if others:
        lines.append(f"left out, from other code or another model: {', '.join(others)}")
    return "\n".join(lines)


def main(argv=None):
    p = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    p.add_argument("--out", type=Path, required=True, metavar="DIR")
    p.add_argument("--cache", type=Path, default=Path.home() / ".cache" / "texnet", metavar="DIR")
    p.add_argument("--model", type=Path, metavar="FILE", default=SHIPPED / WEIGHTS)
    p.add_argument("--parts", nargs="+", choices=PARTS, default=PARTS[:3], metavar="PART")
    p.add_argument("--scenes", type=int, default=recipe.SCENES)
    p.add_argument("--epochs", type=int, default=recipe.EPOCHS)
    p.add_argument("--scratch-scenes", type=int, default=train.SCENES)
    p.add_argument("--scratch-epochs", type=int, default=train.EPOCHS)
    p.add_argument("--test-scenes", type=int, default=TEST_SCENES)
    args = p.parse_args(argv)
    try:
        args.out.mkdir(parents=True, exist_ok=True)
        library = new_library()
        for part in args.parts:
            run(part, args, library)
    except (InputError, OSError) as e:
        print(f"finetune: error: {e}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print("finetune: stopped; run the same command again to resume.", file=sys.stderr)
        return 130
    print(table(args.out, args.model))
    return 0


if __name__ == "__main__":
    sys.exit(main())
