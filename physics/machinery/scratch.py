"""Arrays too large for memory live in an unnamed file, which disappears with them.

They are processed part by part; `release` frees the memory that a part's pages held, so that a
process needs little more than one part at a time.
"""

import mmap
import os
import tempfile
import weakref

import numpy as np

from ..errors import InputError

LARGE = 1 << 26  # bytes
_OURS = weakref.WeakSet()  # maps of files that nobody else sees: all that is released


def zeros(shape, dtype):
    """A new array of zeros, in a file of the folder for temporary files (TMPDIR) if it is LARGE.

    Raises InputError where that folder has no room.
    """
    dtype = np.dtype(dtype)
    size = int(np.prod(shape, dtype=np.int64)) * dtype.itemsize
    if size < LARGE:
        return np.zeros(shape, dtype)
    try:
        with tempfile.TemporaryFile(prefix="texnet-") as file:
            if hasattr(os, "posix_fallocate"):  # else a full disk would kill the process later
                os.posix_fallocate(file.fileno(), 0, size)
            else:
                file.truncate(size)
            array = np.memmap(file, dtype, "r+", shape=tuple(shape))
    except OSError as e:
        raise InputError(
            f"no room for {size / 1e9:.1f} GB in the folder for temporary files, "
            f"{tempfile.gettempdir()} ({e.strerror}); set TMPDIR to another folder."
        ) from e
    _OURS.add(array._mmap)
    return array


def release(array):
    """Forget the pages in memory of an array from `zeros`, or of a view of one; they are read
    again if needed. Other arrays are left alone."""
    while array is not None and not isinstance(array, mmap.mmap):
        array = getattr(array, "base", None)
    if array is not None and array in _OURS and hasattr(array, "madvise"):
        array.madvise(mmap.MADV_DONTNEED)


def parts(array):
    """Yield array[0], array[1], ..., none of which stays in memory."""
    for part in array:
        yield part
        release(array)
