"""Loops compiled by numba, kept on disk for the next process where there is room for that."""

import numba


def compiled(**how):
    """Decorator: numba.njit with these options, its result kept beside the file or in the user's
    cache; made anew by each process where neither may be written."""

    def of(function):
        try:
            return numba.njit(cache=True, **how)(function)
        except RuntimeError:  # numba finds no place
            return numba.njit(**how)(function)

    return of
