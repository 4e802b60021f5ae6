"""The `texnet bench` commands: what they take, and what they refuse before the work."""

from importlib import import_module

import pytest

from benchmarks import speed, stability
from texnet.cli import main


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
    def rows(axis, level, view, library, model):
        done.add(axis)
        of = {"axis": axis, "level": float(level), "scene": view.name}
        for method in stability.METHODS:
            yield of | {"method": method} | dict.fromkeys(stability.COLUMNS, 0.5) | {"failure": ""}

    done = set()
    monkeypatch.setattr(stability, "measured", rows)
    words = ["bench", "stability", "--axes", "noise", "gain off", "--out", str(tmp_path)]
    assert main(words) == 0 and done == {"noise", "gain off"}
    assert main([*words[:3], "nonsense", "--out", str(tmp_path)]) == 2
    assert "no axis 'nonsense' among" in capfd.readouterr().err
