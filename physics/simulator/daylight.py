"""The picture that an ordinary camera would take of the scene by day, for people to look at.

From the same camera samples as the heat cube: albedo times sunlight (with its shadow) and
skylight (what the first bounce sees of the sky). A closed scene is lit from the camera.
"""

import numpy as np

from .trace import SKY

SUN_RGB = np.array([0.85, 0.78, 0.66])  # low sun, yellowish
SKY_RGB = np.array([0.32, 0.40, 0.52])  # light of the whole sky
CLEAR_SKY_RGB = np.array([0.45, 0.66, 0.95])  # the sky itself, seen


def daylight(paths, albedo_rgb, spp, closed):
    """(pixels, 3) linear RGB, about 0..1, from Paths and (materials, 3) albedo."""
    first, second = paths.start[:-1], np.minimum(paths.start[:-1] + 1, paths.start[1:] - 1)
    material = paths.material[first]
    if closed:
        light = paths.direct[:, None] * np.ones(3)
    else:
        light = paths.direct[:, None] * SUN_RGB + (paths.material[second] == SKY)[:, None] * SKY_RGB
    is_sky = material == SKY
    rgb = albedo_rgb[np.where(is_sky, 0, material)] * light
    rgb[is_sky] = CLEAR_SKY_RGB
    return rgb.reshape(-1, spp, 3).mean(axis=1)
