"""What is found before any pixel is solved: the environment that lights the scene, and errors of
the camera and of the air before it.

Bad bands are left out. The noise and the wavelengths are corrected if the cube, or the sky's ozone,
shows other values than stated (`physics.cube.prepared`). Then, in this order: the environment, from
the cube; a sky that is not in view, if nothing else explains the pixels, and the camera's
wavelengths, gains or offset or the air before it, if these explain them, or curve errors, if half
of the materials call for them, or more noise, if nothing fits (`camera.calibration`); how much of
that air is before each pixel (`camera.distances`); the environment again, from the corrected cube;
and how much of its light is the sky's (`physics.lighting`).
"""

from dataclasses import replace
from functools import cache, partial
from typing import NamedTuple

import numpy as np

from physics.cube.heat_cube import HeatCube
from physics.cube.hot import split_hot
from physics.cube.prepared import Prepared, prepared
from physics.cube.saturation import saturated
from physics.environment import Environment
from physics.estimate import USUAL_OBJECTS, Sample, completed, estimate_environment
from physics.lighting import as_lit
from physics.machinery.blas import no_blas_threads
from physics.sky import Atmosphere

from .camera.calibration import calibration
from .camera.correction import Calibration, corrected
from .camera.distances import distances
from .camera.given_environment import error_of_given
from .camera.missing_sky import missing_sky
from .camera.mistaken_sky import LITTLE, mistaken_sky
from .camera.pixels import LEAST_OBJECTS
from .progress import compiling


class Circumstances(NamedTuple):
    """ready                Prepared, at the wavelengths found, but not otherwise corrected
    saturated, left_out  (height, width) bool: saturated pixels; pixels that say nothing of camera
                         and lighting: saturated, dead or far hotter than the others
    cube                 HeatCube as a perfect camera with no air before it would have shown it
    environment          its Environment
    assumed_air          Atmosphere of its sky, if that is not in view; else None
    environment_error_k  K by which a given environment is probably off, as allowed for here
    found                Calibration with which cube was corrected
    distance_m           (height, width) m of its Air before each pixel; None without air
    given                whether the whole environment was given, and none of it found in the cube
    """

    ready: Prepared
    saturated: np.ndarray
    left_out: np.ndarray
    cube: HeatCube
    environment: Environment
    assumed_air: Atmosphere | None
    environment_error_k: float
    found: Calibration
    distance_m: np.ndarray | None
    given: bool


@no_blas_threads()
def circumstances(
    cube, library, looks, *, k=None, environment=None, seed=0, lap=None, progress=None
):  # fmt: skip
    """The Circumstances of a HeatCube for a MaterialLibrary.

    looks        as in a `methods.Method`
    k, environment, seed  as in `pipeline.decompose`, the environment at the cube's bands
    progress     called as progress(done, total, what) while numba compiles the object count
    lap          lap(stage) is called after each stage

    Raises InputError if the library does not cover the bands, or the environment cannot be the
    cube's.
    """
    lap = lap or (lambda stage: None)
    ready = prepared(cube, library)
    given = environment is not None and len(environment.sky) < len(environment)
    if environment is not None:
        environment = _at_true_bands(environment, cube, ready, library, seed)
    beyond = saturated(ready.cube)
    lap("bands")
    split = split_hot(ready.cube)
    left_out = ready.cube.dead | beyond | split.hot
    how = dict(looks=looks, library=library, left_out=left_out)
    if environment is None:
        parts = _with_estimated(ready, split, k, seed, how, lap, progress)
    else:
        parts = _with_given(ready, split.cold, environment, given, how, lap)
    of = Circumstances(saturated=beyond, left_out=left_out, given=given, **parts)
    environment = as_lit(
        of.environment, of.cube, library, left_out,
        error_k=of.environment_error_k, objects=None if given else of.environment.sky,
        curves=of.found.curves,
    )  # fmt: skip
    lap("calibration")
    return of._replace(environment=environment)


def _at_true_bands(given, cube, ready, library, seed):
    """An Environment given at a HeatCube's bands, reduced to the bands used, at the wavelengths
    found for them; if it is all sky, with the other objects added."""
    given = given.only(np.isin(cube.wavelength_um, ready.stated_um))
    given = replace(given, wavelength_um=ready.cube.wavelength_um)
    given.check(ready.cube)
    return completed(given, ready.cube, library, seed)


def _with_given(ready, cold, environment, given, how, lap):
    """The fields of Circumstances for a Prepared in an Environment that was given, all of it or its
    sky. cold is its cube without far hotter pixels; how holds `calibration`'s other arguments."""
    lap("environment")
    found, error_k = error_of_given(cold, environment, None if given else environment.sky, **how)
    return dict(
        ready=ready, cube=ready.cube if found.keeps_cube else corrected(ready.cube, found),
        environment=environment, environment_error_k=error_k,
        assumed_air=None, found=found, distance_m=None,
    )  # fmt: skip


def _with_estimated(ready, split, k, seed, how, lap, progress, moved=False):
    """The same from the Split of its cube, in an Environment of k objects that is estimated, and
    again once the cube is corrected; with an assumed sky, if that explains the pixels. If the
    wavelengths are off, all of it is repeated at those found (moved)."""
    library = how["library"]
    environment, objects, air = _surroundings(ready, split, k, seed, how, lap, progress)
    found = calibration(split.cold, environment, **how, moved=moved or air is not None)
    if found.shift_um:
        lap("calibration")
        there = (of.moved(found.shift_um) for of in (ready, split))
        return _with_estimated(*there, k, seed, how, lap, progress, moved=True)
    estimate = partial(estimate_environment, library=library, k=objects, seed=seed)
    cube, off = ready.cube, None
    if found.air:
        clear = estimate(corrected(cube, found), assume_sky=air)
        off = distances(split.cold, environment, clear, how["looks"](), len(library), found)
    if not found.keeps_cube:
        cube = corrected(cube, found, off)
        environment = estimate(cube, assume_sky=air)
    return dict(
        ready=ready, cube=cube, environment=environment, environment_error_k=0.0,
        assumed_air=air, found=found,
        distance_m=off and off.metres,
    )  # fmt: skip


def _surroundings(ready, split, k, seed, how, lap, progress):
    """The Environment of a Prepared before correction, the number of objects it was to have, and
    the Atmosphere of an assumed sky, or None; arguments as above. A little sky in view may be metal
    that mirrors it."""
    sample = Sample(ready.cube, how["library"], seed, split)
    around = partial(_around, split=split, k=k, how=how, lap=lap, progress=progress)
    as_it_looks = environment, *_ = around(sample)
    if not 0 < sample.sky.mean() <= LITTLE:
        return as_it_looks
    another = cache(lambda: around(sample.without_sky()))
    mistaken = mistaken_sky(split.cold, environment, lambda: another()[0], **how)
    return another() if mistaken and another()[2] else as_it_looks


def _around(sample, split, k, how, lap, progress):
    """The same from a Sample as it is. If no sky is in view, all but wavelengths and air is first
    explained without one, then it is asked whether one makes it likelier."""

    def supported(assume_sky=None):
        from physics.support import supported_count  # numba takes a second to load

        with compiling(progress):
            return supported_count(sample, assume_sky)

    counting = k in (None, "auto")
    pixels = sample.cube.measured_count
    objects = min(USUAL_OBJECTS, pixels) if counting else k
    if sample.sky.any() and k == "auto":
        objects = supported()
    # an assumed sky takes no pixel
    environment = sample.environment(min(objects, pixels) if sample.may_assume_sky else objects)
    lap("environment")
    if environment.sky:
        return environment, objects, None
    with_sky = max(objects, 2) if counting and sample.may_assume_sky else objects
    least, air = 1, None
    if with_sky > 1 and sample.may_assume_sky:
        # the effects of a missing sky would look like wrong wavelengths
        without = cache(lambda: calibration(split.cold, environment, **how, moved=True))
        under_sky = partial(sample.environment, with_sky)
        of = split.cold, environment, without, sample.usual_air(), under_sky
        air = missing_sky(*of, **how)
        if counting and not air and without().curves:
            least = LEAST_OBJECTS  # one cannot tell curves from bands
    if counting:
        objects = max(supported(air), least)
    return sample.environment(objects, air), objects, air
