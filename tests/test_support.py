"""k: as many environment objects as the pixels tell apart, and no more."""

from functools import cache

import numpy as np
import pytest
from traced import scene_of

from physics import HeatCube, MaterialLibrary
from physics.bands import equidistant_bands
from physics.estimate import Sample
from physics.planck import noise_sigma, planck
from physics.simulator import trace_scene
from physics.support import supported_count
from texnet.pipeline import decompose

W, FWHM = equidistant_bands(24)


def supported(cube, library):
    return supported_count(Sample(cube, library))


def test_an_isothermal_enclosure_needs_one_object():
    """Everything is B(T), whatever it is made of: nothing tells surroundings apart."""
    black = planck(W, 293.0)[:, None, None]
    noise = np.random.default_rng(0).normal(size=(24, 30, 40)) * noise_sigma(W, 0.05)[:, None, None]
    cube = HeatCube(black + noise, W, FWHM, 0.05)
    assert supported(cube, MaterialLibrary.starter()) == 1


@pytest.fixture(scope="module")
def forest():
    library = MaterialLibrary.starter()
    traced = trace_scene(scene_of("forest", 7), (48, 64), 16, 7, library)
    return traced.shade(library, W, FWHM)[0]


def test_under_a_sky_a_few_objects_are_not_enough(forest):
    assert 4 <= supported(forest, MaterialLibrary.starter()) <= 8


@cache
def of_ground(forest):
    """The Decomposition of its ground alone, of as many objects as it supports."""
    ground = HeatCube(forest.radiance[:, 30:], W, FWHM, 0.05)
    return decompose(ground, method="local", k="auto")


def test_ground_alone_needs_a_sky_and_what_else_there_is(forest):
    """Without one a single object, which mirrors of itself explain, would do."""
    library = MaterialLibrary.starter()
    ground = HeatCube(forest.radiance[:, 30:], W, FWHM, 0.05)
    assert Sample(forest, library).sky.any() and not Sample(ground, library).sky.any()
    answer = of_ground(forest)
    assert len(answer.environment) >= 2 and answer.sky_assumed


def test_by_default_it_is_five_under_a_sky_and_found_elsewhere(forest):
    ground = HeatCube(forest.radiance[:, 30:], W, FWHM, 0.05)
    assert len(decompose(forest, method="local").environment) == 5
    by_default, auto = decompose(ground, method="local"), of_ground(forest)
    np.testing.assert_array_equal(by_default.environment, auto.environment)
    assert 2 <= len(by_default.environment) < 5


def test_the_order_of_the_library_does_not_matter(forest):
    library = MaterialLibrary.starter()
    turned = library.subset(library.names[::-1])
    assert supported(forest, turned) == supported(forest, library)


def test_decompose_takes_as_many(forest):
    answer = decompose(forest, method="local", k="auto")
    assert len(answer.environment) == supported(forest, MaterialLibrary.starter())


def test_a_single_pixel_has_an_answer(forest):
    one = HeatCube(forest.radiance[:, :1, -1:], W, FWHM, 0.05)
    assert supported(one, MaterialLibrary.starter()) == 1
