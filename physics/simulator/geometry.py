"""Procedural geometry: every relief is a displaced mesh, nothing is painted on.

Two tools make nearly all of it: a smooth random function of position (`value_noise`,
summed over octaves in `fractal_noise`) and sheets of quads that it displaces. The sheet is
a polar grid for terrain (equally fine in angle as seen from its centre), a swept ring for
trunks, limbs and car bodies, a subdivided icosahedron for rocks. Foliage and grass are
real small polygons, one leaf or blade at a time.

Lengths are metres, z points up. Functions return `trimesh.Trimesh`; random ones take a seed,
or a numpy Generator where it is called rng, and repeat themselves exactly.
"""

import functools

import numpy as np
import trimesh

CANCELLED = 1e-6  # of the length of normals, below which their sum is rounding
# A fixed rotation hides the noise lattice, which would otherwise align with walls and ground.
_TILT = trimesh.transformations.euler_matrix(0.61, 0.37, 0.83)[:3, :3]


def mesh(vertices, faces):
    """A trimesh.Trimesh with vertices and faces kept exactly as given."""
    return trimesh.Trimesh(np.asarray(vertices, float), np.asarray(faces), process=False)


def join(meshes):
    """One mesh of several, vertices in order and not merged."""
    first = np.cumsum([0] + [len(m.vertices) for m in meshes])
    return mesh(
        np.concatenate([m.vertices for m in meshes]),
        np.concatenate([m.faces + n for m, n in zip(meshes, first, strict=False)]),
    )


def place(m, position=(0, 0, 0), yaw=0.0, scale=1.0):
    """The mesh scaled, turned by yaw (rad) about z, then moved to position."""
    c, s = np.cos(yaw), np.sin(yaw)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    return mesh((m.vertices * scale) @ turn.T + position, m.faces)


# ---------------------------------------------------------------- noise


def value_noise(points, scale_m, seed):
    """Smooth zero-mean noise at points (n, 3), within -1..1 -> (n,).

    scale_m is the distance over which it changes, one number or one per axis. Lattice
    values are interpolated by Perlin's quintic, so slopes and curvatures are continuous.
    """
    rng = np.random.default_rng(seed)
    size = 4096
    values, order = rng.uniform(-1, 1, size), rng.permutation(size)
    p = (np.asarray(points, float) / scale_m) @ _TILT + rng.uniform(0, size, 3)
    i = np.floor(p).astype(np.int64)
    u = p - i
    u = u * u * u * (u * (u * 6 - 15) + 10)
    x, y, z = i.T
    total = np.zeros(len(p))
    for dx in (0, 1):
        wx = u[:, 0] if dx else 1 - u[:, 0]
        hx = order[(x + dx) % size] + y
        for dy in (0, 1):
            wxy = wx * (u[:, 1] if dy else 1 - u[:, 1])
            hxy = order[(hx + dy) % size] + z
            low, high = values[order[hxy % size]], values[order[(hxy + 1) % size]]
            total += wxy * (low + u[:, 2] * (high - low))
    return total


def fractal_noise(points, scale_m, seed, octaves=4, gain=0.5):
    """value_noise summed over octaves, each half as large in scale and `gain` in height."""
    seeds = np.random.SeedSequence(int(seed)).spawn(octaves)
    scale = np.asarray(scale_m, float)
    return sum(gain**k * value_noise(points, scale / 2**k, seeds[k]) for k in range(octaves))


def normals(m):
    """(vertices, 3) unit normals, area weighted; 0 where the faces' cancel, as of both sides of a
    sheet."""
    v = m.vertices.view(np.ndarray)
    n = np.cross(v[m.faces[:, 1]] - v[m.faces[:, 0]], v[m.faces[:, 2]] - v[m.faces[:, 0]])
    total = np.stack(
        [np.bincount(m.faces.ravel(), np.repeat(n[:, k], 3), minlength=len(v)) for k in range(3)],
        axis=1,
    )
    most = np.bincount(m.faces.ravel(), np.repeat(np.linalg.norm(n, axis=1), 3), minlength=len(v))
    length = np.linalg.norm(total, axis=1)
    length[length <= CANCELLED * most] = np.inf
    return total / length[:, None]


def displace(m, height):
    """The mesh moved along its normals by height in m, one number or (vertices,)."""
    return mesh(m.vertices + normals(m) * np.reshape(height, (-1, 1)), m.faces)


# ---------------------------------------------------------------- sheets


def grid_faces(rows, columns, wrap=False):
    """Two triangles per cell of a (rows, columns) grid; wrap joins last column to first."""
    i, j = np.meshgrid(np.arange(rows - 1), np.arange(columns - (not wrap)), indexing="ij")
    a = (i * columns + j).ravel()
    b = (i * columns + (j + 1) % columns).ravel()
    c, d = a + columns, b + columns
    return np.concatenate([np.stack([a, b, d], 1), np.stack([a, d, c], 1)])


def sheet(x, y, height):
    """Heightfield over the grid lines x (n,) and y (m,); height(points (k, 2)) -> (k,)."""
    xy = np.stack(np.meshgrid(x, y, indexing="xy"), axis=-1).reshape(-1, 2)
    return mesh(np.c_[xy, height(xy)], grid_faces(len(y), len(x)))


def terrain(height, centre, heading, *, radius_m=400.0, rows=260, columns=260, sector=1.5):
    """Heightfield on a polar grid about centre (x, y): fine where a camera there looks.

    height(points (k, 2)) -> (k,); heading in rad is where the camera looks; `columns`
    spokes fill `sector` rad about it and a fifth as many the rest of the circle. Rings grow
    in proportion to their radius, so a triangle takes up about the same angle at any distance.
    """
    front = heading + np.linspace(-sector / 2, sector / 2, columns)
    back = heading + np.linspace(sector / 2, 2 * np.pi - sector / 2, columns // 5 + 2)[1:-1]
    angle = np.concatenate([front, back])
    radius = np.geomspace(0.3, radius_m, rows)[:, None]
    ring = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1)
    xy = np.concatenate([[[0.0, 0.0]], ring.reshape(-1, 2)]) + centre
    n = len(angle)
    fan = np.stack([np.zeros(n, int), np.arange(n), (np.arange(n) + 1) % n], 1) + [0, 1, 1]
    faces = np.concatenate([fan, grid_faces(rows, n, wrap=True)[:, [0, 2, 1]] + 1])
    return mesh(np.c_[xy, height(xy)], faces)


def select(m, face_mask):
    """The mesh of the faces (faces,) bool that are wanted, without unused vertices."""
    faces = m.faces[face_mask]
    used, index = np.unique(faces, return_inverse=True)
    return mesh(m.vertices[used], index.reshape(faces.shape))


def tube(path, radius, sides=12):
    """A ring of `sides` vertices swept along path (n, 3), radius (n,) or (n, 2) for ellipses.

    The frame is carried along without twist; caps close both ends.
    """
    path = np.asarray(path, float)
    radius = np.asarray(radius, float)
    radius = np.broadcast_to(radius.reshape(len(path), -1), (len(path), 2))
    tangent = np.gradient(path, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    u = np.empty_like(path)
    side = np.array([1.0, 0, 0]) if abs(tangent[0, 0]) < 0.9 else np.array([0, 1.0, 0])
    for k, t in enumerate(tangent):
        side = side - t * (side @ t)
        side /= np.linalg.norm(side)
        u[k] = side
    v = np.cross(tangent, u)
    a = np.arange(sides) * 2 * np.pi / sides
    ring = (
        path[:, None]
        + (radius[:, :1] * np.cos(a))[..., None] * u[:, None]
        + (radius[:, 1:] * np.sin(a))[..., None] * v[:, None]
    )
    vertices, faces = ring.reshape(-1, 3), grid_faces(len(path), sides, wrap=True)
    n, j = len(vertices), np.arange(sides)
    k = (j + 1) % sides
    last = n - sides
    ends = np.concatenate(
        [
            np.stack([k, j, np.full(sides, n)], 1),
            np.stack([last + j, last + k, np.full(sides, n + 1)], 1),
        ]
    )
    vertices, faces = np.concatenate([vertices, path[[0, -1]]]), np.concatenate([faces, ends])
    return mesh(vertices, faces)


def lathe(profile, sides=48):
    """A body of revolution about z from profile (n, 2) of (radius, height), bottom to top."""
    r, z = np.asarray(profile, float).T[..., None]
    a = np.arange(sides) * 2 * np.pi / sides
    ring = np.stack([r * np.cos(a), r * np.sin(a), z + 0 * a], axis=-1)
    return mesh(ring.reshape(-1, 3), grid_faces(len(profile), sides, wrap=True))


def box(low, high):
    """An axis-aligned box between two corners; its 8 vertices are shared, so no smooth=True."""
    m = trimesh.creation.box(bounds=[low, high])
    return mesh(m.vertices, m.faces)


def boxes(low, high):
    """Many axis-aligned boxes, corners low and high (n, 3), as one mesh."""
    unit = box((0, 0, 0), (1, 1, 1))
    low, high = np.atleast_2d(low).astype(float), np.atleast_2d(high).astype(float)
    v = low[:, None] + unit.vertices * (high - low)[:, None]
    first = np.arange(len(low))[:, None, None] * len(unit.vertices)
    return mesh(v.reshape(-1, 3), (unit.faces + first).reshape(-1, 3))


def slab(size, spacing_m, relief):
    """A closed upright block, size (width, depth, height), standing on z = 0, centred in x, y.

    All faces are subdivided, to somewhat more than spacing_m if they are wider than twice that,
    and displaced along their normal by relief(points (n, 3)) -> (n,), which fades to nothing at
    the edges so that they stay shut.
    """
    size = np.asarray(size, float)
    parts = []
    for axis in range(3):
        p, q = [k for k in range(3) if k != axis]
        lines = [np.linspace(0, size[k], max(2, int(np.ceil(size[k] / spacing_m)))) for k in (p, q)]
        a, b = (g.ravel() for g in np.meshgrid(*lines, indexing="ij"))
        edge = np.minimum.reduce([a, size[p] - a, b, size[q] - b])
        fade = np.clip(edge / (2 * spacing_m), 0, 1)
        faces = grid_faces(len(lines[0]), len(lines[1]))
        for end in (0, 1):
            v = np.empty((len(a), 3))
            v[:, p], v[:, q], v[:, axis] = a, b, end * size[axis]
            v[:, axis] += (1 if end else -1) * relief(v) * fade
            outward = (axis == 1) != bool(end)
            parts.append(mesh(v - size * [0.5, 0.5, 0], faces[:, ::-1] if outward else faces))
    return join(parts)


# ---------------------------------------------------------------- stone


@functools.cache
def _sphere(subdivisions):
    m = trimesh.creation.icosphere(subdivisions=subdivisions)
    return np.array(m.vertices), np.array(m.faces)


def sphere(subdivisions=3):
    """Unit icosphere, 20 * 4**subdivisions triangles."""
    return mesh(*_sphere(subdivisions))


def rock(seed, size=(1.0, 1.0, 0.7), subdivisions=5, roughness=0.06):
    """A boulder about the origin, half axes `size`: a sphere cut by planes, then weathered.

    Random planes give broken faces, fractal noise of height roughness * size rounds
    and pits them.
    """
    rng, cuts = np.random.default_rng(seed), 14
    v, faces = _sphere(subdivisions)
    n = rng.normal(size=(cuts, 3))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    reach = rng.uniform(0.62, 0.95, cuts) / np.maximum(v @ n.T, 1e-3)
    # A soft minimum over the planes leaves worn rather than knife-sharp edges.
    r = -np.log(np.exp(-18 * np.minimum(reach, 3)).sum(1) + np.exp(-18.0)) / 18
    p = v * r[:, None] * size
    offset = rng.integers(2**31)
    scale = float(np.mean(size))
    relief = fractal_noise(p, 0.45 * scale, offset, octaves=5, gain=0.55)
    cracks = 1 - np.clip(np.abs(value_noise(p, 0.5 * scale, offset + 1)) * 9, 0, 1)
    return displace(mesh(p, faces), roughness * scale * (relief - 0.6 * cracks))


# ---------------------------------------------------------------- plants


def bark_relief(points, seed, depth_m=0.02, grain_m=0.06):
    """(n,) height of bark: plates, long along z, parted by narrow furrows depth_m deep."""
    warp = value_noise(points, 5 * grain_m, seed + 3)[:, None] * [1.2, 1.2, 0] * grain_m
    p = points + warp
    plates = np.abs(value_noise(p, (grain_m, grain_m, 4 * grain_m), seed))
    cross = np.abs(value_noise(p, (2 * grain_m, 2 * grain_m, 1.5 * grain_m), seed + 1))
    fine = value_noise(p, (grain_m / 3, grain_m / 3, 1.2 * grain_m), seed + 2)
    body = np.minimum(1, 3 * plates) * np.minimum(1, 0.35 + 4 * cross)
    return depth_m * (body + 0.25 * fine - 0.6)


def _wander(start, direction, length, points, bend, rng, rise=0.0):
    """A path of (points, 3) from start: random bends, and a pull upwards by rise."""
    step = length / (points - 1)
    turn = rng.normal(0, bend, (points, 3)) + [0, 0, rise / points]
    d = np.asarray(direction, float) + np.cumsum(turn, axis=0)
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    return np.concatenate([[start], start + np.cumsum(d[:-1] * step, axis=0)])


def trunk(seed, height, radius, *, lean=0.03, sides=96, rings=240, depth_m=0.02):
    """A bark-covered trunk rising from the origin -> (mesh, path (n, 3), radii (n,)).

    Rings are spaced closer near the foot, which a camera at eye height sees best.
    """
    rng = np.random.default_rng(seed)
    coarse = _wander(
        np.zeros(3), (rng.normal(0, lean), rng.normal(0, lean), 1), height, 12, lean, rng
    )
    s = np.linspace(0, 1, rings) ** 2
    path = np.stack([np.interp(s, np.linspace(0, 1, 12), c) for c in coarse.T], axis=1)
    kernel = np.hanning(2 * (rings // 12) + 3)
    kernel /= kernel.sum()
    pad = len(kernel) // 2
    for k in range(2):  # round the corners of the coarse path
        ends = [
            2 * path[0, k] - path[pad:0:-1, k],
            path[:, k],
            2 * path[-1, k] - path[-2 : -pad - 2 : -1, k],
        ]
        path[:, k] = np.convolve(np.concatenate(ends), kernel, mode="valid")
    path -= path[0] + [0, 0, 0.25]
    z = s * height
    radii = radius * (1 - 0.75 * s) * (1 + 0.55 * np.exp(-z / (1.6 * radius)))
    m = tube(path, radii, sides)
    v = m.vertices.view(np.ndarray)
    angle = np.arctan2(v[:, 1], v[:, 0])
    foot = np.exp(-np.maximum(v[:, 2], 0) / (2.2 * radius))
    lobes = np.sin(5 * angle + rng.uniform(0, 6)) + 0.6 * np.sin(3 * angle + rng.uniform(0, 6))
    offset = int(rng.integers(2**31))
    grain = np.clip(radius * 0.3, 0.03, 0.12)
    height_m = bark_relief(v, offset, depth_m, grain) + 0.16 * radius * foot * lobes
    height_m += 0.07 * radius * value_noise(v, (radius * 1.5, radius * 1.5, radius * 4), offset + 9)
    height_m[-2:] = 0  # the caps' centres
    return displace(m, height_m), path, radii


def leaves(centres, spread_m, per_centre, size_m, rng):
    """Small folded leaves scattered about centres (n, 3); two triangles each.

    spread_m is the standard deviation about a centre. Leaf normals lean outwards and up,
    as leaves turn to the light.
    """
    centres = np.repeat(np.asarray(centres, float), per_centre, axis=0)
    n = len(centres)
    offset = rng.normal(0, 1, (n, 3)) * [1, 1, 0.7] * spread_m
    normal = rng.normal(0, 0.6, (n, 3)) + offset / spread_m * 0.5 + [0, 0, 0.8]
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    along = np.cross(normal, rng.normal(size=(n, 3)))
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(normal, along)
    size = size_m * rng.uniform(0.6, 1.3, (n, 1))
    base = centres + offset
    fold = 0.12 * size * normal
    v = np.stack(
        [
            base,
            base + size * (0.45 * along + 0.32 * across) + fold,
            base + size * (along - 0.25 * normal),
            base + size * (0.45 * along - 0.32 * across) + fold,
        ],
        axis=1,
    )
    faces = np.array([[0, 2, 1], [0, 3, 2]]) + 4 * np.arange(n)[:, None, None]
    return mesh(v.reshape(-1, 3), faces.reshape(-1, 3))


def tree(
    seed,
    height,
    radius,
    *,
    crown_from=0.35,
    branches=14,
    leaf_m=0.12,
    leaf_count=6000,
    sides=64,
    rings=160,
    depth_m=0.02,
    limb_sides=8,
):
    """A broad-leaved tree on the origin -> (wood mesh, leaf mesh).

    A trunk with bark, primary branches from crown_from * height up, secondary ones on
    them, and clusters of leaves along these.
    """
    rng = np.random.default_rng(seed)
    stem, path, radii = trunk(
        rng.integers(2**31), height, radius, sides=sides, rings=rings, depth_m=depth_m
    )
    wood, tips = [stem], [path[-1]]
    for k in range(branches):
        s = crown_from + (0.97 - crown_from) * (k + rng.uniform(0, 0.8)) / branches
        i = int(np.searchsorted(path[:, 2], s * height).clip(0, len(path) - 1))
        azimuth = 2.4 * k + rng.normal(0, 0.4)  # the golden angle spreads branches evenly
        up = rng.uniform(0.25, 0.9)
        length = height * 0.42 * (1.15 - s) * rng.uniform(0.7, 1.2)
        limb = _wander(path[i], (np.cos(azimuth), np.sin(azimuth), up), length, 9, 0.12, rng, 0.5)
        thick = 0.55 * radii[i] * np.linspace(1, 0.2, 9)
        wood.append(tube(limb, thick, limb_sides))
        for j in range(3, 9):
            d = limb[j] - limb[j - 1]
            d = d / np.linalg.norm(d) + rng.normal(0, 0.7, 3)
            twig = _wander(limb[j], d, length * rng.uniform(0.2, 0.45), 5, 0.15, rng, 0.4)
            twig_sides = max(3, limb_sides // 2)
            wood.append(tube(twig, thick[j] * np.linspace(0.6, 0.15, 5), twig_sides))
            tips += list(twig[2:])
    tips = np.array(tips)
    spread = 0.03 * height
    foliage = leaves(tips, spread, max(1, leaf_count // len(tips)), leaf_m, rng)
    return join(wood), foliage


def conifer(seed, height, radius, *, whorls=18, sprays=12, needle_m=0.3, sides=24, rings=60):
    """A spruce on the origin -> (wood mesh, leaf mesh): whorls of drooping boughs.

    Each bough carries 3 * sprays pointed sprays of needles, needle_m long.
    """
    rng = np.random.default_rng(seed)
    stem, path, radii = trunk(
        rng.integers(2**31), height, radius, sides=sides, rings=rings, lean=0.01, depth_m=0.012
    )
    wood, base, out = [stem], [], []
    t = np.linspace(0.15, 1, sprays)
    for k in range(whorls):
        s = 0.12 + 0.86 * (k + rng.uniform(0, 0.5)) / whorls
        i = int(np.searchsorted(path[:, 2], s * height).clip(0, len(path) - 1))
        length = 0.24 * height * (1.03 - s) ** 0.8
        for azimuth in rng.uniform(0, 1) + np.arange(6) * np.pi / 3 + rng.normal(0, 0.15, 6):
            d = np.array([np.cos(azimuth), np.sin(azimuth), 0.15])
            bough = _wander(path[i], d, length * rng.uniform(0.8, 1.15), 3, 0.05, rng, -0.5)
            wood.append(tube(bough, 0.25 * radii[i] * np.linspace(1, 0.2, 3), 3))
            along = np.stack([np.interp(t, np.linspace(0, 1, 3), c) for c in bough.T], axis=1)
            base.append(along)
            out.append(np.broadcast_to((bough[-1] - bough[0]) / length, along.shape))
    base, out = np.repeat(np.concatenate(base), 3, 0), np.repeat(np.concatenate(out), 3, 0)
    n = len(base)
    direction = out + rng.normal(0, 0.6, (n, 3)) + [0, 0, -0.35]
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    side = np.cross(direction, [0, 0, 1.0]) + rng.normal(0, 0.3, (n, 3))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    length = needle_m * rng.uniform(0.6, 1.3, (n, 1))
    middle = base + 0.5 * length * direction
    v = np.stack(
        [
            base,
            middle + 0.2 * length * side,
            base + length * (direction - [0, 0, 0.25]),
            middle - 0.2 * length * side,
        ],
        axis=1,
    )
    faces = np.array([[0, 2, 1], [0, 3, 2]]) + 4 * np.arange(n)[:, None, None]
    return join(wood), mesh(v.reshape(-1, 3), faces.reshape(-1, 3))


def grass(roots, height_m, rng, width_m=0.012):
    """Bent tapering blades, one from each root (n, 3), three triangles each.

    height_m and width_m are numbers or (n,).
    """
    roots = np.asarray(roots, float)
    n = len(roots)
    h = (height_m * rng.uniform(0.55, 1.25, n))[:, None]
    lean = rng.normal(0, 0.35, (n, 2))
    bend = np.c_[lean, np.zeros(n)] * h
    azimuth = rng.uniform(0, 2 * np.pi, n)
    side = np.c_[np.cos(azimuth), np.sin(azimuth), np.zeros(n)]
    side = side * np.broadcast_to(width_m, n)[:, None] / 2
    up = np.array([0, 0, 1.0])
    middle = roots + 0.35 * bend + 0.6 * h * up
    tip = roots + 1.2 * bend + h * up * (1 - 0.25 * (lean**2).sum(1, keepdims=True))
    low = roots - 0.03 * up
    v = np.stack([low - side, low + side, middle - 0.8 * side, middle + 0.8 * side, tip], axis=1)
    faces = np.array([[0, 1, 3], [0, 3, 2], [2, 3, 4]]) + 5 * np.arange(n)[:, None, None]
    return mesh(v.reshape(-1, 3), faces.reshape(-1, 3))


# ---------------------------------------------------------------- loose surfaces


def ripples(xy, seed, amplitude_m=0.012, wavelength_m=0.5):
    """(n,) height of wind ripples on water at xy (n, 2): a few wave trains, in gusts."""
    rng = np.random.default_rng(seed)
    p = np.c_[xy, np.zeros(len(xy))]
    angle = rng.uniform(0, 2 * np.pi) + rng.normal(0, 0.5, 5)
    length = wavelength_m * rng.uniform(0.5, 1.6, 5)
    phase = np.stack([np.cos(angle), np.sin(angle)]) * 2 * np.pi / length
    waves = np.sin(xy @ phase + rng.uniform(0, 6, 5) + 1.5 * value_noise(p, 1.2, rng)[:, None])
    gust = 0.65 + 0.35 * value_noise(p, 4.0, rng)
    return amplitude_m * gust * (waves * (length / wavelength_m)).sum(1) / 2


def sand_ripples(xy, seed, amplitude_m=0.02, wavelength_m=0.22):
    """(n,) height of wind-blown sand at xy (n, 2): forked crests with one steep side."""
    rng = np.random.default_rng(seed)
    p = np.c_[xy, np.zeros(len(xy))]
    azimuth = rng.uniform(-0.5, 0.5)
    phase = (xy @ [np.sin(azimuth), np.cos(azimuth)]) / wavelength_m
    phase = phase + 1.1 * value_noise(p, 5 * wavelength_m, rng) + 0.25 * value_noise(p, 0.3, rng)
    t = phase % 1.0
    crest = np.where(t < 0.7, t / 0.7, (1 - t) / 0.3)
    crest = crest * crest * (3 - 2 * crest)
    return amplitude_m * crest * (0.75 + 0.25 * value_noise(p, 8 * wavelength_m, rng))


def snow_drifts(xy, seed, amplitude_m=0.12):
    """(n,) height of wind-packed snow at xy (n, 2): soft drifts with sharper lee edges."""
    rng = np.random.default_rng(seed)
    p = np.c_[xy, np.zeros(len(xy))]
    drift = fractal_noise(p, (1.6, 0.8, 1.0), rng.integers(2**31), octaves=3, gain=0.4)
    edge = 1 - np.abs(value_noise(p, (1.1, 0.5, 1.0), rng)) * 2
    fine = fractal_noise(p, 0.1, rng.integers(2**31), octaves=2)
    return amplitude_m * (0.7 * drift + 0.35 * np.maximum(edge, 0) ** 2 + 0.06 * fine)
