"""A closed room without sky: all light is from walls, furniture, a person and a radiator.

5.2 m by 6 m by 2.7 m, air 294 K: floor 292 K, ceiling 295 K, a cold window pane at 281 K with a
radiator of 322 K beneath, a lamp whose shade is at 308 K and bulb at 345 K, a cup of tea at
330 K, a face at 304 K. A concrete shell 0.3 m outside the walls makes sure that no ray escapes.
"""

import numpy as np

from .. import geometry as g
from ..scene import Camera, Scene, SceneObject
from . import props

AIR_K = 294.0
SIZE = (5.2, 6.0, 2.7)  # x from -2.6 to 2.6, y from -3 to 3


def _cushion(size, seed):
    """A stuffed block with rounded edges and folds, on z = 0."""
    size = np.asarray(size, float)
    m = g.slab((1, 1, 1), 0.045, lambda v: 0 * v[:, 0])
    p = (m.vertices - [0, 0, 0.5]) * 2
    round_ = p * np.sqrt(
        1
        - 0.5 * np.roll(p**2, 1, axis=1)
        - 0.5 * np.roll(p**2, 2, axis=1)
        + np.roll(p**2, 1, axis=1) * np.roll(p**2, 2, axis=1) / 3
    )
    p = 0.72 * p + 0.28 * round_
    v = (p / 2 + [0, 0, 0.5]) * size
    return g.displace(g.mesh(v, m.faces), 0.012 * g.fractal_noise(v, 0.16, seed, 3))


def _curtain(x0, x1, seed):
    """A hanging cloth with folds between x0 and x1 on the wall y = 3."""
    x, z = np.linspace(x0, x1, 60), np.linspace(0.12, 2.5, 40)
    a, b = (m.ravel() for m in np.meshgrid(x, z))
    depth = 2.78 + 0.05 * np.sin(2 * np.pi * (a - x0) / 0.13 + 1.2 * np.sin(2 * b))
    p = np.c_[a, depth, b]
    p[:, 1] += 0.02 * g.value_noise(p, (0.1, 0.1, 0.6), seed)
    return g.mesh(p, g.grid_faces(40, 60))


def room(seed=0):
    """The room Scene of this seed, about 0.2 million triangles, atmosphere None."""
    rng = np.random.default_rng([seed, 505])
    number = lambda: int(rng.integers(2**31))
    objects = []

    def add(mesh, material, kelvin, smooth=False, name="", wobble_k=0.3):
        t = kelvin + wobble_k * g.fractal_noise(mesh.vertices, 0.7, number(), 2)
        objects.append(SceneObject(mesh, material, t, smooth, name or material))

    def stand(parts, position, yaw=0.0, name=""):
        for p in parts:
            add(g.place(p.mesh, position, yaw), p.material, AIR_K + p.warmth_k, p.smooth, name)

    add(g.box((-2.9, -3.3, -0.3), (2.9, 3.3, 3.0)), "concrete", AIR_K - 4, name="shell")
    rough = number()
    shell = g.slab(SIZE, 0.06, lambda v: 0.004 * g.fractal_noise(v, 0.25, rough, 3))
    z = shell.triangles_center[:, 2]
    floor, ceiling = z < 0.02, z > SIZE[2] - 0.02
    walls = g.select(shell, ~floor & ~ceiling)
    zw = walls.vertices[:, 2]
    cold = 4 * np.exp(-((walls.vertices[:, 1] - 3) ** 2) / 0.6)  # the outer wall
    add(walls, "plaster", AIR_K - 1.2 + 0.9 * zw - cold, True, "walls")
    add(g.select(shell, ceiling), "white_paint", AIR_K + 1.2, True, "ceiling")
    add(g.select(shell, floor), "wood", AIR_K - 2.2, True, "subfloor")
    at = np.arange(-2.6, 2.6, 0.14)
    cut = rng.uniform(-2, 2, len(at))
    low = np.r_[
        np.c_[at, np.full(len(at), -3.0), 0 * at - 0.03], np.c_[at, cut + 0.004, 0 * at - 0.03]
    ]
    high = np.r_[
        np.c_[at + 0.134, cut, 0 * at + 0.016], np.c_[at + 0.134, 0 * at + 3, 0 * at + 0.016]
    ]
    high[:, 2] += rng.normal(0, 0.0015, len(high))
    add(g.boxes(low, high), "wood", AIR_K - 2.0, name="floor boards")
    add(
        g.boxes(
            [(-2.62, -3, 0), (2.57, -3, 0), (-2.6, 2.97, 0)],
            [(-2.57, 3, 0.12), (2.62, 3, 0.12), (2.6, 3.02, 0.12)],
        ),
        "white_paint",
        AIR_K - 1,
        name="skirting",
    )

    # The window in the far wall, its radiator, curtains.
    w0, w1, z0, z1 = -0.9, 0.9, 1.0, 2.3
    add(g.box((w0, 2.95, z0), (w1, 2.97, z1)), "glass", AIR_K - 13, name="window")
    frame = [
        (w0 - 0.08, w0 + 0.03, z0 - 0.08, z1 + 0.08),
        (w1 - 0.03, w1 + 0.08, z0 - 0.08, z1 + 0.08),
        (w0, w1, z0 - 0.08, z0 + 0.03),
        (w0, w1, z1 - 0.03, z1 + 0.08),
        (-0.04, 0.04, z0, z1),
    ]
    add(
        g.boxes([(a, 2.90, c) for a, b, c, d in frame], [(b, 3.02, d) for a, b, c, d in frame]),
        "white_paint",
        AIR_K - 5,
        name="window frame",
    )
    add(
        g.box((w0 - 0.15, 2.72, z0 - 0.12), (w1 + 0.15, 3.02, z0 - 0.078)),
        "wood",
        AIR_K + 1,
        name="window sill",
    )
    fins = np.arange(-0.75, 0.75, 0.07)
    n = len(fins)
    radiator = g.boxes(
        np.r_[
            np.c_[fins, np.full(n, 2.84), np.full(n, 0.2)],
            [[-0.78, 2.86, 0.24], [-0.78, 2.86, 0.72]],
        ],
        np.r_[
            np.c_[fins + 0.045, np.full(n, 2.93), np.full(n, 0.82)],
            [[0.78, 2.91, 0.3], [0.78, 2.91, 0.78]],
        ],
    )
    add(radiator, "white_paint", AIR_K + 24 + 8 * radiator.vertices[:, 2], name="radiator")
    pipe = g.tube(
        [[0.82, 2.88, 0.0], [0.82, 2.88, 0.2], [0.80, 2.88, 0.27], [0.7, 2.88, 0.27]],
        [0.014] * 4,
        10,
    )
    add(pipe, "steel", AIR_K + 26, True, "pipe")
    for x0, x1 in ((-1.5, -0.85), (0.85, 1.5)):
        add(_curtain(x0, x1, number()), "fabric", AIR_K - 3, True, "curtain")
    add(
        g.tube([[-1.6, 2.8, 2.52], [0, 2.8, 2.52], [1.6, 2.8, 2.52]], [0.018] * 3, 10),
        "steel",
        AIR_K,
        True,
        "curtain rail",
    )

    # Table with chairs, tea things.
    top = 0.75
    turned = g.lathe(
        [[0.035, 0.0], [0.03, 0.1], [0.045, 0.3], [0.03, 0.4], [0.05, 0.6], [0.05, top]], 16
    )
    legs = g.join([g.place(turned, (x, y, 0)) for x in (-0.62, 0.62) for y in (-0.36, 0.36)])
    table = g.join(
        [
            g.boxes(
                [[-0.75, -0.46, top - 0.04], [-0.66, -0.38, top - 0.13]],
                [[0.75, 0.46, top], [0.66, 0.38, top - 0.03]],
            ),
            legs,
        ]
    )
    spot = np.array([0.75, 0.55, 0.01])
    add(g.place(table, spot), "wood", AIR_K - 0.3, name="table")
    cup = g.lathe(
        [
            [0.0, 0.008],
            [0.028, 0.0],
            [0.03, 0.01],
            [0.041, 0.05],
            [0.044, 0.09],
            [0.040, 0.09],
            [0.036, 0.05],
            [0.02, 0.015],
            [0, 0.013],
        ],
        32,
    )
    a = np.linspace(-1.4, 1.4, 9)
    handle = g.tube(
        np.c_[0.038 + 0.03 * np.cos(a), 0 * a, 0.05 + 0.028 * np.sin(a)], [0.006] * 9, 8
    )
    plate = g.lathe(
        [[0, 0.004], [0.07, 0.0], [0.12, 0.018], [0.122, 0.022], [0.07, 0.008], [0, 0.009]], 40
    )
    jug = g.lathe(
        [
            [0, 0],
            [0.07, 0],
            [0.1, 0.06],
            [0.105, 0.12],
            [0.07, 0.2],
            [0.055, 0.25],
            [0.07, 0.3],
            [0.064, 0.3],
            [0.05, 0.25],
            [0.0, 0.24],
        ],
        40,
    )
    for dx, dy, kind, warm in (
        (-0.35, -0.15, g.join([cup, handle]), 36),
        (0.1, -0.22, plate, 0),
        (0.1, -0.22, g.place(cup, (0, 0, 0.012)), 20),
        (-0.05, 0.12, jug, 4),
        (0.45, 0.0, plate, 0),
    ):
        add(
            g.place(kind, spot + [dx, dy, top], rng.uniform(0, 6), 1.35),
            "ceramic",
            AIR_K + warm,
            True,
            "tea things",
            0.8,
        )
    chair = g.boxes(
        [
            [-0.2, -0.2, 0.42],
            [-0.2, -0.2, 0],
            [0.16, -0.2, 0],
            [-0.2, 0.16, 0],
            [0.16, 0.16, 0],
            [-0.16, 0.17, 0.62],
            [-0.16, 0.17, 0.78],
            [-0.16, 0.17, 0.92],
        ],
        [
            [0.2, 0.2, 0.46],
            [-0.16, -0.16, 0.43],
            [0.2, -0.16, 0.43],
            [-0.16, 0.2, 1.0],
            [0.2, 0.2, 1.0],
            [0.16, 0.19, 0.7],
            [0.16, 0.19, 0.85],
            [0.16, 0.19, 1.0],
        ],
    )
    for x, y, yaw in ((0.35, -0.25, 3.0), (1.2, -0.2, 3.4), (1.75, 0.75, -1.7)):
        add(g.place(chair, (x, y, 0.012), yaw), "wood", AIR_K - 0.6, name="chair")
        seat = _cushion((0.38, 0.38, 0.05), number())
        add(g.place(seat, (x, y, 0.468), yaw), "fabric", AIR_K + 0.5, True, "seat")

    # Sofa on the left wall, rug, shelf with books, lamp, door, pictures.
    for x, y, zz, size in (
        (-2.05, 0.35, 0.08, (0.9, 2.0, 0.34)),
        (-2.42, 0.35, 0.3, (0.28, 2.0, 0.6)),
        (-2.05, -0.62, 0.1, (0.9, 0.24, 0.55)),
        (-2.05, 1.32, 0.1, (0.9, 0.24, 0.55)),
        (-1.98, -0.1, 0.40, (0.72, 0.8, 0.16)),
        (-1.98, 0.78, 0.40, (0.72, 0.8, 0.16)),
        (-2.2, 1.0, 0.56, (0.16, 0.42, 0.4)),
    ):
        part = g.place(_cushion(size, number()), (x, y, zz))
        warm = 5 * np.exp(-((part.vertices - [-1.95, -0.1, 0.6]) ** 2).sum(1) / 0.12)
        add(part, "fabric", AIR_K + warm, True, "sofa")  # someone has just got up
    edge = np.linspace(-1, 1, 130)
    weave = number()
    rug = g.sheet(
        1.15 * edge,
        0.85 * edge,
        lambda p: (
            0.035
            + 0.007 * np.sin(40 * p[:, 0]) * np.sin(40 * p[:, 1])
            + 0.006 * g.fractal_noise(np.c_[p, 0 * p[:, 0]], 0.2, weave, 3)
            - 0.03 * (np.max(np.abs(p) / [1.15, 0.85], axis=1) > 0.985)
        ),
    )
    add(g.place(rug, (-0.5, -0.35, 0.0), 0.1), "fabric", AIR_K - 1.2, True, "rug")
    case = g.boxes(
        [[2.28, 1.4, 0], [2.28, 2.78, 0], [2.58, 1.4, 0]]
        + [[2.28, 1.42, h] for h in (0.06, 0.48, 0.9, 1.32, 1.74, 2.08)],
        [[2.6, 1.43, 2.1], [2.6, 2.81, 2.1], [2.61, 2.8, 2.1]]
        + [[2.59, 2.79, h + 0.025] for h in (0.06, 0.48, 0.9, 1.32, 1.74, 2.08)],
    )
    add(case, "wood", AIR_K - 0.5, name="shelf")
    books = {"fabric": [], "pvc": []}
    for h in (0.085, 0.505, 0.925, 1.345, 1.765):
        y = 1.44
        while y < 2.6:
            thick = rng.uniform(0.025, 0.07)
            tall = rng.uniform(0.2, 0.3 if h > 1.7 else 0.36)
            kind = books["fabric" if rng.random() < 0.6 else "pvc"]
            kind.append(((rng.uniform(2.31, 2.38), y, h - 0.001), (2.57, y + thick, h + tall)))
            y += thick + (0.003 if rng.random() < 0.85 else rng.uniform(0.05, 0.2))
    for material, blocks in books.items():
        low, high = zip(*blocks, strict=True)
        add(g.boxes(low, high), material, AIR_K - 0.3, name="books")
    lamp = (-2.1, 2.2)
    stem = g.lathe(
        [[0, 0.01], [0.16, 0.01], [0.16, 0.03], [0.02, 0.05], [0.013, 0.1], [0.013, 1.5]], 24
    )
    shade = g.lathe([[0.24, 1.3], [0.15, 1.65], [0.145, 1.65], [0.235, 1.3]], 40)
    add(
        g.place(stem, (*lamp, 0)),
        "steel",
        AIR_K + 0.5 + 6 * (stem.vertices[:, 2] > 1.2),
        True,
        "lamp",
    )
    add(g.place(shade, (*lamp, 0)), "fabric", AIR_K + 14, True, "lamp shade", 2.0)
    bulb = g.mesh(g.sphere(3).vertices * [0.05, 0.05, 0.07] + [*lamp, 1.52], g.sphere(3).faces)
    add(bulb, "glass", AIR_K + 51, True, "bulb")
    panel = [
        [2.52, -0.9, 0.0],
        [2.5, -0.78, 0.25],
        [2.5, -0.4, 0.25],
        [2.5, -0.78, 1.15],
        [2.5, -0.4, 1.15],
    ]
    high = [
        [2.61, 0.0, 2.05],
        [2.53, -0.46, 1.05],
        [2.53, -0.08, 1.05],
        [2.53, -0.46, 1.9],
        [2.53, -0.08, 1.9],
    ]
    add(g.boxes(panel, high), "wood", AIR_K - 1, name="door")
    add(
        g.boxes([[-2.61, -0.1, 1.35], [-2.61, 0.9, 1.45]], [[-2.56, 0.7, 1.95], [-2.56, 1.4, 1.9]]),
        "wood",
        AIR_K - 0.5,
        name="picture frame",
    )
    add(
        g.boxes(
            [[-2.6, -0.05, 1.4], [-2.6, 0.94, 1.49]], [[-2.552, 0.65, 1.9], [-2.552, 1.36, 1.86]]
        ),
        "glass",
        AIR_K - 0.4,
        name="picture",
    )
    hang = g.lathe(
        [[0.02, 2.1], [0.2, 2.0], [0.27, 1.86], [0.262, 1.86], [0.19, 1.985], [0.0, 2.06]][::-1], 40
    )
    add(g.place(hang, (0.75, 0.55, 0.0)), "steel", AIR_K + 9, True, "pendant lamp")
    add(
        g.tube([[0.75, 0.55, 2.07], [0.75, 0.55, 2.4], [0.75, 0.55, 2.71]], [0.006] * 3, 6),
        "pvc",
        AIR_K + 1,
        True,
        "flex",
    )
    # Clothes worn indoors are closer to the skin's temperature than to the air's.
    stand(props.person(number(), AIR_K, 1.72, stride=0.08), (-0.65, 1.35, 0.012), 2.85, "person")
    return Scene(
        objects,
        Camera((-0.55, -2.75, 1.55), (0.1, 2.0, 0.98), 56),
        None,
        sun_direction=(-0.3, -0.5, 0.8),
        name="room",
    )
