"""TeX vision: a night scene that reads like daylight.

Hue is the material, saturation the temperature, and value (brightness) the texture lit by the sky
alone, as in the paper's Sec. 3. Colours denote materials; they are not pseudo-colours.
"""

import numpy as np
from matplotlib.colors import hsv_to_rgb

from physics.cube.dead_pixels import gaps

from .decomposition import Decomposition, check_decomposition
from .metrics import non_sky
from .stretch import stretch

SATURATION = (0.25, 0.75)  # coldest to warmest; never grey, or the hue would not show
VALUE = (0.15, 1.00)  # darkest to brightest texture; never black, for the same reason
GAMMA = 0.8  # lifts the shadows a little, as a photograph does
SKY_SATURATION, SKY_VALUE = 0.25, 0.97  # pale and bright, as a clear sky by day


def tex_vision(decomposition: Decomposition) -> np.ndarray:
    """The TeX-vision picture of a Decomposition: (height, width, 3) uint8 sRGB.

    hue         hue_deg of the pixel's material
    saturation  temperature, 2nd to 98th percentile of the non-sky pixels -> 0.25..0.75
    value       sky-lit texture, 1st to 99th percentile of the same -> 0.15..1, gamma 0.8

    The sky is uniformly pale and bright: its maps describe what may stand before it. Areas in which
    nothing was measured are black. Raises InputError if decomposition is not a Decomposition.
    """
    check_decomposition(decomposition)
    d = decomposition
    ground = non_sky(d)
    seen = ground & ~d.dead
    warmth = stretch(d.temperature_k, seen, 2, 98)
    light = stretch(d.sky_texture, seen, 1, 99) ** GAMMA
    hsv = np.stack(
        [
            (np.asarray(d.hue_deg) % 360 / 360)[d.material],
            np.where(ground, _between(SATURATION, warmth), SKY_SATURATION),
            np.where(ground, _between(VALUE, light), SKY_VALUE),
        ],
        axis=-1,
    )
    hsv[gaps(d.dead), 2] = 0
    return np.rint(255 * hsv_to_rgb(hsv)).astype(np.uint8)


def _between(ends, unit):
    return ends[0] + (ends[1] - ends[0]) * unit
