"""The chart: what its points and its front mean, and that a stopped run goes on."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from traced import one_thread  # noqa: F401

import benchmarks.accuracy as accuracy
import benchmarks.chart as chart
from benchmarks import rows
from benchmarks.chart import Scene, by_scipy, by_separation, medians, pareto, pareto_methods
from benchmarks.peers import brightness, isstes, nem
from benchmarks.rows import read_csv, settings, whole_scenes
from physics.library import MaterialLibrary
from physics.simulator import trace_scene
from physics.simulator.presets import preset
from texnet.cli import main
from texnet.files.weights import save_network
from texnet.metrics import evaluate, non_sky
from texnet.network import TeXNet

# --- the front and the points ----------------------------------------------------------------


def test_the_front_of_known_points():
    cost = [1.0, 2.0, 3.0, 3.0, 5.0, 4.0]
    score = [0.1, 0.5, 0.4, 0.9, 0.9, 0.95]
    assert pareto(cost, score) == [0, 1, 3, 5]


POINTS = st.lists(st.tuples(st.integers(0, 9), st.integers(0, 9)), min_size=1, max_size=12)


@given(POINTS)
def test_nothing_on_the_front_is_beaten_and_all_else_is_matched_by_it(points):
    cost, score = zip(*points, strict=True)
    front = pareto(cost, score)
    for i, (c, s) in enumerate(points):
        better = [j for j in front if cost[j] <= c and score[j] >= s]
        assert better  # itself, if it is on the front
        assert i not in front or [points[j] for j in better] == [(c, s)]
    assert list(front) == sorted(front, key=cost.__getitem__)


def row(scene, method, seconds, t, right=0.9, texture=0.5, bands=4):
    errors = dict(zip(chart.ERRORS, (t, right, texture), strict=True))
    return dict(scene=scene, bands=bands, method=method, seconds_per_megapixel=seconds) | errors


def test_medians_leave_out_the_rooms_and_bracket_themselves():
    texture = [0.0, 0.1, 0.2, 0.3, np.nan]
    rows = [row(i, "net", 10.0 + i, 1.0 + i, texture=texture[i]) for i in range(5)]
    (of,) = medians(rows)
    assert of["temperature_rmse_k"] == 3.0
    assert (of["temperature_rmse_k_low"], of["temperature_rmse_k_high"]) == (2.0, 4.0)
    assert of["texture_correlation"] == pytest.approx(0.15)


def test_less_is_better_of_temperature_and_more_of_the_others():
    rows = [row(0, "a", 1.0, 3.0, 0.5), row(0, "b", 2.0, 1.0, 0.4), row(0, "c", 3.0, 2.0, 0.6)]
    summary = medians([*rows, row(0, "scipy", 9e4, 0.1, 1.0)])
    assert pareto_methods(summary, 4, "temperature_rmse_k") == ["a", "b"]
    assert pareto_methods(summary, 4, "material_accuracy") == ["a", "c"]


# --- the methods on a traced scene -----------------------------------------------------------


@pytest.fixture(scope="module")
def traced():
    return trace_scene(preset("patches", 3), (40, 60), 16, 3, MaterialLibrary.starter())


def test_the_sky_that_the_separations_are_told_lights_what_is_open_to_it(traced):
    """Where a surface sees nearly nothing but sky, X is the downwelling sky within the light that
    the rest of its hemisphere may add."""
    scene = Scene(traced, 9)
    truth = scene.truth
    open_ = non_sky(truth) & (truth.sky_view > 0.9)
    assert open_.sum() > 100
    x = truth.texture[:, open_].mean(axis=1)
    closed = 1 - truth.sky_view[open_].mean()
    ground = scene.law.radiance(truth.temperature_k[open_].max())
    # tilted surfaces see more of the warm horizon
    assert (x > 0.9 * scene.sky).all() and (x < scene.sky + (closed + 0.1) * ground).all()


def test_a_separation_is_told_the_sky_and_what_it_says_of_x_obeys_eq_1(traced):
    scene = Scene(traced, 9)
    answer, truth = by_separation(nem)(scene)
    sky = ~non_sky(truth)
    assert (answer.material[sky] == scene.library.sky_index).all()
    assert (answer.material[~sky] != scene.library.sky_index).all()
    y, x = np.argwhere(~sky)[17]
    e = scene.curves[answer.material[y, x]]
    s = e * scene.law.radiance(answer.temperature_k[y, x]) + (1 - e) * answer.texture[:, y, x]
    np.testing.assert_allclose(s, scene.cube.radiance[:, y, x], rtol=1e-5)


def test_a_picture_of_reversed_relief_scores_the_same(traced, monkeypatch):
    """A separation cannot tell which way it is: the better one counts."""
    scene, light = Scene(traced, 9), chart.light
    scores = [evaluate(*by_separation(nem)(scene))["texture_correlation"]]

    def reversed_light(*args):
        x, mean = light(*args)
        return x, -mean

    monkeypatch.setattr(chart, "light", reversed_light)
    scores.append(evaluate(*by_separation(nem)(scene))["texture_correlation"])
    assert scores[0] == pytest.approx(scores[1]) and scores[0] > 0


def test_scipy_and_its_truth_are_of_the_same_pixels(traced, monkeypatch):
    monkeypatch.setattr(chart, "SCIPY_PIXELS", 6)
    scene = Scene(traced, 9)
    answer, truth = by_scipy(scene)
    assert truth.material.shape == (1, 6) and truth.texture.shape == (9, 1, 6)
    errors = evaluate(answer, truth)
    # the temperature of each is found to a kelvin or so, which no other pixel's truth would be
    assert errors["temperature_rmse_k"] < 2.0 < np.ptp(scene.truth.temperature_k)


# --- a run -----------------------------------------------------------------------------------


@pytest.fixture
def toy(monkeypatch):
    monkeypatch.setattr(chart, "SCENES", 2)
    monkeypatch.setattr(chart, "BANDS", (4, 6))
    monkeypatch.setattr(chart, "STEPS", {"net+sgd, 2 steps": 2})
    monkeypatch.setattr(chart, "SCIPY_PIXELS", 1)
    monkeypatch.setattr(chart, "THREADS", 1)
    monkeypatch.setattr(chart, "on_two_threads", lambda: None)
    monkeypatch.setattr(accuracy, "SIZE", (24, 32))
    monkeypatch.setattr(accuracy, "SPP", 4)
    # named as if they were texnet's, which take longer
    few = {"NEM": nem, "local": brightness, "sgd": isstes}
    few = {name: by_separation(module) for name, module in few.items()}
    monkeypatch.setattr(chart, "all_methods", lambda networks: few)


def test_a_stopped_run_goes_on_after_the_last_whole_scene(tmp_path, toy, monkeypatch):
    class Stop(Exception):
        pass

    def stop(done, total, what):
        if done == 8:  # in the second scene
            raise Stop

    with pytest.raises(Stop):
        chart.measure(tmp_path, progress=stop)
    first = read_csv(tmp_path / "chart.csv", settings())
    assert len(first) == 6 and {r["scene"] for r in first} == {"random 3000000"}
    done = []
    whole = chart.measure(tmp_path, progress=lambda n, total, what: done.append(n))
    assert done == list(range(6, 12))
    assert read_csv(tmp_path / "chart.csv", settings())[:6] == first
    assert len(whole["rows"]) == 12 and (tmp_path / "chart.png").stat().st_size > 0

    # nothing is left to do; what other code left is not taken for this one's
    chart.measure(tmp_path, progress=lambda *_: pytest.fail("measured again"))
    monkeypatch.setattr(rows, "CODE", [])
    done.clear()
    chart.measure(tmp_path, progress=lambda n, *_: done.append(n))
    assert done[0] == 0


def test_a_half_measured_scene_does_not_count():
    wanted = {("4", "a"), ("4", "b")}
    rows = [dict(scene=s, bands="4", method=m) for s, m in [("1", "a"), ("1", "b"), ("2", "a")]]
    assert {r["scene"] for r in whole_scenes(rows, wanted)} == {"1"}


def test_the_command_charts_and_prints(tmp_path, toy, capfd):
    out = tmp_path / "out"
    assert main(["bench", "chart", "--out", str(out), "--json"]) == 0
    answer = json.loads(capfd.readouterr().out.splitlines()[-1])
    assert answer["command"] == "bench chart" and len(answer["rows"]) == 12
    assert {p.name for p in out.iterdir()} == {"chart.csv", "chart.png"}


def test_networks_are_charted_by_name_and_none_twice(tmp_path, capfd):
    path = tmp_path / "small.safetensors"
    save_network(TeXNet(width=8, dilations=(1,), messages=1), path, {})
    assert "small" in chart.all_methods([path])
    assert main(["bench", "chart", "--out", str(tmp_path), "--network", "none.safetensors"]) == 2
    words = ["bench", "chart", "--out", str(tmp_path)] + 2 * ["--network", str(path)]
    assert main(words) == 2
    assert "two methods are called small" in capfd.readouterr().err
