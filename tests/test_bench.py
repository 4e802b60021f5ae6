"""The `texnet bench` commands: what they take, and what they refuse before the work."""

import json
from dataclasses import replace
from functools import cache
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from benchmarks import difficulties, finetune, lowtran7, rows, speed, stability
from physics.errors import InputError
from physics.estimate import estimate_environment
from physics.library import MaterialLibrary
from physics.simulator import trace_scene
from physics.simulator.presets import preset
from texnet.cli import main
from texnet.methods import METHODS
from texnet.runtime import Runtime

LIBRARY = MaterialLibrary.starter()


@pytest.mark.parametrize("what", ["speed", "stability", "chart"])
def test_without_the_network_there_is_one_sentence_and_no_folder(
    what, tmp_path, capfd, monkeypatch
):
    monkeypatch.setattr(import_module(f"benchmarks.{what}"), "ONNX", tmp_path / "none.onnx")
    assert main(["bench", what, "--out", str(tmp_path / "out")]) == 2
    err = capfd.readouterr().err
    assert err.startswith("texnet: error: model: cannot read") and err.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("words, large", [([], False), (["--large"], True)])
def test_speed_measures_the_large_cube_if_asked(words, large, tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(speed, "measure", lambda out, large: asked.append(large) or {})
    assert main(["bench", "speed", *words, "--out", str(tmp_path)]) == 0
    assert asked == [large]


def test_stability_measures_the_axes_that_are_named(tmp_path, capfd, monkeypatch):
    def measured(axis, level, view, library, model, known):
        done.add(axis)
        of = {"axis": axis, "level": float(level), "scene": view.name}
        for method in METHODS:
            yield of | {"method": method} | dict.fromkeys(stability.COLUMNS, 0.5) | {"failure": ""}

    done = set()
    monkeypatch.setattr(stability, "measured", measured)
    words = ["bench", "stability", "--axes", "noise", "gain off", "--out", str(tmp_path)]
    assert main(words) == 0 and done == {"noise", "gain off"}
    said = capfd.readouterr().out.rpartition(f"{tmp_path}: ")[2].rstrip(".\n").split(", ")
    assert sorted(said) == sorted(path.name for path in tmp_path.iterdir())
    assert main([*words[:3], "nonsense", "--out", str(tmp_path)]) == 2
    assert "no axis 'nonsense' among" in capfd.readouterr().err


@pytest.mark.parametrize(
    "name", sorted(p.stem for p in Path(speed.__file__).parent.glob("*.py") if p.stem != "__init__")
)
def test_every_benchmark_finds_what_it_imports(name):
    assert import_module(f"benchmarks.{name}").__doc__


def test_a_command_that_fails_says_why(tmp_path):
    row = speed._command("help", ["--help"], 2)
    assert row["repeats"] == 2 and 0 < row["least"] <= row["seconds"] <= row["most"]
    words = ["decompose", str(tmp_path / "none.npz"), "--out", str(tmp_path / "out")]
    with pytest.raises(InputError, match=f"^speed: a night: .*{tmp_path / 'none.npz'}"):
        speed._command("a night", words, 1)


def test_what_other_code_measured_is_left_out_of_the_table(tmp_path):
    row = dict.fromkeys(["material_accuracy", "cross_entropy", "temperature_rmse_k"], 0.5) | {
        "method": "net", "texture_correlation": 0.5, "draws": 1,
        "minutes_scenes": 1.0, "minutes_training": 1.0,
    }  # fmt: skip
    model = tmp_path / "model"
    model.write_bytes(b"weights")
    for part, made in (("zero-shot", rows.settings(model)), ("scenes", rows.settings())):
        text = json.dumps({"made": made, "rows": [{"part": part} | row]})
        (tmp_path / f"{part}.json").write_text(text)
    said = finetune.table(tmp_path, model)
    assert said.splitlines()[1].startswith("zero-shot") and said.endswith("another model: scenes")
    table = (tmp_path / "finetune.csv").read_text()
    assert "zero-shot" in table and "scenes," not in table.splitlines()[-1]


def test_noisy_bands_are_noisy_anew_in_each_draw():
    view = difficulties.View("forest", 7)
    s = [difficulties.noisy_bands(replace(view, draw=d), LIBRARY, 5).cube for d in (0, 1)]
    moved = (s[1].radiance - s[0].radiance).std(axis=(1, 2)) / np.sqrt(2) / s[0].sigma
    assert np.sort(moved) == pytest.approx([1] * (len(moved) - 5) + [10] * 5, rel=0.1)


def test_exponents_are_those_of_power_laws():
    rows = [
        {"axis": axis, "method": method, "size": n, "seconds": 0.3 * n**power}
        for axis, method, power in (("bands", "a", 1.0), ("bands", "b", 0.5), ("pixels", "a", 2.0))
        for n in (1, 10, 40)
    ]  # fmt: skip
    found = speed.exponents(rows)
    assert found["bands"] == pytest.approx({"a": 1.0, "b": 0.5})
    assert found["pixels"] == pytest.approx({"a": 2.0})


def test_what_is_timed_runs(monkeypatch):
    """On small pictures: the simulator beside Embree on the same rays, and each axis of growth."""
    for name in ("GROWTH", "SIMULATED_GROWTH"):
        axes = dict.fromkeys(getattr(speed, name), (4,))
        monkeypatch.setattr(speed, name, axes | {"pixels": (24,)})
    for name, size in (("GROWTH_SIDE", 24), ("SIMULATED_SIDE", 8), ("SIMULATED", (8, 12))):
        monkeypatch.setattr(speed, name, size)
    monkeypatch.setattr(speed, "preset", cache(lambda *_: preset("random", 7)))  # few triangles
    row = speed.simulator(LIBRARY)
    assert row["rays"] >= 8 * 12 * speed.SPP and 0 < row["ratio"] < 1
    traced = trace_scene(speed.preset(), (24, 32), 4, 7, LIBRARY)
    cube = speed.frame(traced, LIBRARY, size=(24, 32))
    row = speed.solver(cube, LIBRARY, estimate_environment(cube, LIBRARY, 4))
    assert row["pixels"] == 24 * 32 and row["seconds_per_megapixel"] > 0
    rows = list(speed.growth(traced, LIBRARY, Runtime(speed.ONNX).run))
    assert {(r["axis"], r["method"]) for r in rows} == {
        *((axis, method) for axis in speed.GROWTH for method in ("local", "net+sgd")),
        *((axis, "simulate") for axis in speed.SIMULATED_GROWTH),
    }  # fmt: skip
    assert all(r["seconds"] > 0 for r in rows)


def test_fortran_data_are_read():
    text = """C     DATA X / 9. /
      BLOCK DATA FIRST
      DATA A/ 1.0, -2.5E-01,
     1        3./
      DATA B /4.0/
      BLOCK DATA SECOND
      DATA A / .5 /
"""
    assert lowtran7.data_statements(text) == {
        ("FIRST", "A"): [1.0, -0.25, 3.0], ("FIRST", "B"): [4.0], ("SECOND", "A"): [0.5]
    }  # fmt: skip
