"""Which method fits a time budget: the most accurate one that this machine runs fast enough.

`methods.csv` in texnet/data, measured by `texnet bench accuracy`, says how accurate each method is
in temperature, material and texture at several numbers of bands; the best method has the least sum
of ranks in the three. Speed depends on the machine: starting with the best, each method is run on
the middle of the cube, and once on the whole cube thinned out, to time what does not depend on
size, until one is fast enough.
"""

import csv
import math
import time
from dataclasses import replace
from functools import partial
from importlib.resources import files

import numpy as np

from physics.cube.hot import split_hot
from physics.cube.prepared import prepared
from physics.errors import InputError
from physics.estimate import USUAL_OBJECTS, estimate_environment

from .methods import NETS
from .pipeline import decompose

ERRORS = {"temperature_rmse_k": False, "material_accuracy": True, "texture_correlation": True}
MEASURED = files("texnet") / "data" / "methods.csv"
# side, pixels, of the picture for the first run, which loads, compiles and times the fixed costs,
# and of the one that is timed
WARM, CROP = 64, 256


def choose(cube, library, k, budget, model_of, progress=None):
    """The most accurate method within a budget -> its name, the expected seconds per megapixel.

    k         as in `decompose`
    budget    seconds per megapixel
    model_of  a method's name -> its model, as in `decompose`
    progress  as in `decompose`

    Raises InputError with the time of the fastest method if none fits.
    """
    start = time.perf_counter()
    cube, _, _ = split_hot(prepared(cube, library).cube)  # the middle may be all hot
    before = time.perf_counter() - start
    whole = isinstance(k, (int, np.integer))
    objects = k if whole else min(USUAL_OBJECTS, cube.measured_count)
    for _ in range(2):  # the first time loads
        start = time.perf_counter()
        environment = estimate_environment(cube, library, objects)
        once = (before + time.perf_counter() - start) / (cube.shape[0] * cube.shape[1])

    few = thinned(cube, WARM)

    def seconds(method):
        run = partial(decompose, library=library, method=method, model=model_of(method))
        for _ in range(2):  # the first time loads
            d = run(few, k=min(k, few.measured_count) if whole else k, progress=progress)
        # which samples as many pixels of these as of the whole cube
        calibration = d.seconds["calibration"] / (cube.shape[0] * cube.shape[1])
        if not whole:  # the objects are counted, too
            calibration += d.seconds["environment"] / (cube.shape[0] * cube.shape[1])
        part = middle(cube, CROP)
        start = time.perf_counter()
        d = run(part, environment=environment, progress=progress)
        took = time.perf_counter() - start - d.seconds["calibration"]  # of a given environment
        took /= part.shape[0] * part.shape[1]
        return 1e6 * (once + calibration + took)

    methods = best_first(cube.bands)
    if len(library) < 2:  # the network chooses between materials
        methods = [method for method in methods if method not in NETS]
    return first_within(budget, methods, seconds, cube.shape[0] * cube.shape[1] / 1e6)


def best_first(bands):
    """Names of methods, most accurate first, as measured at the nearest number of bands."""
    lines = MEASURED.read_text(encoding="utf-8").splitlines()
    rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    measured = {int(r["bands"]) for r in rows}
    nearest = min(measured, key=lambda n: abs(math.log(n / bands)))
    of = [r for r in rows if int(r["bands"]) == nearest]
    ranks = dict.fromkeys((r["method"] for r in of), 0)
    for name, more_is_better in ERRORS.items():
        ordered = sorted(of, key=lambda r, name=name: float(r[name]), reverse=more_is_better)
        for rank, r in enumerate(ordered):
            ranks[r["method"]] += rank
    return sorted(ranks, key=ranks.get)


def first_within(budget, methods, seconds, megapixels):
    """The first method with seconds(method) <= budget, per megapixel, and these seconds; else
    raises InputError."""
    took = {}
    for method in methods:
        took[method] = seconds(method)
        if took[method] <= budget:
            return method, took[method]
    fastest = min(took, key=took.get)
    raise InputError(
        f"--budget: no method takes {budget:g} s per megapixel or less on this cube and machine; "
        f"the fastest, {fastest}, takes {took[fastest]:.1f}, {took[fastest] * megapixels:.2g} s in "
        "all (a small cube takes more per megapixel than a large one)."
    )


def thinned(cube, side):
    """A HeatCube of every nth row and column, at least side of each, if there are as many."""
    return _part(cube, *(slice(None, None, max(1, n // side)) for n in cube.shape))


def middle(cube, side):
    """The middle of a HeatCube, at most side x side pixels."""
    first = [max(0, (n - side) // 2) for n in cube.shape]
    return _part(cube, *(slice(i, i + side) for i in first))


def _part(cube, rows, columns):
    dead = cube.dead[rows, columns]
    part = cube.radiance[:, rows, columns].copy()
    return replace(cube, radiance=part, dead=None if dead.all() else dead)
