"""Relief and an unrelated temperature pattern on every object, as in the paper's Fig. "tmp".

Stripes, checks and blobs of +-3 to +-5.5 K, as heaters or shadows leave them, cross carved
panels, a brick wall, a turned pillar, planks and boulders without following their relief;
a contrast that a plain thermal picture cannot tell from texture. Air 284 K; panels 2-3 m high
stand 6-9 m away on rippled sand.
"""

import numpy as np

from ...sky import Atmosphere
from .. import geometry as g
from ..scene import Camera, Scene, SceneObject
from . import props
from .temperature import blobs, checks, stripes

AIR_K = 284.0


def _rosette(v):
    """Carved petals and rings about the panel's middle, a frame of mouldings; heights in m."""
    u, w = v[:, 0] - 1.3, v[:, 2] - 1.4
    r, a = np.hypot(u, w), np.arctan2(w, u)
    petals = np.clip((0.85 * (0.62 + 0.38 * np.abs(np.cos(4 * a))) - r) / 0.07, 0, 1)
    rings = 0.25 * np.sin(2 * np.pi * r / 0.21) * (r < 0.62)
    bead = np.exp(-((np.maximum(np.abs(u) / 1.12, np.abs(w) / 1.22) - 0.92) ** 2) / 0.0012)
    return 0.055 * petals + 0.035 * petals * rings / 0.25 + 0.05 * bead


def patterned(seed=0):
    """The patterned Scene of this seed, about 0.4 million triangles."""
    rng = np.random.default_rng([seed, 404])
    number = lambda: int(rng.integers(2**31))
    objects = []
    ground_seed = number()

    def ground_height(xy):
        p = np.c_[xy, np.zeros(len(xy))]
        r = np.hypot(*xy.T)
        near = np.clip((40 - r) / 25, 0, 1)
        loose = g.sand_ripples(xy, ground_seed, 0.045, 0.34) + 0.07 * g.value_noise(
            p, 1.7, ground_seed
        )
        return near * loose + 6 * np.clip((r - 40) / 200, 0, 1) ** 2

    def add(mesh, material, pattern, mean_k, swing_k, smooth=True, name=""):
        t = mean_k + swing_k * pattern(mesh.vertices.view(np.ndarray))
        objects.append(SceneObject(mesh, material, t, smooth, name or material))

    def stand(m, x, y, yaw=0.0, sink=0.06):
        floor = ground_height(np.array([[x, y]]))[0]
        return g.place(m, (x, y, floor - sink), yaw)

    ground = g.terrain(ground_height, (0, -0.5), np.pi / 2, radius_m=350, rows=230, columns=210)
    add(ground, "sand", lambda p: checks(p * [1, 1, 0], 2.2, 0.9), AIR_K + 1, 3.0, name="ground")

    panel_seed = number()
    carved = g.slab(
        (2.6, 0.4, 2.8),
        0.022,
        lambda v: (
            np.where(v[:, 1] < 0.01, _rosette(v), 0)
            + 0.006 * g.fractal_noise(v, 0.2, panel_seed, 3)
        ),
    )
    add(
        stand(carved, -2.55, 7.2, 0.22),
        "sandstone",
        lambda p: stripes(p, (1, 0.2, 1.2), 0.62),
        AIR_K + 3,
        4.0,
        False,
        "carved panel",
    )

    flat = lambda v: 0 * v[:, 0]
    core = g.place(g.slab((3.2, 0.35, 2.46), 0.05, flat), (0, 0.175, 0))
    coping = g.place(g.slab((3.4, 0.5, 0.14), 0.05, flat), (0, 0.175, 2.46))
    bricks = props.brick_courses(
        (-1.6, 1.6), (-0.1, 2.45), lambda low, high: low[:, 0] > -9, rng, (0.3, 0.105), 0.02, 0.03
    )
    add(
        stand(g.join([core, coping, bricks]), 2.75, 7.6, -0.28),
        "brick",
        lambda p: checks(p, 0.95, -0.3),
        AIR_K + 2,
        3.5,
        False,
        "brick wall",
    )

    profile = np.array(
        [
            [0, 0],
            [0.5, 0],
            [0.5, 0.2],
            [0.42, 0.24],
            [0.46, 0.3],
            [0.36, 0.38],
            [0.30, 0.5],
            [0.36, 0.8],
            [0.44, 1.05],
            [0.40, 1.3],
            [0.24, 1.5],
            [0.2, 1.6],
            [0.34, 1.7],
            [0.36, 1.78],
            [0.22, 1.84],
            [0.3, 1.98],
            [0.33, 2.14],
            [0.27, 2.32],
            [0.1, 2.42],
            [0, 2.43],
        ]
    )
    s = np.linspace(0, len(profile) - 1, 150)
    k = np.arange(len(profile))
    pillar = g.lathe(np.stack([np.interp(s, k, c) for c in profile.T], axis=1), 150)
    v = pillar.vertices.view(np.ndarray)
    twist = np.arctan2(v[:, 1], v[:, 0]) * 12 + 5 * v[:, 2]
    flutes = 0.022 * np.abs(np.sin(twist / 2)) * ((v[:, 2] > 0.42) & (v[:, 2] < 1.5))
    pillar = g.displace(pillar, flutes + 0.006 * g.fractal_noise(v, 0.12, number(), 3))
    blob_seed = number()
    add(
        stand(pillar, 0.2, 5.6),
        "concrete",
        lambda p: blobs(p, 0.34, blob_seed),
        AIR_K + 4,
        5.5,
        name="pillar",
    )

    grain_seed = number()

    def planks(v):
        across = (v[:, 0] / 0.24) % 1.0
        groove = -0.03 * (np.minimum(across, 1 - across) < 0.07)
        grain = g.value_noise(v, (0.025, 0.5, 0.6), grain_seed)
        return groove + 0.007 * grain + 0.012 * np.floor(v[:, 0] / 0.24) % 0.02

    fence = g.slab((3.4, 0.16, 2.1), 0.024, planks)
    add(
        stand(fence, -0.1, 10.2, 0.05),
        "wood",
        lambda p: stripes(p, (0.35, 0.1, 1), 0.42, 0.4),
        AIR_K + 1.5,
        4.5,
        False,
        "planks",
    )

    for x, y, size, material in [
        (-1.35, 4.3, 0.5, "granite"),
        (1.9, 4.9, 0.42, "limestone"),
        (4.6, 6.2, 0.6, "granite"),
        (-4.3, 6.0, 0.55, "clay"),
    ]:
        stone = g.rock(number(), size * rng.uniform(0.9, 1.15, 3), 5, 0.08)
        stone = stand(stone, x, y, rng.uniform(0, 6), -0.4 * size)
        turn, period = rng.uniform(-1, 1), rng.uniform(0.36, 0.46)
        add(
            stone,
            material,
            lambda p, t=turn, w=period: checks(p, w, t),
            AIR_K + 3,
            4.0,
            name="boulder",
        )
    return Scene(
        objects,
        Camera((0.0, -0.3, 1.75), (0.05, 6.5, 0.88), 41),
        Atmosphere(air_temperature_k=AIR_K, water_cm=1.2),
        sun_direction=(-0.7, -0.45, 0.55),
        name="patterned",
    )
