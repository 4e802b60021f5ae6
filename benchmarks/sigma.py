"""Could another sigma of T contain 68 % of the errors within one and 95 % within two?

    python -m benchmarks.sigma --out DIR [--bands N ...] [--scenes N]

Only if |error| / sigma has the shape of a Gaussian's: its 95.4 % quantile must be twice its 68.3 %
quantile. Scaling sigma does not change their ratio; another sigma may. Here boosted trees learn the
68.3 % quantile of |error| from all that the answers to a pixel and its eight neighbours say (sigma,
scatter of T, difference of T from neighbours of the same material, probabilities, residual ...), on
the first half of random scenes outside all splits, and are measured on the other half, beside the
sigma of `net+sgd`. Writes sigma.csv: per number of bands and sigma both quantiles, their ratio, and
the share within one sigma once it is scaled so that 95.4 % lie within two.
"""

import numpy as np
from sklearn.ensemble import HistGradientBoostingRegressor

from benchmarks import ONNX
from benchmarks.accuracy import NETD_K, SIZE, SPP, K
from benchmarks.arguments import arguments
from benchmarks.rows import write_csv
from physics.bands import equidistant_bands
from physics.library import MaterialLibrary
from physics.simulator import trace_scene
from physics.simulator.presets import preset
from texnet.metrics import non_sky
from texnet.pipeline import decompose
from texnet.runtime import Runtime

SEED = 6_000_000  # outside all splits; some were used for tuning
ONE, TWO = 0.6827, 0.9545  # of a Gaussian's errors within one sigma and two
LEAST_K = 1e-3  # smallest error, as its logarithm is learned


def features(d):
    """(n, height, width) features of a Decomposition that may indicate the error of T."""
    t = d.temperature_k.astype(np.float64)
    p = np.take_along_axis(d.material_probability, d.material[None].astype(np.int64), 0)[0]
    near = lambda a: np.lib.stride_tricks.sliding_window_view(
        np.pad(a, 1, mode="edge"), (3, 3)
    ).reshape(*a.shape, 9)
    of_same = near(d.material) == d.material[..., None]
    off = np.abs(near(t) - t[..., None])
    same_beside = np.delete(of_same, 4, axis=-1)
    mean = (near(t) * of_same).sum(-1) / of_same.sum(-1)
    return np.stack([
        d.temperature_sigma_k, near(d.temperature_sigma_k).min(-1),
        near(d.temperature_sigma_k).mean(-1), near(t).std(-1), off.max(-1),
        np.where(same_beside, np.delete(off, 4, axis=-1), np.inf).min(-1).clip(max=off.max(-1)),
        np.abs(t - mean), np.abs(t - np.median(near(t), -1)), same_beside.sum(-1), p,
        near(p).mean(-1), near(p).min(-1), d.residual, d.unknown,
    ])  # fmt: skip


def pixels(scenes, bands, model):
    """Yield features (pixels, n) and |error of T| (pixels,), K, for each of some traced scenes."""
    library = MaterialLibrary.starter()
    for traced in scenes:
        cube, truth = traced.shade(library, *equidistant_bands(bands), NETD_K)
        d = decompose(cube, k=K, model=model)
        ground = non_sky(truth)
        yield features(d)[:, ground].T, np.abs(d.temperature_k - truth.temperature_k)[ground]


def learned(x, error):
    """sigma(features), K: the 68.3 % quantile of |error|."""
    trees = HistGradientBoostingRegressor(loss="quantile", quantile=ONE, random_state=0)
    trees.fit(x, np.log(error + LEAST_K))
    return lambda x: np.exp(trees.predict(x))


def row(bands, name, error, sigma):
    one, two = np.quantile(error / sigma, [ONE, TWO])
    within = float((error <= two / 2 * sigma).mean())
    return {
        "bands": bands, "sigma": name, "quantile_68": one, "quantile_95": two, "ratio": two / one,
        "within_1_where_95_within_2": within,
    }  # fmt: skip


def main():
    args = arguments(__doc__, bands=(4, 54), scenes=48)
    library, model, scenes, rows = MaterialLibrary.starter(), Runtime(ONNX).run, [], []
    for seed in range(SEED, SEED + args.scenes):
        scenes.append(trace_scene(preset("random", seed), SIZE, SPP, seed, library))
        print(f"random {seed}", flush=True)
    for bands in args.bands:
        of = list(pixels(scenes, bands, model))
        first, second = (
            [np.concatenate(a) for a in zip(*half, strict=True)]
            for half in (of[: len(of) // 2], of[len(of) // 2 :])
        )
        x, error = second
        rows.append(row(bands, "net+sgd", error, x[:, 0]))
        rows.append(row(bands, "learned", error, learned(*first)(x)))
        write_csv(args.out / "sigma.csv", rows)
    for r in rows:
        print("  ".join(f"{n} {v:.3g}" if n != "sigma" else v for n, v in r.items()))


if __name__ == "__main__":
    main()
