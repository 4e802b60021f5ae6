"""Made things and people, as lists of parts: (mesh, material, warmth, smooth).

A part's warmth is what it has above the air in K, one number or one per vertex; presets add
the air temperature and their own smooth variation. Everything stands on z = 0 about the origin,
people and cars facing +y.
"""

from typing import NamedTuple

import numpy as np
import trimesh

from .. import geometry as g


class Part(NamedTuple):
    mesh: trimesh.Trimesh
    material: str
    warmth_k: float | np.ndarray
    smooth: bool = True


def _spot(m, centre, rise_k, radius_m):
    """(vertices,) a Gaussian spot of rise_k about centre."""
    return rise_k * np.exp(-((m.vertices - centre) ** 2).sum(1) / (2 * radius_m**2))


def _limb(points, radii):
    """A limb through points with radii, rounded at both ends."""
    points, radii = np.asarray(points, float), np.asarray(radii, float)
    s = np.linspace(0, 1, len(points))
    t = np.linspace(0, 1, 14)
    path = np.stack([np.interp(t, s, c) for c in points.T], axis=1)
    # A quarter ellipse in the last rings closes the limb like a capsule.
    end = np.sqrt(np.clip(1 - (1 - np.minimum(t, 1 - t) / 0.09) ** 2, 0.02, 1))
    end[(t > 0.09) & (t < 0.91)] = 1
    return g.tube(path, np.interp(t, s, radii) * end, 14)


# Height, half width, half depth (m) of a jacket: hem over the hips, waist, chest, collar.
_JACKET = np.array([
    [0.74, 0.160, 0.110], [0.76, 0.195, 0.135], [0.84, 0.190, 0.132], [0.92, 0.182, 0.126],
    [1.00, 0.170, 0.115], [1.08, 0.162, 0.110], [1.16, 0.168, 0.116], [1.24, 0.183, 0.124],
    [1.32, 0.197, 0.122], [1.37, 0.195, 0.112], [1.41, 0.165, 0.098], [1.44, 0.110, 0.085],
    [1.47, 0.075, 0.075], [1.50, 0.066, 0.066],
])  # fmt: skip


def person(seed, air_k, height=1.75, stride=0.25):
    """A walking person: clothed trunk, arms and legs; bare head and hands; rubber shoes.

    The surface lies between the air and 306 K: the face by 80 % of the way, hands 65 %, clothes
    20-35 %. stride is in m, and negative with the other foot first.
    """
    k = height / 1.75
    rows = np.linspace(0, len(_JACKET) - 1, 60)
    z, width, deep = (np.interp(rows, np.arange(len(_JACKET)), c) for c in _JACKET.T)
    torso = g.tube(np.stack([0 * z, 0 * z, z], axis=1), np.c_[width, deep], 48)
    fold = g.fractal_noise(torso.vertices, (0.09, 0.09, 0.16), seed, 2)
    torso = g.displace(torso, 0.014 * fold)
    cloth = [torso]
    for side in (-1, 1):
        swing = side * stride
        hip, foot = (side * 0.09, 0, 0.92), (side * 0.1, swing, 0.08)
        knee = (side * 0.1, swing * 0.55 + 0.05, 0.5)
        cloth.append(_limb([hip, knee, foot], [0.1, 0.068, 0.052]))
        elbow = (side * 0.27, -swing * 0.3 - 0.03, 1.12)
        wrist = (side * 0.27, -swing * 0.7 + 0.08, 0.9)
        cloth.append(_limb([(side * 0.18, 0, 1.41), elbow, wrist], [0.07, 0.055, 0.042]))
    cloth = g.join(cloth)
    skull = g.sphere(4).vertices * [0.076, 0.098, 0.118]
    x, y, z = skull.T
    face = y > 0
    y += 0.024 * face * np.exp(-((x / 0.013) ** 2) - ((z + 0.012) / 0.022) ** 2)  # nose
    y += 0.012 * np.clip(-z / 0.1, 0, 1)  # jaw
    for eye in (-0.032, 0.032):
        y -= 0.012 * face * np.exp(-(((x - eye) / 0.016) ** 2) - ((z - 0.016) / 0.013) ** 2)
    y -= 0.006 * face * np.exp(-((x / 0.024) ** 2) - ((z + 0.062) / 0.006) ** 2)  # mouth
    head = g.mesh(np.stack([x, y + 0.01, z + 1.62], axis=1), g.sphere(4).faces)
    ears = [
        g.mesh(g.sphere(2).vertices * [0.012, 0.02, 0.032] + [e, -0.005, 1.62], g.sphere(2).faces)
        for e in (-0.078, 0.078)
    ]
    neck = g.tube([[0, 0, 1.42], [0, 0.0, 1.48], [0, 0.008, 1.56]], [0.06, 0.053, 0.055], 16)
    hands = [
        g.place(
            g.mesh(g.sphere(2).vertices * [0.03, 0.045, 0.085], g.sphere(2).faces),
            (s * 0.27, -s * stride * 0.85 + 0.09, 0.83),
        )
        for s in (-1, 1)
    ]
    skin = g.join([head, neck, *ears, *hands])
    hair = g.select(head, head.triangles_center @ [0, -0.9, 1.0] > 1.655)
    hair = g.displace(hair, 0.012 + 0.004 * g.value_noise(hair.vertices, 0.02, seed))
    shoes = g.join(
        [
            g.place(
                g.mesh(g.sphere(2).vertices * [0.05, 0.13, 0.055], g.sphere(2).faces),
                (s * 0.1, s * stride + 0.05, 0.045),
            )
            for s in (-1, 1)
        ]
    )
    gap = 306 - air_k
    chest = _spot(cloth, (0, 0, 1.3), 0.1, 0.25)
    share = 0.22 + chest + 0.03 * g.value_noise(cloth.vertices, 0.2, seed)
    bare = np.where(skin.vertices[:, 2] > 1.4, 0.8, 0.65)
    parts = [
        Part(cloth, "fabric", gap * share),
        Part(skin, "skin", gap * bare),
        Part(hair, "fabric", gap * 0.35),
        Part(shoes, "rubber", gap * 0.15),
    ]
    return [p._replace(mesh=g.place(p.mesh, scale=k)) for p in parts]


# Side view of a saloon: distance from the tail (m), height of bonnet or roof, of the window line.
_CAR = np.array(
    [
        [0.00, 0.62, 0.60],
        [0.04, 0.86, 0.80],
        [0.30, 0.97, 0.90],
        [0.62, 1.00, 0.93],
        [1.10, 1.33, 0.94],
        [1.45, 1.43, 0.94],
        [2.00, 1.46, 0.93],
        [2.45, 1.42, 0.92],
        [2.75, 1.32, 0.91],
        [3.28, 0.97, 0.90],
        [3.60, 0.93, 0.88],
        [4.10, 0.84, 0.78],
        [4.33, 0.72, 0.66],
        [4.42, 0.55, 0.52],
    ]
)


def car(paint="aluminium", running=True):
    """A saloon 4.4 m long: lofted body, glass all round, four wheels, lamps, bumpers.

    A running engine warms the bonnet by 9 K, tyres by 4 K, the exhaust by 20 K.
    """
    y = np.unique(np.concatenate([np.linspace(0, 4.42, 90), _CAR[:, 0]]))
    roof, belt = (np.interp(y, _CAR[:, 0], _CAR[:, c]) for c in (1, 2))
    for line in (roof, belt):  # round the profile's corners
        line[1:-1] = np.convolve(np.pad(line, 2, mode="edge"), [0.2] * 5, "valid")[1:-1]
    u = np.abs(y / 4.42 * 2 - 1)
    half = 0.88 * (1 - 0.16 * u**5) * np.clip((1 - u) / 0.02, 0.75, 1)
    floor = 0.22 + 0.12 * u**8
    # A section, as (share of half width, height between floor, window line and roof).
    x_share = [0, 0.75, 0.95, 1.0, 1.0, 0.985, 0.96, 0.9, 0.80, 0.62, 0.3, 0]
    z_rule = [
        (0, 0),
        (0, 0),
        (0.06, 0),
        (0.25, 0),
        (0.6, 0),
        (0.85, 0),
        (1, 0),
        (1, 0.45),
        (1, 0.88),
        (1, 0.97),
        (1, 1),
        (1, 1),
    ]
    cabin = np.clip((roof - belt) / 0.4, 0, 1)
    right = []
    for share, (low, high) in zip(x_share, z_rule, strict=True):
        lean = share + (min(1.0, share * 1.08) - share) * (1 - cabin) * (high > 0)
        z = floor + low * (belt - floor) + high * (roof - belt)
        right.append(np.stack([lean * half, y - 2.21, z], axis=1))
    right = np.stack(right, axis=1)
    ring = np.concatenate([right, right[:, -2:0:-1] * [-1, 1, 1]], axis=1)
    rows, columns = ring.shape[:2]
    faces = g.grid_faces(rows, columns, wrap=True)
    body = g.mesh(ring.reshape(-1, 3), faces[:, ::-1])
    quad = np.arange(len(faces)) % ((rows - 1) * columns)
    row, column = quad // columns, quad % columns
    station = y[row]
    column = np.minimum(column, columns - 1 - column)  # both sides alike
    pillar = (np.abs(station - 2.12) < 0.05) | (np.abs(station - 1.0) < 0.06)
    side = ((column == 6) | (column == 7)) & (station > 0.86) & (station < 3.02) & ~pillar
    screen = (column >= 8) & (
        ((station > 2.78) & (station < 3.22)) | ((station > 0.7) & (station < 1.08))
    )
    tall = (roof - belt)[row] > 0.1
    glass = (side | screen) & tall
    shell = g.select(body, ~glass)
    windows = g.displace(g.select(body, glass), -0.006)
    warm = _spot(shell, (0, 1.5, 0.9), 9.0 if running else 0.0, 0.55) - 1.0
    ends = []
    for k in (0, -1):  # close nose and tail
        ends.append(g.mesh(ring[k], [(0, i, i + 1) for i in range(1, columns - 1)]))
    wheels, hubs = [], []
    for sx in (-1, 1):
        for sy in (-1.33, 1.36):
            r = np.array(
                [
                    [0.0, -0.1],
                    [0.2, -0.11],
                    [0.3, -0.1],
                    [0.325, -0.06],
                    [0.325, 0.06],
                    [0.3, 0.1],
                    [0.2, 0.11],
                    [0.0, 0.1],
                ]
            )
            tyre = g.lathe(r, 36)
            tread = np.arctan2(tyre.vertices[:, 1], tyre.vertices[:, 0])
            tyre = g.mesh(
                tyre.vertices * (1 + 0.012 * np.sign(np.sin(18 * tread)))[:, None], tyre.faces
            )
            disc = g.lathe(
                [[0, 0.125], [0.05, 0.135], [0.07, 0.12], [0.15, 0.115], [0.19, 0.13], [0.2, 0.1]][
                    ::-1
                ],
                30,
            )
            spokes = g.boxes(np.array([[-0.02, 0.05, 0.115]]), np.array([[0.02, 0.19, 0.135]]))
            spokes = g.join([g.place(spokes, yaw=a) for a in np.arange(5) * 2 * np.pi / 5])
            for m, out in ((tyre, wheels), (g.join([disc, spokes]), hubs)):
                v = np.c_[m.vertices[:, 2] * sx, m.vertices[:, 0], m.vertices[:, 1] * sx]
                out.append(g.mesh(v + [sx * 0.80, sy, 0.318], m.faces))
    trim = g.boxes(
        [
            [-0.74, -2.235, 0.42],
            [-0.66, 2.1, 0.40],
            [-0.95, 0.78, 0.93],
            [0.84, 0.78, 0.93],
            [-0.905, -0.2, 0.78],
            [0.885, -0.2, 0.78],
        ],
        [
            [0.74, -2.1, 0.55],
            [0.66, 2.235, 0.52],
            [-0.84, 0.88, 1.05],
            [0.95, 0.88, 1.05],
            [-0.875, -0.06, 0.81],
            [0.905, -0.06, 0.81],
        ],
    )
    lamps = g.boxes(
        [[-0.72, 2.06, 0.6], [0.46, 2.06, 0.6], [-0.74, -2.22, 0.66], [0.5, -2.22, 0.66]],
        [[-0.46, 2.16, 0.72], [0.72, 2.16, 0.72], [-0.5, -2.12, 0.8], [0.74, -2.12, 0.8]],
    )
    pipe = g.tube([[0.5, -2.3, 0.27], [0.5, -2.1, 0.27], [0.5, -1.9, 0.27]], [0.03] * 3, 12)
    return [
        Part(g.join([shell, *ends]), paint, np.r_[warm, np.full(2 * columns, -1.0)]),
        Part(windows, "glass", -1.5),
        Part(g.join(wheels), "rubber", 4.0 if running else 0.0, False),
        Part(g.join(hubs), "steel", 2.0 if running else 0.0, False),
        Part(trim, "pvc", -0.5, False),
        Part(lamps, "glass", 3.0 if running else -1.0, False),
        Part(pipe, "steel", 20.0 if running else 0.0),
    ]


def lamp_post():
    """A tapered steel post of 6 m with an arm over +y and a warm lamp head."""
    height = 6.0
    post = g.lathe([[0.0, -0.2], [0.13, -0.2], [0.13, 0.9], [0.09, 1.0], [0.05, height]], 20)
    a = np.linspace(0, np.pi / 2, 8)
    arm = np.c_[np.zeros(8), 1.3 * (1 - np.cos(a)), height - 0.05 + 0.5 * np.sin(a)]
    head = g.place(
        g.mesh(g.sphere(3).vertices * [0.16, 0.38, 0.09], g.sphere(3).faces),
        (0, 1.55, height + 0.42),
    )
    return [
        Part(g.join([post, g.tube(arm, np.full(8, 0.045), 12)]), "steel", 0.0),
        Part(head, "aluminium", 12.0),
    ]


def brick_courses(x, z, keep, rng, brick=(0.24, 0.08), joint=0.012, proud=0.014):
    """Bricks in running bond on the wall y = 0, x and z = (low, high), facing -y.

    keep(low (n, 2), high (n, 2)) -> (n,) bool leaves bricks out, e.g. over windows. Each
    stands `proud` of the joints by its own small amount and tilt.
    """
    rows = int((z[1] - z[0]) / brick[1])
    columns = int((x[1] - x[0]) / brick[0]) + 1
    i, j = (a.ravel() for a in np.mgrid[:rows, :columns])
    left = x[0] + (j - 0.5 * (i % 2)) * brick[0]
    low = np.stack([np.maximum(left, x[0]), z[0] + i * brick[1]], axis=1)
    high = np.stack([np.minimum(left + brick[0], x[1]), low[:, 1] + brick[1]], axis=1) - joint
    wanted = (high[:, 0] - low[:, 0] > 0.03) & keep(low, high)
    low, high = low[wanted], high[wanted]
    n = len(low)
    out = -proud + rng.normal(0, 0.003, (n, 1)) + rng.normal(0, 0.0025, (n, 4))
    front = np.empty((n, 4, 3))
    front[:, :, 0] = np.stack([low[:, 0], high[:, 0], high[:, 0], low[:, 0]], axis=1)
    front[:, :, 2] = np.stack([low[:, 1], low[:, 1], high[:, 1], high[:, 1]], axis=1)
    front[:, :, 1] = out
    back = front.copy()
    back[:, :, 1] = 0.005
    v = np.concatenate([front, back], axis=1).reshape(-1, 3)
    faces = np.array(
        [[0, 1, 2], [0, 2, 3]]
        + [
            f
            for k in range(4)
            for f in ([k, k + 4, (k + 1) % 4], [(k + 1) % 4, k + 4, (k + 1) % 4 + 4])
        ]
    )
    return g.mesh(v, (faces + 8 * np.arange(n)[:, None, None]).reshape(-1, 3))


STOREY_M = 3.1


def house(seed, width, depth, storeys, *, wall="brick", relief=True, shop=False):
    """A town house, its front on y = 0 facing -y, from x = 0 to width.

    Windows and a door are real recesses of 0.18 m with frames, sills and lintels. A front
    near the camera has relief: bricks one by one, or rough plaster with a string course.
    Lit windows and the ground floor are warmer, the eaves colder.
    """
    rng = np.random.default_rng(seed)
    height = storeys * STOREY_M + 0.5
    columns = max(2, int(width / 2.4))
    pitch = width / columns
    door = int(rng.integers(columns))
    holes, doors = [], []
    for s in range(storeys):
        for c in range(columns):
            x = (c + 0.5) * pitch
            if s == 0 and c == door:
                doors.append((x - 0.55, x + 0.55, 0.12, 2.4))
            elif s == 0 and shop:
                holes.append((x - 0.42 * pitch, x + 0.42 * pitch, 0.6, 2.6))
            else:
                holes.append((x - 0.58, x + 0.58, s * STOREY_M + 0.95, s * STOREY_M + 2.5))
    openings = np.array(holes + doors)

    # The wall between openings, on the grid lines of all their edges: no T-junctions.
    xs = np.unique(np.r_[0, width, openings[:, :2].ravel()])
    zs = np.unique(np.r_[-0.3, height, openings[:, 2:].ravel()])
    if wall != "brick" and relief:
        xs = np.unique(np.r_[xs, np.linspace(0, width, int(width / 0.07))])
        zs = np.unique(np.r_[zs, np.linspace(0, height, int(height / 0.07))])
    a, b = (m.ravel() for m in np.meshgrid(xs, zs))
    front = g.mesh(np.c_[a, 0 * a, b], g.grid_faces(len(zs), len(xs)))
    c = front.triangles_center
    hole = np.zeros(len(c), bool)
    for x0, x1, z0, z1 in openings:
        hole |= (c[:, 0] > x0) & (c[:, 0] < x1) & (c[:, 2] > z0) & (c[:, 2] < z1)
    front = g.select(front, ~hole)
    if wall != "brick" and relief:
        v = front.vertices.copy()
        v[:, 1] -= 0.012 * g.fractal_noise(v, 0.35, int(rng.integers(2**31)), 3, 0.6)
        front = g.mesh(v, front.faces)

    walls = [front]
    glass, frame, sill, panels = [], [], [], []
    for x0, x1, z0, z1 in openings:
        d = 0.18
        corner = np.array([[x0, z0], [x1, z0], [x1, z1], [x0, z1]])
        v = np.concatenate([np.insert(corner, 1, 0, 1), np.insert(corner, 1, d + 0.05, 1)])
        f = [
            t
            for k in range(4)
            for t in ([k, k + 4, (k + 1) % 4], [(k + 1) % 4, k + 4, (k + 1) % 4 + 4])
        ]
        walls.append(g.mesh(v, f))
    for x0, x1, z0, z1 in holes:
        d, w, middle = 0.14, 0.055, (x0 + x1) / 2
        glass.append(((x0, d + 0.03, z0), (x1, d + 0.04, z1)))
        frame += [
            ((x0, d, z0), (x0 + w, d + 0.06, z1)),
            ((x1 - w, d, z0), (x1, d + 0.06, z1)),
            ((x0 + w, d, z0), (x1 - w, d + 0.06, z0 + w)),
            ((x0 + w, d, z1 - w), (x1 - w, d + 0.06, z1)),
            ((middle - 0.03, d + 0.005, z0 + w), (middle + 0.03, d + 0.055, z1 - w)),
            ((x0 + w, d + 0.01, z1 - 0.55), (x1 - w, d + 0.05, z1 - 0.5)),
        ]
        sill += [
            ((x0 - 0.08, -0.09, z0 - 0.08), (x1 + 0.08, 0.13, z0 + 0.004)),
            ((x0 - 0.1, -0.03, z1 - 0.004), (x1 + 0.1, 0.02, z1 + 0.2)),
        ]
    for x0, x1, z0, z1 in doors:
        panels.append(((x0, 0.12, z0), (x1, 0.17, z1)))
        for row in (0.12, 0.9, 1.65):
            for side in (x0 + 0.1, (x0 + x1) / 2 + 0.05):
                panels.append(((side, 0.095, z0 + row), (side + 0.4, 0.13, z0 + row + 0.55)))
        sill += [
            ((x0 - 0.15, -0.3, -0.2), (x1 + 0.15, 0.12, z0 + 0.004)),
            ((x0 - 0.15, -0.06, z1 - 0.004), (x1 + 0.15, 0.02, z1 + 0.25)),
        ]
    sill += [
        ((-0.03, -0.22, height - 0.28), (width + 0.03, 0.1, height)),
        ((-0.02, -0.12, height - 0.42), (width + 0.02, 0.1, height - 0.27)),
    ]
    if wall != "brick":
        for s in range(1, storeys):
            sill.append(
                ((-0.01, -0.06, s * STOREY_M + 0.3), (width + 0.01, 0.02, s * STOREY_M + 0.45))
            )
        quoin = np.arange(0.2, height - 0.7, 0.62)
        sill += [
            ((x, -0.05, z), (x + 0.45, 0.02, z + 0.36))
            for z in quoin
            for x in (-0.01, width - 0.44)
        ]
    # Behind the front: side walls, back and roof as one box, seen through no gap.
    core = g.box((0, 0.24, -0.3), (width, depth, height - 0.05))
    cheeks = g.boxes(
        [(-0.0, 0, -0.3), (width - 0.02, 0, -0.3)],
        [(0.02, 0.26, height - 0.06), (width, 0.26, height - 0.06)],
    )
    ridge = np.array(
        [
            [-0.1, -0.25, height - 0.04],
            [width + 0.1, -0.25, height - 0.04],
            [width + 0.1, depth + 0.2, height - 0.04],
            [-0.1, depth + 0.2, height - 0.04],
            [-0.1, depth / 2, height + 0.3 * depth],
            [width + 0.1, depth / 2, height + 0.3 * depth],
        ]
    )
    roof = g.mesh(
        ridge,
        [[0, 1, 5], [0, 5, 4], [3, 4, 5], [3, 5, 2], [1, 2, 5], [0, 4, 3], [0, 3, 2], [0, 2, 1]],
    )
    stack = g.box(
        (width * 0.7, depth * 0.4, height),
        (width * 0.7 + 0.7, depth * 0.4 + 0.6, height + 0.3 * depth + 1.1),
    )

    def split(pairs):
        low, high = zip(*pairs, strict=True)
        return g.boxes(low, high)

    panes = split(glass)
    lit = np.repeat(
        np.where(rng.random(len(glass)) < 0.4, 5.0, 1.0) + rng.normal(0, 0.5, len(glass)), 8
    )
    shell = g.join([*walls, core, cheeks, stack])
    z = shell.vertices[:, 2]
    warm = 2.2 - 0.22 * z + 0.8 * g.fractal_noise(shell.vertices, 1.5, int(rng.integers(2**31)), 2)
    for x0, x1, _, z1 in holes:  # heat rises from every window
        warm = warm + 0.8 * np.exp(
            -((shell.vertices[:, 0] - (x0 + x1) / 2) ** 2) / 0.4 - (z - z1 - 0.2) ** 2 / 0.15
        )
    parts = [
        Part(shell, wall, warm, False),
        Part(panes, "glass", lit, False),
        Part(split(frame), "white_paint", 0.5, False),
        Part(split(sill), "limestone", 0.8, False),
        Part(split(panels), "wood", 1.5, False),
        Part(roof, "clay", -2.5, False),
    ]
    if wall == "brick" and relief:

        def keep(low, high):
            inside = np.zeros(len(low), bool)
            for x0, x1, z0, z1 in openings:
                inside |= (
                    (high[:, 0] > x0)
                    & (low[:, 0] < x1)
                    & (high[:, 1] > z0 - 0.06)
                    & (low[:, 1] < z1 + 0.2)
                )
            return ~inside & (high[:, 1] < height - 0.42)

        bricks = brick_courses((0, width), (0, height), keep, rng)
        one = rng.normal(0, 0.25, len(bricks.vertices) // 8)  # no two bricks are the same
        warm = 2.2 - 0.22 * bricks.vertices[:, 2] + np.repeat(one, 8)
        warm = warm + 0.8 * g.fractal_noise(bricks.vertices, 1.5, int(rng.integers(2**31)), 2)
        parts.append(Part(bricks, wall, warm, False))
    return parts
