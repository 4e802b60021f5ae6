"""MATLAB's .mat files, version 5 to 7: the tables of real numbers and lists of strings in them.

Read here and not by scipy, whose reader is not hardened: damaged files crash the interpreter.
The layout (MathWorks, "MAT-File Format"): 128 bytes of header, then elements, each a tag (type,
number of bytes) and a body, padded to 8 bytes. A variable is an element of elements: flags (class,
whether complex), dimensions, name, content. Numbers are stored column by column, often in a
smaller type than their class. Since version 7 each variable is deflated.
"""

import struct
import zlib
from pathlib import Path

import numpy as np

from physics.errors import InputError

LITTLE_ENDIAN_5 = b"\x00\x01IM"  # bytes 124 to 128 of the header
STORED = {
    1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8",
}  # fmt: skip
NUMERIC = dict(zip(range(6, 16), "f8 f4 i1 u1 i2 u2 i4 u4 i8 u8".split(), strict=True))
TEXT = {1: "latin-1", 2: "latin-1", 4: "utf-16-le", 16: "utf-8", 17: "utf-16-le"}
MATRIX, COMPRESSED = 14, 15  # types of element
CELL, CHAR, OPAQUE = 1, 4, 17  # classes of variable
COMPLEX = 0x800


def read_mat(path):
    """The variables of a .mat file by name, in the file's order.

    Each is an array of MATLAB's shape, or a list of str (a char array's rows, a cell array's
    strings), or None if it is neither: complex, sparse, a struct, an object. Raises InputError
    if the file is damaged or of another version.
    """
    try:
        raw = Path(path).read_bytes()
    except OSError as e:
        raise InputError(f"cannot read {path}: {e.strerror}.") from e
    if raw[124:128] != LITTLE_ENDIAN_5:
        raise InputError(
            f"{path} is no .mat file of version 5 to 7 (7.3 is another format, HDF5); "
            "save it again in MATLAB with save -v7."
        )
    try:
        variables = {}
        for kind, body in _elements(memoryview(raw)[128:]):
            inflated = _elements(zlib.decompress(body)) if kind == COMPRESSED else [(kind, body)]
            variables |= dict(_variable(b) for k, b in inflated if k == MATRIX)
        return variables
    except (ValueError, IndexError, struct.error, zlib.error) as e:
        raise InputError(f"{path} is not a whole .mat file.") from e


def _elements(data):
    """(type, body) of each element."""
    at = 0
    while at < len(data):
        kind, size = struct.unpack_from("<II", data, at)
        if kind >> 16:  # both fit into four bytes, the body into the next four
            kind, size, start, end = kind & 0xFFFF, kind >> 16, at + 4, at + 8
        else:
            start = at + 8
            end = start + size + (0 if kind == COMPRESSED else -size % 8)
        if start + size > min(end, len(data)):
            raise ValueError("an element is cut off")
        yield kind, data[start : start + size]
        at = end


def _variable(body):
    """(name, value) of a variable."""
    parts = list(_elements(body))
    flags = struct.unpack("<II", parts[0][1])[0]
    kind = flags & 0xFF
    if kind == OPAQUE:  # an object, which has no dimensions
        return _name(parts[1][1]), None
    shape, name = np.frombuffer(parts[1][1], "<i4"), _name(parts[2][1])
    if (shape < 0).any():
        raise ValueError("negative dimensions")
    if kind in NUMERIC and not flags & COMPLEX:
        stored, numbers = parts[3]
        if stored not in STORED:
            raise ValueError("numbers of no known type")
        array = np.frombuffer(numbers, "<" + STORED[stored]).astype(NUMERIC[kind], copy=False)
        return name, array.reshape(shape, order="F")
    if kind == CHAR:
        return name, _rows(shape, *parts[3]) if shape.prod() else [""]
    if kind == CELL:
        return name, _strings(parts[3:])
    return name, None


def _name(text):
    name = bytes(text).decode("ascii")
    if not name.isprintable():
        raise ValueError("a name with control characters")
    return name


def _rows(shape, stored, text):
    """The rows of a char array, without the blanks that pad them."""
    if stored not in TEXT:
        raise ValueError("text of no known type")
    letters = np.array(list(bytes(text).decode(TEXT[stored]))).reshape(shape, order="F")
    return ["".join(row).rstrip() for row in letters.reshape(shape[0], -1)]


def _strings(cells):
    """The strings of a cell array, or None if a cell holds anything else."""
    strings = []
    for _, body in cells:
        # Only char arrays are read, so that nested cells cannot cause recursion.
        flags = struct.unpack("<II", next(_elements(body))[1])[0] if len(body) else 0
        value = _variable(body)[1] if flags & 0xFF == CHAR else None
        if value is None or len(value) != 1:
            return None
        strings += value
    return strings
