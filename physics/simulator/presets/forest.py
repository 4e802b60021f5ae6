"""The paper's decomposition scene: bark, foliage, rock, water, soil, grass and sky.

A clear night two hours after sunset, air at 285 K: stone, water and trunks still hold the
day's heat (288-291 K), leaves follow the air, open grass and soil have cooled below it. Two
trunks of 0.7 m stand 5-7 m from the camera, their bark 6 cm deep; a pond of about 12 m by
8 m lies in front, boulders of up to 2 m around it, trees of 11-17 m out to 130 m, hills to 400 m.
"""

import numpy as np

from ...sky import Atmosphere
from .. import geometry as g
from ..scene import Camera, Scene, SceneObject
from .temperature import temperature_field

AIR_K = 285.0
WATER_LEVEL = -0.62


def _smoothstep(x, low, high):
    t = np.clip((x - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)


def _height(seed):
    """The ground: gentle swells, a basin for the pond, hills far away; roots and litter."""

    def height(xy):
        p = np.c_[xy, np.zeros(len(xy))]
        r = np.hypot(xy[:, 0], xy[:, 1])
        z = 0.3 * g.fractal_noise(p, 9.0, seed, octaves=2)
        basin = np.hypot((xy[:, 0] - 0.6) / 6.2, (xy[:, 1] - 10.2) / 4.3)
        basin = basin + 0.22 * g.value_noise(p, 3.0, seed + 1)
        z = z * _smoothstep(basin, 0.9, 1.8) - 1.15 * _smoothstep(-basin, -1.3, -0.65)
        far = _smoothstep(r, 45, 260)
        z = z + far * (7 + 9 * g.value_noise(p, 90.0, seed + 2))
        near = _smoothstep(-r, -60, -15)
        return z + 0.055 * near * g.fractal_noise(p, 0.5, seed + 3, octaves=4, gain=0.6)

    return height


def forest(seed=0):
    """The forest Scene of this seed, 0.4-0.5 million triangles."""
    rng = np.random.default_rng([seed, 101])
    number = lambda: int(rng.integers(2**31))
    height = _height(number())
    objects = []

    def add(mesh, material, mean_k, smooth=True, name="", **field):
        t = temperature_field(mesh, mean_k, number(), **field)
        objects.append(SceneObject(mesh, material, t, smooth, name or material))

    def on_ground(x, y, sink=0.0):
        return np.array([x, y, height(np.array([[x, y]]))[0] - sink])

    def plant(meshes, x, y):
        spot, yaw = on_ground(x, y, 0.05), rng.uniform(0, 6)
        wood, leaf_mesh = (g.place(m, spot, yaw) for m in meshes)
        add(
            wood,
            "bark",
            AIR_K + 3.0,
            name="tree",
            amplitude_k=0.9,
            scale_m=0.6,
            lapse_k_per_m=-0.12,
        )
        add(
            leaf_mesh,
            "foliage",
            AIR_K + 0.2,
            smooth=False,
            name="canopy",
            amplitude_k=0.7,
            scale_m=1.2,
            lapse_k_per_m=-0.05,
        )

    # Beyond the near bank turf covers part of the soil: faces of the same relief, no seam.
    ground = g.terrain(height, (0, 0), np.pi / 2, radius_m=400, rows=170, columns=140)
    middle = ground.triangles_center * [1, 1, 0]
    turf = g.value_noise(middle, 6.0, number()) + 0.25 * g.value_noise(middle, 0.7, number())
    turf = (turf > 0.02) & (np.linalg.norm(middle, axis=1) > 9)
    turf &= height(middle[:, :2]) > WATER_LEVEL + 0.1
    add(g.select(ground, ~turf), "soil", AIR_K - 0.8, name="ground", amplitude_k=1.2, scale_m=1.5)
    add(g.select(ground, turf), "grass", AIR_K - 1.8, name="turf", amplitude_k=0.9, scale_m=1.5)

    def level(xy):
        r = np.hypot(xy[:, 0], xy[:, 1])
        return WATER_LEVEL + g.ripples(xy, seed, 0.014, 0.7) * _smoothstep(-r, -22, -8)

    water = g.terrain(level, (0, 0), np.pi / 2, radius_m=20, rows=150, columns=170, sector=1.7)
    centres = water.triangles_center
    # Only the pond: where the basin's floor is well below, the bank hides the rest.
    water = g.select(water, height(centres[:, :2]) < WATER_LEVEL + 0.08)
    add(water, "water", AIR_K + 3.5, name="pond", amplitude_k=0.4, scale_m=2.0)

    # The two big trunks in front, then trees of the middle distance, by hand for the view.
    near = [(-2.75, 5.3, 0.36, 15), (3.65, 6.7, 0.40, 17)]
    middle_trees = [
        (-6.6, 12.5, 0.30, 14),
        (7.4, 14.5, 0.28, 13),
        (2.9, 18.5, 0.27, 15),
        (-3.4, 20.5, 0.25, 13),
    ]
    far = []
    while len(far) < 13:
        r, a = rng.uniform(24, 60), rng.uniform(-0.7, 0.7)
        if abs(a + 0.02) > 0.08 or r > 50:
            far.append((r * np.sin(a), r * np.cos(a), 0.2, rng.uniform(11, 16)))
    kinds = [
        dict(sides=180, rings=120, leaf_count=2200, depth_m=0.06, leaf_m=0.15, crown_from=0.2),
        dict(
            sides=64,
            rings=60,
            limb_sides=6,
            leaf_count=2000,
            depth_m=0.035,
            leaf_m=0.22,
            crown_from=0.22,
        ),
        dict(
            sides=12,
            rings=30,
            leaf_count=1000,
            leaf_m=0.48,
            crown_from=0.2,
            limb_sides=3,
            branches=9,
        ),
    ]
    planted = [
        (t, k) for k, group in zip(kinds, (near, middle_trees, far), strict=True) for t in group
    ]
    for (x, y, radius, tall), kind in planted:
        plant(g.tree(number(), tall, radius, **kind), x, y)
    for _ in range(20):
        r, a = rng.uniform(55, 130), rng.uniform(-0.75, 0.75)
        spruce = g.conifer(
            number(), rng.uniform(10, 17), 0.2, whorls=10, sprays=4, needle_m=1.7, sides=8, rings=12
        )
        plant(spruce, r * np.sin(a), r * np.cos(a))

    for x, y, size in [
        (1.95, 5.0, 0.62),
        (-1.1, 6.0, 0.38),
        (-4.6, 8.2, 0.9),
        (6.6, 10.0, 1.1),
        (2.6, 14.9, 1.15),
        (-1.6, 15.3, 1.0),
        (0.2, 4.5, 0.2),
        (3.1, 5.3, 0.3),
    ]:
        shape = size * rng.uniform(0.85, 1.25, 3) * [1.1, 0.95, 0.85]
        stone = g.rock(number(), shape, 5 if size == 0.62 else 4, 0.07)
        stone = g.place(stone, on_ground(x, y, -0.35 * shape[2]), rng.uniform(0, 6))
        add(
            stone,
            "granite",
            AIR_K + 5.0,
            name="boulder",
            amplitude_k=1.5,
            scale_m=0.8,
            lapse_k_per_m=-0.6,
        )

    # Grass in tufts where a noise says so, denser near the camera; bushes further out.
    r, a = 2.5 + 22 * rng.random(2600) ** 1.2, rng.uniform(-0.75, 0.75, 2600)
    tuft = np.stack([r * np.sin(a), r * np.cos(a)], axis=1)
    wet = height(tuft) < WATER_LEVEL + 0.06
    patch = g.value_noise(np.c_[tuft, np.zeros(len(tuft))], 1.8, number()) > -0.05
    tuft = tuft[patch & ~wet]
    roots = np.repeat(tuft, 14, axis=0) + rng.normal(0, 0.08, (14 * len(tuft), 2))
    roots = np.c_[roots, height(roots)]
    away = np.hypot(roots[:, 0], roots[:, 1])
    add(
        g.grass(roots, 0.2, rng, 0.012 + 0.001 * away),
        "grass",
        AIR_K - 1.8,
        smooth=False,
        amplitude_k=0.6,
        scale_m=1.0,
    )
    for _ in range(20):
        r, a = rng.uniform(11, 40), rng.uniform(-0.7, 0.7)
        spot = on_ground(r * np.sin(a), r * np.cos(a))
        if spot[2] < WATER_LEVEL + 0.15:
            continue
        core = spot + rng.normal(0, 1, (24, 3)) * [0.5, 0.5, 0.25] + [0, 0, 0.5]
        add(
            g.leaves(core, 0.22, 22, 0.11, rng),
            "foliage",
            AIR_K - 0.3,
            smooth=False,
            name="bush",
            amplitude_k=0.6,
            scale_m=0.6,
        )

    eye = on_ground(0, 0)[2] + 1.7
    return Scene(
        objects,
        Camera((0, 0, eye), (0.15, 10, eye + 0.55), 44),
        Atmosphere(air_temperature_k=AIR_K, water_cm=1.2),
        sun_direction=(-0.72, -0.12, 0.62),
        name="forest",
    )
