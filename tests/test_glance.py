"""A glance from afar: what is there is found, what is left out is nowhere in the answer."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from traced import one_thread, traced  # noqa: F401

from physics import HeatCube, MaterialLibrary
from physics.estimate import estimate_environment
from physics.known import known_arrays
from texnet import glance
from texnet.learned import torch_model
from texnet.pipeline import decompose

SHAPE = (160, 240)


def seen_of(field):
    """materials_seen of a picture whose material is field (height, width) for sure."""
    return list(glance.materials_seen(np.eye(12, dtype=np.float32)[field].transpose(2, 0, 1)))


def test_what_fills_a_patch_is_seen_and_single_pixels_are_not():
    field = np.zeros(SHAPE, int)
    field[40:43, 50:53] = 3  # holds a whole patch wherever patches begin
    assert seen_of(field) == [0, 3]
    doubt = np.zeros((12, *SHAPE), np.float32)
    doubt[0], doubt[5] = 0.996, 0.004  # a little everywhere
    assert list(glance.materials_seen(doubt)) == [0, 5]  # two at least
    doubt[:2] = 0.498
    doubt[7, ::40, ::40], doubt[:2, ::40, ::40] = 0.3, 0.35
    assert list(glance.materials_seen(doubt)) == [0, 1]


@pytest.mark.parametrize("at", range(4))
def test_a_post_as_wide_as_the_gap_is_seen(at):
    """Three columns of a picture of which a glance takes every fourth."""
    band = np.zeros((64, 96))
    band[:, 40 + at : 43 + at] = 1
    afar = glance._from_afar(band, 4)
    assert afar.shape == (16, 24)
    assert afar.sum() == pytest.approx(0.75 * 16, abs=1)


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_permuting_the_library_permutes_what_is_seen(seed):
    rng = np.random.default_rng(seed)
    p = rng.dirichlet(np.full(9, 0.05), size=(12, 15)).transpose(2, 0, 1)
    order = rng.permutation(9)
    assert set(order[glance.materials_seen(p[order])]) == set(glance.materials_seen(p))


@pytest.mark.parametrize("step", [2, 3])
def test_the_answer_is_that_of_the_materials_seen(step, monkeypatch):
    cube, _ = traced("patterned", 18, size=(24, 36), spp=8)
    library = MaterialLibrary.starter()
    known = known_arrays(cube, library, estimate_environment(cube, library, 3))
    monkeypatch.setattr(glance, "PIXELS", 24 * 36 // step**2)
    answered = []

    def run(part, seen):
        answered.append((part.shape, len(seen)))
        of_seen = {name: known[name][seen] for name in ("emissivity", "is_sky")}
        return torch_model()(part.radiance, known | of_seen)

    maps = glance.answer(run, run, cube, len(library))
    afar = tuple(-(-size // step) for size in (24, 36))
    p = maps["material_probability"]
    seen = np.flatnonzero(p.any(axis=(1, 2)))
    assert answered == [(afar, 30), ((24, 36), len(seen))] and len(seen) < 20
    alone = run(cube, seen)
    np.testing.assert_array_equal(p[seen], alone["material_probability"])
    np.testing.assert_array_equal(maps["material"], seen[alone["material"]])
    np.testing.assert_array_equal(maps["temperature_k"], alone["temperature_k"])
    np.testing.assert_allclose(p.sum(axis=0), 1, atol=1e-5)


def test_a_small_picture_is_answered_with_the_whole_library():
    side = int((4 * glance.PIXELS) ** 0.5) - 1
    cube = HeatCube(np.full((3, side, side), 7.0), [8.0, 9.0, 10.0])
    whole = glance.answer(lambda part, seen: (part.shape, list(seen)), None, cube, 5)
    assert whole == ((side, side), [0, 1, 2, 3, 4])


@pytest.mark.parametrize("method", ["local", "sgd", "net"])
def test_every_method_leaves_out_what_it_does_not_see(method, monkeypatch):
    cube, truth = traced("patterned")
    monkeypatch.setattr(glance, "PIXELS", truth.material.size // 4)
    d = decompose(cube, method=method, k=3)
    seen = d.material_probability.any(axis=(1, 2))
    assert seen.sum() < 20 and seen[np.unique(d.material)].all()
    np.testing.assert_allclose(d.material_probability.sum(axis=0), 1, atol=1e-5)
    there = np.array(truth.material_names)[np.unique(truth.material)]
    assert set(there) <= set(np.array(d.material_names)[seen])
