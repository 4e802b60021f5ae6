"""Measurements are rows, dicts of plain values; a benchmark keeps them as CSV."""

import csv
import os
import platform
from importlib.metadata import version
from pathlib import Path

from benchmarks import ONNX, SHIPPED
from physics.provenance import provenance
from physics.whole_file import whole_file

_ROOT = Path(__file__).parents[1]
CODE = [_ROOT / name for name in ("physics", "texnet", "training", "export", "benchmarks")]
DATA = [ONNX, SHIPPED / "texnet.safetensors", _ROOT / "physics" / "data" / "starter_library.json"]


def settings(*networks):
    """What tells measurements apart: code, shipped data, packages, this machine, other networks."""
    packages = {n: version(n) for n in ("numpy", "torch", "onnxruntime", "numba", "scipy")}
    machine = [packages, platform.machine(), os.cpu_count()]
    return "of " + provenance(machine, [*CODE, *DATA, *networks])  # never to be read as a number


def write_csv(path, rows):
    """Write rows of the same keys, the first row's order, whole or not at all."""
    with whole_file(path) as part, open(part, "w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)


def read_csv(path):
    """The rows that write_csv wrote, all their values as text; none if there is no file."""
    if not path.exists():
        return []
    with open(path, newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))
