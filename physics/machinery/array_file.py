"""Named arrays in one npz file: written whole or not at all, read without pickle."""

import zipfile
import zlib
from tokenize import TokenError

import numpy as np

from ..errors import InputError
from . import scratch
from .whole_file import whole_file

# what numpy and zipfile raise on damaged files
BROKEN_NPY = (ValueError, TypeError, OverflowError, SyntaxError, RuntimeError, TokenError)
BROKEN_NPZ = (*BROKEN_NPY, OSError, EOFError, zipfile.BadZipFile, zlib.error)


def save_arrays(path, arrays, *, compress):
    """Write a dict of arrays as an npz, whole or not at all, in little memory."""
    method = zipfile.ZIP_DEFLATED if compress else zipfile.ZIP_STORED
    with whole_file(path) as whole, zipfile.ZipFile(whole, "w", method) as file:
        for name, array in arrays.items():
            with file.open(f"{name}.npy", "w", force_zip64=True) as npy:
                array = np.asarray(array)
                np.lib.format.write_array(_Released(npy, array), array, allow_pickle=False)


class _Released:
    """A file to write an array to, which does not keep in memory what is written."""

    def __init__(self, file, array):
        self.file, self.array = file, array

    def write(self, part):
        self.file.write(part)
        scratch.release(self.array)


def load_arrays(path, names, what, optional=()):
    """Read the arrays of these names, and the optional ones that are there -> dict; InputError,
    which starts with `what`, if not all are there or the file is damaged."""
    try:
        # Opened here, because np.load leaks the file if it is no whole zip.
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as data:
            missing = [n for n in names if n not in data.files]
            arrays = {n: data[n] for n in (*names, *optional) if n in data.files}
    except BROKEN_NPZ as e:
        reason = getattr(e, "strerror", None) or "it is not a whole npz file of plain arrays"
        raise InputError(f"{what}: cannot read {path}: {reason}.") from e
    if missing:
        raise InputError(f"{what}: {path} is no {what} file; it lacks {', '.join(missing)}.")
    return arrays
