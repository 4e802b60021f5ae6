"""Snow, grass and sand side by side, as in the paper's Fig. 1b: texture from relief alone.

Each patch has one material and one temperature (snow 270.5 K, grass 277 K, sand 282 K under a
clear sky over air of 276 K), so all that a picture shows within a patch is geometry: drifts of
12 cm, blades of 10-20 cm, ripples 22 cm apart and 2.5 cm high, and a line of footprints in the
snow and in the sand. The patches part at x = -1.25 and 1.25 m and reach 300 m.
"""

import numpy as np

from ...sky import Atmosphere
from .. import geometry as g
from ..scene import Camera, Scene, SceneObject

BORDER_M = 1.25


def _footprints(xy, x, depth_m, rng):
    """(n,) height of a walk along y at x: soles pressed in, what they pushed out as a rim."""
    z = np.zeros(len(xy))
    for k, at in enumerate(np.arange(1.0, 14.0, 0.62)):
        turn = rng.normal(0.08, 0.08) * (-1) ** k
        d = xy - [x + 0.13 * (-1) ** k + rng.normal(0, 0.02), at + rng.normal(0, 0.04)]
        c, s = np.cos(turn), np.sin(turn)
        near = (np.abs(d) < 1).all(axis=1)  # a step is 30 cm long; its exp must not see 300 m
        d = d[near]
        u, v = d[:, 0] * c - d[:, 1] * s, d[:, 0] * s + d[:, 1] * c
        r = np.hypot(u / (0.058 + 0.012 * np.clip(v / 0.15, -1, 1)), v / 0.15)
        rim, sole = np.exp(-((r - 1.35) ** 2) / 0.06), 0.5 * (1 - np.tanh(7 * (r - 1)))
        z[near] += depth_m * (0.45 * rim - sole)
    return z


def patches(seed=0, fineness=1):
    """The patches Scene of this seed, about 0.3 million triangles.

    fineness  so many times as many lines each way in the meshes of snow and sand, which otherwise
              are 2 to 3 cm apart where the camera looks; close by, facets show in shadows
    """
    rng = np.random.default_rng([seed, 303])
    number = lambda: int(rng.integers(2**31))
    # Lines across and along get coarser with distance as they do in the picture.
    near = 1.2 * 1.0125 ** (np.arange(170 * fineness) / fineness)
    y = np.concatenate([[-300, -60, -10, -2, 0.4], near, np.geomspace(10.2, 300, 45)])
    outer = BORDER_M + np.concatenate(
        [np.arange(0, 3.2, 0.03 / fineness), np.geomspace(3.2, 300, 60)]
    )
    swell_seed = number()

    def swell(xy):
        p = np.c_[xy, np.zeros(len(xy))]
        far = np.clip((np.hypot(*xy.T) - 30) / 200, 0, 1)
        return 0.1 * g.value_noise(p, 3.0, swell_seed) + 2 * far**2

    def seam(xy):  # loose relief fades at the border, so that neighbours meet
        return np.clip((np.abs(xy[:, 0]) - BORDER_M) / 0.12, 0, 1)

    snow_seed, sand_seed, step_rng = number(), number(), np.random.default_rng(number())

    def snow(xy):
        loose = 0.03 + g.snow_drifts(xy, snow_seed, 0.13) + _footprints(xy, -2.1, 0.11, step_rng)
        return swell(xy) + seam(xy) * loose

    def sand(xy):
        loose = g.sand_ripples(xy, sand_seed, 0.03, 0.24) + _footprints(xy, 2.75, 0.06, step_rng)
        p = np.c_[xy, np.zeros(len(xy))]
        return swell(xy) + seam(xy) * (loose + 0.05 * g.value_noise(p, 1.3, sand_seed))

    lawn = g.sheet(np.linspace(-BORDER_M, BORDER_M, 40), y, swell)
    n = 50000
    at = 1.2 * (120 / 1.2) ** rng.random(n)  # as dense in the picture far away as near
    roots = np.stack([rng.uniform(-BORDER_M, BORDER_M, n), at], axis=1)
    p = np.c_[roots, np.zeros(n)]
    tall = 0.11 + 0.05 * g.value_noise(p, 0.5, number()) + 0.03 * g.value_noise(p, 0.15, number())
    roots = np.c_[roots, swell(roots)]
    blades = g.grass(roots, tall, rng, 0.007 + 0.0022 * at)
    return Scene(
        [
            SceneObject(g.sheet(-outer[::-1], y, snow), "snow", 270.5, True, "snow"),
            SceneObject(g.join([lawn, blades]), "grass", 277.0, False, "grass"),
            SceneObject(g.sheet(outer, y, sand), "sand", 282.0, True, "sand"),
        ],
        Camera((0.0, -0.6, 2.3), (0.0, 4.2, 1.1), 48),
        Atmosphere(air_temperature_k=276.0, water_cm=0.8),
        sun_direction=(-0.78, 0.25, 0.45),
        name="patches",
    )
