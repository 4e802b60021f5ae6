"""A library made from the cube alone against the exact one, on scenes not used for tuning it.

    python -m benchmarks.library_from_cube --out DIR

Scenes of `benchmarks.accuracy` in 54 bands. From each cube `physics.blind` makes a library, with
which the cube is decomposed, as it also is with the exact curves of the scene's own materials. The
materials found are matched with the true ones that have at least 1 % of the pixels so that most
pixels agree (Hungarian method). Writes

    scenes.csv     per scene: number of materials, purity (share of the pixels that have their
                   cluster's commonest true material) and adjusted Rand index over pixels
                   that neither takes for sky; T, the share of its errors within two sigmas, and
                   texture, with both libraries
    materials.csv  per matched material: its share, RMS error of e over bands, mean error of e,
                   and RMS error of e after subtracting the mean error

and prints them with their medians. Scenes without sky are refused, and reported.
"""

import numpy as np
from scipy.optimize import linear_sum_assignment
from sklearn.metrics import adjusted_rand_score

from benchmarks.accuracy import NETD_K, K, test_scenes
from benchmarks.arguments import arguments
from benchmarks.rows import write_csv
from physics.bands import equidistant_bands
from physics.blind import library_from_cube
from physics.errors import InputError
from physics.library import SKY, MaterialLibrary
from texnet.metrics import evaluate, non_sky
from texnet.pipeline import decompose

BANDS, METHODS, LEAST_SHARE = 54, ("local", "net+sgd"), 0.01
COMPARED = (
    "temperature_rmse_k", "temperature_mae_k", "within_2_sigma", "texture_correlation",
)  # fmt: skip


def of_scene(name, cube, truth, exact, found):
    """Row for the scene, rows for its materials; exact and found are libraries."""
    row = {"scene": name}
    for method in METHODS:
        for what, library in (("exact", exact), ("found", found)):
            answer = decompose(cube, library, method=method, k=K)
            metrics = evaluate(answer, truth)
            row |= {f"{metric}, {method}, {what}": metrics[metric] for metric in COMPARED}
            if (method, what) == (METHODS[0], "found"):
                clusters = answer
    ground = non_sky(clusters) & non_sky(truth)
    label, true = clusters.material[ground], np.array(truth.material_names)[truth.material[ground]]
    names, count = np.unique(true, return_counts=True)
    names = names[count >= LEAST_SHARE * truth.material.size]
    overlap = np.array([[(true == n) & (label == c) for c in range(len(found))] for n in names])
    overlap = overlap.sum(axis=2)
    pairs = [p for p in zip(*linear_sum_assignment(-overlap), strict=True) if overlap[p]]
    materials, curves = [], found.at(cube.wavelength_um)
    for i, c in pairs:
        error = curves[c] - exact.at(cube.wavelength_um)[exact.index(names[i])]
        materials.append({
            "scene": name, "material": names[i], "found": found.names[c],
            "share": np.mean(true == names[i]), "same_pixels": overlap[i, c] / overlap[i].sum(),
            "rms": np.sqrt(np.mean(error**2)), "mean": error.mean(), "rms_less_mean": error.std(),
        })  # fmt: skip
    counts = {
        "materials": len(names), "found": len(found) - 1,
        "purity": overlap.max(axis=0).sum() / overlap.sum(),
        "adjusted_rand": adjusted_rand_score(true, label),
    }  # fmt: skip
    return row | counts, materials


def main():
    args = arguments(__doc__, scenes=12)
    starter, scenes, materials = MaterialLibrary.starter(), [], []
    for name, traced in test_scenes(args.scenes):
        cube, truth = traced.shade(starter, *equidistant_bands(BANDS), NETD_K)
        try:
            found, _ = library_from_cube(cube)
        except InputError as e:
            print(f"{name}: {e}", flush=True)
            continue
        own = set(np.array(truth.material_names)[truth.material].ravel()) | {SKY}
        row, rows = of_scene(name, cube, truth, starter.subset(sorted(own)), found)
        scenes.append(row)
        materials += rows
        print({k: v if isinstance(v, str) else round(float(v), 3) for k, v in row.items()})
        for r in rows:
            errors = f"RMS {r['rms']:.3f} mean {r['mean']:+.3f}"
            print(f"    {r['material']:14} {r['found']:12} {errors} on {r['same_pixels']:.2f}")
        write_csv(args.out / "scenes.csv", scenes)
        write_csv(args.out / "materials.csv", materials)
    for rows, first in ((scenes, 1), (materials, 3)):
        for key in list(rows[0])[first:]:
            values = [r[key] for r in rows]
            print(f"{key:40} mean {np.nanmean(values):7.3f}  median {np.nanmedian(values):7.3f}")


if __name__ == "__main__":
    main()
