"""The four methods: how the pixels of a cube are solved in a known environment.

net, net+sgd   evidence -> network -> refinement and texture (`model`)
local, sgd     exact local solution of every pixel and material -> semi-global refinement ->
               distilled texture, with the uncertainty of each part (`solver`)
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import NamedTuple, Protocol

import numpy as np

from physics.expected import only
from physics.known import MAX_T, known_arrays
from physics.planck import brightness_temperature

from .uncertainty import OWN_CURVES

NETS = "net", "net+sgd"
METHODS = "local", "sgd", *NETS
WEIGHTS, ONNX = "texnet.safetensors", "texnet.onnx"  # in texnet/data: the network that ships


class Look(NamedTuple):
    """answer(environment, cube, seen): maps by name, as in `model.TeX`, of the pixels of a HeatCube
    in an Environment, restricted to the library's materials with the ascending indices seen. Log
    evidence is comparable between answers of one Look, but not between two Looks.

    at_once  how many calls may run at a time, in threads, once the first has returned
    """

    answer: Callable
    at_once: int = 1

    def __call__(self, environment, cube, seen):
        return self.answer(environment, cube, seen)


class Run(Protocol):
    """The final answer, maps by name as of a Look, with progress. Materials are weighted as
    expected (physics.expected.Expected) and limited, in each of the picture's Regions, to those
    held there. lap(stage) is called after each stage."""

    def __call__(self, environment, cube, seen, expected=None, regions=None, *, lap): ...


class Method(NamedTuple):
    """looks() makes a new Look, by net+sgd or local, for finding the circumstances and the glance;
    expects: whether run uses what is expected."""

    looks: Callable[[], Look]
    run: Run
    expects: bool


def by_network(library, model, refined=True, progress=None):
    """The Method net+sgd for a MaterialLibrary, or net if not refined; model as in
    `pipeline.decompose`, progress(done, total)."""
    # model may be a method of an object with this attribute, such as export.Runtime
    at_once = getattr(getattr(model, "__self__", None), "at_once", 1)

    def known_of(environment, cube, seen):
        return only(known_arrays(cube, library, environment), seen)

    def answer(known, cube, model, *how):
        maps = model(cube.radiance, known, *how)
        return maps | {"temperature_sigma_k": _cut_off(maps, known["prior_k"], cube)}

    def looks():
        basis = None  # the first call's serves all: evidence under another is not comparable

        def look(environment, cube, seen):
            nonlocal basis
            known = known_of(environment, cube, seen)
            known["basis"] = basis = known["basis"] if basis is None else basis
            return answer(known, cube, model)

        return Look(look, at_once)

    def run(environment, cube, seen, expected=None, regions=None, *, lap):
        of = model if refined else partial(model, refined=False)
        maps = answer(known_of(environment, cube, seen), cube, of, progress, expected, regions)
        lap("network")
        return maps

    return Method(looks, run, expects=True)


def by_solver(library, smooth, report):
    """The Method local for a MaterialLibrary, or sgd if smooth; report(what) gives a
    progress(done, total) or None."""
    import numba  # which takes a second to load

    from .solver import solve_each, solve_smooth

    def there(seen):
        return library.subset([library.names[i] for i in seen])

    def look(environment, cube, seen):
        return solve_each(cube, there(seen), environment)

    def run(environment, cube, seen, expected=None, regions=None, *, lap):
        off = OWN_CURVES * environment.curve_spread
        environment = replace(environment, curve_spread=off)
        if smooth:
            return solve_smooth(cube, there(seen), environment, expected, report, lap)
        maps = solve_each(cube, there(seen), environment, expected, regions, report("local"))
        lap("local")
        return maps

    return Method(lambda: Look(look, numba.get_num_threads()), run, expects=False)


def _cut_off(maps, prior_k, cube):
    """(height, width) sigma of T; where T was clipped, at least the distance to the pixel's
    brightness temperature in the HeatCube."""
    t, sigma, (usual, spread) = maps["temperature_k"], maps["temperature_sigma_k"], prior_k
    cut = np.abs(t - usual) > 0.999 * MAX_T * spread
    if not cut.any():
        return sigma
    looks = brightness_temperature(cube.wavelength_um[:, None], cube.radiance[:, cut]).max(axis=0)
    sigma = sigma.copy()
    sigma[cut] = np.maximum(sigma[cut], np.abs(looks - t[cut]))
    return sigma
