"""Sets of training scenes: what is in a record, and that a set is the same however it is made."""

import dataclasses
import multiprocessing
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from conftest import hear_ctrl_c

from physics import InputError, MaterialLibrary
from physics.library import SKY
from physics.planck import noise_sigma, planck
from physics.simulator import Scene
from physics.simulator.presets.random_scene import random_scene
from training import scenes
from training.scenes import BASE_SEED, Record, SceneSet, Settings, make_record, scene_of
from training.vary import vary

TINY = Settings(size=24, spp=16, bands=48)
COUNT = 6
STARTER = MaterialLibrary.starter()
ROOT = Path(__file__).parent.parent


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A set of COUNT scenes, made by two workers."""
    told = []
    made = SceneSet(tmp_path_factory.mktemp("made"), "train", COUNT, TINY)
    made.make(workers=2, progress=lambda *a: told.append(a))
    assert told == [(i, COUNT) for i in range(COUNT + 1)]
    return made


def contents(scene_set):
    return {p.name: p.read_bytes() for p in scene_set.folder.iterdir()}


def is_varied(record):
    return not np.allclose(record.curves, STARTER.at(record.wavelength_um))


# ---------------------------------------------------------------- records


def test_records_hold_what_they_say(made):
    assert len(made) == COUNT and len(list(made)) == COUNT
    for r in made:
        n, h = TINY.bands, TINY.size
        assert r.radiance.shape == r.texture.shape == (n, h, h)
        assert r.curves.shape == (len(r.names), n) and r.wavelength_um.shape == (n,)
        for key in ("temperature_k", "sky_view", "material"):
            assert getattr(r, key).shape == (h, h)
        kinds = {f.name: getattr(getattr(r, f.name), "dtype", None) for f in dataclasses.fields(r)}
        assert kinds.pop("texture") == np.float16 and kinds.pop("material") == np.uint8
        assert kinds.pop("wavelength_um") == np.float64 and kinds.pop("seed") is None
        assert kinds.pop("names") is None and set(kinds.values()) == {np.dtype(np.float32)}
        sky = r.material == r.names.index(SKY)
        assert not r.texture[:, sky].any() and (r.sky_view[sky] == 1).all()
        assert r.texture[:, ~sky].min() > 0 and r.radiance.min() > 0
    libraries = [is_varied(r) for r in made]
    assert any(libraries) and not all(libraries)


def test_equation_1_holds_in_pixels_of_one_material(made):
    for r in made:
        w = r.wavelength_um[:, None, None]
        e = r.curves[r.material].transpose(2, 0, 1)
        padded = np.pad(r.material, 1, mode="edge")
        near = np.lib.stride_tricks.sliding_window_view(padded, (3, 3))
        pure = (near == r.material[..., None, None]).all((2, 3))
        pure &= r.material != r.names.index(SKY)
        own, lit = e * planck(w, r.temperature_k), (1 - e) * r.texture.astype(float)
        error = lambda s: np.abs(r.radiance - s)[:, pure] / noise_sigma(w, 0.05)[:, 0]  # noqa: B023
        # What is left: X in half precision (up to half of this noise) and warm and cold, or
        # a little of something else, in one pixel.
        assert pure.any() and np.median(error(own + lit)) < 1
        assert np.median(error(own)) > 20 * np.median(error(own + lit))


def test_the_library_changes_nothing_but_the_light(made, monkeypatch):
    i = next(i for i, r in enumerate(made) if is_varied(r))
    monkeypatch.setattr(scenes, "vary", lambda library, rng: library)
    plain = make_record(TINY, "train", i)
    for key in ("material", "temperature_k", "sky_view"):
        np.testing.assert_array_equal(getattr(plain, key), getattr(made[i], key))
    assert (plain.radiance != made[i].radiance).any()


def test_splits_share_no_seed(made):
    reach = scenes.MAX_SCENES * scenes.MAX_TRIES
    first = sorted([0, *scenes.BASE_SEED.values()])
    assert (np.diff(first) >= reach).all() and first[1] > 9999
    assert [r.seed for r in made] == [scenes.BASE_SEED["train"] + i for i in range(COUNT)]
    assert made[0].seed != make_record(TINY, "test", 0).seed


def test_every_other_scene_is_enclosed_but_of_the_test():
    """What is tested stays what it was before there were any."""
    of = lambda split, n: [scene_of(BASE_SEED[split] + i) for i in range(n)]
    for split in ("train", "validation"):
        outdoors = {i: s for i, s in enumerate(of(split, 8)) if s.atmosphere is not None}
        assert all(s.name.startswith("enclosed") == (i % 2 == 1) for i, s in outdoors.items())
    for i, scene in enumerate(of("test", 4)):
        same = random_scene(BASE_SEED["test"] + i)
        assert scene.name == same.name and len(scene.objects) == len(same.objects)


def test_a_scene_that_leaks_gives_way_to_another(monkeypatch):
    def some_leak(seed):
        scene = scene_of(seed)
        # Outdoors without an atmosphere is not closed.
        return Scene(scene.objects, scene.camera) if seed < bad_below else scene

    monkeypatch.setattr(scenes, "scene_of", some_leak)
    monkeypatch.setattr(scenes, "MAX_TRIES", 2)
    base = scenes.BASE_SEED["validation"]
    bad_below = base + scenes.MAX_SCENES
    assert make_record(TINY, "validation", 1).seed == base + 1 + scenes.MAX_SCENES
    bad_below = 10 * base
    with pytest.raises(InputError, match="not closed"):
        make_record(TINY, "validation", 1)


# ---------------------------------------------------------------- varied libraries


def test_varied_libraries_are_plausible_and_others():
    sky = STARTER.sky_index
    for seed in range(20):
        varied = vary(STARTER, np.random.default_rng(seed))
        assert varied.names == STARTER.names
        np.testing.assert_array_equal(varied.emissivity[sky], STARTER.emissivity[sky])
        solid = np.delete(varied.emissivity, sky, axis=0)
        assert solid.min() >= 0.02 and solid.max() <= 0.995
        change = np.abs(varied.emissivity - STARTER.emissivity).max(axis=1)
        assert (np.delete(change, sky) > 1e-3).all()
        again = vary(STARTER, np.random.default_rng(seed))
        np.testing.assert_array_equal(varied.emissivity, again.emissivity)


def test_a_library_of_one_material_can_be_varied():
    one = STARTER.subset(["water"])
    assert (vary(one, np.random.default_rng(0)).emissivity != one.emissivity).any()


# ---------------------------------------------------------------- making a set


def test_the_number_of_workers_does_not_matter(made, tmp_path):
    alone = SceneSet(tmp_path / "a" / "b", "train", COUNT, TINY)
    alone.make(workers=1)
    assert contents(alone) == contents(made)


RUN = """
import sys
from training.scenes import SceneSet, Settings
s = SceneSet(sys.argv[1], "train", int(sys.argv[2]), Settings(size=24, spp=16, bands=48))
s.make(workers=2, progress=lambda done, total: print(done, flush=True))
"""


@pytest.mark.parametrize("with_signal", [signal.SIGINT, signal.SIGKILL])
def test_an_interrupted_run_ends_whole_and_can_be_taken_up(made, tmp_path, with_signal):
    run = subprocess.Popen(
        [sys.executable, "-c", RUN, str(tmp_path), "500"], cwd=ROOT, start_new_session=True,
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, preexec_fn=hear_ctrl_c,
    )  # fmt: skip
    while run.stdout.readline() not in ("2\n", ""):
        pass
    # Ctrl-C reaches the whole group, a kill the one process.
    (os.killpg if with_signal == signal.SIGINT else os.kill)(run.pid, with_signal)
    began = time.monotonic()
    errors = run.communicate()[1]
    while time.monotonic() < began + 20:
        try:
            os.killpg(run.pid, 0)
        except ProcessLookupError:
            break
        time.sleep(0.05)
    else:
        pytest.fail("a worker lives on")
    if with_signal == signal.SIGINT:
        assert errors.count("Traceback") == 1 and "KeyboardInterrupt" in errors
    rest = SceneSet(tmp_path, "train", COUNT, TINY)
    expected = contents(made)
    kept = {n: c for n, c in contents(rest).items() if n in expected}
    assert len(kept) >= 3 and kept.items() <= expected.items()
    assert not [p.name for p in rest.folder.iterdir() if p.name.startswith(".")]
    rest.make(workers=1)
    assert {n: contents(rest)[n] for n in expected} == expected


class Mortal(SceneSet):
    """Its one worker, having made a scene, dies before it is given the next."""

    def render(self, i):
        if self.path(0).exists():
            os.kill(os.getpid(), signal.SIGKILL)
        return super().render(i)


def test_a_worker_that_dies_is_said_to_have_died(tmp_path):
    dying = Mortal(tmp_path, "train", 3, TINY)
    with pytest.raises(InputError, match="a worker died"):
        dying.make(workers=1)
    assert dying.path(0).exists() and not dying.path(1).exists()


def test_a_worker_that_dies_between_two_scenes_is_said_to_have_died(tmp_path):
    some = SceneSet(tmp_path, "train", 3, TINY)

    def kill(done, total):
        if done:
            (worker,) = multiprocessing.active_children()
            worker.kill()
            worker.join()

    with pytest.raises(InputError, match="a worker died"):
        some.make(workers=1, progress=kill)
    assert some.path(0).exists()


def test_a_made_set_is_not_made_again(made):
    before = {p.name: p.stat().st_mtime_ns for p in made.folder.iterdir()}
    told = []
    made.make(progress=lambda *a: told.append(a))
    assert told == [(COUNT, COUNT)]
    assert {p.name: p.stat().st_mtime_ns for p in made.folder.iterdir()} == before


def test_the_folder_says_what_made_it(tmp_path, monkeypatch):
    folder = lambda **change: (
        SceneSet(tmp_path, "test", 1, dataclasses.replace(TINY, **change)).folder
    )
    folders = {folder(), folder(size=25), folder(spp=17), folder(bands=49)}
    assert len(folders) == 4 and folder() in folders
    assert SceneSet(tmp_path, "train", 9, TINY).folder == folder()
    monkeypatch.setitem(scenes.BASE_SEED, "test", 4_000_000)
    assert folder() not in folders


def test_bad_input_is_one_sentence(tmp_path, made):
    with pytest.raises(InputError, match="no split 'tset'"):
        SceneSet(tmp_path, "tset", 1)
    with pytest.raises(InputError, match="1 to 100000 scenes"):
        SceneSet(tmp_path, "test", 0)
    unmade = SceneSet(tmp_path, "test", 2, Settings(spp=0))
    with pytest.raises(InputError, match="No such file"):
        unmade[0]
    with pytest.raises(IndexError):
        unmade[2]
    with pytest.raises(InputError, match="spp must be a whole number of 1"):  # as told by a worker
        unmade.make(workers=1)
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="cannot make the folder"):
        SceneSet(tmp_path / "file", "test", 2, TINY).make()
    part = tmp_path / "part.npz"
    part.write_bytes(made.path(0).read_bytes()[:999])
    with pytest.raises(InputError, match="scene record: cannot read"):
        Record.load(part)


@pytest.mark.parametrize(
    "key, wrong",
    [
        ("names", np.array("sky")), ("seed", np.ones(2)), ("radiance", np.ones(5)),
        ("material", np.ones((2, 3), np.uint8)), ("curves", np.ones((2, 3))),
    ],
)  # fmt: skip
def test_arrays_that_do_not_fit_are_refused(tmp_path, made, key, wrong):
    with np.load(made.path(0)) as data:
        np.savez(tmp_path / "wrong.npz", **(dict(data) | {key: wrong}))
    with pytest.raises(InputError, match="no scene record file; its arrays do not fit"):
        Record.load(tmp_path / "wrong.npz")
