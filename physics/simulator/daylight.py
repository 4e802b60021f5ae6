"""The picture that an ordinary camera would take of the scene by day, for people to look at.

From the paths of the heat cube, with all bounces: what leaves a surface is its albedo a times the
light that falls on it, of the sun, of the sky, and of other surfaces. Nothing glows. Unrolled
along a path of surfaces 0, 1, 2, ... that ends in the sky or by roulette,

    L = sum_d (prod_{i < d} a_i / q_i) a_d sun_d E + (prod_{i < end} a_i / q_i) L_sky,    q_0 = 1

with E = SUN_RGB, the irradiance of what faces the sun over pi, sun_d from the path (`Paths`), and
L_sky = SKY_RGB in all directions; the last term only where the path ends in the sky. The image of
the sun in a mirror is left out. A closed scene is lit from the camera, and its walls light nothing.
"""

import numpy as np

from ..machinery.compiled import compiled
from .trace import ESCAPED

SUN_RGB = np.array([0.85, 0.78, 0.66])  # low sun, yellowish
SKY_RGB = np.array([0.32, 0.40, 0.52])  # light of the whole sky
CLEAR_SKY_RGB = np.array([0.45, 0.66, 0.95])  # the sky itself, seen


def daylight(paths, albedo_rgb, spp, closed):
    """(pixels, 3) linear RGB, about 0..1, from Paths and (materials, 3) albedo."""
    sun = np.ones(3) if closed else SUN_RGB
    rgb = np.zeros(((len(paths.start) - 1) // spp, 3))
    weight = albedo_rgb / paths.day_roulette[:, None]
    _daylight(
        paths.start, paths.material, paths.sun, spp, albedo_rgb, weight, sun, SKY_RGB,
        CLEAR_SKY_RGB, rgb,
    )  # fmt: skip
    return rgb / spp


@compiled(nogil=True)
def _daylight(start, material, sun, spp, albedo, weight, sun_rgb, sky_rgb, seen_sky_rgb, rgb):
    """Add every path's L to the sums (pixels, 3) of its pixel."""
    for path in range(len(start) - 1):
        total, first = rgb[path // spp], start[path]
        for c in range(3):
            if material[first] == ESCAPED:
                total[c] += seen_sky_rgb[c]
                continue
            w = 1.0
            for at in range(first, start[path + 1]):
                m = material[at]
                if m == ESCAPED:
                    total[c] += w * sky_rgb[c]
                else:
                    total[c] += w * albedo[m, c] * sun[at] * sun_rgb[c]
                    w *= albedo[m, c] if at == first else weight[m, c]
