"""Fine-tuning and training at toy size: what they promise, not how good they are."""

import json
import multiprocessing
import os
import resource
import signal
import subprocess
import sys
import threading
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from conftest import hear_ctrl_c
from traced import one_thread  # noqa: F401
from traced import traced as traced_cube

import training.crops as crops
import training.finetune as module
import training.reshade as reshade
import training.samples as samples
import training.train as train_module
from physics import InputError, MaterialLibrary
from physics.bands import equidistant_bands
from physics.cube.heat_cube import HeatCube
from physics.known import known_arrays
from physics.library import SKY
from physics.simulator import simulate
from physics.simulator.presets import preset
from physics.simulator.traced import TracedScene
from texnet.circumstances import circumstances
from texnet.cli import _parser, main
from texnet.files.cube_io import write_cube
from texnet.files.library_io import with_sky
from texnet.files.weights import load_network, save_network
from texnet.learned import shipped_network, torch_model
from texnet.methods import by_network
from texnet.metrics import evaluate
from texnet.network import TeXNet
from texnet.pipeline import decompose
from training.crops import CalibratedCube, Crops
from training.finetune import calibrated, finetune
from training.reshade import ReshadedSet
from training.samples import draw
from training.scenes import SceneSet, Settings
from training.train import Draws, Training, WholeCheckpoints, fit

ROOT = Path(__file__).parent.parent
STARTER = MaterialLibrary.starter()
TINY = Settings(size=24, spp=8)
NEW = STARTER.subset(["sky", "sand", "ice", "steel"])
MATT = STARTER.subset([n for n in STARTER.names if n not in ("aluminium", "copper")])
DRAWS = 4  # per epoch: one step


@pytest.fixture(autouse=True)
def toy(monkeypatch):
    monkeypatch.setattr(module, "PER_EPOCH", DRAWS)
    monkeypatch.setattr(module, "HELD_OUT", 1)
    monkeypatch.setattr(samples, "BANDS", (4, 16))
    for of_draws in (samples, crops):
        monkeypatch.setattr(of_draws, "OBJECTS", (1, 4))
    monkeypatch.setattr(train_module, "WORKERS", 0)
    monkeypatch.setattr(ReshadedSet.__init__, "__defaults__", (0, TINY))
    monkeypatch.setattr(SceneSet.__init__, "__defaults__", (TINY,))


def network(seed=0):
    torch.manual_seed(seed)
    return TeXNet(width=8, dilations=(1,), messages=1).eval()


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("cache")


@pytest.fixture
def traced(cache):
    made = ReshadedSet(cache, "train", 2, NEW)
    made.make()
    return made


@pytest.fixture
def cube(traced):
    return traced.shade(0, *equidistant_bands(20), netd_k=0.05)[0]


def taken(cube, **answer):
    """A HeatCube, answered to: all of it sand at 300 K, lit evenly by both of two objects."""
    (height, width), index = cube.shape, NEW.names.index("sand")
    material = np.full((height, width), index)
    of = dict(
        material=material, material_names=NEW.names,
        material_probability=np.eye(len(NEW), dtype=np.float32)[:, material],
        temperature_k=np.full((height, width), 300, np.float32), sky=(1,),
        thermal_lighting=np.full((2, height, width), 0.5, np.float32),
        environment=np.stack([cube.radiance.max((1, 2)), cube.radiance.min((1, 2))]),
    )  # fmt: skip
    return CalibratedCube(cube, SimpleNamespace(**of | answer))


def weights(net):
    return {name: p.clone() for name, p in net.state_dict().items()}


def same(a, b):
    return all(torch.equal(a[name], b[name]) for name in a)


# --- scenes shaded again -----------------------------------------------------------------


def test_the_same_paths_serve_any_library(traced, cache):
    other = ReshadedSet(cache, "train", 2, MATT)
    assert other.path(0) == traced.path(0) and len(traced) == reshade.TURNS * 2
    a, b = traced[0], other[0]
    assert a.names == NEW.names and b.names == MATT.names
    # but for mixed pixels, where another material may have the majority
    assert np.mean(a.temperature_k == b.temperature_k) > 0.8
    assert np.mean(a.sky_view == b.sky_view) > 0.8
    assert (a.radiance != b.radiance).any()


def test_each_turn_has_other_materials_and_a_seed_says_which(traced, cache):
    again, other = (ReshadedSet(cache, "train", 2, MATT, seed) for seed in (0, 1))
    first = again[0]
    repeated = ReshadedSet(cache, "train", 2, MATT)[0]
    np.testing.assert_array_equal(first.radiance, repeated.radiance)
    for record in (again[2], other[0]):
        assert np.mean(record.temperature_k == first.temperature_k) > 0.8
        assert (record.radiance != first.radiance).any()
    names = TracedScene.load(traced.path(0)).materials
    assert len(np.unique(first.material[first.material != first.names.index(SKY)])) > 1 < len(names)


def test_tracing_takes_up_where_it_stopped(tmp_path):
    scenes, told = ReshadedSet(tmp_path, "test", 2, NEW), []

    def stop(done, total):
        if done == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        scenes.make(workers=1, progress=stop)
    kept = scenes.path(0).stat().st_mtime_ns
    scenes.make(workers=1, progress=lambda *a: told.append(a))
    assert told == [(1, 2), (2, 2)] and scenes.path(0).stat().st_mtime_ns == kept


def test_a_library_without_sky_gets_one(traced, cache):
    bare = NEW.subset([n for n in NEW.names if n != SKY])
    hues, words = np.arange(len(bare)) * 7.0, ["as measured"] * len(bare)
    own = MaterialLibrary(
        bare.names, np.linspace(7, 15, 30), bare.at(np.linspace(7.5, 14.5, 30)), hues, None, words
    )
    full = with_sky(own)
    assert tuple(full.hue_deg) == (*hues, STARTER.hue_deg[STARTER.sky_index])
    assert full.descriptions[:-1] == own.descriptions
    assert full.names == (*bare.names, SKY) and with_sky(NEW) is NEW
    w = np.linspace(8, 14, 77)
    np.testing.assert_allclose(full.at(w)[:-1], own.at(w), atol=1e-12)
    np.testing.assert_allclose(full.at(w)[-1], STARTER.at(w)[STARTER.sky_index], atol=1e-12)
    record = ReshadedSet(cache, "train", 2, own)[0]
    assert record.names == full.names
    far = MaterialLibrary(["a"], [3.0, 5.0], [[0.9, 0.9]])
    with pytest.raises(InputError, match="not 3-5 um"):
        with_sky(far)


def test_a_library_of_part_of_the_bands(traced, cache):
    w = np.linspace(9, 12, 40)
    part = MaterialLibrary(NEW.names, w, NEW.at(w))
    record = ReshadedSet(cache, "train", 2, part)[1]
    assert record.wavelength_um[[0, -1]] == pytest.approx([9.05, 11.95], abs=0.05)
    for seed in range(6):  # any bands that a draw may choose
        sample = draw(record, np.random.default_rng(seed))
        centre = sample.known.nodes_um
        assert centre.min() > 8.9 and centre.max() < 12.1
        assert len(centre) <= len(record.wavelength_um)
    few = MaterialLibrary(NEW.names, [9.0, 9.3], NEW.at([9.0, 9.3]))
    with pytest.raises(InputError, match="covers 9-9.3 um"):
        ReshadedSet(cache, "train", 2, few)
    with pytest.raises(InputError, match="no material but the sky"):
        ReshadedSet(cache, "train", 2, NEW.subset([SKY]))


@pytest.mark.parametrize("name", [SKY, "sand"])
def test_a_library_that_leaves_no_choice_is_refused(cache, name):
    with pytest.raises(InputError, match=f"it holds only {name}"):
        finetune(network(), NEW.subset([name]), cache)


@pytest.mark.parametrize("e", [0.9, 0.12, 0.04])
def test_weights_of_the_paths_stay_tame_whatever_the_metal(tmp_path, e):
    """Their mean square, bounce by bounce, grows like that of (1 - e) / (1 - traced_with)."""
    metal = MaterialLibrary(["sky", "metal"], [8.0, 14.0], [[0.5, 0.5], [e, e]])
    q = 1 - ReshadedSet(tmp_path, "train", 1, metal).traced_with
    assert (1 - e) ** 2 / q < 1


# --- fine-tuning -------------------------------------------------------------------------


def test_fine_tuning_lowers_the_loss_on_the_new_library(cache, traced, monkeypatch):
    monkeypatch.setattr(module, "LEARNING_RATE", 5e-3)  # three steps should show
    start, told = network(), []
    before = weights(start)
    better, history = finetune(
        start, NEW, cache, scenes=2, epochs=3, progress=lambda *a: told.append(a)
    )
    assert same(weights(start), before) and not same(weights(better), before)
    assert history["after"]["supervised"] < history["before"]["supervised"]
    assert told[-1] == (3 * DRAWS, 3 * DRAWS, "training") and told[0][2] == "scenes"
    assert history["materials"] == list(NEW.names) and history["terms"] == "both"
    assert json.loads(json.dumps(history)) == history


def test_a_worker_that_dies_is_said_in_words(tmp_path, monkeypatch):
    """As where /dev/shm is small, or memory runs out: torch says it by a RuntimeError."""
    for words, told in (
        ("DataLoader worker (pid 1) is killed by signal: Killed.", True),
        ("unable to allocate shared memory(shm) for file </torch_1>", True),
        ("another mistake", False),
        ("Caught RuntimeError in DataLoader worker process 0.\nRuntimeError: shapes", False),
    ):

        def stumble(*_, words=words, **__):
            try:
                raise RuntimeError(words)
            finally:
                raise RuntimeError("Please call iter(combined_loader) first.")

        monkeypatch.setattr(train_module.lightning.Trainer, "fit", stumble)
        monkeypatch.setattr(train_module, "Loader", lambda *_: SimpleNamespace(close=int))
        wanted = (InputError, "a worker died") if told else (RuntimeError, "combined_loader")
        with pytest.raises(wanted[0], match=wanted[1]):
            fit(None, None, None, tmp_path, epochs=1)


def test_nothing_of_a_loader_is_left_when_it_is_closed(monkeypatch):
    """Neither a worker nor a thread, which the end of all would break off at its last tasks."""
    monkeypatch.setattr(train_module, "WORKERS", 2)
    before = set(threading.enumerate())
    loader = train_module.Loader(["a", "b", "c"], range(3))
    draws = iter(loader)
    assert next(draws) == "a"
    assert set(threading.enumerate()) > before and len(multiprocessing.active_children()) == 2
    loader.close()
    assert set(threading.enumerate()) == before and not multiprocessing.active_children()


def test_a_checkpoint_on_a_full_disk_is_an_oserror(tmp_path):
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, hard))
    try:
        with pytest.raises(OSError, match="last.ckpt"):
            WholeCheckpoints().save_checkpoint({"w": torch.zeros(20_000)}, tmp_path / "last.ckpt")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        signal.signal(signal.SIGXFSZ, before)
    assert not list(tmp_path.iterdir())


def test_same_seed_same_weights_and_a_stopped_run_goes_on_to_them(tmp_path, cache, traced):
    def run(folder, seed=0, stop_at=None):
        def progress(done, total, what):
            if what == "training" and done == stop_at:
                raise KeyboardInterrupt

        (tmp_path / folder).mkdir(exist_ok=True)
        for made in traced.folder.parent.iterdir():
            if made.name != "runs" and not (tmp_path / folder / made.name).exists():
                (tmp_path / folder / made.name).symlink_to(made)
        return finetune(
            network(), NEW, tmp_path / folder, scenes=2, epochs=2, seed=seed, progress=progress
        )

    whole, history = run("whole")
    handler = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        run("stopped", stop_at=DRAWS + 2)
    assert signal.getsignal(signal.SIGINT) is handler
    assert list((tmp_path / "stopped" / "runs").glob("*/last.ckpt"))
    resumed, again = run("stopped")
    assert same(weights(whole), weights(resumed))
    assert again["after"] == history["after"] and again["before"] == history["before"]
    other, _ = run("other", seed=1)
    assert not same(weights(whole), weights(other))


def test_training_goes_on_to_the_same_weights_and_metrics(tmp_path, traced):
    draws, held_out = Draws(traced, 0), Draws(ReshadedSet(*_of(traced), 2, NEW, 5), 7)

    def run(folder, epochs):
        # the schedule is of three epochs, however soon a run stops
        part = Training(network(), 3)
        metrics = fit(part, draws, [held_out[0]], folder, epochs=epochs, per_epoch=DRAWS)
        return weights(part.network), metrics

    whole, metrics = run(tmp_path / "whole", 3)
    # of what validates, and not of what trains
    assert set(metrics) == {"accuracy", "cross_entropy", "temperature_rmse_k", "supervised"}
    first, _ = run(tmp_path / "part", 2)
    second, again = run(tmp_path / "part", 3)
    assert not same(whole, first) and same(whole, second) and metrics == again
    # a finished run is not run again
    third, again = run(tmp_path / "part", 3)
    assert same(whole, third) and metrics == again


def _of(scenes):
    return scenes.folder.parent, scenes.split


def test_half_of_the_bands_comes_to_tell_what_all_do(cache, cube, monkeypatch):
    monkeypatch.setattr(module, "CUBES_LEARNING_RATE", 5e-3)
    # a dozen steps: three may lower it or not, as the crops fall
    better, history = finetune(network(), NEW, cache, epochs=12, cubes=[cube])
    assert history["terms"] == "supervised" and history["before"].keys() == history["after"].keys()
    assert history["after"]["cross_entropy"] < history["before"]["cross_entropy"]


def test_materials_get_no_worse_without_truth(tmp_path, monkeypatch):
    """In a wood, whose mixed pixels fit wrong materials, and mixtures of curves, better than the
    right one: by the misfit of Eq. 1 as many draws name 1.7 points fewer right."""
    monkeypatch.setattr(module, "PER_EPOCH", 160)
    monkeypatch.setattr(module, "CUBES_LEARNING_RATE", 2e-4)  # fewer steps should show
    w, fwhm = equidistant_bands(18)
    wood, truth = simulate(
        preset("forest", 11), wavelength_um=w, fwhm_um=fwhm, size=(48, 72), spp=16
    )
    tuned, _ = finetune(shipped_network(), STARTER, tmp_path, epochs=1, cubes=[wood])
    before, after = (
        evaluate(decompose(wood, model=torch_model(net)), truth) for net in (None, tuned)
    )
    # as much as the draws' seed makes of it
    assert after["material_accuracy"] > before["material_accuracy"] - 0.005
    assert after["cross_entropy"] < before["cross_entropy"] + 0.03
    assert after["temperature_rmse_k"] < before["temperature_rmse_k"] + 0.01


def test_another_noise_is_another_run(cache, cube):
    """What was learned of a cube thought noisier is not taken for what its right noise teaches."""
    noisy = HeatCube(cube.radiance, cube.wavelength_um, cube.fwhm_um, 0.5)
    results = [
        weights(finetune(network(), NEW, cache, epochs=1, cubes=[c])[0]) for c in (cube, noisy)
    ]
    assert any(not torch.equal(a, results[1][name]) for name, a in results[0].items())


def test_what_validates_is_not_what_trains(cache, cube, monkeypatch):
    """By any seed."""
    seen = []
    monkeypatch.setattr(module, "_measure", lambda m, draws: seen.append(draws) or {})
    monkeypatch.setattr(module, "fit", lambda m, draws, *_, **__: seen.append(draws))
    tall = HeatCube(np.tile(cube.radiance, (1, 5, 5)), cube.wavelength_um, cube.fwhm_um, 0.05)
    finetune(network(), NEW, cache, epochs=1, cubes=[tall], seed=train_module.VALIDATION_SEED)
    held_out, draws, _ = seen
    for i in range(6):
        assert not torch.equal(held_out[i][0].radiance, draws[i][0].radiance)


@pytest.mark.parametrize("of", [12, 1])
def test_all_that_is_held_out_is_measured(cache, cube, monkeypatch, of):
    monkeypatch.setattr(module, "HELD_OUT", 3)
    crops = set()

    class Measuring:
        def measures(self, sample, _):
            crops.add(sample.temperature_k.sum().item())
            return {"accuracy": 0.0}

    warm = [taken(cube, temperature_k=np.full(cube.shape, 300.0 + i)) for i in range(of)]
    module._measure(Measuring(), Crops(warm, with_sky(NEW), 0, 64))
    assert len(crops) == of
    crops.clear()
    measure = module._measure
    monkeypatch.setattr(module, "_measure", lambda _, draws: measure(Measuring(), draws))
    monkeypatch.setattr(module, "fit", lambda *_, **__: None)
    finetune(network(), NEW, cache, scenes=1, epochs=1)
    assert len(crops) == 3


@pytest.mark.parametrize("what", ["checkpoint", "scene"])
def test_a_damaged_file_of_the_cache_is_named(tmp_path, what, monkeypatch):
    scenes = ReshadedSet(tmp_path, "train", 1, NEW)
    scenes.make()
    file = tmp_path / "run" / "last.ckpt" if what == "checkpoint" else scenes.path(0)
    if what == "checkpoint":
        file.parent.mkdir()
        file.write_bytes(b"PK" + bytes(100))
    else:
        file.write_bytes(file.read_bytes()[:-1000])
        monkeypatch.setattr(train_module, "WORKERS", 1)
    with pytest.raises(InputError, match=f"(?s)^(?!.*Traceback).*{file.name}") as caught:
        part = Training(network(), 1)
        fit(part, Draws(scenes, 0), None, tmp_path / "run", epochs=1, per_epoch=DRAWS)
    assert "\n" not in str(caught.value)


def test_many_cubes_take_few_open_files(cube):
    """Workers share tensors by an open file each, of which many systems allow 1024."""
    many = Crops([taken(cube)] * 3, NEW, 0, 96)
    tensors = [a for c in many.cubes for a in c if isinstance(a, torch.Tensor)]
    of_views = [
        a for c in many.cubes for v in c[-1] for a in (*v, *v.known.values(), *v.scene.values())
    ]
    assert len(tensors) == 3 and not any(isinstance(a, torch.Tensor) for a in of_views)


def test_a_cube_that_does_not_fit_is_told(cube, cache):
    w = cube.wavelength_um + 3
    far = HeatCube(cube.radiance, w, cube.fwhm_um, 0.05)
    with pytest.raises(InputError, match="^cube 2 of 2: "):
        finetune(network(), NEW, cache, epochs=1, cubes=[cube, far])


def test_crops_are_small_and_know_the_whole_cube(cube):
    tall = HeatCube(np.tile(cube.radiance, (1, 5, 1)), cube.wavelength_um, cube.fwhm_um, 0.05)
    both = Crops([taken(tall), taken(cube)], NEW, 0, 96)
    assert len(both) == 2
    shapes = {tuple(both[i][0].radiance.shape) for i in range(4)}
    assert shapes == {(10, 96, 24), (10, 24, 24)}
    sample, _ = both[2]
    again, _ = Crops([taken(tall), taken(cube)], NEW, 0, 96)[2]
    assert torch.equal(sample.radiance, again.radiance)
    environments = [v.known["environment"] for v in both.cubes[0][-1]]
    assert any(np.array_equal(sample.known.environment, e) for e in environments)
    narrow = MaterialLibrary(NEW.names, [9.0, 12.0], NEW.at([9.0, 12.0]))
    with pytest.raises(InputError, match="its curves cover 9-12 um"):
        Crops([taken(cube)], narrow, 0, 96)
    pixel = HeatCube(cube.radiance[:, :1, :1], cube.wavelength_um, cube.fwhm_um, 0.05)
    assert len(Crops([taken(pixel)], NEW, 0, 96).cubes[0][-1]) == 1  # one object at most
    few = cube.only(np.arange(cube.bands) < 3)
    with pytest.raises(InputError, match="needs 4 or more"):
        Crops([taken(few)], NEW, 0, 96)


def test_a_camera_s_gain_is_not_learned():
    seen = traced_cube("forest", 54)[0]
    bright = HeatCube(1.03 * seen.radiance, seen.wavelength_um, seen.fwhm_um, seen.netd_k)
    right, taken = (calibrated(c, STARTER, shipped_network()).cube for c in (seen, bright))
    np.testing.assert_array_equal(right.radiance, seen.radiance)
    assert np.median(taken.radiance / seen.radiance) == pytest.approx(1, abs=0.005)
    fine = HeatCube(seen.radiance, seen.wavelength_um, seen.fwhm_um, 0.005)
    as_taken = decompose(fine, model=torch_model()).netd_k
    assert calibrated(fine, STARTER, shipped_network()).cube.netd_k == as_taken


def test_a_sky_that_decompose_assumes_is_learned_with():
    seen = traced_cube("forest", 54)[0]
    below = HeatCube(seen.radiance[:, 30:], seen.wavelength_um, seen.fwhm_um, seen.netd_k)
    taken = calibrated(below, STARTER, shipped_network())
    assert bool(taken.assumed_air) == decompose(below, model=torch_model()).sky_assumed
    for air in (None, taken.assumed_air):
        crops = Crops([taken._replace(assumed_air=air)], STARTER, 0, 96)
        skies = [v.known["sky_object"].sum() for v in crops.cubes[0][-1]]
        assert (np.array(skies[1:]) > 0).all() == bool(air) and skies[0] == 0


def test_curves_that_decompose_takes_to_be_off_are_learned_with_as_such():
    seen = traced_cube("street", 54)[0]
    waves = 0.01 * np.sin(STARTER.wavelength_um + np.arange(len(STARTER))[:, None])
    waves[STARTER.sky_index] = 0
    off = MaterialLibrary(STARTER.names, STARTER.wavelength_um, STARTER.emissivity - 0.01 + waves)
    taken = calibrated(seen, off, shipped_network())
    assert taken.curve_error == decompose(seen, off, model=torch_model()).curve_error > 0
    alike, certain = (
        Crops([of], off, 0, 96).cubes[0][-1] for of in (taken, taken._replace(curve_error=0.0))
    )
    for view, without in zip(alike, certain, strict=True):
        assert len(view.known["curve_spread"]) and not len(without.known["curve_spread"])
    # those of the environment that decompose answers in, which its usual V tells
    found = circumstances(seen, off, by_network(off, torch_model()).looks, k=3).environment
    assert found.usual_lighting is not None
    own = known_arrays(taken.cube, off, found)
    seen, told = alike[2].seen, alike[2].known
    np.testing.assert_allclose(told["usual_lighting"], own["usual_lighting"], rtol=1e-5)
    np.testing.assert_allclose(told["curve_spread"], own["curve_spread"][:, seen], rtol=1e-5)


def test_the_usual_lighting_that_decompose_finds_is_learned_with():
    """Of the ground's pixels; a fire's, which are lit by nothing that others are, have no say."""
    seen = traced_cube("street", 4)[0]
    hot = seen.radiance.copy()
    hot[:, -16:, 8:56] *= 40
    for radiance in (seen.radiance, hot):
        cube = HeatCube(radiance, seen.wavelength_um, seen.fwhm_um, seen.netd_k)
        taken = calibrated(cube, STARTER, shipped_network())
        looks = by_network(STARTER, torch_model()).looks
        found = circumstances(cube, STARTER, looks, k=4).environment
        assert found.usual_lighting is not None
        usual = Crops([taken], STARTER, 0, 96).cubes[0][-1][3].known["usual_lighting"]
        np.testing.assert_allclose(usual, found.usual_lighting, rtol=1e-5)
    everywhere = Crops([taken._replace(left_out=None)], STARTER, 0, 96).cubes[0][-1][3]
    assert not np.allclose(everywhere.known["usual_lighting"], usual)


def test_the_answer_lies_where_the_crop_lies(cube):
    tall = HeatCube(np.tile(cube.radiance, (1, 5, 1)), cube.wavelength_um, cube.fwhm_um, 0.05)
    t = 280 + np.arange(tall.dead.size, dtype=np.float32).reshape(tall.shape) / 100
    v = np.stack([t - t.min(), t.max() - t]) / np.ptp(t)
    of = taken(tall, temperature_k=t, thermal_lighting=v)
    crops, glances = Crops([of], NEW, 0, 20), 0
    views = {v.known["environment"].tobytes(): v.seen for v in crops.cubes[0][-1]}
    assert len({seen.tobytes() for seen in views.values()}) > 2  # other halves of the bands
    for i in range(12):
        s, _ = crops[i]
        seen = views[s.known.environment.numpy().tobytes()]
        top, left = np.argwhere(t == s.temperature_k[0, 0].item())[0]
        at = slice(top, top + 20), slice(left, left + 20)
        np.testing.assert_array_equal(s.temperature_k, t[at])
        np.testing.assert_array_equal(s.radiance, tall.radiance[seen][:, *at])
        np.testing.assert_array_equal(s.sky_view, v[1][at])
        x = np.tensordot(of.answer.environment.T, v[:, *at], 1)[seen]
        np.testing.assert_allclose(s.texture, x, rtol=1e-5)
        if s.glance:
            glances += 1
            assert (s.glance.top, s.glance.left) == (top, left)
            # the mean of a patch is among the pixels that it is the mean of
            patch = tall.radiance[seen][:, top : top + 8, left : left + 8]
            step = s.glance.step
            near = s.glance.radiance[:, top // step + 1, left // step].numpy()
            assert (near <= patch.max((1, 2))).all() and (near >= patch.min((1, 2))).all()
    assert 2 <= glances <= 10


def test_what_was_in_doubt_remains_so(cube):
    """Materials are drawn by their probability; what is sky has no T."""
    p = np.zeros((len(NEW), *cube.shape), np.float32)
    sand, steel, sky = (NEW.names.index(name) for name in ("sand", "steel", "sky"))
    p[sand], p[steel] = 0.7, 0.3
    p[:, 0], p[sky, 0] = 0, 1
    material = p.argmax(0)
    sample, _ = Crops([taken(cube, material_probability=p, material=material)], NEW, 0, 96)[0]
    assert (sample.material[0] == sky).all() and not sample.ground[0].any()
    below = sample.material[1:]
    assert ((below == sand) | (below == steel)).all() and sample.ground[1:].all()
    n = below.numel()
    assert (below == sand).float().mean() == pytest.approx(0.7, abs=4 * (0.21 / n) ** 0.5)


def test_of_a_fire_nothing_is_learned():
    """Neither of it nor of what is answered to it: it is as if it had not been measured."""
    seen = traced_cube("street", 8)[0]
    hot = seen.radiance.copy()
    hot[:, 20:24, 8:16] *= 40
    fire = HeatCube(hot, seen.wavelength_um, seen.fwhm_um, seen.netd_k)
    crops = Crops([calibrated(fire, STARTER, shipped_network())], STARTER, 0, 96)
    for i in range(4):
        sample, _ = crops[i]
        assert sample.radiance.max() < 1.2 * seen.radiance.max()
        assert sample.temperature_k.max() < 400


def test_crops_show_what_was_measured(cube):
    s = np.zeros((cube.bands, 60, 200), np.float32)
    s[:, :, :100] = np.tile(cube.radiance, (1, 3, 5))[:, :60, :100]
    dead, whole = (
        Crops([taken(HeatCube(part, cube.wavelength_um, cube.fwhm_um, 0.05))], NEW, 0, 48)
        for part in (s, s[:, :, :100])
    )
    for i in range(20):
        crop = dead[i][0].radiance
        assert crop.shape == whole[i][0].radiance.shape == (cube.bands // 2, 48, 48)
        # at most a tenth are copies of the last column
        assert (crop == crop[:, :, -1:]).all(dim=0).float().mean() < 0.2


# --- the command line --------------------------------------------------------------------


@pytest.fixture
def files(tmp_path, cube):
    NEW.subset(["sand", "ice", "steel"]).save(tmp_path / "library.json")
    save_network(network(), tmp_path / "model.safetensors", {"made": "up"})
    write_cube(cube, tmp_path / "cube.npz")
    return tmp_path


def command(files, cache, *more, out="out.safetensors"):
    return [
        "finetune", "--library", files / "library.json", "--model", files / "model.safetensors",
        "--out", files / out, "--cache", cache, "--epochs", "1", *more,
    ]  # fmt: skip


def run(capfd, words):
    code = main([str(w) for w in words])
    return code, *capfd.readouterr()


def test_the_command_fine_tunes_on_scenes(capfd, files, cache, traced):
    code, out, err = run(capfd, command(files, cache, "--scenes", "2", "--json"))
    assert code == 0 and "has no sky; the starter library's was used" in out
    assert "Lightning" not in err and "GPU" not in err and "Trainer" not in err
    result = json.loads(out.splitlines()[-1])
    assert result["command"] == "finetune" and result["before"]["accuracy"] <= 1
    net, history = load_network(files / "out.safetensors")
    assert history["from"] == {"made": "up"} and history["sky"] == "the starter library's"


def test_the_command_fine_tunes_on_cubes(capfd, files, cache):
    code, out, _ = run(capfd, command(files, cache, "--cubes", files / "cube.npz"))
    assert code == 0 and "half of the cubes' bands" in out and (files / "out.safetensors").exists()
    assert "compare on a cube with one" in out
    code, _, err = run(capfd, command(files, __file__, "--cubes", files / "cube.npz"))
    assert code == 2 and "cannot make the folder" in err


def help_of(capsys):
    with pytest.raises(SystemExit):
        _parser().parse_args(["finetune", "--help"])
    return " ".join(capsys.readouterr().out.split())


def test_the_defaults_are_those_of_the_modules(capsys):
    train = _parser().parse_args(["train", "--out", "x"])
    assert (train.scenes, train.epochs) == (train_module.SCENES, train_module.EPOCHS)
    tune = _parser().parse_args(["finetune", "--out", "x", "--library", "y"])
    assert (tune.scenes, tune.epochs) == (None, module.EPOCHS)
    assert f"simulated scenes to train on, default: {module.SCENES}" in help_of(capsys)


@pytest.mark.parametrize(
    "change, sentence",
    [
        (["--library", "none.json"], "library: cannot read none.json"),
        (["--model", "none.safetensors"], "model: cannot read none.safetensors: there is no"),
        (["--cubes", "none.npz"], "cube: there is no file none.npz"),
        (["--out", "no/folder.safetensors"], "there is no folder no"),
        (["--epochs", "0"], "need a whole number 1-10000"),
        (["--scenes", "many"], "need a whole number 1-100000"),
        (["--cubes", "none.npz", "--scenes", "5"], "leave out --scenes"),
        (["--cache", __file__], "cannot make the folder"),
    ],
)
def test_wrong_input_is_one_sentence(capfd, files, cache, change, sentence):
    code, out, err = run(capfd, command(files, cache, *change))
    assert code == 2 and out == "" and not (files / "out.safetensors").exists()
    assert err.startswith("texnet: error: ") and err.count("\n") == 1 and sentence in err


@pytest.mark.parametrize("name", ["train", "finetune"])
def test_without_the_extra_the_command_says_how_to_get_it(capfd, files, cache, monkeypatch, name):
    for loaded in [n for n in sys.modules if n.split(".")[0] == "training"]:
        monkeypatch.delitem(sys.modules, loaded)
    monkeypatch.setitem(sys.modules, "pytorch_lightning", None)
    train = ["train", "--out", files / "out.safetensors"]
    words = {"train": train, "finetune": command(files, cache)}
    code, out, err = run(capfd, words[name])
    assert code == 2 and err.count("\n") == 1 and "pip install -e '.[train]'" in err


STOPPED = """
import sys, training.finetune as f, training.train as t
from training.reshade import ReshadedSet
from training.scenes import Settings
from texnet.cli import main
if __name__ == "__main__":
    f.PER_EPOCH, f.HELD_OUT, t.WORKERS = 4, 1, 1
    ReshadedSet.__init__.__defaults__ = (0, Settings(size=24, spp=8))
    real = t.Report.on_train_batch_end
    def told(self, trainer, *a):
        real(self, trainer, *a)
        print("draw", trainer.current_epoch, flush=True)
    t.Report.on_train_batch_end = told
    sys.exit(main())
"""


RESUME = "run the same command again to resume from the last epoch"


@pytest.mark.parametrize(
    "number, code, said",
    [
        (signal.SIGINT, 130, f"texnet: stopped; {RESUME}.\n"),
        (signal.SIGTERM, 143, ""),
    ],
)
def test_a_signal_to_all_of_it_ends_it_without_a_traceback(
    files, cache, traced, number, code, said
):
    words = [str(w) for w in command(files, cache, "--scenes", "2", "--epochs", "500")]
    (files / "stopped.py").write_text(STOPPED)
    process = subprocess.Popen(
        [sys.executable, files / "stopped.py", *words], cwd=ROOT, start_new_session=True,
        env=os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"}, stdout=subprocess.PIPE,
        stderr=subprocess.PIPE, text=True, preexec_fn=hear_ctrl_c,
    )  # fmt: skip
    while process.stdout.readline() not in ("draw 1\n", ""):
        pass
    os.killpg(process.pid, number)
    _, err = process.communicate(timeout=60)
    assert (process.returncode, err) == (code, said)
    assert not (files / "out.safetensors").exists()
