"""Loops compiled by numba, kept on disk for the next process where there is room for that."""

from contextlib import suppress
from pathlib import Path

import numba

from .provenance import provenance

_SOURCES = provenance([], [Path(__file__).parents[1]])


def compiled(**how):
    """Decorator: numba.njit with these options, its result kept beside the file or in the user's
    cache; made anew by each process where neither may be written."""

    def of(function):
        try:
            made = numba.njit(cache=True, **how)(function)
        except RuntimeError:  # numba finds no place
            return numba.njit(**how)(function)
        with suppress(AttributeError):  # numba's own affair, that may change
            # it looks for changes in the function's own file; what that calls is in others, too
            file = made._cache._cache_file
            file._source_stamp = file._source_stamp, _SOURCES
        return made

    return of
