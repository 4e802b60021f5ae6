"""Independent work on pixels, done for some thousand of them at a time."""

import torch
from torch._higher_order_ops.scan import scan
from torch.nn import functional

# size of a chunk, so that intermediates stay in the cache: pixels times materials for the evidence
# (a few operations on much data) and the solution (a thousand on little, each with overhead);
# pixels times bands for distilling texture
SEEN, SOLVED, TEXTURED = 32_768, 131_072, 131_072


def chunks_of(pixels, size, most):
    """Number of chunks for so many pixels, each of about most = pixels times size."""
    return (pixels * size + most - 1) // most


def by_chunks(work, arrays, chunks):
    """work(*arrays) for arrays (..., P) of independent pixels; returns a tuple of such arrays.

    On a CPU and in an exported graph (ONNX's Scan) it is done in about so many chunks of equal
    size, elsewhere all at once.
    """
    if torch.compiler.is_exporting():
        return _scan(work, arrays, chunks)
    if arrays[0].device.type != "cpu":
        return tuple(work(*arrays))
    size = max(1, -(-arrays[0].shape[-1] // chunks))
    parts = [work(*part) for part in zip(*(a.split(size, -1) for a in arrays), strict=True)]
    return tuple(torch.cat(part, -1) for part in zip(*parts, strict=True))


def _scan(work, arrays, chunks):
    pixels = arrays[0].shape[-1]
    size = (pixels + chunks - 1) // chunks

    def split(a):
        a = functional.pad(a, (0, chunks * size - pixels))
        return a.unflatten(-1, (chunks, size)).movedim(-2, 0).contiguous()

    def join(a):
        return a.movedim(0, -2).flatten(-2)[..., :pixels]

    def step(carry, parts):
        # scan needs a carry, and as a new tensor
        return carry.clone(), (*work(*parts),)

    _, out = scan(step, torch.zeros(1), tuple(split(a) for a in arrays))
    return tuple(join(a) for a in out)
