"""How answers change under skies that do not follow our own model's profiles.

    python -m benchmarks.other_skies --out DIR

The random test scenes of `benchmarks.accuracy` that have a sky, each shaded twice: under the sky of
its own atmosphere (`physics.sky`) and under that of the LOWTRAN 7 standard atmosphere with the
nearest air temperature, all of it warmed by as much as its horizon is colder than the scene's air
(`data/lowtran7_skies.csv`, by `benchmarks.lowtran7`). These have their own profiles of temperature,
vapour and ozone, one with an inversion. Writes other_skies.csv and prints the means.
"""

import csv
from pathlib import Path

import numpy as np

from benchmarks import ONNX
from benchmarks.accuracy import ERRORS, NETD_K, SCENES, measure, test_scenes
from benchmarks.arguments import arguments
from benchmarks.rows import write_csv
from benchmarks.threads import THREADS, on_two_threads
from physics.bands import equidistant_bands
from physics.library import MaterialLibrary
from physics.planck import planck
from physics.sky import air_mass
from texnet.runtime import Runtime

SKIES = Path(__file__).parent / "data" / "lowtran7_skies.csv"
BANDS, METHODS = (4, 9, 54), ("local", "net+sgd")


def lowtran7():
    """Wavelengths (n,) in um, and columns (n,) by climate and by zenith angle in degrees, or 1 km:
    brightness temperature, K, and transmittance."""
    with open(SKIES, newline="", encoding="utf-8") as file:
        names, *rows = csv.reader(file)
    wavelength_um, *columns = np.array(rows, float).T
    skies = {}
    for name, column in zip(names[1:], columns, strict=True):
        climate, what = name.split(", ")
        skies.setdefault(climate, {})[what] = column
    return wavelength_um, skies


def nearest_sky(air_k):
    """(wavelength_um, cos_zenith) -> radiance, for the climate whose horizon is nearest to air_k,
    warmed to match it."""
    w, skies = lowtran7()
    angles = [angle for angle in next(iter(skies.values())) if angle != "1 km"]
    mass = np.log(air_mass(np.cos(np.radians([float(angle) for angle in angles]))))
    horizon = {climate: sky[angles[-1]].max() for climate, sky in skies.items()}
    climate = min(horizon, key=lambda c: abs(horizon[c] - air_k))
    kelvins = np.array([skies[climate][angle] for angle in angles]) + air_k - horizon[climate]

    def sky(wavelength_um, cos_zenith):
        at_bands = np.array([np.interp(wavelength_um, w, k) for k in kelvins])
        at = np.interp(np.log(air_mass(cos_zenith)), mass, np.arange(len(mass)))
        low = np.minimum(at.astype(int), len(mass) - 2)
        part = (at - low)[:, None]
        return planck(wavelength_um, (1 - part) * at_bands[low] + part * at_bands[low + 1])

    return sky


def main():
    args = arguments(__doc__, scenes=SCENES)
    on_two_threads()
    models, library, rows = {"net+sgd": Runtime(ONNX, THREADS).run}, MaterialLibrary.starter(), []
    for name, traced in test_scenes(args.scenes):
        if traced.atmosphere is None:
            continue
        other = nearest_sky(traced.atmosphere.air_temperature_k)
        for bands in BANDS:
            w, fwhm = equidistant_bands(bands)
            for sky, of in (("own", None), ("LOWTRAN 7", other)):
                cube, truth = traced.shade(library, w, fwhm, NETD_K, sky=of)
                for method in METHODS:
                    row = {"scene": name, "bands": bands, "sky": sky, "method": method}
                    scores, _ = measure(cube, truth, method, models.get(method))
                    rows.append(row | scores)
        write_csv(args.out / "other_skies.csv", rows)
        print(name, flush=True)
    shown = *ERRORS, "within_2_sigma"
    print(", ".join(("bands", "method", "sky", *shown)))
    for bands in BANDS:
        for method in METHODS:
            for sky in ("own", "LOWTRAN 7"):
                of = [
                    r for r in rows if (r["bands"], r["method"], r["sky"]) == (bands, method, sky)
                ]
                means = "  ".join(f"{np.nanmean([r[e] for r in of]):7.3f}" for e in shown)
                print(f"{bands:3d} {method:8} {sky:10} {means}")


if __name__ == "__main__":
    main()
