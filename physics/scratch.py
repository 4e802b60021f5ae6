"""Arrays larger than is good for memory live in a file without a name, and go with it.

What is large is worked on part by part; `release` takes back the memory that a part's pages
held, so that a process needs little more than one part at a time.
"""

import mmap
import os
import tempfile

import numpy as np

LARGE = 1 << 26  # bytes


def empty(shape, dtype):
    """A new array, in a file of the folder for temporary files (TMPDIR) if it is LARGE.

    Raises OSError where that folder has no room.
    """
    dtype = np.dtype(dtype)
    size = int(np.prod(shape, dtype=np.int64)) * dtype.itemsize
    if size < LARGE:
        return np.empty(shape, dtype)
    with tempfile.TemporaryFile(prefix="texnet-") as file:
        if hasattr(os, "posix_fallocate"):  # else a full disk would kill the process later
            os.posix_fallocate(file.fileno(), 0, size)
        else:
            file.truncate(size)
        return np.memmap(file, dtype, "r+", shape=tuple(shape))


def release(array):
    """Forget the pages of an array in a file that are in memory; they are read again if needed."""
    while array is not None:
        if isinstance(array, mmap.mmap):
            if hasattr(array, "madvise"):
                array.madvise(mmap.MADV_DONTNEED)
            return
        array = getattr(array, "base", None)


def parts(array):
    """Yield array[0], array[1], ..., none of which stays in memory."""
    for part in array:
        yield part
        release(array)
