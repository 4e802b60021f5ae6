"""A time budget: the most accurate method that fits, whatever the machine measures."""

import json
from dataclasses import replace
from types import SimpleNamespace
from unittest import mock

import made_up
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import texnet.budget as module
from physics import HeatCube, InputError, MaterialLibrary
from physics.planck import planck
from texnet.budget import CROP, best_first, choose, first_within, middle, thinned
from texnet.cli import main
from texnet.files.cube_io import write_cube
from texnet.methods import METHODS

SLOW_IS_BETTER = {"careful": 40.0, "good": 20.0, "quick": 5.0}  # most accurate first


def of(seconds):
    return lambda budget: first_within(budget, seconds, seconds.get, 2.0)


@pytest.mark.parametrize(
    "budget, method",
    [(1000, "careful"), (40, "careful"), (39, "good"), (20, "good"), (6, "quick"), (5, "quick")],
)
def test_the_better_method_where_time_allows_and_the_faster_where_not(budget, method):
    assert of(SLOW_IS_BETTER)(budget) == (method, SLOW_IS_BETTER[method])


@given(st.lists(st.floats(0.1, 1e3), min_size=1, max_size=6), st.floats(0.1, 2e3), st.floats(1, 10))
def test_more_time_never_makes_it_worse(seconds, budget, times):
    rank = dict(enumerate(seconds))
    if budget < min(seconds):
        with pytest.raises(InputError):
            of(rank)(budget)
        return
    less, more = of(rank)(budget), of(rank)(times * budget)
    assert more[0] <= less[0] and less[1] <= budget


def test_a_slower_and_worse_method_is_never_chosen_nor_even_timed_when_a_better_one_fits():
    timed = []

    def seconds(method):
        timed.append(method)
        return {"best": 10.0, "worse and slower": 30.0}[method]

    assert first_within(15, ["best", "worse and slower"], seconds, 2.0)[0] == "best"
    assert timed == ["best"]


def test_where_nothing_fits_it_says_what_the_fastest_takes():
    with pytest.raises(InputError, match=r"quick, takes 5\.0, 10 s in all"):
        of(SLOW_IS_BETTER)(4.9)


@pytest.mark.parametrize("bands", [1, 4, 7, 30, 54, 400])
def test_every_method_is_ranked_at_any_number_of_bands(bands):
    assert sorted(best_first(bands)) == sorted(METHODS)


@pytest.fixture
def measured(tmp_path, monkeypatch):
    """measured(rows) puts a table in place of the package's."""
    table = tmp_path / "methods.csv"
    monkeypatch.setattr(module, "MEASURED", table)
    head = "# by\nbands,method,temperature_rmse_k,material_accuracy,texture_correlation\n"
    return lambda *rows: table.write_text(head + "\n".join(rows) + "\n")


def test_the_nearest_number_of_bands_is_by_ratio(measured):
    measured("4,a,1,0.9,0.9", "4,b,2,0.8,0.8", "64,a,2,0.1,0.1", "64,b,1,0.2,0.2")
    assert best_first(15) == ["a", "b"]
    assert best_first(17) == ["b", "a"]


def test_the_best_is_best_in_most_and_less_is_better_of_temperature(measured):
    measured("4,a,1.0,0.7,0.9", "4,b,1.5,0.8,0.8", "4,c,9.0,0.6,0.7")
    assert best_first(4) == ["a", "b", "c"]
    measured("4,a,9.0,0.7,0.9", "4,b,1.5,0.8,0.8", "4,c,1.0,0.6,0.7")
    assert best_first(4)[0] == "b"


def test_the_middle_of_a_cube_is_that_and_of_a_small_one_all():
    cube = made_up.cube(made_up.truth(40, CROP + 10))
    part = middle(cube, CROP)
    np.testing.assert_array_equal(part.radiance, cube.radiance[:, :, 5:-5])
    assert part.netd_k == cube.netd_k


def test_a_thinned_cube_is_of_all_of_it():
    cube = made_up.cube(made_up.truth(140, 20))
    cube = replace(cube, relative_noise=np.arange(1.0, cube.bands + 1))
    part = thinned(cube, 64)
    np.testing.assert_array_equal(part.radiance, cube.radiance[:, ::2])
    np.testing.assert_array_equal(part.sigma, cube.sigma)


# --- the whole of it -----------------------------------------------------------------------


@pytest.fixture
def cube_and_library(tmp_path):
    cube = made_up.cube(made_up.truth(20, 24))
    path, library = tmp_path / "cube.npz", tmp_path / "library.json"
    write_cube(cube, path)
    starter = MaterialLibrary.starter()
    starter.subset(["sky", "grass", "water", "bark"]).save(library)
    return path, library


def test_what_is_foreseen_is_what_the_clock_says(monkeypatch):
    """By a clock that only the method moves: 2 s a pixel for one method, 1 s for the other, and
    what is done once, whether an environment is given or not."""
    now, tried, once = [0.0], [], 9000 * 0.5

    def decompose(cube, library, *, method, model, progress, k=None, environment=None):
        tried.append((method, cube.shape))
        assert model == f"model of {method}" and k == (3 if environment is None else None)
        now[0] += {"net+sgd": 2.0, "net": 1.0}[method] * cube.radiance[0].size + once
        return SimpleNamespace(seconds={"calibration": once})

    monkeypatch.setattr(module, "decompose", decompose)
    monkeypatch.setattr(module, "best_first", lambda bands: ["net+sgd", "net"])
    monkeypatch.setattr(module.time, "perf_counter", lambda: now[0])
    cube = made_up.cube(made_up.truth(30, 300))
    library, named = MaterialLibrary.starter(), "model of {}".format
    assert choose(cube, library, 3, 2.6e6, named) == ("net+sgd", pytest.approx(2.5e6))
    assert choose(cube, library, 3, 2.4e6, named) == ("net", pytest.approx(1.5e6))
    assert tried[-1] == ("net", (30, CROP))


def test_of_dead_pixels_on_a_grid_enough_is_left_to_foresee():
    """The thinned cube sees hardly any other."""
    truth = made_up.truth(70, 160)
    dead = np.zeros(truth.temperature_k.shape, bool)
    dead[:, ::2] = True
    dead[:2, :3] = False
    cube = replace(made_up.cube(truth), dead=dead)
    library = MaterialLibrary.starter().subset(["sky", "grass", "water", "bark"])
    with mock.patch.object(module, "best_first", lambda bands: ["local"]):
        assert choose(cube, library, 5, 1e9, lambda method: None)[0] == "local"


def test_a_furnace_in_the_middle_is_foreseen_as_the_rest():
    """Its pixels are most of the part that is timed, whose environment is that of the picture."""
    cube = made_up.cube(made_up.truth(150, 160))
    s = cube.radiance.copy()
    s[:, 50:100, 50:110] = planck(cube.wavelength_um, 600.0)[:, None, None]
    burning = HeatCube(s, cube.wavelength_um, cube.fwhm_um, cube.netd_k)
    library = MaterialLibrary.starter().subset(["sky", "grass", "water", "bark"])
    with (
        mock.patch.object(module, "CROP", 60),
        mock.patch.object(module, "best_first", lambda bands: ["local"]),
        mock.patch.object(module, "decompose", wraps=module.decompose) as tried,
    ):
        choose(burning, library, 3, 1e9, lambda method: None)
    parts = [call.args[0] for call in tried.call_args_list]
    assert any(part.dead.mean() > 0.5 for part in parts)
    for part in parts:
        assert (part.measured()[:, ~part.dead].T < planck(cube.wavelength_um, 400.0)).all()


def test_a_budget_chooses_and_is_reported(tmp_path, cube_and_library, capfd, monkeypatch):
    cube, library = cube_and_library
    monkeypatch.setattr(module, "best_first", lambda bands: ["net+sgd"])
    words = ["decompose", cube, "--library", library, "--out", tmp_path / "out", "--budget", "1e6"]
    assert main([*map(str, words), "--json"]) == 0
    *text, last = capfd.readouterr().out.splitlines()
    answer = json.loads(last)
    foreseen = answer["budget"]["foreseen_seconds_per_megapixel"]
    assert answer["method"] == "net+sgd" and 0 < foreseen <= 1e6
    assert answer["budget"]["seconds_per_megapixel"] == 1e6
    assert any(line.startswith("Method") and "foreseen" in line for line in text)


def test_a_single_material_leaves_the_methods_without_a_network(monkeypatch):
    tried = []

    def decompose(*_, method, **__):
        tried.append(method)
        return SimpleNamespace(seconds={"calibration": 0.0})

    monkeypatch.setattr(module, "decompose", decompose)
    cube, library = made_up.cube(made_up.truth(8, 9)), MaterialLibrary.starter().subset(["water"])
    assert choose(cube, library, 3, 1e9, lambda method: None)[0] in ("sgd", "local")
    assert not {"net", "net+sgd"} & set(tried)


@pytest.mark.parametrize(
    "words, sentence",
    [
        (["--budget", "10", "--method", "local"], "leave out --method"),
        (["--budget", "10", "--model", "x.onnx"], "leave out --method"),
        (["--budget", "0"], "above 0"),
        (["--budget", "soon"], "above 0"),
        (["--budget", "1e-9"], "no method takes 1e-09 s"),
        (["--budget", "1e-9"], "a small cube takes more"),
    ],
)
def test_a_budget_that_makes_no_sense_is_one_sentence(
    tmp_path, cube_and_library, capfd, monkeypatch, words, sentence
):
    cube, library = cube_and_library
    monkeypatch.setattr(module, "best_first", lambda bands: ["net+sgd"])
    out = tmp_path / "out"
    common = ["decompose", str(cube), "--library", str(library), "--out", str(out)]
    assert main([*common, *words]) == 2
    shown = capfd.readouterr()
    assert shown.out == "" and shown.err.count("\n") == 1 and sentence in shown.err
    assert not out.exists()
