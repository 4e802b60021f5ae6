"""How accurately is the camera's noise estimated if it is not stated?

    python -m benchmarks.netd --out DIR

Random scenes of the test split, as in `accuracy`, with several numbers of bands and NETD: the
estimate of `physics.cube.netd` from the cube, divided by the sensor's true NETD. Writes netd.csv,
one row per cube, and prints the least, median and largest ratio for each number of bands.
"""

from dataclasses import replace

import numpy as np

from benchmarks.accuracy import test_scenes
from benchmarks.arguments import arguments
from benchmarks.rows import write_csv
from physics.bands import equidistant_bands
from physics.library import MaterialLibrary

SCENES, BANDS, NETDS_K = 12, (1, 2, 3, 4, 6, 8, 18, 54, 100), (0.02, 0.05, 0.2, 1.0)


def main():
    args = arguments(__doc__, scenes=SCENES)
    library, rows = MaterialLibrary.starter(), []
    for name, traced in test_scenes(args.scenes):
        for bands in BANDS:
            for netd_k in NETDS_K:
                cube, _ = traced.shade(library, *equidistant_bands(bands), netd_k)
                found = replace(cube, netd_k=None).with_netd().netd_k
                rows.append(
                    {"scene": name, "bands": bands, "netd_k": netd_k, "ratio": found / netd_k}
                )
        print(name, flush=True)
        write_csv(args.out / "netd.csv", rows)
    print("bands" + "".join(f"{f'{k:g} K':>20}" for k in NETDS_K))
    for bands in BANDS:
        of = [
            [r["ratio"] for r in rows if (r["bands"], r["netd_k"]) == (bands, k)] for k in NETDS_K
        ]
        said = (f"{min(a):.2f} {np.median(a):.2f} {max(a):.2f}" for a in of)
        print(f"{bands:5d}" + "".join(f"{text:>20}" for text in said))


if __name__ == "__main__":
    main()
