"""Measurements are rows, dicts of plain values; a benchmark keeps them as CSV, whose last column
states their provenance."""

import csv
import os
import platform
from importlib.metadata import version
from pathlib import Path

from benchmarks import ONNX, SHIPPED
from physics.machinery.provenance import provenance
from physics.machinery.whole_file import whole_file
from texnet.methods import WEIGHTS

_ROOT = Path(__file__).parents[1]
CODE = [_ROOT / name for name in ("physics", "texnet", "training", "export", "benchmarks")]
DATA = [ONNX, SHIPPED / WEIGHTS, *sorted((_ROOT / "physics" / "data").iterdir())]

PACKAGES = "numpy", "torch", "onnxruntime", "numba", "scipy", "scikit-learn", "embreex", "trimesh"
SETTINGS = "settings"  # the column


def settings(*networks):
    """What distinguishes measurements: code, shipped data, packages, machine, other networks."""
    machine = [{name: version(name) for name in PACKAGES}, platform.machine(), os.cpu_count()]
    return "of " + provenance(machine, [*CODE, *DATA, *networks])  # never to be read as a number


def write_csv(path, rows, made=None):
    """Write rows with the same keys, in the first row's order, whole or not at all, each with the
    settings that it was made with: made, or those of this code if None."""
    made = made or settings()
    with whole_file(path) as part, open(part, "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [*rows[0], SETTINGS])
        writer.writeheader()
        writer.writerows(row | {SETTINGS: made} for row in rows)


def read_csv(path, made):
    """The rows from write_csv that were made with these settings, with numeric text converted to
    numbers; none if there is no file."""
    return [row for by, row in _rows(path) if by == made]


def made_otherwise(path, made):
    """The rows of such a file that were made with any other settings."""
    return [row for by, row in _rows(path) if by != made]


def _rows(path):
    """(settings, row) of each row of such a file."""
    if not path.exists():
        return
    with open(path, newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            yield row.pop(SETTINGS, None), {name: _value(text) for name, text in row.items()}


def _value(text):
    for kind in (int, float):
        try:
            return kind(text)
        except (TypeError, ValueError):  # None, in a truncated row
            pass
    return text


def whole_scenes(rows, wanted):
    """The rows of scenes that have the (bands, method) wanted, and no others."""
    of = {}
    for r in rows:
        of.setdefault(r["scene"], set()).add((r["bands"], r["method"]))
    return [r for r in rows if of[r["scene"]] == wanted]
