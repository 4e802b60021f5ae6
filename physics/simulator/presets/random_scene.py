"""A different scene for every seed, to train on: layout, shapes, materials, warmth, sky, camera.

Air 258-308 K; objects 10 K colder to 15 K warmer, with smooth variation or patterns of up to
5 K within them; 0.3-4.5 cm of water, as much as the air can hold; 220-480 DU of ozone. About
one scene in seven is a closed room without sky. Under 150 thousand triangles; under 700 thousand
where it is enclosed.
"""

from dataclasses import replace

import numpy as np

from ...library import SKY, MaterialLibrary
from ...sky import Atmosphere
from .. import geometry as g
from ..scene import Camera, Scene, SceneObject
from .temperature import blobs, checks, stripes, temperature_field

INDOORS = 0.15  # share of closed rooms


def _rock(rng, size):
    shape = size * rng.uniform(0.6, 1.3, 3)
    m = g.rock(rng.integers(2**31), shape, 4, rng.uniform(0.02, 0.1))
    return g.place(m, (0, 0, 0.5 * shape[2]), rng.uniform(0, 6)), True


def _trunk(rng, size):
    m = g.trunk(
        rng.integers(2**31),
        rng.uniform(3, 9),
        rng.uniform(0.15, 0.45),
        lean=0.05,
        sides=56,
        rings=90,
        depth_m=rng.uniform(0.01, 0.04),
    )[0]
    return m, True


def _tree(rng, size):
    wood, crown = g.tree(
        rng.integers(2**31),
        rng.uniform(4, 10),
        rng.uniform(0.1, 0.25),
        branches=8,
        leaf_count=1500,
        leaf_m=0.2,
        sides=24,
        rings=40,
        limb_sides=4,
    )
    return (wood, crown), True


def _relief(rng):
    """A random relief for flat faces: rough, ribbed, dimpled or plain."""
    kind, seed, depth = rng.integers(4), int(rng.integers(2**31)), rng.uniform(0.005, 0.04)
    period = rng.uniform(0.12, 0.4)
    if kind == 0:
        return lambda v: depth * g.fractal_noise(v, period, seed, 3)
    if kind == 1:
        return lambda v: depth * np.sin(2 * np.pi * (v[:, 0] + v[:, 1]) / period)
    if kind == 2:
        return lambda v: depth * np.prod(np.sin(2 * np.pi * (v + 0.1) / period), axis=1) * 2
    return lambda v: np.zeros(len(v))


def _block(rng, size):
    extent = size * rng.uniform(0.5, 2.0, 3)
    spacing = np.sqrt(2 * (extent.sum() ** 2 - (extent**2).sum()) / 8000)
    return g.place(g.slab(extent, spacing, _relief(rng)), yaw=rng.uniform(0, 6)), False


def _wall(rng, size):
    extent = np.array([rng.uniform(1.5, 4), rng.uniform(0.1, 0.5), rng.uniform(1, 3)])
    return g.place(g.slab(extent, 0.06, _relief(rng)), yaw=rng.normal(0, 0.5)), False


def _plate(rng, size):
    m = g.slab((rng.uniform(0.8, 2), rng.uniform(0.8, 2), 0.05), 0.05, _relief(rng))
    tilt = rng.uniform(0.2, 1.3)
    v = m.vertices @ np.array(
        [[1, 0, 0], [0, np.cos(tilt), np.sin(tilt)], [0, -np.sin(tilt), np.cos(tilt)]]
    )
    return g.place(g.mesh(v - [0, 0, v[:, 2].min()], m.faces), yaw=rng.normal(0, 0.8)), False


def _ball(rng, size):
    m = g.sphere(4)
    v = m.vertices * size * 0.8 + [0, 0, 0.7 * size]
    bumps = g.fractal_noise(v, size * rng.uniform(0.2, 0.6), rng.integers(2**31), 3)
    return g.displace(g.mesh(v, m.faces), rng.uniform(0, 0.12) * size * bumps), True


def _statue(rng, size):
    """A turned shape of random profile, fluted or dented."""
    n = 9
    z = np.linspace(0, rng.uniform(1.0, 2.6), n)
    r = size * rng.uniform(0.25, 0.8, n)
    t = np.linspace(0, n - 1, 80)
    profile = np.c_[np.interp(t, np.arange(n), r), np.interp(t, np.arange(n), z)]
    profile = np.concatenate([[[0, 0]], profile, [[0, z[-1]]]])
    m = g.lathe(profile, 56)
    angle = np.arctan2(m.vertices[:, 1], m.vertices[:, 0])
    flutes = 0.03 * size * np.sin(rng.integers(5, 14) * angle) * (rng.random() < 0.5)
    dents = 0.06 * size * g.fractal_noise(m.vertices, 0.3 * size, rng.integers(2**31), 3)
    return g.displace(m, flutes + dents * rng.random()), True


def _leaf_clump(rng, size):
    core = rng.normal(0, 1, (25, 3)) * size * [0.6, 0.6, 0.4] + [0, 0, 0.8 * size]
    return g.leaves(core, 0.3 * size, 40, rng.uniform(0.06, 0.2), rng), False


def _tufts(rng, size):
    roots = np.c_[rng.normal(0, 0.7 * size, (2500, 2)), np.zeros(2500)]
    return g.grass(roots, rng.uniform(0.15, 0.6), rng, 0.02), False


# Each shape with the materials it is often made of; half the time it is made of any other.
_STONES = ("granite", "limestone", "sandstone", "concrete", "clay")
_WALLS = ("brick", "plaster", "concrete", "wood", "glass", "white_paint", "sandstone", "steel")
_SHAPES = (
    (_rock, _STONES),
    (_trunk, ("bark", "wood")),
    (_tree, ("bark",)),
    (_block, _WALLS),
    (_wall, _WALLS),
    (_plate, ("aluminium", "copper", "glass", "steel", "rust", "pvc")),
    (_ball, ("ceramic", "rubber", "pvc", "polystyrene", "skin", "ice")),
    (_statue, (*_STONES, "skin", "fabric", "copper")),
    (_leaf_clump, ("foliage",)),
    (_tufts, ("grass",)),
)
_GROUNDS = (
    "soil",
    "grass",
    "sand",
    "snow",
    "asphalt",
    "concrete",
    "clay",
    "granite",
    "ice",
    "water",
)


def _pick(rng, usual):
    any_ = [name for name in MaterialLibrary.starter().names if name != SKY]
    return str(rng.choice(usual if rng.random() < 0.5 else any_))


def _temperature(rng, m, mean_k):
    """(vertices,) K about mean_k: a smooth field, or one of the patterns on top of it."""
    v, kind = m.vertices.view(np.ndarray), rng.integers(6)
    t = temperature_field(
        m,
        mean_k,
        rng.integers(2**31),
        amplitude_k=rng.uniform(0, 2),
        scale_m=rng.uniform(0.3, 2),
        lapse_k_per_m=rng.normal(0, 0.4),
    )
    t = np.clip(t, mean_k - 6, mean_k + 6)  # a tall object's lapse ends somewhere
    swing = rng.uniform(1, 5)
    if kind == 0:
        t = t + swing * stripes(v, rng.normal(size=3), rng.uniform(0.4, 1.5))
    elif kind == 1:
        t = t + swing * checks(v, rng.uniform(0.5, 1.8), rng.uniform(-1, 1))
    elif kind == 2:
        t = t + swing * blobs(v, rng.uniform(0.3, 1.2), rng.integers(2**31))
    return t


def _ground_relief(rng):
    """height(points (n, 2)) -> (n,) of a random ground: swells, one small relief, far hills."""
    kind, seed = rng.integers(4), int(rng.integers(2**31))
    swell, size = rng.uniform(0, 0.35), rng.uniform(3, 9)
    rough, hills = rng.uniform(0.01, 0.06), rng.uniform(0, 25)

    def height(xy):
        p = np.c_[xy, np.zeros(len(xy))]
        r = np.hypot(*xy.T)
        near = np.clip((45 - r) / 30, 0, 1)
        if kind == 0:
            fine = rough * g.fractal_noise(p, 0.5, seed, 4, 0.6)
        elif kind == 1:
            fine = g.sand_ripples(xy, seed, 2 * rough, 0.4)
        elif kind == 2:
            fine = g.snow_drifts(xy, seed, 3 * rough)
        else:
            fine = g.ripples(xy, seed, 0.5 * rough, 0.7)
        far = np.clip((r - 40) / 200, 0, 1) ** 2
        z = swell * g.value_noise(p, size, seed + 1) * np.clip((90 - r) / 60, 0, 1)
        return z + near * fine + far * hills * (1 + 0.6 * g.value_noise(p, 80.0, seed + 2))

    return height


def _wood(rng, air_k, add):
    """Trees and bushes all around the camera, of a few kinds."""
    kinds = []
    for _ in range(int(rng.integers(2, 4))):
        seed, tall, radius = rng.integers(2**31), rng.uniform(6, 15), rng.uniform(0.12, 0.35)
        if rng.random() < 0.7:
            parts = g.tree(
                seed,
                tall,
                radius,
                crown_from=rng.uniform(0.15, 0.45),
                branches=8,
                leaf_count=1800,
                leaf_m=rng.uniform(0.2, 0.4),
                sides=24,
                rings=40,
                limb_sides=3,
            )
        else:
            parts = g.conifer(
                seed, tall, radius, whorls=9, sprays=4, needle_m=1.2, sides=12, rings=20
            )
        kinds.append((parts, _pick(rng, ("bark",)), _pick(rng, ("foliage",))))
    for _ in range(int(rng.integers(12, 60))):
        spot = _around(rng, 3.0, 28.0)
        (wood, crown), bark, foliage = kinds[rng.integers(len(kinds))]
        yaw, size = rng.uniform(0, 6), rng.uniform(0.7, 1.2)
        add(g.place(wood, spot, yaw, size), bark, mean_k=air_k + rng.uniform(-2, 8))
        add(g.place(crown, spot, yaw, size), foliage, False, mean_k=air_k + rng.uniform(-2, 3))
    leaf, foliage = rng.uniform(0.06, 0.2), _pick(rng, ("foliage",))
    for _ in range(int(rng.integers(16))):
        size = rng.uniform(0.4, 1.2)
        core = rng.normal(0, 1, (25, 3)) * size * [0.6, 0.6, 0.3] + [0, 0, 0.6 * size]
        bush = g.leaves(core + _around(rng, 4.0, 20.0), 0.3 * size, 40, leaf, rng)
        add(bush, foliage, False, mean_k=air_k + rng.uniform(-2, 3))


def _around(rng, nearest, farthest):
    """A spot about the camera, as likely in any square metre; right before it, 7 m off or more."""
    r, a = np.sqrt(rng.uniform(nearest**2, farthest**2)), rng.uniform(-np.pi, np.pi)
    if abs(a) < 0.5:
        r = max(r, 7.0)
    return np.array([r * np.sin(a), r * np.cos(a), -0.5])


def _street(rng, air_k, add):
    """Fronts of houses on both sides of the camera, often also before and behind it."""
    left, right = -rng.uniform(3, 9), rng.uniform(3, 9)
    rows = [((x, -25.0), np.pi / 2, 75.0) for x in (left, right)]
    rows += [
        ((left, y), 0.0, right - left) for y in (rng.uniform(20, 45), -12) if rng.random() < 0.5
    ]
    window = _pick(rng, ("glass",))
    for (x, y), yaw, length in rows:
        along = 0.0
        while along < length:
            wide, tall = min(rng.uniform(5, 14), length - along), rng.uniform(4, 14)
            middle = along + wide / 2
            spot = (x + np.cos(yaw) * middle, y + np.sin(yaw) * middle, -0.5)
            front = g.slab((wide, 0.6, tall), 0.3, _relief(rng))
            mean_k = air_k + rng.uniform(-3, 6)
            add(g.place(front, spot, yaw), _pick(rng, _WALLS), False, mean_k=mean_k)
            i, j = (a.ravel() for a in np.mgrid[: int(wide / 2.4), : int((tall - 1) / 2.8)])
            if i.size and rng.random() < 0.7:
                low = np.stack([0.6 + 2.4 * i - wide / 2, 0 * i - 0.36, 1.5 + 2.8 * j], axis=1)
                panes = g.boxes(low, low + [1.2, 0.72, 1.4])
                add(g.place(panes, spot, yaw), window, False, mean_k=mean_k + rng.uniform(-3, 4))
            along += wide


def enclosed_scene(seed=0):
    """The random Scene of this seed, if outdoors in a wood or a street: less of its light is the
    sky's."""
    scene, rng = random_scene(seed), np.random.default_rng([seed, 808])
    if scene.atmosphere is None:
        return scene
    objects = list(scene.objects)

    def add(m, material, smooth=True, *, mean_k):
        objects.append(SceneObject(m, material, _temperature(rng, m, mean_k), smooth))

    around = _wood if rng.random() < 0.5 else _street
    around(rng, scene.atmosphere.air_temperature_k, add)
    return replace(scene, objects=objects, name=f"enclosed {seed}")


def random_scene(seed=0):
    """The random Scene of this seed."""
    rng = np.random.default_rng([seed, 606])
    indoors = rng.random() < INDOORS
    air_k = rng.uniform(285, 303) if indoors else rng.uniform(258, 308)
    objects = []

    def add(m, material, smooth=True, mean_k=None):
        mean_k = air_k + rng.uniform(-10, 15) if mean_k is None else mean_k
        objects.append(SceneObject(m, material, _temperature(rng, m, mean_k), smooth))

    eye = rng.uniform(1.2, 2.4)
    if indoors:
        width, depth, tall = rng.uniform(4, 8), rng.uniform(6, 10), rng.uniform(2.5, 3.5)
        near, reach, half = -depth / 2 + 0.8, depth - 1.6, 0.38 * width
        height = lambda xy: np.zeros(len(xy))
        # A plain outer shell closes the room whatever the relief of its walls does.
        add(
            g.box(
                (-width / 2 - 0.3, -depth / 2 - 0.3, -0.3),
                (width / 2 + 0.3, depth / 2 + 0.3, tall + 0.3),
            ),
            "concrete",
            False,
        )
        roughness = g.slab((width, depth, tall), 0.12, _relief(rng))
        z = roughness.triangles_center[:, 2]
        for face in (z < 0.1, (z >= 0.1) & (z <= tall - 0.1), z > tall - 0.1):
            add(g.select(roughness, face), _pick(rng, _WALLS))
        camera_y = -depth / 2 + 0.6
    else:
        near, reach, half, camera_y = 3.0, rng.uniform(6, 14), None, 0.0
        height = _ground_relief(rng)
        ground = g.terrain(height, (0, 0), np.pi / 2, radius_m=400, rows=150, columns=130)
        add(ground, _pick(rng, _GROUNDS))
        eye += height(np.zeros((1, 2)))[0]

    taken = []
    for _ in range(int(rng.integers(4, 12))):
        size = rng.uniform(0.35, 1.1)
        for _ in range(8):  # tries to find a free place; then it may overlap
            y = near + reach * rng.random()
            x = rng.uniform(-half, half) if indoors else rng.uniform(-0.6, 0.6) * (y + 1)
            if all(np.hypot(x - a, y - b) > 0.9 * (size + c) for a, b, c in taken):
                break
        taken.append((x, y, size))
        kind, usual = _SHAPES[rng.integers(len(_SHAPES))]
        if indoors and kind in (_tree, _trunk, _wall):
            kind, usual = _SHAPES[3]
        shape, smooth = kind(rng, size)
        spot = (x, y, height(np.array([[x, y]]))[0] - 0.04)
        if isinstance(shape, tuple):
            wood, crown = (g.place(m, spot) for m in shape)
            add(wood, _pick(rng, usual))
            add(crown, _pick(rng, ("foliage",)), False)
        else:
            add(g.place(shape, spot), _pick(rng, usual), smooth)
    if not indoors and rng.random() < 0.6:  # a tree line
        for _ in range(int(rng.integers(4, 14))):
            r, a = rng.uniform(30, 90), rng.uniform(-0.8, 0.8)
            x, y = r * np.sin(a), r * np.cos(a)
            spruce = g.conifer(
                rng.integers(2**31),
                rng.uniform(7, 15),
                0.2,
                whorls=7,
                sprays=4,
                needle_m=1.6,
                sides=6,
                rings=8,
            )
            spot = (x, y, height(np.array([[x, y]]))[0] - 0.1)
            add(g.place(spruce[0], spot), "bark", mean_k=air_k + 1)
            add(g.place(spruce[1], spot), "foliage", False, mean_k=air_k)
    camera = Camera(
        (0.0, camera_y, eye),
        (rng.uniform(-0.8, 0.8), camera_y + 6.0, eye + rng.uniform(-1.4, 0.5)),
        rng.uniform(34, 58),
    )
    # Cold air holds little water: about 4.5 cm at 303 K, a tenth of it at 268 K.
    moist = 4.5 * min(1.0, np.exp(0.065 * (air_k - 303)))
    air = (
        None
        if indoors
        else Atmosphere(
            air_temperature_k=air_k,
            water_cm=rng.uniform(0.3, max(0.4, moist)),
            ozone_du=rng.uniform(220, 480),
            co2_ppm=rng.uniform(400, 450),
        )
    )
    a, up = rng.uniform(0, 2 * np.pi), rng.uniform(0.35, 0.9)
    sun = (np.cos(a) * np.sqrt(1 - up**2), np.sin(a) * np.sqrt(1 - up**2), up)
    return Scene(objects, camera, air, sun_direction=sun, name=f"random {seed}")
