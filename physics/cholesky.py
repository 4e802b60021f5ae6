"""Cholesky's factorisation of many small matrices, by operations that ONNX has, too."""

import torch

BLOCK = 6


def cholesky(gram, most):
    """L and L^-1 of I + gram (R, q, q) = L L'; an exported graph is for any q <= most."""
    if torch.compiler.is_exporting():
        return _cholesky_by_blocks(gram, most)
    one = eye(gram.shape[1], gram.shape[1], gram)
    lower = torch.linalg.cholesky_ex(one + gram)[0]
    return lower, torch.linalg.solve_triangular(lower, one, upper=False)


def _cholesky_by_blocks(gram, most):
    """The same, from operations that ONNX has.

    Padded with the identity to `most`, a multiple of BLOCK; block by block, within a block by
    elimination.
    """
    pad = eye(most, gram.shape[1], gram)
    a = pad @ gram @ pad.T + eye(most, most, gram)
    inverse = eye(most, most, gram).expand_as(a)
    lower, rows = [], []
    for start in range(0, most, BLOCK):
        # a and inverse hold the rows and columns not yet eliminated
        root_inverse = _root_inverse(a[:, :BLOCK, :BLOCK])
        row = root_inverse @ inverse[:, :BLOCK]  # of L^-1
        upper = root_inverse @ a[:, :BLOCK]  # of L'
        rest = upper[:, :, BLOCK:].transpose(1, 2)
        rows.append(row)
        lower.append(torch.cat([torch.zeros_like(row[:, :, :start]), upper], dim=2))
        a = a[:, BLOCK:, BLOCK:] - rest @ upper[:, :, BLOCK:]
        inverse = inverse[:, BLOCK:] - rest @ row
    return (
        pad.T @ torch.cat(lower, dim=1).transpose(1, 2) @ pad,
        pad.T @ torch.cat(rows, dim=1) @ pad,
    )


def _root_inverse(a):
    """l^-1 of a (R, BLOCK, BLOCK) = l l', by Gauss's elimination of [a, I]."""
    one = eye(BLOCK, BLOCK, a)
    both = torch.cat([a, one.expand_as(a)], dim=2)
    for i in range(BLOCK - 1):
        row, column = both[:, i : i + 1], both[:, :, i : i + 1]
        below = (torch.arange(BLOCK, device=a.device)[:, None] > i).to(a.dtype)
        both = both - (below * column / row[:, :, i : i + 1]) * row
    pivots = (both[:, :, :BLOCK] * one).sum(2, keepdim=True)
    return both[:, :, BLOCK:] * torch.rsqrt(pivots)


def log_det(lower):
    """(R,) log determinants of triangular matrices (R, q, q)."""
    return torch.log(torch.diagonal(lower, dim1=1, dim2=2)).sum(dim=1)


def eye(rows, columns, like):
    """(rows, columns) ones on the diagonal, of the type and device of a tensor."""
    return torch.eye(rows, columns, dtype=like.dtype, device=like.device)
