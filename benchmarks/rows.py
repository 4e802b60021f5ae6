"""Measurements are rows, dicts of plain values; a benchmark keeps them as CSV."""

import csv

from physics.whole_file import whole_file


def write_csv(path, rows):
    """Write rows of the same keys, the first row's order, whole or not at all."""
    with whole_file(path) as part, open(part, "w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)


def read_csv(path):
    """The rows that `write_csv` wrote; what reads as a number is one."""
    with open(path, newline="") as file:
        return [{name: _value(text) for name, text in row.items()} for row in csv.DictReader(file)]


def _value(text):
    try:
        return float(text)
    except ValueError:
        return text
