"""What each part of the network and of its loss earns: short trainings, one change each.

    python -m benchmarks.ablation --out DIR [--cache DIR] [--epochs N]

Every variant is trained alike on the scenes of `texnet train`, for a few epochs (4 of 30), and
measured on the validation scenes, the network alone: cross entropy, accuracy, T RMSE. Costs are
parameters, and multiply-adds per pixel of the convolutions. Writes ablation.csv and
ablation.png; what is done is kept, so a stopped run goes on.
"""

import argparse
import json
from pathlib import Path

import pytorch_lightning as lightning

from benchmarks.rows import write_csv
from texnet.network import DILATIONS, TeXNet
from training import train
from training.scenes import SceneSet

VARIANTS = {
    "as shipped": {},
    "width 24": {"width": 24},
    "width 72": {"width": 72},
    "no messages": {"messages": 0},
    "one 3 x 3 layer": {"dilations": DILATIONS[:1]},
    "supervised only": {"terms": "supervised"},
    "physics only": {"terms": "physics"},
}
EPOCHS, PER_EPOCH, SEED = 4, 320, 0


def measure(name, sets, cache, epochs):
    """Train one variant -> a dict of its costs and validation metrics."""
    change = dict(VARIANTS[name])
    terms = change.pop("terms", "both")
    lightning.seed_everything(SEED, verbose=False)
    network = TeXNet(**change)
    module = train.Training(network, epochs * PER_EPOCH // train.TOGETHER, terms)
    what = dict(variant=name, epochs=epochs, data=sets[0].folder.name)
    train.fit(
        module, train.Draws(sets[0], SEED, train.SIDE), None,
        cache / "runs" / train.run_name(what), epochs=epochs, per_epoch=PER_EPOCH,
    )  # fmt: skip
    module.terms = "both"  # all are measured alike
    draws = train.Draws(sets[1], train.VALIDATION_SEED)
    metrics = [module.eval().measures(*draws[i]) for i in range(len(sets[1]))]
    return {
        "variant": name,
        "parameters": sum(p.numel() for p in network.parameters()),
        "multiply_adds_per_pixel": sum(
            p.numel() for n, p in network.named_parameters() if p.ndim == 4
        ),
        **{n: sum(float(m[n]) for m in metrics) / len(metrics) for n in metrics[0]},
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--cache", type=Path, default=Path.home() / ".cache" / "texnet")
    parser.add_argument("--epochs", type=int, default=EPOCHS)
    parser.add_argument("--variants", nargs="+", choices=VARIANTS, default=list(VARIANTS))
    args = parser.parse_args()
    args.out.mkdir(parents=True, exist_ok=True)
    sets = [
        SceneSet(args.cache, "train", train.SCENES),
        SceneSet(args.cache, "validation", train.VALIDATION_SCENES),
    ]
    for s in sets:
        s.make()
    rows = []
    for name in args.variants:
        kept = args.out / f"{name}.json"
        if not kept.exists():
            kept.write_text(json.dumps(measure(name, sets, args.cache, args.epochs)))
        rows.append(json.loads(kept.read_text()))
        print(json.dumps(rows[-1]), flush=True)
    write_csv(args.out / "ablation.csv", rows)
    _draw(rows, args.out / "ablation.png")


def _draw(rows, path):
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, axis = pyplot.subplots(figsize=(6, 4), layout="constrained")
    for r in rows:
        axis.plot(r["multiply_adds_per_pixel"], r["cross_entropy"], "o")
        axis.annotate(
            f" {r['variant']} ({r['parameters'] / 1e3:.0f} k)",
            (r["multiply_adds_per_pixel"], r["cross_entropy"]), fontsize=8,
        )  # fmt: skip
    axis.set(
        xscale="log", xlabel="multiply-adds per pixel", ylabel="validation cross entropy (nats)"
    )
    figure.savefig(path, dpi=110)


if __name__ == "__main__":
    main()
