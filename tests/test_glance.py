"""A glance from afar: what is there is found, what is left out is nowhere in the answer."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from traced import one_thread, traced  # noqa: F401

from physics import HeatCube, MaterialLibrary
from physics.estimate import estimate_environment
from physics.expected import Expected
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
    """Two columns of a picture of which a glance takes two in four."""
    band = np.zeros((64, 96))
    band[:, 40 + at : 42 + at] = 1
    afar = glance._patches(band, 4)
    assert afar.shape == (16, 24)
    assert afar.sum() == 8 and afar.max() >= 0.5


@pytest.mark.parametrize("step", [2, 3, 4])
@pytest.mark.parametrize("shape", [(24, 36), (25, 37), (5, 4)])
def test_patches_are_means_with_half_the_noise(step, shape):
    band = np.random.default_rng(0).normal(size=shape)
    afar = glance._patches(band, step)
    assert afar.shape == tuple(-(-size // step) for size in shape)
    np.testing.assert_allclose(glance._patches(0 * band + 3, step), 3)
    row, column = step, step * 2 // 2 + (step - 2)  # of the second row, one step to the right
    top, left = row + (step - 2) // 2, column
    patch = band[top : top + 2, left : left + 2]
    if patch.size == 4:
        assert afar[1, 1] == pytest.approx(patch.mean(), rel=1e-6)
    cube = HeatCube(np.full((3, *shape), 7.0), [8.0, 9.0, 10.0], netd_k=0.08)
    assert glance._from_afar(cube, step).netd_k == 0.04


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
    monkeypatch.setattr(glance, "PATCHES", 24 * 36 // step**2)
    answered, there = [], []

    def run(part, seen, expected):
        answered.append((part.shape, len(seen)))
        there.append(expected)
        of_seen = {name: known[name][seen] for name in ("emissivity", "is_sky")}
        return torch_model()(part.radiance, known | of_seen, expected=expected)

    maps = glance.answer(run, run, cube, len(library))
    afar = tuple(-(-size // step) for size in (24, 36))
    p = maps["material_probability"]
    seen = np.flatnonzero(p.any(axis=(1, 2)))
    assert answered == [(afar, 30), ((24, 36), len(seen))] and len(seen) < 20
    assert there[0] is None and there[1].step == step
    alone = run(cube, seen, there[1])
    np.testing.assert_array_equal(p[seen], alone["material_probability"])
    np.testing.assert_array_equal(maps["material"], seen[alone["material"]])
    np.testing.assert_array_equal(maps["temperature_k"], alone["temperature_k"])
    np.testing.assert_allclose(p.sum(axis=0), 1, atol=1e-5)


@pytest.mark.parametrize("least", [1, 4])
def test_a_small_picture_is_answered_with_the_whole_library(least):
    """And the smallest is not looked at from afar."""
    side = int((4 * glance.PATCHES) ** 0.5) - 1 if least == 4 else 3
    cube = HeatCube(np.full((3, side, side), 7.0), [8.0, 9.0, 10.0], netd_k=0.05)

    def look(part, seen, expected):
        p = np.zeros((5, *part.shape), np.float32)
        p[1] = 1
        return {"material_probability": p}

    shape, seen, expected = glance.answer(
        lambda part, seen, expected: (part.shape, list(seen), expected), look, cube, 5
    )
    assert shape == (side, side) and seen == [0, 1, 2, 3, 4]
    assert (expected is None) == (least == 1)


def test_what_is_seen_everywhere_is_expected_and_nothing_is_impossible():
    p = np.full((4, 6, 8), 1e-6, np.float32)
    p[2] = 1 - 3e-6
    expected = glance.expected(p)
    np.testing.assert_allclose(expected[2], 0, atol=1e-4)
    np.testing.assert_allclose(expected[[0, 1, 3]], 0.5 * np.log(glance.LEAST), rtol=1e-6)


def test_where_it_is_in_doubt_the_commoner_is_expected():
    p = np.full((3, 8, 8), 0.0, np.float32)
    p[0, :6], p[1, :1] = 1, 1
    p[:2, :1] = 0.5  # two alike
    p[:2, 6:] = 0.5
    expected = glance.expected(p)
    assert (expected[0, 6:] > expected[1, 6:] + 0.2).all()


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_permuting_the_library_permutes_what_is_expected(seed):
    rng = np.random.default_rng(seed)
    p = rng.dirichlet(np.full(9, 0.05), size=(12, 15)).transpose(2, 0, 1)
    order = rng.permutation(9)
    np.testing.assert_allclose(
        glance.expected(p[order]), glance.expected(p)[order], rtol=1e-5, atol=1e-6
    )


@given(
    st.integers(1, 30), st.integers(1, 30), st.sampled_from([2, 3, 4]), st.data()
)  # fmt: skip
def test_what_is_expected_of_a_tile_is_that_of_the_whole(height, width, step, data):
    rng, size = np.random.default_rng(height), [-(-n // step) for n in (height, width)]
    expected = Expected(rng.normal(size=(3, *size)).astype(np.float32), step)
    whole = expected.of_tile(0, 0, height, width)
    assert whole.shape == (3, height, width) and whole.dtype == np.float32
    top, left = data.draw(st.integers(0, height - 1)), data.draw(st.integers(0, width - 1))
    part = expected.of_tile(top, left, height - top, width - left)
    np.testing.assert_allclose(part, whole[:, top:, left:], atol=1e-5)


def test_between_points_it_is_linear_and_beyond_them_constant():
    slope = Expected(np.arange(5, dtype=np.float32)[None, :, None] + np.zeros((1, 1, 3)), 4)
    column = slope.of_tile(0, 0, 20, 12)[0, :, 5]
    np.testing.assert_allclose(column, np.clip((np.arange(20) + 0.5) / 4 - 0.5, 0, 4), atol=1e-6)


@pytest.mark.parametrize("method", ["local", "sgd", "net"])
def test_every_method_leaves_out_what_it_does_not_see(method, monkeypatch):
    cube, truth = traced("patterned")
    monkeypatch.setattr(glance, "PATCHES", truth.material.size // 4)
    d = decompose(cube, method=method, k=3)
    seen = d.material_probability.any(axis=(1, 2))
    assert seen.sum() < 20 and seen[np.unique(d.material)].all()
    np.testing.assert_allclose(d.material_probability.sum(axis=0), 1, atol=1e-5)
    there = np.array(truth.material_names)[np.unique(truth.material)]
    assert set(there) <= set(np.array(d.material_names)[seen])
