"""A picture of any size, processed in tiles that see a halo around themselves.

If an answer looks no farther than the halo, tiling changes only the memory it takes: that of the
tiles at work, since the picture and large maps are in files (`scratch`).
"""

import mmap
from itertools import pairwise, product
from threading import Lock

import numpy as np

from . import scratch
from .threads import in_threads

TILE_BYTES = 3e8  # about what the work on all tiles at hand may take; in ONNX Runtime, on two
MOST_AT_ONCE = 8  # tiles; for more, memory is scarcer than cores
UNRELEASED = 4  # times LARGE, of pages
TILE_PIXELS = 300  # what a tile costs beside its pixels, as a number of them


def run_tiled(run, image, halo, pixels, progress=None, multiple=1, at_once=1, cuts=None):
    """Maps of an image (..., height, width), tile by tile.

    run       takes a tile (..., h, w); top, left, height and width (4,) int64 of the part of it
              that it has to answer, with a dict of maps (..., height, width); and the row and
              column of the image at which the tile begins
    halo      how many pixels around itself an answer depends on
    pixels    at most about so many in one tile, its halo included
    multiple  tiles begin at multiples of it; halo must be one
    progress  called as progress(done, total) after each tile
    at_once   tiles that are worked on at a time, in threads
    cuts      borders in rows and in columns, the image's own included, that no tile crosses but by
              its halo; None: the image's own
    """
    height, width = image.shape[-2:]
    down, across = cuts or ((0, height), (0, width))
    sharing = at_once if len(down) + len(across) == 4 else 1  # else other parts keep them busy
    tiles = []
    for (y0, y1), (x0, x1) in product(pairwise(down), pairwise(across)):
        rows, columns = tile_size(y1 - y0, x1 - x0, halo, pixels, multiple, sharing)
        for y, x in product(range(y0, y1, rows), range(x0, x1, columns)):
            tiles.append((y, x, min(rows, y1 - y), min(columns, x1 - x)))
    maps, writing, unreleased = {}, Lock(), 0

    def work(part):
        nonlocal unreleased
        y, x, h, w = part
        top, left = max(0, y - halo), max(0, x - halo)
        tile = image[..., top : y + h + halo, left : x + w + halo]
        answer = run(tile.copy(), np.array([y - top, x - left, h, w]), (top, left))
        with writing:
            for name, map_ in answer.items():
                if name not in maps:
                    maps[name] = scratch.zeros((*map_.shape[:-2], height, width), map_.dtype)
                maps[name][..., y : y + h, x : x + w] = map_
            unreleased += sum(map(_of_pages, (tile, *answer.values())))
            # not each time: a page lies in tiles side by side
            if unreleased > UNRELEASED * scratch.LARGE:
                release()
                unreleased = 0

    def release():
        for array in (image, *maps.values()):
            scratch.release(array)

    in_threads(work, tiles, at_once, progress)
    release()
    return maps


def _of_pages(part):
    """Bytes of the pages that a part of an array, (..., h, w), lies in, at most about."""
    rows = part.size // part.shape[-1]
    return part.nbytes + rows * mmap.PAGESIZE


def tile_size(height, width, halo, pixels, multiple=1, at_once=1):
    """Rows and columns of the tiles, halo not included, that cost least: the pixels that all tiles
    look at, and TILE_PIXELS for each, where in the last round some of at_once may have nothing to
    do. The smallest, where all look at more pixels than they may."""
    least = max(halo, multiple)
    rows, columns = (
        np.unique(-(-n // (np.arange(1, n // least + 2) * multiple)) * multiple)
        for n in (height, width)
    )
    rows = rows[:, None]
    down, across = -(-height // rows), -(-width // columns)
    largest = np.minimum(rows + np.minimum(down - 1, 2) * halo, height) * np.minimum(
        columns + np.minimum(across - 1, 2) * halo, width
    )
    tiles = down * across
    seen = (height + 2 * halo * (down - 1)) * (width + 2 * halo * (across - 1))
    rounds = -(-tiles // at_once)
    cost = (seen / tiles + TILE_PIXELS) * rounds
    best = np.where(largest <= pixels, cost, np.inf).argmin()
    i, j = np.unravel_index(best, cost.shape)
    return int(rows[i, 0]), int(columns[j])
