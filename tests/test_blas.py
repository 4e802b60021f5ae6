"""BLAS's threads are held back while anybody wants it, and are as they were afterwards."""

import numpy as np
from threadpoolctl import threadpool_info, threadpool_limits

from physics.machinery.blas import no_blas_threads


def threads():
    return {lib["num_threads"] for lib in threadpool_info() if lib["user_api"] == "blas"}


def test_the_last_one_out_sets_them_back():
    assert np.linalg.eigvalsh(np.eye(3)).sum() == 3  # BLAS is loaded
    with threadpool_limits(2, "blas"):
        before, one, other = threads(), no_blas_threads(), no_blas_threads()
        one.__enter__()
        assert threads() == {1}
        other.__enter__()
        one.__exit__(None, None, None)
        assert threads() == {1}  # whoever is still within
        other.__exit__(None, None, None)
        assert threads() == before
