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
    """The rows that write_csv wrote, all their values as text; none if there is no file."""
    if not path.exists():
        return []
    with open(path, newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))
