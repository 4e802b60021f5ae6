"""A picture of any size, worked off in tiles that see a halo around themselves.

Where an answer looks no farther than the halo, tiling changes nothing but the memory it takes:
that of a tile, picture and large maps being in files (`scratch`).
"""

import math

import numpy as np

from . import scratch

TILE_BYTES = 5.2e8  # about what the work on one tile may take


def run_tiled(run, image, halo, pixels, progress=None, multiple=1):
    """Maps of an image (..., height, width), tile by tile.

    run       takes a tile (..., h, w), and top, left, height and width (4,) int64 of the part of
              it that it has to answer, with a dict of maps (..., height, width)
    halo      how many pixels around itself an answer depends on
    pixels    at most about so many in one tile, its halo included
    multiple  tiles begin at multiples of it; halo must be one
    progress  called as progress(done, total) after each tile
    """
    height, width = image.shape[-2:]
    side = max(halo, int(math.sqrt(pixels)) - 2 * halo, multiple) // multiple * multiple
    corners = [(y, x) for y in range(0, height, side) for x in range(0, width, side)]
    maps = {}
    for done, (y, x) in enumerate(corners, 1):
        top, left = max(0, y - halo), max(0, x - halo)
        tile = image[..., top : y + side + halo, left : x + side + halo]
        h, w = min(side, height - y), min(side, width - x)
        inner = np.array([y - top, x - left, h, w])
        for name, part in run(tile.copy(), inner).items():
            if name not in maps:
                maps[name] = scratch.empty((*part.shape[:-2], height, width), part.dtype)
            maps[name][..., y : y + h, x : x + w] = part
            scratch.release(maps[name])
        scratch.release(image)
        if progress is not None:
            progress(done, len(corners))
    return maps
