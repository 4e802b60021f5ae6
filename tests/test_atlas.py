"""The atlas says in figures what its rows hold, and finds their faults."""

import csv
from pathlib import Path

import numpy as np

from benchmarks import difficulties
from benchmarks.atlas import draw, faults, page
from benchmarks.difficulties import Axis
from benchmarks.rows import SETTINGS, read_csv
from benchmarks.stability import COLUMNS
from texnet.methods import METHODS

AXES = {"noise": Axis("NETD (K)", (0.1, 1), None), "not measured": Axis("what", (0,), None)}


def row(level, error, sigma, failure="", method="m", scene="s"):
    return dict.fromkeys(COLUMNS, 0.5) | {
        "axis": "noise", "scene": scene, "method": method, "level": level, "failure": failure,
        "temperature_mae_k": error, "sigma_k": sigma,
    }  # fmt: skip


def doubt(method, covered, scene):
    return {"scene": scene, "method": method, "covered": covered, "false_alarms": 0.04}


def test_faults_are_found():
    assert not list(faults([row(0, 1, 1), row(1, 2, 2), row(2, 1, 1)]))
    assert len(list(faults([row(0, 1, 1), row(1, 2, 0.5)]))) == 1
    assert len(list(faults([row(0, 1, 1), row(1, np.nan, np.nan, "raised")]))) == 1


def test_the_page_has_means_over_scenes_and_cases(tmp_path):
    rows = [
        row(level, error * level, 2.0, method=method, scene=scene)
        for method in METHODS for scene, error in (("a", 1), ("b", 3)) for level in (0.1, 1)
    ]  # fmt: skip
    cases = (0.8, "a"), (0.9, "b"), (1.0, "c")
    missing = [doubt(method, c, scene) for method in METHODS for c, scene in cases]
    page(rows, AXES, missing, tmp_path / "atlas.md")
    text = (tmp_path / "atlas.md").read_text()
    three = "50% | 50% | 50%"
    first = f"0.20 | 2.00 | {three}"
    assert f"| noise: NETD (K) | 0.1 | 0.50 | {first} | {first} |" in text
    assert f"|  | 1 | 0.50 | 2.00 | 2.00 | {three} |" in text
    assert "not measured" not in text
    assert "| `net+sgd` | 90.0 ± 5.8 % | 90.0 % | 2 of 3 | 4.0 ± 0.0 % | 4.0 % |" in text
    assert "0 in 16 different answers" in text
    assert "| `net` | 0.50 | 0.50 |" in text


def test_what_is_said_twice_counts_once(tmp_path):
    rows = [row(0.1, 1, 1, method="net+sgd", scene=s) | {"amplification": ord(s)} for s in "abc"]
    cases = (0.8, "a"), (0.9, "b"), (1.0, "c")
    missing = [doubt(method, c, s) for method in METHODS for c, s in cases]
    page(rows, AXES, missing, tmp_path / "once.md")
    again = [r | {"axis": "not measured", "level": 0.0} for r in rows[:2]]
    page(rows + again, {"noise": AXES["noise"]}, missing * 2, tmp_path / "twice.md")
    once, twice = ((tmp_path / f"{name}.md").read_text() for name in ("once", "twice"))
    assert "in 3 different answers" in once
    assert twice == once.replace("2 of 3", "4 of 6")


def test_a_part_of_the_axes_can_be_shown(tmp_path):
    rows = [row(0.1, 1, 1, method="net+sgd")]
    page(rows, AXES, [], tmp_path / "atlas.md")
    text = (tmp_path / "atlas.md").read_text()
    assert "lacks" not in text and "| 0.1 |" in text
    draw(rows, AXES, tmp_path / "atlas.png")
    assert (tmp_path / "atlas.png").stat().st_size > 1000


def test_the_page_in_docs_is_of_the_tables_beside_it_and_each_axis_of_one_code(tmp_path):
    docs = Path(__file__).parents[1] / "docs"
    tables, of = [], set()
    for name in ("stability.csv", "missing.csv"):
        with open(docs / name, newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        of |= {(row.get("axis", name), row[SETTINGS]) for row in rows}
        made = dict.fromkeys(row[SETTINGS] for row in rows)
        tables.append([row for one in made for row in read_csv(docs / name, one)])
    assert len(of) == len({axis for axis, _ in of}) == len(difficulties.AXES) + 1
    rows, missing = tables
    page(rows, difficulties.AXES, missing, tmp_path / "atlas.md")
    assert (tmp_path / "atlas.md").read_text("utf-8") == (docs / "atlas.md").read_text("utf-8")
