"""A picture of any size by a model that answers tiles, in torch (`learned`) or ONNX Runtime
(`runtime`), with the materials expected and allowed in each tile."""

import numpy as np

from physics.errors import InputError
from physics.expected import among_all
from physics.hypotheses import of_materials, set_up
from physics.known import bytes_per_pixel
from physics.machinery.tiles import run_tiled


def by_tiles(
    answer, radiance, known, expected=None, regions=None, *, halo, cell, tile_bytes, at_once=1,
    progress=None,
):  # fmt: skip
    """Maps (..., height, width) by name, material int16 among all materials.

    answer      (scene, tile, log_expected, inner) -> maps of the part inner of a tile (bands, h,
                w), see `physics.machinery.tiles.run_tiled`; scene, as from
                `physics.hypotheses.set_up`, and log_expected (materials, h, w) contain only the
                materials looked for there
    radiance    (bands, height, width) W m-2 sr-1 um-1
    known       dict of float32 arrays as `physics.known.known_arrays` makes it
    expected    physics.expected.Expected of the materials; None: nothing is expected
    regions     physics.expected.Regions of the picture; None: all materials everywhere
    halo, cell  how far the model sees, pixels; tiles begin at multiples of cell
    tile_bytes  approximate memory for a tile;  at_once  tiles processed in threads at a time
    progress    called as progress(done, total) after each tile

    Raises InputError if expected or regions do not match these materials and this picture.
    """
    materials = len(known["is_sky"])
    if expected is not None and len(expected.nats) != materials:
        raise InputError(
            f"model: expected must be of {materials} materials, got {len(expected.nats)}."
        )
    if regions is not None:
        regions.check(radiance.shape[1:], materials, cell)

    scene = set_up(known)

    def of_tile(tile, inner, corner):
        held = regions.at(*(corner + inner[:2])) if regions else np.ones(materials, bool)
        if expected is None:
            log_expected = np.zeros((np.count_nonzero(held), *tile.shape[1:]), np.float32)
        else:
            log_expected = expected.of_tile(*corner, *tile.shape[1:], held)
        there = of_materials(scene, held) if regions else scene
        maps = answer(there, tile, log_expected, inner)
        return among_all(maps | {"material": maps["material"].astype(np.int16)}, held)

    pixels = tile_bytes / bytes_per_pixel(known)
    cuts = regions and regions.cuts
    return run_tiled(of_tile, radiance, halo, pixels, progress, cell, at_once, cuts)
