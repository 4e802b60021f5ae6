"""Spectra in a text file: a header with the axis and the columns' names, then a row per wavelength.

Columns are separated by whichever of comma, semicolon and tab comes first in the header, or by
blanks. Lines that begin with # are comments, except for the header as numpy.savetxt writes it.
"""

import csv
import math

import numpy as np

from physics.errors import InputError

from .wavelengths import ascending

AXES = {"wavelength_um": "um", "wavelength_nm": "nm", "wavenumber_cm1": "cm-1"}  # and their units
MAX_GAP_UM = 1.0  # between rows of a spectrum; wider ones would be filled with guesses


def read_table(path, what, column):
    """The text table at path -> the columns' names, wavelengths (n,) um, ascending, values
    (columns, n), and words on what was converted.

    what, column  words for the table and for a column, such as library and material

    Raises InputError if the file cannot be read or is not such a table.
    """
    try:
        with open(path, encoding="utf-8-sig") as file:
            rows = _rows(file)
    except OSError as e:
        raise InputError(f"{what}: cannot read {path}: {e.strerror}.") from e
    except (UnicodeDecodeError, csv.Error) as e:
        raise InputError(f"{what}: {path} is no table in UTF-8 text ({e}).") from e
    axis, *names = rows[0][1] if rows else [""]
    if axis not in AXES:
        raise InputError(
            f"{what}: the first column of {path} must be headed {' or '.join(AXES)}, but its "
            f"header starts with {axis[:60]!r}."
        )
    if not all(names):
        raise InputError(
            f"{what}: a column of {path} has no name in its header; name it, or, if it is empty, "
            "delete it or the separator at the end of each line."
        )
    values = []
    for line, cells in rows[1:]:
        values.append([number(cell) for cell in cells])
        if "" in cells and len(cells) == len(names) + 1:
            empty = rows[0][1][cells.index("")]
            raise InputError(
                f"{what}: line {line} of {path} has no number for {empty}; every column must have "
                "one in every line: leave out the line, or the column."
            )
        if len(cells) != len(names) + 1 or None in values[-1]:
            raise InputError(
                f"{what}: line {line} of {path} must hold {len(names) + 1} numbers, as many as the "
                "header has columns, with a decimal point."
            )
    if not values or not names:
        raise InputError(
            f"{what}: {path} must hold a column per {column} and a row per wavelength."
        )
    table = np.array(values).T
    order, w, moved = ascending(table[0], AXES[axis], what)
    words = [
        f"table with {axis}, {len(names)} {column}{'s' * (len(names) > 1)}",
        f"{w.size} rows became {w[0]:.4g}-{w[-1]:.4g} um{moved}",
    ]
    return names, w, table[1:, order], words


def _rows(lines):
    """[(line number from 1, cells)] of all lines except blank ones and comments."""
    lines = [(n, line.strip()) for n, line in enumerate(lines, 1) if line.strip()]
    rows = [(n, line) for n, line in lines if line[0] != "#"]
    if rows and not rows[0][1].startswith(tuple(AXES)):  # as numpy.savetxt writes its header
        before = [(n, line.lstrip("# ")) for n, line in lines if n < rows[0][0]]
        rows = [(n, line) for n, line in before if line.startswith(tuple(AXES))][-1:] + rows
    mark = next((c for _, header in rows[:1] for c in header if c in ",;\t"), None)
    apart = str.split
    if mark:
        apart = lambda line: next(csv.reader([line], delimiter=mark, skipinitialspace=True))
    return [(n, [cell.strip() for cell in apart(line)]) for n, line in rows]


def number(text):
    """The finite number in a text, or None."""
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None
