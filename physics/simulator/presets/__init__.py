"""Scenes by name. The map:

forest     the paper's decomposition scene: bark, foliage, granite, water, soil, grass, sky
street     an evening street: brick, plaster, glass, asphalt, cars, people
patches    snow, grass and sand, each of one temperature: texture from relief alone
patterned  relief and an unrelated temperature pattern on every object
room       a closed room: no sky
random     a different scene for every seed, to train on (random_scene)
enclosed   the same, if outdoors in a wood or a street

props and temperature are what they are made of.
"""

import numpy as np

from ...errors import InputError
from .forest import forest
from .patches import patches
from .patterned import patterned
from .random_scene import enclosed_scene, random_scene
from .room import room
from .street import street

PRESETS = {
    "forest": forest,
    "street": street,
    "patches": patches,
    "patterned": patterned,
    "room": room,
    "random": random_scene,
    "enclosed": enclosed_scene,
}


def preset(name, seed=0):
    """The Scene of a preset by name and seed, a whole number of 0 or more; InputError lists the
    names if there is none such."""
    if name not in PRESETS:
        raise InputError(
            f"scene: no preset {name!r}; choose from {', '.join(PRESETS)}, or give a scene file "
            "(.json)."
        )
    if not isinstance(seed, (int, np.integer)) or seed < 0:
        raise InputError(f"scene: seed must be a whole number of 0 or more, got {seed!r}.")
    return PRESETS[name](seed)


__all__ = ["PRESETS", "preset"]
