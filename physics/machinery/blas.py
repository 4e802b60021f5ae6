"""BLAS's own threads, where they would only wait for each other or be in the way of ours."""

from contextlib import contextmanager
from threading import Lock

from threadpoolctl import threadpool_limits

_COUNTING, _within, _held = Lock(), 0, None


@contextmanager
def no_blas_threads():
    """BLAS works in one thread while anybody is within. How many it has is the whole process's, so
    the first who comes in sets it, and the last who goes sets it back."""
    global _within, _held
    with _COUNTING:
        if not _within:
            _held = threadpool_limits(1, "blas")
        _within += 1
    try:
        yield
    finally:
        with _COUNTING:
            _within -= 1
            if not _within:
                _held.restore_original_limits()
