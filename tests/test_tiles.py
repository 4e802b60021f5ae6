"""Tiles do not show where the halo covers what an answer looks at, and do where it does not."""

import time
from threading import get_ident

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from physics.machinery.tiles import TILE_PIXELS, run_tiled, tile_size

REACH = 2


def windows(image, inner=None, _=None):
    """The sum over 5 x 5 windows, zero beyond the border: it looks 2 pixels around itself."""
    padded = np.pad(image, ((0, 0), (REACH, REACH), (REACH, REACH)))
    views = np.lib.stride_tricks.sliding_window_view(padded, (5, 5), axis=(1, 2))
    return cut({"sum": views.sum(axis=(3, 4)), "first": image[0]}, inner)


def cut(maps, inner):
    top, left, height, width = (0, 0, None, None) if inner is None else inner
    rows = slice(top, None if height is None else top + height)
    columns = slice(left, None if width is None else left + width)
    return {name: a[..., rows, columns] for name, a in maps.items()}


@given(
    st.integers(1, 40), st.integers(1, 40), st.integers(REACH, 6), st.integers(1, 900),
    st.integers(0, 99), st.integers(1, 3),
)  # fmt: skip
def test_tiling_changes_nothing(height, width, halo, pixels, seed, at_once):
    image = np.random.default_rng(seed).integers(0, 1000, (3, height, width))
    seen = []
    tiled = run_tiled(
        windows, image, halo, pixels, lambda *done: seen.append(done), at_once=at_once
    )
    for name, whole in windows(image).items():
        np.testing.assert_array_equal(tiled[name], whole)
    assert seen == [(i + 1, len(seen)) for i in range(len(seen))]


@given(st.integers(1, 40), st.integers(1, 40), st.integers(1, 900), st.sampled_from([2, 3, 4]))
def test_tiles_begin_where_cells_do(height, width, pixels, cell):
    """Means over cells of the whole picture are those of the tiles' own cells."""

    def means(image, inner=None, _=None):
        y, x = (np.arange(n) // cell for n in image.shape[-2:])
        sums, counts = np.zeros((2, y[-1] + 1, x[-1] + 1))
        np.add.at(sums, (y[:, None], x), image)
        np.add.at(counts, (y[:, None], x), 1)
        return cut({"mean": (sums / counts)[y[:, None], x]}, inner)

    image = np.random.default_rng(height).normal(size=(height, width))
    tiled = run_tiled(means, image, cell, pixels, multiple=cell)
    np.testing.assert_allclose(tiled["mean"], means(image)["mean"], rtol=1e-12, atol=1e-12)


@given(st.data())
def test_no_tile_goes_beyond_a_cut_and_nothing_changes(data):
    size = data.draw(st.tuples(st.integers(1, 40), st.integers(1, 40)))
    cuts = tuple(
        tuple(sorted({0, n} | data.draw(st.sets(st.integers(1, n), max_size=3)))) for n in size
    )
    image, inner = np.random.default_rng(0).integers(0, 1000, (3, *size)), []

    def run(tile, part, corner):
        start = np.add(corner, part[:2])
        inner.append(list(zip(start, start + part[2:], strict=True)))
        return windows(tile, part)

    at_once, pixels = data.draw(st.integers(1, 3)), data.draw(st.integers(1, 900))
    tiled = run_tiled(run, image, REACH, pixels, at_once=at_once, cuts=cuts)
    np.testing.assert_array_equal(tiled["sum"], windows(image)["sum"])
    for part in inner:
        for (start, end), cut in zip(part, cuts, strict=True):
            assert not any(start < c < end for c in cut)


def test_one_at_a_time_stays_in_the_thread_of_the_caller():
    """numba and torch keep their number of threads by thread."""
    seen = []

    def run(tile, inner, _):
        seen.append(get_ident())
        return windows(tile, inner)

    run_tiled(run, np.zeros((1, 40, 40)), 2, 400)
    assert set(seen) == {get_ident()} and len(seen) > 1


def test_too_small_a_halo_shows():
    image = np.random.default_rng(0).integers(0, 1000, (1, 30, 30))
    assert (run_tiled(windows, image, 1, 64)["sum"] != windows(image)["sum"]).any()


def test_what_goes_wrong_in_a_tile_is_said_and_ends_the_others():
    begun = []

    def run(tile, inner, _):
        begun.append(1)
        if len(begun) == 1:
            raise ArithmeticError("no")
        time.sleep(0.01)
        return windows(tile, inner)

    with pytest.raises(ArithmeticError, match="no"):
        run_tiled(run, np.zeros((1, 300, 300)), 2, 100, at_once=2)
    assert len(begun) < 100  # of thousands


def test_ctrl_c_ends_after_the_tiles_at_work():
    begun = []

    def run(tile, inner, _):
        begun.append(1)
        time.sleep(0.01)
        return windows(tile, inner)

    def stop(done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_tiled(run, np.zeros((1, 300, 300)), 2, 100, stop, at_once=2)
    assert len(begun) < 100


@given(
    st.integers(1, 3000), st.integers(1, 3000), st.integers(1, 30), st.integers(3000, 60000),
    st.integers(1, 8),
)  # fmt: skip
def test_tiles_look_at_few_pixels_more_than_squares_would(height, width, halo, pixels, at_once):
    """Squares as large as may be, those at the lower and right border cut: the simple way. (What
    fits into one tile is cut up for the threads' sake alone.)"""
    side = int(pixels**0.5) - 2 * halo
    assume(side >= halo and height * width > pixels)

    def looked_at(rows, columns):
        return [
            (min(y + rows + halo, height) - max(y - halo, 0))
            * (min(x + columns + halo, width) - max(x - halo, 0))
            for y in range(0, height, rows) for x in range(0, width, columns)
        ]  # fmt: skip

    ours = looked_at(*tile_size(height, width, halo, pixels, at_once=at_once))
    squares = looked_at(side, side)
    assert max(ours) <= pixels

    def cost(tiles):
        """Rounds of the mean tile; the largest takes as long as it takes, whatever is beside it."""
        rounds = -(-len(tiles) // at_once)
        return max(rounds * (sum(tiles) / len(tiles) + TILE_PIXELS), max(tiles) + TILE_PIXELS)

    assert cost(ours) <= 1.1 * cost(squares)


def test_a_tile_is_no_larger_than_asked():
    shapes = []

    def run(tile, inner, _):
        shapes.append(tile.shape)
        return windows(tile, inner)

    run_tiled(run, np.zeros((1, 300, 200)), 5, 40 * 40)
    assert max(h * w for _, h, w in shapes) <= 40 * 40
    assert len(shapes) > 10
