"""A picture of any size, worked off in tiles that see a halo around themselves.

Where an answer looks no farther than the halo, tiling changes nothing but the memory it takes:
that of the tiles at work, picture and large maps being in files (`scratch`).
"""

from threading import Lock

import numpy as np

from . import scratch
from .threads import in_threads

TILE_BYTES = 3e8  # about what the work on all tiles at hand may take
TILE_PIXELS = 300  # what a tile costs beside its pixels, as a number of them


def run_tiled(run, image, halo, pixels, progress=None, multiple=1, at_once=1):
    """Maps of an image (..., height, width), tile by tile.

    run       takes a tile (..., h, w); top, left, height and width (4,) int64 of the part of it
              that it has to answer, with a dict of maps (..., height, width); and the row and
              column of the image at which the tile begins
    halo      how many pixels around itself an answer depends on
    pixels    at most about so many in one tile, its halo included
    multiple  tiles begin at multiples of it; halo must be one
    progress  called as progress(done, total) after each tile
    at_once   tiles that are worked on at a time, in threads
    """
    height, width = image.shape[-2:]
    rows, columns = tile_size(height, width, halo, pixels, multiple, at_once)
    corners = [(y, x) for y in range(0, height, rows) for x in range(0, width, columns)]
    maps, writing = {}, Lock()

    def work(corner):
        y, x = corner
        top, left = max(0, y - halo), max(0, x - halo)
        tile = image[..., top : y + rows + halo, left : x + columns + halo]
        h, w = min(rows, height - y), min(columns, width - x)
        answer = run(tile.copy(), np.array([y - top, x - left, h, w]), (top, left))
        with writing:
            for name, part in answer.items():
                if name not in maps:
                    maps[name] = scratch.empty((*part.shape[:-2], height, width), part.dtype)
                maps[name][..., y : y + h, x : x + w] = part
                scratch.release(maps[name])
            scratch.release(image)

    in_threads(work, corners, at_once, progress)
    return maps


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
