"""An evening street: asphalt, concrete, brick and plaster fronts, cars, people, a tree, sky.

Air 283 K, one hour after sunset: asphalt is still 5 K above the air, walls 1-3 K, lit
windows 5 K; a bonnet that has just been driven 9 K, faces 18 K. The carriageway is 7 m
wide with pavements of 2.6 m on both sides, the houses have 2-4 storeys of 3.1 m.
"""

import numpy as np

from ...sky import Atmosphere
from .. import geometry as g
from ..scene import Camera, Scene, SceneObject
from . import props
from .temperature import temperature_field

AIR_K = 283.0
KERB_M = 0.14


def street(seed=0):
    """The street Scene of this seed, 0.3-0.45 million triangles."""
    rng = np.random.default_rng([seed, 202])
    number = lambda: int(rng.integers(2**31))
    objects = []

    def add(mesh, material, kelvin, smooth=True, name=""):
        objects.append(SceneObject(mesh, material, kelvin, smooth, name or material))

    def stand(parts, position, yaw=0.0, name=""):
        for part in parts:
            m = g.place(part.mesh, position, yaw)
            wobble = 0.4 * g.value_noise(m.vertices, 0.8, number())
            add(m, part.material, AIR_K + part.warmth_k + wobble, part.smooth, name)

    # Carriageway: worn asphalt, cambered, fine near the camera; warmer in the wheel tracks.
    y = np.concatenate([[-60, -20], np.arange(-6, 14, 0.09), np.geomspace(14, 150, 60)])
    x = np.linspace(-3.5, 3.5, 90)
    s = number()

    def road_height(xy):
        p = np.c_[xy, np.zeros(len(xy))]
        edge = np.clip((3.5 - np.abs(xy[:, 0])) / 0.3, 0, 1)
        rough = 0.012 * g.fractal_noise(p, 0.35, s, 4, 0.62) + 0.012 * g.value_noise(p, 2.5, s + 1)
        crack = 1 - np.clip(np.abs(g.fractal_noise(p, 1.6, s + 2, 3)) * 22, 0, 1)
        return 0.02 * (1 - (xy[:, 0] / 3.5) ** 2) + edge * (rough - 0.018 * crack)

    road = g.sheet(x, y, road_height)
    track = sum(np.exp(-((road.vertices[:, 0] - c) ** 2) / 0.08) for c in (-2.5, -1.0, 1.0, 2.5))
    add(
        road,
        "asphalt",
        temperature_field(road, AIR_K + 5, number(), scale_m=1.2) + 1.2 * track,
        name="road",
    )
    plain = g.terrain(
        lambda xy: -0.6 + 0.03 * np.maximum(np.hypot(*xy.T) - 120, 0),
        (0, 20),
        np.pi / 2,
        radius_m=450,
        rows=40,
        columns=60,
    )
    add(plain, "soil", AIR_K - 1.0, name="plain")
    manhole = g.lathe([[0.0, 0.045], [0.26, 0.045], [0.3, 0.04], [0.33, 0.01]][::-1], 40)
    add(g.place(manhole, (0.6, 6.2, 0.0)), "steel", AIR_K + 6, False, "manhole")

    # Pavements: slabs one by one with joints, a kerb, a bed beneath so that joints have a floor.
    for side in (-1, 1):
        i, j = (a.ravel() for a in np.mgrid[:4, :46])
        low = np.stack(
            [3.68 + 0.62 * i, -4 + 0.8 * j + 0.4 * (i % 2), np.full(i.size, -0.05)], axis=1
        )
        high = low + [0.605, 0.785, 0.05 + KERB_M]
        high[:, 2] += rng.normal(0, 0.004, i.size)
        k = np.arange(40)
        kerb_low = np.stack([np.full(40, 3.48), -4 + 1.0 * k, np.full(40, -0.1)], axis=1)
        kerb_high = kerb_low + [0.185, 0.985, 0.1 + KERB_M + 0.01]
        slabs = g.boxes(np.r_[low, kerb_low], np.r_[high, kerb_high])
        bed = g.boxes(
            [[3.5, -60, -0.4], [3.5, 33, -0.4]], [[6.4, 34, KERB_M - 0.02], [6.4, 150, KERB_M]]
        )
        for m, name in ((slabs, "slabs"), (bed, "bed")):
            v = m.vertices * [side, 1, 1]
            m = g.mesh(v, m.faces[:, ::-1] if side < 0 else m.faces)
            add(
                m, "concrete", temperature_field(m, AIR_K + 2.5, number(), scale_m=1.0), False, name
            )

    # Houses wall to wall; a front with relief where the camera can see it.
    for side in (-1, 1):
        at, k = -12.0 - rng.uniform(0, 3), 0
        while at < 75:
            width = rng.uniform(7, 11)
            wall = "brick" if (k + (side > 0)) % 2 else "plaster"
            storeys = int(rng.integers(2, 5)) if at > 3 else 3
            close = -4 < at < 22
            parts = props.house(
                number(),
                width,
                9.0,
                storeys,
                wall=wall,
                relief=close,
                shop=bool(rng.random() < 0.35),
            )
            if side < 0:  # the front faces +x
                stand(parts, (-6.3, at, KERB_M), np.pi / 2, "house")
            else:
                stand(parts, (6.3, at + width, KERB_M), -np.pi / 2, "house")
            at += width + (0.0 if rng.random() < 0.7 else rng.uniform(1.5, 4))
            k += 1

    stand(props.car("aluminium"), (2.35, 8.0, 0.0), np.pi, "car")
    stand(props.car("white_paint", running=False), (-2.35, 10.5, 0.0), 0.0, "car")
    stand(props.car("white_paint", running=False), (2.45, 17.0, 0.0), np.pi, "car")
    stand(props.car("aluminium"), (-1.6, 30.0, 0.0), np.pi, "car")
    stand(props.person(number(), AIR_K, 1.8, stride=0.3), (-0.85, 5.6, 0.02), -1.9, "person")
    stand(props.person(number(), AIR_K, 1.66, stride=-0.2), (4.75, 9.5, KERB_M), 3.0, "person")
    stand(props.person(number(), AIR_K, 1.72, stride=0.3), (-4.9, 15.5, KERB_M), 0.1, "person")
    for at in (9.0, 25.0, 41.0):
        stand(props.lamp_post(), (3.95, at, KERB_M), np.pi / 2, "lamp post")
        stand(props.lamp_post(), (-3.95, at + 8, KERB_M), -np.pi / 2, "lamp post")
    for x, at in ((-4.3, 21.0), (4.4, 28.5), (-4.3, 36.0)):
        wood, crown = g.tree(
            number(),
            7.5,
            0.16,
            leaf_count=4200,
            leaf_m=0.17,
            sides=32,
            rings=60,
            crown_from=0.3,
            limb_sides=5,
        )
        stand(
            [props.Part(wood, "bark", 1.5), props.Part(crown, "foliage", 0.2, False)],
            (x, at, KERB_M - 0.02),
            0.0,
            "tree",
        )
    return Scene(
        objects,
        Camera((-0.5, -1.2, 1.65), (0.1, 10, 2.5), 46),
        Atmosphere(air_temperature_k=AIR_K, water_cm=1.6),
        sun_direction=(-0.55, -0.5, 0.67),
        name="street",
    )
