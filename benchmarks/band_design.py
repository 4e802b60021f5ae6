"""Designed filters against equidistant ones, on scenes used for neither.

    python -m benchmarks.band_design --out DIR

`physics.filters` designs N = 3, 4, 6 and 9 filters for the starter library. Some scenes of
`benchmarks.accuracy` are path-traced once and shaded through these, through N contiguous filters,
and through N equidistant ones as wide as the designed; noise by the same law, k = 5 objects
estimated from the noisy cube. Writes band_design.csv, one row per scene, filters and method, and
bands.png; prints means, and the gain of the design over each of the others with its standard error
over the scenes: over all, and over those where all filters detected the sky that is there.
"""

import numpy as np
from matplotlib.figure import Figure

from benchmarks.accuracy import K, test_scenes
from benchmarks.arguments import arguments
from benchmarks.colours import BLUE, GREEN, VERMILLION
from benchmarks.rows import write_csv
from physics.bands import equidistant_bands
from physics.filters import HIGH_UM, LOW_UM, NETD_K, design_filters
from physics.library import MaterialLibrary
from physics.machinery.whole_file import whole_file
from texnet.metrics import evaluate, non_sky
from texnet.pipeline import decompose

COUNTS, METHODS = (3, 4, 6, 9), ("local", "net+sgd")
DESIGNED, SIDE_BY_SIDE, AS_WIDE = "designed", "side by side", "equidistant, as wide"
SHOWN = {
    "material_accuracy": "right material",
    "temperature_rmse_k": "T off by (RMS, K)",
    "temperature_mae_k": "T off by (mean, K)",
    "texture_correlation": "sky-lit texture, correlation",
}
STYLE = {DESIGNED: (VERMILLION, "o"), SIDE_BY_SIDE: (BLUE, "s"), AS_WIDE: (GREEN, "^")}


def filter_sets(library):
    """{N: {name: (centres, widths)}} in um."""
    sets = {}
    for n in COUNTS:
        best = design_filters(library, n)
        half = best.fwhm_um[0] / 2
        sets[n] = {
            DESIGNED: (best.wavelength_um, best.fwhm_um),
            SIDE_BY_SIDE: equidistant_bands(n, LOW_UM, HIGH_UM),
            AS_WIDE: (np.linspace(LOW_UM + half, HIGH_UM - half, n), best.fwhm_um),
        }
    return sets


def table(rows):
    """Lines of text: per N, method and metric the means, and the gains."""
    lost = {r["scene"] for r in rows if r["sky_found"] != r["sky_in_view"]}
    yield f"The sky was missed, or seen where none is, in {', '.join(sorted(lost)) or 'none'}."
    for what, of in (
        ("all scenes", rows), ("the others", [r for r in rows if r["scene"] not in lost])
    ):  # fmt: skip
        yield what
        yield f"{'N':>2} {'method':8} {'':28}" + "".join(f"{name:>22}" for name in STYLE)
        for n in COUNTS:
            for method in METHODS:
                for metric, label in SHOWN.items():
                    columns = [_column(of, n, method, name, metric) for name in STYLE]
                    means = "".join(f"{c.mean():22.3f}" for c in columns)
                    yield f"{n:2d} {method:8} {label:28}{means}"
                    more = [columns[0] - other for other in columns[1:]]
                    yield f"{'gain':>62}" + "".join(
                        f"{m.mean():13.3f} ±{m.std(ddof=1) / len(m) ** 0.5:7.3f}" for m in more
                    )


def _column(rows, n, method, name, metric):
    of = [r for r in rows if (r["filters"], r["method"], r["set"]) == (n, method, name)]
    return np.array([r[metric] for r in of if np.isfinite(r[metric])])  # a room has no texture


def draw(rows, sets, path):
    """Positions of the designed filters, and the results of each set of filters."""
    figure = Figure((9.5, 7.4), dpi=95, layout="constrained")
    axes = figure.subplots(2, 2).ravel()
    _draw_filters(axes[0], sets)
    for axis, metric in zip(
        axes[1:], ("material_accuracy", "temperature_mae_k", "texture_correlation"), strict=True
    ):
        for shift, (name, (colour, marker)) in zip((-0.1, 0, 0.1), STYLE.items(), strict=True):
            for method, line in zip(METHODS, (":", "-"), strict=True):
                means = [_column(rows, n, method, name, metric).mean() for n in COUNTS]
                said = f"{name}, {method}"
                at = np.add(COUNTS, shift)  # equal ones side by side
                axis.plot(at, means, line, color=colour, marker=marker, label=said)
        axis.set(xlabel="filters", ylabel=SHOWN[metric], xticks=COUNTS)
        axis.grid(alpha=0.3)
    figure.legend(
        *axes[1].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=9
    )
    with whole_file(path) as part:
        figure.savefig(part)


def _draw_filters(axis, sets):
    for row, n in enumerate(COUNTS):
        for j, (name, (colour, _)) in enumerate(STYLE.items()):
            centres, widths = sets[n][name]
            y = row + 0.27 * (1 - j)
            # overlapping filters are distinguished by their centres
            axis.barh(y, widths, 0.2, centres - widths / 2, color=colour, alpha=0.25)
            axis.plot(centres, np.full(n, y), "|", color=colour, markersize=9, label=name)
    handles, labels = axis.get_legend_handles_labels()
    axis.legend(
        handles[: len(STYLE)], labels[: len(STYLE)], fontsize=8, ncols=3, loc="upper center",
        columnspacing=1, handletextpad=0.2,
    )  # fmt: skip
    axis.set(xlabel="wavelength (µm)", ylabel="filters", yticks=range(len(COUNTS)),
             yticklabels=COUNTS, xlim=(LOW_UM, HIGH_UM), ylim=(-0.5, len(COUNTS)))  # fmt: skip


def main():
    args = arguments(__doc__, scenes=12)
    library, rows = MaterialLibrary.starter(), []
    sets = filter_sets(library)
    for scene, traced in test_scenes(args.scenes):
        for n in COUNTS:
            for name, (centres, widths) in sets[n].items():
                netd_k = NETD_K / widths[0]
                cube, truth = traced.shade(library, centres, widths, netd_k)
                for method in METHODS:
                    answer = decompose(cube, method=method, k=K)
                    row = {
                        "scene": scene, "filters": n, "set": name, "method": method,
                        "netd_k": netd_k, "sky_in_view": not non_sky(truth).all(),
                        "sky_found": bool(answer.sky),
                    }  # fmt: skip
                    rows.append(row | evaluate(answer, truth))
        print(scene, flush=True)
        write_csv(args.out / "band_design.csv", rows)
    print("\n".join(table(rows)))
    draw(rows, sets, args.out / "bands.png")


if __name__ == "__main__":
    main()
