"""Small path-traced cubes for tests of the whole chain, each traced once per process."""

import functools
import json
from pathlib import Path

import numba
import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from physics.bands import equidistant_bands
from physics.cube.heat_cube import HeatCube
from physics.simulator import simulate
from physics.simulator.presets import preset
from texnet.cli import main
from texnet.pipeline import decompose, shipped_model

ANSWER = (Path(__file__).parents[1] / "docs" / "files.md").read_text(encoding="utf-8")
ARRAYS, JSON = ANSWER.partition("## Libraries")[0].split("`--json` prints")


scene_of = functools.cache(preset)  # the forest's geometry takes seconds


@functools.cache
def traced(name, bands=24, size=(48, 72), spp=16):
    """(HeatCube, Truth) of a preset scene."""
    w, fwhm = equidistant_bands(bands)
    return simulate(scene_of(name), wavelength_um=w, fwhm_um=fwhm, size=size, spp=spp)


@functools.cache
def right(name, bands=24, method="net+sgd"):
    """The Decomposition of a preset scene's cube by a method, of a right camera."""
    return decompose(traced(name, bands)[0], method=method)


def averaged(cube, bands):
    """The cube of a camera with fewer, wider bands: each the mean of neighbours of this one."""
    group = cube.bands // bands
    mean = lambda a: a[: bands * group].reshape(bands, group, *a.shape[1:]).mean(axis=1)
    return HeatCube(
        mean(cube.radiance), mean(cube.wavelength_um), group * mean(cube.fwhm_um),
        cube.netd_k / np.sqrt(group),
    )  # fmt: skip


def said(capsys, cube, out, *more):
    """What decompose says of a cube file, its JSON, and the arrays that it writes, by documented
    keys."""
    assert main(["decompose", str(cube), "--out", str(out), "--json", *more]) == 0
    text, result = capsys.readouterr().out.rsplit("\n", 2)[:2]
    result = json.loads(result)
    with np.load(out / "decomposition.npz") as npz:
        arrays = dict(npz)
    for keys, documented in ((arrays, ARRAYS), (result, JSON)):
        assert not [key for key in keys if f"`{key}`" not in documented]
    return text, result, arrays


def names_of(answer):
    """(height, width) names of the materials in a Truth or Decomposition."""
    return np.array(answer.material_names)[answer.material]


@pytest.fixture(scope="module", autouse=True)
def one_thread():
    """On tiny cubes threads only wait for each other, and for those of a second test process."""
    threads, runtime = numba.get_num_threads(), shipped_model("net+sgd").__self__
    at_once = runtime.at_once
    numba.set_num_threads(1)
    runtime.at_once = 1
    with threadpool_limits(1):
        yield
    runtime.at_once = at_once
    numba.set_num_threads(threads)
