"""Triangles made smaller until no edge is too long: what varies over them is known at vertices."""

import numpy as np


def refined(vertices, faces, longest):
    """A mesh (n, columns) and (f, 3), of the same surface, whose edges are not too long.

    vertices  the first three columns are places, m; the others are halved with them
    longest   (m, 3) middles of edges -> (m,) m that these may have

    Whether an edge is halved is its own affair, so that triangles which share it stay joined.
    """
    done = []
    while len(faces):
        edges = np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
        keys, of = np.unique(edges @ [len(vertices), 1], return_inverse=True)
        start, end = (vertices[i] for i in np.divmod(keys, len(vertices)))
        half = (start + end) / 2
        long = np.linalg.norm((end - start)[:, :3], axis=1) > longest(half[:, :3])
        middle = np.where(long, len(vertices) + np.cumsum(long) - 1, -1)[of].reshape(-1, 3)
        whole = (middle < 0).all(axis=1)
        done.append(faces[whole])
        faces = _cut(faces[~whole], middle[~whole])
        vertices = np.concatenate([vertices, half[long]])
    return vertices, np.concatenate(done)


def _cut(faces, middle):
    """Faces (f, 3) cut at the vertices in the middle (f, 3) of their edges, of which the first is
    between the first two corners; -1 where there is none, of one to three."""
    count = (middle >= 0).sum(axis=1)
    # turned so that of one the first edge is cut, of two the last is not
    first = np.where(count == 1, (middle >= 0).argmax(axis=1), (middle < 0).argmax(axis=1) + 1)
    turn = (first[:, None] + np.arange(3)) % 3
    a, b, c = np.take_along_axis(faces, turn, axis=1).T
    ab, bc, ca = np.take_along_axis(middle, turn, axis=1).T
    parts = (
        [(a, ab, c), (ab, b, c)],
        [(ab, b, bc), (a, ab, c), (ab, bc, c)],
        [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)],
    )
    made = (np.stack(part, axis=1)[count == n] for n, of in enumerate(parts, 1) for part in of)
    return np.concatenate(list(made))
