"""Paths kept and shaded again: with the same library exactly `simulate`, with another unbiased."""

import dataclasses
import threading

import numpy as np
import pytest
import trimesh

from physics import InputError, MaterialLibrary
from physics.planck import planck
from physics.simulator import Camera, Scene, SceneObject, TracedScene, simulate, trace_scene
from physics.simulator.sensor import FLOOR_K, Bands
from physics.simulator.trace import Tracer
from physics.simulator.traced import trace_on_demand
from physics.sky import Atmosphere

W, FWHM = np.array([8.5, 10.0, 12.5]), np.array([0.0, 0.2, 0.3])
SIZE, SPP, Z = (12, 16), 16, 4.5
SHARED = dict(wavelength_um=W, fwhm_um=FWHM, size=SIZE, spp=SPP)


def library(**emissivity):
    """name=e or name=(e at 8 um, e at 14 um), and a sky."""
    rows = {k: np.broadcast_to(v, 2) for k, v in {**emissivity, "sky": 0.5}.items()}
    return MaterialLibrary(list(rows), [8.0, 14.0], np.array(list(rows.values())))


FIRST = library(soil=(0.95, 0.9), unused=0.5, paint=(0.75, 0.85))
SECOND = library(mirror=(0.6, 0.7), bark=0.9, clay=(0.85, 0.95))
FAR = Camera((4, 3, 2), (0, 0, 1))
STANDS_FOR = {"soil": "clay", "paint": "mirror"}


def scene(soil="soil", paint="paint", camera=FAR, ball_k=300.0):
    half = 3000.0
    corners = [[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]]
    plane = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)
    ball = trimesh.creation.icosphere(subdivisions=4).apply_translation((0, 0, 1.2))
    # Of falling index in the library, so that no order is taken for granted.
    objects = [SceneObject(ball, paint, ball_k), SceneObject(plane, soil, 295.0, False)]
    return Scene(objects, camera, Atmosphere())


def assert_same(one, other):
    np.testing.assert_array_equal(one[0].radiance, other[0].radiance)
    for f in dataclasses.fields(one[1]):
        np.testing.assert_array_equal(getattr(one[1], f.name), getattr(other[1], f.name))


def test_the_same_library_gives_what_simulate_gives(monkeypatch):
    monkeypatch.setattr("physics.simulator.traced.PATHS_PER_BLOCK", 1000)  # four blocks
    fine = Bands.of(W, FWHM).fine_um
    at_bands = MaterialLibrary(FIRST.names, fine, FIRST.at(fine))
    traced = trace_scene(scene(), SIZE, SPP, 3, at_bands)
    assert len(traced.blocks) == 4
    for netd_k in (0, 0.05):
        expected = simulate(scene(), **SHARED, seed=3, netd_k=netd_k, library=FIRST)
        assert_same(traced.shade(FIRST, W, FWHM, netd_k), expected)


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (FIRST, SECOND),  # paths of which some weigh more than 1
        (library(soil=0.3, paint=0.3), library(clay=0.9, mirror=(0.3, 0.4))),  # long ones
    ],
)
def test_another_library_agrees_with_tracing_anew(first, second):
    anew, again, runs = [], [], 24
    renamed = scene("clay", "mirror")
    for seed in range(runs):
        traced = trace_scene(scene(), SIZE, SPP, seed, first)
        again.append(traced.shade(second, W, FWHM, 0, STANDS_FOR))
        anew.append(simulate(renamed, **SHARED, seed=100 + seed, netd_k=0, library=second))
    truth = again[0][1]
    assert truth.material_names == second.names
    assert {second.names[m] for m in np.unique(truth.material)} == {"clay", "mirror", "sky"}
    solid = truth.material != second.sky_index  # where roulette matters
    for image in (lambda cube, _: cube.radiance, lambda _, truth: truth.sky_texture[None]):
        a, b = (np.array([image(*r)[:, solid] for r in one], float) for one in (anew, again))
        z = (a.mean(0) - b.mean(0)) / np.sqrt((a.var(0, ddof=1) + b.var(0, ddof=1)) / runs)
        n = z.shape[1]
        # Student's t of some 2 (runs - 1) degrees of freedom has this variance.
        wide = (runs - 1) / (runs - 2)
        assert np.abs(z.mean(1)).max() < Z * np.sqrt(wide / n)
        assert np.abs((z**2).mean(1) - wide).max() < Z * np.sqrt(2.5 / n)
        assert np.abs(z).max() < 5.5


def test_too_bright_a_mirror_leaves_radiance_positive():
    traced = trace_scene(scene(), SIZE, 2, 0, FIRST)
    mirror = library(mirror=0.0)
    names = {"soil": "mirror", "paint": "mirror"}
    cube, truth = traced.shade(mirror, W, FWHM, 0, names)
    floor = planck(W, FLOOR_K).astype(np.float32)[:, None, None]
    assert (cube.radiance == floor).any() and (cube.radiance >= floor).all()
    assert (truth.texture >= 0).all()


def test_several_materials_may_stand_for_one():
    # Ball and ground fill the picture at one temperature: of one kind, no pixel is mixed.
    close = scene(camera=Camera((4, 3, 2), (0, 0, 0.3), 20), ball_k=295.0)
    traced = trace_scene(close, SIZE, SPP, 0, FIRST)
    cube, truth = traced.shade(SECOND, W, FWHM * 0, 0, {"soil": "clay", "paint": "clay"})
    assert (truth.material == SECOND.index("clay")).all()
    e, x = truth.emissivity, truth.texture
    s = e * planck(W[:, None, None], truth.temperature_k) + (1 - e) * x
    np.testing.assert_allclose(cube.radiance, s, rtol=1e-6)
    # Of two kinds, some are, and the majority counts.
    truth = traced.shade(SECOND, W, FWHM, 0, STANDS_FOR)[1]
    assert set(np.unique(truth.material)) == {SECOND.index("clay"), SECOND.index("mirror")}


@pytest.mark.parametrize(
    "key, wrong",
    [
        ("size", np.ones((2, 2), int)), ("size", np.ones(3, int)), ("spp", np.ones(2)),
        ("spp", np.array(0)), ("seed", np.array(np.inf)), ("materials", np.array("soil")),
        ("vertices", np.ones(7, int)), ("of_heat", np.array(1)), ("value", np.ones(3, np.float32)),
        ("temperature_range_k", np.ones(3)), ("atmosphere", np.ones(9)),
        ("size", -np.array(SIZE)), ("roulette", np.zeros(2)), ("day_roulette", np.full(3, 0.5)),
        ("temperature_range_k", np.array([300.0, 295])),
        ("temperature_range_k", np.array([np.nan, 300])),
        ("temperature_range_k", np.array([297.0, 300])),
    ],
)  # fmt: skip
def test_arrays_that_do_not_fit_are_refused(tmp_path, key, wrong):
    file = tmp_path / "paths.npz"
    trace_scene(scene(), SIZE, SPP, 7, FIRST).save(file)
    with np.load(file) as data:
        arrays = dict(data) | {key: wrong}
    np.savez(file, **arrays)
    with pytest.raises(InputError, match="no traced scene file; its arrays do not fit"):
        TracedScene.load(file)


def test_a_material_beyond_those_named_is_refused(tmp_path):
    file = tmp_path / "paths.npz"
    trace_scene(scene(), SIZE, SPP, 7, FIRST).save(file)
    with np.load(file) as data:
        arrays = dict(data)
    arrays["material"][-1] = 3  # of two; the third is the sky
    np.savez(file, **arrays)
    with pytest.raises(InputError, match="no traced scene file; its arrays do not fit"):
        TracedScene.load(file)


def test_a_block_traced_on_demand_is_the_same_each_time(tmp_path):
    """Daylight, too: of snow more paths go on for it alone."""
    white = library(soil=(0.95, 0.9), paint=(0.75, 0.85))
    white = dataclasses.replace(white, albedo_rgb=np.full((3, 3), 0.9))
    on_demand = trace_on_demand(scene(), SIZE, SPP, 7, white)
    one, *others = (on_demand.blocks[i] for i in (0, 0, -1))  # of one
    for other in others:
        for f in dataclasses.fields(one):
            np.testing.assert_array_equal(getattr(one, f.name), getattr(other, f.name))
    assert (one.end < one.start[1:]).any()
    on_demand.save(tmp_path / "paths.npz")
    kept = trace_scene(scene(), SIZE, SPP, 7, white)
    back = TracedScene.load(tmp_path / "paths.npz")
    assert_same(back.shade(white, W, FWHM), kept.shade(white, W, FWHM))


@pytest.mark.parametrize("closed", [False, True])
def test_round_trip(tmp_path, monkeypatch, closed):
    monkeypatch.setattr("physics.simulator.traced.PATHS_PER_BLOCK", 1000)
    original = scene()
    if closed:
        shell = SceneObject(trimesh.creation.box(extents=(20, 20, 20)), "soil", 290.0, False)
        original = Scene([*original.objects, shell], original.camera)
    traced, file = trace_scene(original, SIZE, SPP, 7, FIRST), tmp_path / "paths.npz"
    traced.save(file)
    monkeypatch.setattr("physics.simulator.traced.PATHS_PER_BLOCK", 500)  # blocks are no content
    back = TracedScene.load(file)
    assert len(back.blocks) > len(traced.blocks) and (back.atmosphere is None) == closed
    shadings = (FIRST, W, FWHM, 0.05), (SECOND, W, FWHM, 0, STANDS_FOR)
    again = [back.shade(*args) for args in shadings]
    monkeypatch.setattr("physics.simulator.traced.PATHS_PER_BLOCK", 1000)
    for args, result in zip(shadings, again, strict=True):
        assert_same(traced.shade(*args), result)
    assert file.stat().st_size < 16 * SIZE[0] * SIZE[1] * SPP
    assert [f.name for f in tmp_path.iterdir()] == ["paths.npz"]
    file.write_bytes(file.read_bytes()[:5000])
    with pytest.raises(InputError, match="not a whole npz file"):
        TracedScene.load(file)
    np.savez(file, size=np.ones(2))
    with pytest.raises(InputError, match="no traced scene file; it lacks spp"):
        TracedScene.load(file)


def test_bad_input_is_one_sentence():
    traced = trace_scene(scene(), (4, 6), 1, 0, FIRST)
    with pytest.raises(InputError, match="materials lacks the scene's soil"):
        traced.shade(SECOND, W, FWHM, 0, {"paint": "clay"})
    with pytest.raises(InputError, match="no material 'mud'"):
        traced.shade(SECOND, W, FWHM, 0, {"soil": "mud", "paint": "clay"})
    with pytest.raises(InputError, match="no material 'paint'"):
        traced.shade(SECOND, W, FWHM, 0)
    with pytest.raises(InputError, match="NETD"):
        traced.shade(FIRST, W, FWHM, -1)
    with pytest.raises(InputError, match="curves cover"):
        traced.shade(FIRST, W + 5, FWHM)
    with pytest.raises(InputError, match="no 'sky'"):
        traced.shade(FIRST.subset(["soil", "paint"]), W, FWHM)
    with pytest.raises(InputError, match="seed"):
        trace_scene(scene(), (4, 6), 1, -1, FIRST)
    with pytest.raises(InputError, match="width must be a whole number of 1"):
        trace_scene(scene(), (4, 0), 1, 0, FIRST)


def test_paths_are_traced_in_threads(monkeypatch):
    """Every block in one, not in the caller's before they start."""
    threads, paths = [], Tracer.paths

    def seen(*args):
        threads.append(threading.current_thread())
        return paths(*args)

    monkeypatch.setattr("physics.simulator.traced.usual_threads", lambda: 2)
    monkeypatch.setattr(Tracer, "paths", seen)
    trace_scene(scene(), SIZE, SPP, 3, FIRST)
    assert threads and threading.main_thread() not in threads
