"""The doubt that edges add to sigma of T."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import maximum_filter, minimum_filter, uniform_filter

from texnet.doubt import ROWS, SCATTER, SCATTER_OF_MATERIALS, sigma_among_neighbours


@settings(deadline=None, max_examples=20)
@given(st.integers(1, 6), st.integers(1, 6), st.floats(60, 900), st.integers(0, 2**32 - 1))
def test_it_is_what_a_slow_window_gives(height, width, level, seed):
    rng = np.random.default_rng(seed)
    t = level + 20 * rng.standard_normal((height, width))
    m, sigma = rng.integers(0, 3, t.shape), rng.uniform(0.01, 2, t.shape)
    window = lambda of, a: of(a, 3, mode="nearest")  # noqa: E731
    variance = window(uniform_filter, t * t) - window(uniform_filter, t) ** 2
    edge = window(minimum_filter, m) != window(maximum_filter, m)
    slow = sigma**2 + (SCATTER**2 + edge * SCATTER_OF_MATERIALS**2) * variance
    fast = sigma_among_neighbours(sigma, t.astype(np.float32), m)
    np.testing.assert_allclose(fast, np.sqrt(slow), rtol=1e-3)


def test_rows_that_are_worked_on_apart_know_their_neighbours():
    t = np.full((2 * ROWS + 3, 4), 290.0, np.float32)
    t[ROWS] = 300.0
    sigma = sigma_among_neighbours(np.full(t.shape, 0.1), t, np.zeros(t.shape, int))
    near = np.abs(np.arange(len(t)) - ROWS) <= 1
    assert (sigma[near] > 0.4).all() and sigma[~near] == pytest.approx(0.1)


def test_where_all_is_alike_nothing_is_added():
    sigma = np.full((5, 7), 0.3)
    t, m = np.full((5, 7), 300.0, np.float32), np.ones((5, 7), int)
    assert sigma_among_neighbours(sigma, t, m) == pytest.approx(0.3)
    m[2] = 0  # another material as warm as the others
    assert sigma_among_neighbours(sigma, t, m) == pytest.approx(0.3)
