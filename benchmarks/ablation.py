"""What each part of the network and of its loss contributes: short trainings, one change each.

    python -m benchmarks.ablation --out DIR [--cache DIR] [--epochs N] [--variants NAME ...]

All variants see the same draws of the scenes of `texnet train`, in one run, for a fifth of its
epochs, and are measured on the validation scenes, the network alone: cross entropy, accuracy,
T RMSE, each a mean over two seeds. `seeds` is half the difference in cross entropy between the
seeds, `standard_error` that of the difference to the first variant (the shipped form, unless others
are named) over the scenes. Costs are parameters, and multiply-adds per pixel of the convolutions.
Writes ablation.csv, ablation.png and the weights of the first seed, VARIANT.safetensors, for
`texnet bench chart --network`; a stopped run resumes from its last epoch.
"""

import argparse
from pathlib import Path

import numpy as np
import pytorch_lightning as lightning
import torch
from matplotlib.figure import Figure

from benchmarks.rows import write_csv
from physics.machinery.whole_file import whole_file
from texnet.files.weights import save_network
from texnet.network import TeXNet
from texnet.progress import progress_bar
from training import train
from training.scenes import SceneSet

VARIANTS = {
    "width 48": {},  # the shipped form
    "width 24": {"width": 24},
    "width 16": {"width": 16},
    "cells of 4 x 4": {"stride": 4, "dilations": (1, 2, 1)},
    "one 3 x 3 layer": {"dilations": (1,)},
    "no messages": {"messages": 0},
    "supervised only": {"terms": "supervised"},
    "physics only": {"terms": "physics"},
}
EPOCHS, SEEDS = 12, (0, 1)
OFF_SCALE = 2.0  # nats


class Together(train.Training):
    """Trainings that see the same draws, each independent of the others."""

    def __init__(self, trainings, steps):
        super().__init__(torch.nn.ModuleDict(trainings), steps)

    def loss(self, sample, s):
        return sum(t.loss(sample, s) for t in self.network.values())

    def configure_gradient_clipping(self, optimizer, gradient_clip_val, **_):
        for t in self.network.values():
            torch.nn.utils.clip_grad_norm_(t.parameters(), gradient_clip_val)


def compare(out, cache, epochs, variants=tuple(VARIANTS), progress=None):
    """Train variants, write weights into out -> a row of costs and validation metrics for each."""
    sets = [
        SceneSet(cache, "train", train.SCENES),
        SceneSet(cache, "validation", train.VALIDATION_SCENES),
    ]
    for s in sets:
        s.make()
    trainings = {}
    steps = epochs * train.PER_EPOCH // train.TOGETHER
    for name in variants:
        change = VARIANTS[name]
        of_network = {n: v for n, v in change.items() if n != "terms"}
        for seed in SEEDS:
            lightning.seed_everything(seed, verbose=False)
            trainings[f"{name}, seed {seed}"] = train.Training(
                TeXNet(**of_network), steps, change.get("terms", "both")
            )
    what = dict(variants={name: VARIANTS[name] for name in variants}, seeds=SEEDS, epochs=epochs)
    what["data"] = sets[0].folder.name
    train.fit(
        Together(trainings, steps), train.Draws(sets[0], SEEDS[0], train.SIDE), None,
        cache / "runs" / train.run_name(what), epochs=epochs, progress=progress,
    )  # fmt: skip
    draws = train.Draws(sets[1], train.VALIDATION_SEED)
    metrics = {name: [] for name in trainings}
    for i in range(len(sets[1])):
        sample, s = draws[i]
        for name, t in trainings.items():
            t.eval().terms = "both"  # all are measured alike
            with torch.no_grad():
                metrics[name].append({n: float(v) for n, v in t.measures(sample, s).items()})
    of_seeds = lambda name: [metrics[f"{name}, seed {seed}"] for seed in SEEDS]
    network = lambda name: trainings[f"{name}, seed {SEEDS[0]}"].network
    for name in variants:
        save_network(network(name), out / f"{name}.safetensors", what | {"variant": name})
    return [_row(n, network(n), of_seeds(n), of_seeds(variants[0])) for n in variants]


def _row(name, network, metrics, first):
    entropy = lambda m: np.array([[scene["cross_entropy"] for scene in seed] for seed in m])
    more = (entropy(metrics) - entropy(first)).mean(0)
    return {
        "variant": name,
        "parameters": sum(p.numel() for p in network.parameters()),
        "multiply_adds_per_pixel": _multiply_adds(network),
        **{n: float(np.mean([m[n] for s in metrics for m in s])) for n in metrics[0][0]},
        "seeds": float(np.ptp(entropy(metrics).mean(1)) / 2),
        "standard_error": float(more.std(ddof=1) / len(more) ** 0.5),
    }


def _multiply_adds(network):
    """Of the convolutions, per pixel."""
    size = lambda module: sum(p.numel() for p in module.parameters() if p.ndim == 4)
    return size(network) - size(network.trunk) * (1 - network.config["stride"] ** -2)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--cache", type=Path, default=Path.home() / ".cache" / "texnet")
    parser.add_argument("--epochs", type=int, default=EPOCHS)
    parser.add_argument("--variants", nargs="+", choices=VARIANTS, default=list(VARIANTS))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    with progress_bar() as report:
        rows = compare(args.out, args.cache, args.epochs, args.variants, report)
    for row in rows:
        print(row, flush=True)
    write_csv(args.out / "ablation.csv", rows)
    _draw(rows, args.out / "ablation.png")


def _draw(rows, path):
    figure = Figure(figsize=(10, 4.2), layout="constrained")
    axes = figure.subplots(1, 2, sharey=True)
    costs = {"parameters": "parameters", "multiply_adds_per_pixel": "multiply-adds per pixel"}
    for axis, (cost, label) in zip(axes, costs.items(), strict=True):
        for i, r in enumerate(rows):
            said = f"{i + 1}  {r['variant']}: {r['cross_entropy']:.2f}"
            if r["cross_entropy"] > OFF_SCALE:
                axis.plot([], [], " ", label=f"{said}, off the scale")
                continue
            at = r[cost], r["cross_entropy"]
            axis.errorbar(*at, r["seeds"], fmt="o", capsize=2, color=f"C{i % 10}",
                          label=said)  # fmt: skip
            axis.annotate(i + 1, at, xytext=(4, 4), textcoords="offset points", fontsize=9)
        axis.set(xscale="log", xlabel=label)
    axes[0].set(ylabel="validation cross entropy (nats)")
    figure.legend(*axes[1].get_legend_handles_labels(), loc="outside right center", fontsize=8,
                  title="nats")  # fmt: skip
    with whole_file(path) as part:
        figure.savefig(part, dpi=110)


if __name__ == "__main__":
    main()
