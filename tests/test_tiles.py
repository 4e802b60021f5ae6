"""Tiles do not show where the halo covers what an answer looks at, and do where it does not."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from physics.tiles import run_tiled

REACH = 2


def windows(image):
    """The sum over 5 x 5 windows, zero beyond the border: it looks 2 pixels around itself."""
    padded = np.pad(image, ((0, 0), (REACH, REACH), (REACH, REACH)))
    views = np.lib.stride_tricks.sliding_window_view(padded, (5, 5), axis=(1, 2))
    return {"sum": views.sum(axis=(3, 4)), "first": image[0]}


@given(
    st.integers(1, 40), st.integers(1, 40), st.integers(REACH, 6), st.integers(1, 900),
    st.integers(0, 99),
)  # fmt: skip
def test_tiling_changes_nothing(height, width, halo, pixels, seed):
    image = np.random.default_rng(seed).integers(0, 1000, (3, height, width))
    seen = []
    tiled = run_tiled(windows, image, halo, pixels, lambda *done: seen.append(done))
    for name, whole in windows(image).items():
        np.testing.assert_array_equal(tiled[name], whole)
    assert seen == [(i + 1, len(seen)) for i in range(len(seen))]


def test_too_small_a_halo_shows():
    image = np.random.default_rng(0).integers(0, 1000, (1, 30, 30))
    assert (run_tiled(windows, image, 1, 64)["sum"] != windows(image)["sum"]).any()


def test_a_tile_is_no_larger_than_asked():
    shapes = []

    def run(tile):
        shapes.append(tile.shape)
        return windows(tile)

    run_tiled(run, np.zeros((1, 300, 200)), 5, 40 * 40)
    assert max(h * w for _, h, w in shapes) <= 40 * 40
    assert len(shapes) > 10
