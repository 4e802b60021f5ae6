"""What the benchmark of accuracy says of two methods and of materials, and that it goes on."""

from types import SimpleNamespace

import numba
import numpy as np
import pytest
import torch
from threadpoolctl import threadpool_limits

from benchmarks import accuracy
from benchmarks.accuracy import ERRORS, differences, unknown
from benchmarks.confusion import confused, named_as, table
from texnet import budget
from texnet.cli import main


def test_differences_are_paired_by_scene():
    """A difference that is the same in every scene has no error, however the scenes differ."""
    rows = [
        {"scene": scene, "bands": 9, "method": method}
        | dict.fromkeys(ERRORS, 10.0 * scene + 0.5 * (method == "local"))
        for scene in range(4)
        for method in ("net+sgd", "local")
    ]
    rows[0]["texture_correlation"] = np.nan  # a room
    said = {line.split()[1]: line.split() for line in list(differences(rows, "local"))[1:]}
    assert said.keys() == set(ERRORS)
    assert [float(n) for n in said["temperature_mae_k"][2:4]] == pytest.approx([-0.5, 0])
    assert said["temperature_mae_k"][4:] == ["4", "of", "4"]
    assert said["material_accuracy"][4:] == ["0", "of", "4"]
    assert said["texture_correlation"][4:] == ["0", "of", "3"]


def test_half_of_the_scenes_have_no_more_unknown_than_the_median():
    rows = [
        {"scene": scene, "bands": bands, "method": "local", "abstention": scene / bands}
        for scene in range(5) for bands in (4, 10)
    ]  # fmt: skip
    few, many = (line.split() for line in list(unknown(rows))[1:])
    assert few == ["4", "local", "0.250", "0.500", "0.750"]
    assert many == ["10", "local", "0.100", "0.200", "0.300"]


NAMES = ("sky", "tree", "soil", "glass")


def test_materials_are_counted_by_name_where_something_was_measured():
    truth = SimpleNamespace(material_names=NAMES, material=np.array([[0, 1, 1], [1, 2, 3]]))
    of_library = NAMES[::-1]  # whose order does not matter
    answer = SimpleNamespace(
        material_names=of_library, material=np.array([[3, 2, 1], [2, 1, 2]]),
        dead=np.array([[False] * 3, [False, False, True]]),
    )  # fmt: skip
    counts = named_as(answer, truth)
    assert counts == {
        ("sky", "sky"): 1, ("tree", "tree"): 2, ("tree", "soil"): 1, ("soil", "soil"): 1,
    }  # fmt: skip
    tree, *others = confused(counts)
    assert tree == {
        "material": "tree", "share": 3 / 5, "right": 2 / 3, "taken_for": {"soil": 1 / 3},
    }  # fmt: skip
    assert [r["material"] for r in others] == ["sky", "soil"]
    assert all(r["right"] == 1 and not r["taken_for"] for r in others)
    assert "tree                   60.0%   66.7%  soil 33.3%" in list(table(counts))


def test_the_means_feed_the_budget(tmp_path, monkeypatch):
    """In rooms no texture is lit by the sky."""
    row = lambda bands, method, t, right, texture: dict.fromkeys(accuracy.SHOWN, 0.0) | dict(
        bands=bands, method=method, temperature_rmse_k=t, material_accuracy=right,
        texture_correlation=texture,
    )  # fmt: skip
    rows = [
        row(4, "sgd", 1.0, 0.8, 0.9), row(4, "sgd", 3.0, 0.6, np.nan), row(4, "net", 2.1, 0.6, 0.8),
        row(54, "sgd", 2.0, 0.7, 0.9), row(54, "net", 1.0, 0.8, 0.8),
    ]  # fmt: skip
    accuracy.write_methods(rows, tmp_path / "methods.csv")
    assert (tmp_path / "methods.csv").read_text().splitlines()[2] == "4,sgd,2,0.7,0.9"
    monkeypatch.setattr(budget, "MEASURED", tmp_path / "methods.csv")
    assert budget.best_first(5) == ["sgd", "net"] and budget.best_first(40) == ["net", "sgd"]


@pytest.fixture
def threads_as_before():
    of_numba, of_torch = numba.get_num_threads(), torch.get_num_threads()
    with threadpool_limits():
        yield
    numba.set_num_threads(of_numba)
    torch.set_num_threads(of_torch)


@pytest.mark.usefixtures("threads_as_before")
def test_a_stopped_run_goes_on_after_the_last_whole_scene(tmp_path, monkeypatch, capsys):
    """To the same figures, the time aside."""
    monkeypatch.setattr(accuracy, "SIZE", (24, 32))
    monkeypatch.setattr(accuracy, "SPP", 4)
    original, scenes = accuracy.measure, []

    def counted(cube, truth, *of):
        scenes.append(truth)
        return original(cube, truth, *of)

    monkeypatch.setattr(accuracy, "measure", counted)

    def run(out, *more):
        words = ["--out", out, "--scenes", 2, "--bands", 4, "--methods", "local", *more]
        scenes.clear()
        status = main(["bench", "accuracy", *map(str, words)])
        if status:
            return status
        said = capsys.readouterr().out.splitlines()
        means = [line.split()[:-1] for line in said if " local" in line]
        assert said[-1] == f"{out}: accuracy.csv, confusion.csv, methods.csv."
        return len(scenes), means, said[said.index("4 bands, local") : -1]

    whole = run(tmp_path / "whole")
    assert whole[0] == 2 and len(whole[2]) > 3

    def stopped(cube, truth, *of):
        if (tmp_path / "part" / "accuracy.csv").exists():
            raise KeyboardInterrupt
        return original(cube, truth, *of)

    monkeypatch.setattr(accuracy, "measure", stopped)
    assert run(tmp_path / "part") == 130
    assert "run the same command again to resume after the last scene" in capsys.readouterr().err
    monkeypatch.setattr(accuracy, "measure", counted)
    assert run(tmp_path / "part") == (1, *whole[1:])
    assert run(tmp_path / "part") == (0, *whole[1:])
    for other in (["--finer", "2"], ["--finer", "2", "--enclosed"]):  # each time other pictures
        assert run(tmp_path / "part", *other)[0] == 2
