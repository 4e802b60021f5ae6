"""A glance from afar: what is there is found, what is left out is nowhere in the answer."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from traced import names_of, one_thread, scene_of, traced  # noqa: F401

from benchmarks import ONNX
from benchmarks.difficulties import steel_plate
from physics import HeatCube, InputError, MaterialLibrary
from physics.bands import equidistant_bands
from physics.estimate import estimate_environment
from physics.exact.local import solve_local
from physics.exact.reduced import reduce_model
from physics.expected import SKY_NEAR, Expected, Regions, only
from physics.known import known_arrays
from physics.simulator import geometry as g
from physics.simulator import simulate
from physics.simulator.scene import Camera, Scene, SceneObject
from physics.sky import Atmosphere
from texnet import glance
from texnet.learned import torch_model
from texnet.pipeline import decompose
from texnet.runtime import Runtime
from texnet.solver import solve_each

SHAPE = (160, 240)
LEAST = 96  # pixels of a region on a side
regions = partial(glance.regions, least=LEAST)


def seen_of(field):
    """materials_seen of a picture whose material is field (height, width) for sure."""
    return list(glance.materials_seen(np.eye(12, dtype=np.float32)[field].transpose(2, 0, 1)))


def test_what_fills_neighbouring_patches_is_seen_and_single_ones_are_not():
    field = np.zeros(SHAPE, int)
    field[40:43, 50:53] = 3  # holds two by two wherever they begin
    assert seen_of(field) == [0, 3]
    doubt = np.zeros((12, *SHAPE), np.float32)
    doubt[0], doubt[5] = 0.996, 0.004  # a little everywhere
    assert list(glance.materials_seen(doubt)) == [0, 5]  # two at least
    doubt[:2] = 0.498
    doubt[7, ::40, ::40], doubt[:2, ::40, ::40] = 0.3, 0.35
    assert list(glance.materials_seen(doubt)) == [0, 1]


def test_less_is_enough_where_materials_are_in_doubt():
    p = np.zeros((12, *SHAPE), np.float32)
    p[:2], p[9] = [[[0.792]], [[0.2]]], 0.007
    assert list(glance.materials_seen(p)) == [0, 1]
    p[:4] = 0.248  # now nobody is sure
    assert list(glance.materials_seen(p)) == [0, 1, 2, 3, 9]


@pytest.mark.parametrize("step", [2, 3, 4])
def test_each_part_holds_what_is_seen_in_it_or_close_by(step):
    """Two materials are everywhere, a third within a part, a fourth across a border."""
    shape = 300, 700
    field = np.indices([-(-size // step) for size in shape]).sum(axis=0) // 2 % 2
    rows, columns = regions(np.eye(4)[field].transpose(2, 0, 1), step, shape).cuts
    assert (rows[0], rows[-1]) == (0, 300) and (columns[0], columns[-1]) == (0, 700)
    for cuts in (rows, columns):
        assert LEAST - glance.STEP <= np.diff(cuts).min() and np.diff(cuts).max() < 2 * LEAST
    within, across = (columns[3] + columns[4]) // 2 // step, columns[2] // step
    field[5:9, within : within + 4] = 2
    field[5:9, across - 2 : across + 2] = 3
    parts = regions(np.eye(4)[field].transpose(2, 0, 1), step, shape)
    assert parts.held[..., :2].all() and not parts.held[1:, :, 2:].any()
    assert np.flatnonzero(parts.held[0, :, 2]).tolist() == [3]
    assert np.flatnonzero(parts.held[0, :, 3]).tolist() == [1, 2]
    for i, j in np.ndindex(parts.held.shape[:2]):
        for row in (rows[i], rows[i + 1] - 1):
            for column in (columns[j], columns[j + 1] - 1):
                np.testing.assert_array_equal(parts.at(row, column), parts.held[i, j])


def test_a_part_of_which_no_patch_was_measured_may_hold_anything():
    probability = np.full((4, 75, 175), np.nan)
    probability[:, :, :40] = np.array([0.0, 0.0, 0.5, 0.5])[:, None, None]
    held = regions(probability, 4, (300, 700)).held
    assert (held[:, 0] == [False, False, True, True]).all() and held[:, -1].all()


def test_a_picture_smaller_than_two_parts_is_one():
    parts = regions(np.ones((4, 64, 96)) / 4, 2, (128, 191))
    assert parts.cuts == ((0, 128), (0, 191)) and parts.held.shape == (1, 1, 4)
    assert parts.held.all()


def parts_of_it():
    """Regions of a picture of 24 x 36 pixels, in some of which sky is looked for."""
    held = np.random.default_rng(0).random((2, 3, 30)) < 0.3
    held[..., MaterialLibrary.starter().sky_index] = [[True, False, True], [False, True, False]]
    return Regions(((0, 12, 24), (0, 12, 24, 36)), held)


def test_local_answers_each_part_as_if_nothing_else_were_in_the_library():
    cube, _ = traced("patterned", 18, size=(24, 36), spp=8)
    library, parts = MaterialLibrary.starter(), parts_of_it()
    environment = estimate_environment(cube, library, 3)
    maps = solve_each(cube, library, environment, regions=parts)
    for i, j in np.ndindex(2, 3):
        part, there = np.s_[..., 12 * i : 12 * i + 12, 12 * j : 12 * j + 12], parts.held[i, j]
        some = library.subset([n for n, held in zip(library.names, there, strict=True) if held])
        alone = solve_each(cube, some, environment)
        p = maps["material_probability"][part]
        assert not p[~there].any()
        # both have B(T) as a series, to a two-hundredth of the noise
        np.testing.assert_allclose(p[there], alone["material_probability"][part], atol=0.02)
        same = maps["material"][part] == np.flatnonzero(there)[alone["material"][part]]
        assert same.mean() > 0.98  # the others are as likely as another
        off = (maps["temperature_k"] - alone["temperature_k"])[part][same]
        np.testing.assert_allclose(off, 0, atol=0.01)


@pytest.mark.parametrize("model", [torch_model(), Runtime(ONNX, threads=2).run])
def test_a_network_answers_each_part_as_if_nothing_else_were_in_the_library(model):
    cube, _ = traced("patterned", 18, size=(24, 36), spp=8)
    library = MaterialLibrary.starter()
    known = known_arrays(cube, library, estimate_environment(cube, library, 3))
    parts = parts_of_it()
    nats = np.random.default_rng(1).normal(size=(30, 6, 9)).astype(np.float32)
    maps = model(cube.radiance, known, None, Expected(nats, 4), parts)
    for i, j in np.ndindex(2, 3):
        part, there = np.s_[..., 12 * i : 12 * i + 12, 12 * j : 12 * j + 12], parts.held[i, j]
        alone = model(cube.radiance, only(known, there), None, Expected(nats[there], 4))
        p = maps["material_probability"][part]
        assert not p[~there].any()
        np.testing.assert_allclose(p[there], alone["material_probability"][part], atol=1e-4)
        same = maps["material"][part] == np.flatnonzero(there)[alone["material"][part]]
        assert same.mean() > 0.98  # the others are as likely as another
        off = (maps["temperature_k"] - alone["temperature_k"])[part][same]
        np.testing.assert_allclose(off, 0, atol=0.01)


ALL = np.ones((1, 1, 30), bool)
ONE = np.eye(30, dtype=bool)[:1, None]


@pytest.mark.parametrize("model", [torch_model(), Runtime(ONNX, threads=2).run])
@pytest.mark.parametrize(
    "cuts, held, says",
    [
        (((0, 20), (0, 36)), ALL, "from 0 to 24"),
        (((0, 24), (0, 36, 36)), ALL, "must ascend"),
        (((0, 7, 24), (0, 36)), np.ones((2, 1, 30), bool), "multiples of 2"),
        (((0, 24), (0, 36)), ALL[..., 1:], "held must be"),
        (((0, 24), (0, 36)), ONE, "two materials at least"),
    ],
)
def test_parts_that_are_not_the_pictures_are_refused(model, cuts, held, says):
    cube, _ = traced("patterned", 18, size=(24, 36), spp=8)
    library = MaterialLibrary.starter()
    known = known_arrays(cube, library, estimate_environment(cube, library, 3))
    with pytest.raises(InputError, match=says):
        model(cube.radiance, known, regions=Regions(cuts, held))


@pytest.mark.parametrize("method", ["net", "net+sgd"])
def test_each_part_of_a_large_picture_is_answered_by_what_a_glance_saw_there(method, monkeypatch):
    cube, _ = traced("patterned", 18, size=(24, 36), spp=8)
    monkeypatch.setattr(glance, "PATCHES", 24 * 36 // 4)
    monkeypatch.setattr(glance, "NET_REGION", 12)
    held, of = [], glance.regions
    monkeypatch.setattr(glance, "regions", lambda *a: held.append(of(*a)) or held[-1])
    d = decompose(cube, method=method, k=3)
    (parts,) = held
    assert parts.held.shape[:2] == (2, 3) and not parts.held.all()
    seen = np.flatnonzero(d.material_probability.any(axis=(1, 2)))
    assert len(seen) == parts.held.any(axis=(0, 1)).sum() < 30
    for i, j in np.ndindex(2, 3):
        p = d.material_probability[:, 12 * i : 12 * i + 12, 12 * j : 12 * j + 12]
        there = np.isin(np.arange(30), seen[parts.held[i, j]])
        assert not p[~there].any() and p[there].any(axis=(1, 2)).all()
        np.testing.assert_allclose(p.sum(axis=0), 1, atol=1e-5)


@pytest.mark.parametrize("at", range(4))
def test_a_post_as_wide_as_the_gap_is_seen(at):
    """Two columns of a picture of which a glance takes two in four."""
    band = np.zeros((64, 96))
    band[:, 40 + at : 42 + at] = 1
    afar = glance._patches(band, 4)
    assert afar.shape == (16, 24)
    assert afar.sum() == 8 and afar.max() >= 0.5


@pytest.mark.parametrize("step", [2, 3, 4])
@pytest.mark.parametrize("shape", [(24, 36), (25, 37), (26, 38), (27, 39), (5, 4), (3, 9), (1, 30)])
def test_patches_are_means_with_half_the_noise_to_the_last(step, shape):
    bands = np.random.default_rng(0).normal(size=(2000, *shape)).astype(np.float32)
    afar = np.stack([glance._patches(band, step) for band in bands])
    assert afar.shape[1:] == tuple(-(-size // step) for size in shape)
    cube = HeatCube(np.full((3, *shape), 7.0), [8.0, 9.0, 10.0], netd_k=0.08)
    less = glance.from_afar(cube, step).netd_k / 0.08
    assert less == pytest.approx(0.5 if min(shape) > 1 else 0.5**0.5)
    np.testing.assert_allclose(afar.std(axis=0), less, rtol=0.1)
    np.testing.assert_allclose(glance._patches(0 * bands[0] + 3, step), 3)


@settings(max_examples=30)
@given(st.integers(0, 2**32 - 1))
def test_permuting_the_library_permutes_what_is_seen_and_expected(seed):
    rng = np.random.default_rng(seed)
    p = rng.dirichlet(np.full(9, 0.05), size=(12, 15)).transpose(2, 0, 1)
    order = rng.permutation(9)
    assert set(order[glance.materials_seen(p[order])]) == set(glance.materials_seen(p))
    there = glance.expected(p)[order]
    np.testing.assert_allclose(glance.expected(p[order]), there, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("step", [2, 3])
def test_the_answer_is_that_of_the_materials_seen(step, monkeypatch):
    cube, _ = traced("patterned", 18, size=(24, 36), spp=8)
    library = MaterialLibrary.starter()
    known = known_arrays(cube, library, estimate_environment(cube, library, 3))
    monkeypatch.setattr(glance, "PATCHES", 24 * 36 // step**2)
    answered, there = [], []

    def run(part, seen, expected=None, regions=None):
        answered.append((part.shape, len(seen)))
        there.append(expected)
        of_seen = {name: known[name][seen] for name in ("emissivity", "is_sky")}
        return torch_model()(part.radiance, known | of_seen, expected=expected)

    maps = glance.answer(run, run, cube, len(library), library.sky_index, expects=True)
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


LARGEST_SMALL = int((4 * glance.PATCHES) ** 0.5) - 1


SIZES = [(LARGEST_SMALL, True), (4, True), (3, True), (60, False)]


@pytest.mark.parametrize("side, expects", SIZES)
def test_a_small_picture_is_answered_with_the_whole_library(side, expects):
    """The smallest, and where nobody makes use of it, without a glance."""
    cube = HeatCube(np.full((3, side, side), 7.0), [8.0, 9.0, 10.0], netd_k=0.05)

    def look(part, seen):
        p = np.zeros((5, *part.shape), np.float32)
        p[1] = 1
        return {"material_probability": p}

    shape, seen, expected = glance.answer(
        lambda part, seen, expected=None: (part.shape, list(seen), expected),
        look,
        cube,
        5,
        0,
        expects,
    )
    assert shape == (side, side) and seen == [0, 1, 2, 3, 4]
    assert (expected is not None) == (side > 3 and expects)


def test_a_glance_that_sees_no_measurement_leaves_nothing_out(monkeypatch):
    """As where every patch lies on rows of a detector that are dead."""
    monkeypatch.setattr(glance, "PATCHES", 20)
    dead = np.zeros((20, 16), bool)
    dead[1::4] = dead[2::4] = True
    cube = HeatCube(np.full((3, 20, 16), 7.0), [8.0, 9.0, 10.0], netd_k=0.05, dead=dead)
    look = lambda part, seen: {"material_probability": np.full((5, *part.shape), 0.2)}
    seen = glance.answer(lambda part, seen, *_: list(seen), look, cube, 5, 0, False)
    assert seen == [0, 1, 2, 3, 4]


def test_what_is_seen_everywhere_is_expected_and_nothing_is_impossible():
    p = np.zeros((4, 6, 8), np.float32)
    p[2] = 1
    expected = glance.expected(p)
    assert (expected[2] - expected[[0, 1, 3]] > 2).all() and np.isfinite(expected).all()
    assert (expected > -3.5).all()  # a factor of thirty or so


def test_what_is_no_number_hides_no_material():
    p = np.eye(12, dtype=np.float32)[np.repeat([[0, 3, 5]], 9, axis=0)].transpose(2, 0, 1).copy()
    p[:, 2, 1] = np.nan
    assert list(glance.materials_seen(p)) == [0, 3, 5]


def test_what_is_no_number_spoils_no_other_patch():
    p = np.random.default_rng(0).dirichlet(np.ones(4), size=(6, 8)).transpose(2, 0, 1)
    whole = glance.expected(p)
    p[:, 2, 3] = np.nan
    spoilt = glance.expected(p)
    assert np.isfinite(spoilt).all()
    at = np.ones((6, 8), bool)
    at[2, 3] = False
    np.testing.assert_allclose(spoilt[:, at], whole[:, at], atol=0.05)


def test_where_it_is_in_doubt_the_commoner_is_expected():
    p = np.full((3, 8, 8), 0.0, np.float32)
    p[0, :6] = 1
    p[:2, 6:] = 0.5  # two alike
    expected = glance.expected(p)
    assert (expected[0, 6:] > expected[1, 6:] + 0.2).all()


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
    slope = Expected(np.arange(5, dtype=np.float32)[None, :, None].repeat(3, 2), 4)
    column = slope.of_tile(0, 0, 20, 12)[0, :, 5]
    np.testing.assert_allclose(column, np.clip((np.arange(20) + 0.5) / 4 - 0.5, 0, 4), atol=1e-6)


def test_the_network_is_told_what_the_glance_expects():
    cube, _ = traced("patterned")
    given = []

    def model(radiance, known, progress=None, expected=None, regions=None, told=True):
        given.append((radiance.shape[1:], expected and expected.nats.shape))
        return torch_model()(radiance, known, progress, expected if told else None, regions)

    environment = estimate_environment(cube.with_netd(), MaterialLibrary.starter(), 3)
    d = decompose(cube, environment=environment, model=model)
    deaf = decompose(cube, environment=environment, model=partial(model, told=False))
    afar = tuple(-(-size // 2) for size in cube.shape)
    of_all = [g for g in given if g[0] in (afar, cube.shape)]  # not of the sample that calibrates
    assert of_all == 2 * [(afar, None), (cube.shape, (30, *afar))]
    p, plain = d.material_probability, deaf.material_probability
    assert 0.01 < np.abs(p - plain).max()
    assert p.max(axis=0).mean() > plain.max(axis=0).mean()  # surer, on the whole


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


@pytest.mark.parametrize("size", [(5, 7), (4, 7), (3, 3), (1, 5), (1, 1)])
def test_a_picture_s_last_patches_are_looked_at_like_its_first(size):
    """Whatever their number: what is seen does not depend on which way round the picture is."""
    probability = np.zeros((6, *size), np.float32)
    probability[0] = 1.0
    probability[:, -1, -2:] = np.eye(6, dtype=np.float32)[4][:, None]
    seen = glance.materials_seen(probability)
    assert 4 in seen
    for flipped in (probability[:, ::-1], probability[:, :, ::-1], probability[:, ::-1, ::-1]):
        assert 4 in glance.materials_seen(flipped)


def test_sky_is_expected_least_where_none_was_seen_near():
    """Below SKY_NEAR, so that nothing is partly sky there; but near dead patches all may be."""
    p = np.zeros((3, 30, 40), np.float32)
    p[0], p[1, 4, 30] = 0.5, 0.4  # one patch with some sky
    p[2] = 1 - p[:2].sum(axis=0)
    p[:, 20, 3] = np.nan
    y, x = np.ogrid[:30, :40]
    near = np.maximum(abs(y - 4), abs(x - 30)) <= glance.BORDER
    near |= np.maximum(abs(y - 20), abs(x - 3)) <= glance.BORDER
    without, expected = glance.expected(p), glance.expected(p, sky=1)
    np.testing.assert_array_equal(expected[1] < SKY_NEAR, ~near)
    np.testing.assert_array_equal(expected[1][near], without[1][near])
    np.testing.assert_array_equal(expected[[0, 2]], without[[0, 2]])
    assert without.min() > SKY_NEAR and np.isfinite(expected).all()


@pytest.mark.parametrize("method", ["net+sgd", "local"])
def test_metal_that_reflects_ground_and_sky_is_not_ground_before_sky(method, monkeypatch):
    """A Lambertian plate of steel that leans over the ground, below the sky in view."""
    monkeypatch.setattr(glance, "PATCHES", 2000)  # `local` looks from afar, too
    ground = SceneObject(g.sheet(*[np.linspace(-300, 300, 61)] * 2, lambda xy: 0 * xy[:, 0]),
                         "asphalt", 290.0)  # fmt: skip
    camera = Camera((0, 0, 1.8), (0, 6, 0.6), 40)
    scene = Scene([ground], camera, Atmosphere(air_temperature_k=288.0))
    scene = replace(scene, objects=[ground, steel_plate(scene, 0.0)])
    w, fwhm = equidistant_bands(36)
    cube, truth = simulate(scene, wavelength_um=w, fwhm_um=fwhm, size=(96, 144), spp=16)
    steel = names_of(truth) == "steel"
    found = decompose(cube, method=method)
    anywhere = lambda p, sky=None, usual=glance.expected: usual(p)
    monkeypatch.setattr(glance, "expected", anywhere)
    before = decompose(cube, method=method)
    right, was = ((names_of(d) == "steel")[steel].mean() for d in (found, before))
    assert right > 0.8 and right > was + 0.05 and steel.mean() > 0.1
    right, was = ((names_of(d) == names_of(truth)).mean() for d in (found, before))
    assert right > was


def test_what_is_far_from_the_sky_is_solved_without_it_behind():
    """And what is near, as before: `solve_each` and `net+sgd`, half of a picture being far."""
    cube, _ = traced("forest")
    library = MaterialLibrary.starter()
    environment = estimate_environment(cube, library, 3)
    nats = np.zeros((len(library), 12, 18), np.float32)
    nats[library.sky_index, :, 9:] = -5.0
    expected = Expected(nats, 4)
    near = np.arange(cube.shape[1]) < cube.shape[1] // 2
    free = solve_each(cube, library, environment)
    told = solve_each(cube, library, environment, expected)
    for name in ("material", "temperature_k", "log_evidence"):
        np.testing.assert_array_equal(told[name][:, near], free[name][:, near], err_msg=name)
    model = reduce_model(cube, library, environment)
    pure = solve_local(model, cube.spectra, partly=False)
    assert not ((model.sky_share[pure.row] > 0) & (model.sky_share[pure.row] < 1)).any()
    assert (told["log_evidence"] <= free["log_evidence"] + 1e-4)[:, ~near].all()
    assert (told["log_evidence"] < free["log_evidence"] - 5)[:, ~near].any()

    known = known_arrays(cube, library, environment)
    inner = np.abs(np.arange(cube.shape[1]) - cube.shape[1] // 2) > 22  # beyond the network's sight
    runs = torch_model(), Runtime(ONNX).run
    of_torch, of_onnx = (run(cube.radiance, known, expected=expected) for run in runs)
    np.testing.assert_array_equal(of_torch["material"], of_onnx["material"])
    nats[library.sky_index, :, 9:] = -3.9  # as little, but not too little
    free = runs[0](cube.radiance, known, expected=Expected(nats, 4))
    at = near & inner
    np.testing.assert_array_equal(of_torch["material"][:, at], free["material"][:, at])
    assert (of_torch["log_evidence"] < free["log_evidence"] - 5)[:, ~near].any()
