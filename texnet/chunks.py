"""Work that each pixel does by itself, done for some thousand pixels at a time."""

import torch
from torch._higher_order_ops.scan import scan
from torch.nn import functional

CHUNK = 8192  # pixels, at most: what they take on the way stays in the processor's cache


def by_chunks(work, arrays, most):
    """work(*arrays), of arrays (..., P) whose pixels do not depend on each other: a tuple of such.

    Chunk by chunk on a CPU and in an exported graph (ONNX's Scan), elsewhere all at once. P is at
    most `most`.
    """
    if torch.compiler.is_exporting():
        return _scan(work, arrays, most)
    size = CHUNK if arrays[0].device.type == "cpu" else most
    parts = [work(*part) for part in zip(*(a.split(size, -1) for a in arrays), strict=True)]
    return tuple(torch.cat(part, -1) for part in zip(*parts, strict=True))


def _scan(work, arrays, most):
    chunks = (most + CHUNK - 1) // CHUNK  # not of P, which torch may only know from numbers
    pixels = arrays[0].shape[-1]
    size = (pixels + chunks - 1) // chunks

    def split(a):
        a = functional.pad(a, (0, chunks * size - pixels))
        return a.unflatten(-1, (chunks, size)).movedim(-2, 0).contiguous()

    def join(a):
        return a.movedim(0, -2).flatten(-2)[..., :pixels]

    def step(nothing, parts):
        return nothing.clone(), (*work(*parts),)

    _, out = scan(step, torch.zeros(1), tuple(split(a) for a in arrays))
    return tuple(join(a) for a in out)
