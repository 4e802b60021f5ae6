"""A small made-up scene with its Truth, and Decompositions of it, for tests without a solver."""

from types import SimpleNamespace

import numpy as np

from physics.cube.heat_cube import HeatCube
from physics.planck import planck
from physics.truth import Truth
from texnet.pipeline import Decomposition

NAMES = ("grass", "water", "sky", "bark")
WAVELENGTH = np.linspace(8.0, 14.0, 6)


def truth(height=24, width=30, seed=0):
    """A Truth of three materials and sky, every field filled and varied."""
    rng = np.random.default_rng(seed)
    material = rng.integers(0, 4, (height, width)).astype(np.int16)
    material[:6] = 2
    sky = material == 2
    view = np.where(sky, 0.0, rng.uniform(0.05, 0.95, (height, width)))
    temperature = rng.uniform(280.0, 300.0, (height, width))
    w = WAVELENGTH[:, None, None]
    texture = np.where(sky, 0.0, view * planck(w, 250.0) + (1 - view) * planck(w, 288.0))
    return Truth(
        temperature_k=temperature.astype(np.float32),
        material=material,
        material_names=NAMES,
        emissivity=np.full(texture.shape, 0.9, np.float32),
        texture=texture.astype(np.float32),
        sky_view=view.astype(np.float32),
        sky_texture=np.where(sky, 6.0, view * planck(10.0, 250.0)).astype(np.float32),
        visible=rng.uniform(0, 1, (height, width, 3)).astype(np.float32),
        wavelength_um=WAVELENGTH,
    )


def cube(t):
    """The HeatCube of a Truth by Eq. 1, sky as a black body."""
    black = planck(t.wavelength_um[:, None, None], t.temperature_k.astype(float))
    s = t.emissivity * black + (1 - t.emissivity) * t.texture
    return HeatCube(s, t.wavelength_um, np.ones(len(t.wavelength_um)), 0.05)


def perfect(t, names=NAMES):
    """The Decomposition that is the Truth, with a library of these names in this order."""
    to_names = np.array([names.index(n) for n in t.material_names])
    material = to_names[t.material].astype(np.int16)
    lighting = np.stack([t.sky_view, 1 - t.sky_view]) * (t.material != 2)
    hues = {"grass": 110.0, "water": 220.0, "sky": 205.0, "bark": 30.0}
    d = Decomposition(
        temperature_k=t.temperature_k,
        material=material,
        material_names=tuple(names),
        thermal_lighting=lighting.astype(np.float32),
        environment=planck(t.wavelength_um, np.array([[250.0], [288.0]])),
        sky=(0,),
        texture=t.texture,
        sky_texture=t.sky_texture,
        residual=np.ones(material.shape, np.float32),
        temperature_sigma_k=np.full(material.shape, 0.1, np.float32),
        material_probability=(np.arange(len(names))[:, None, None] == material).astype(np.float32),
        unknown=np.zeros(material.shape, bool),
        saturated=np.zeros(material.shape, bool),
        dead=np.zeros(material.shape, bool),
        hot=np.zeros(material.shape, bool),
        wavelength_um=t.wavelength_um,
        emissivity=np.full((len(names), len(t.wavelength_um)), 0.95),
        hue_deg=np.array([hues[n] for n in names]),
        camera_netd_k=0.05,
        netd_k=0.05,
        left_out={9.5: "dead"},
        seconds={"local": 0.5},
    )
    return SimpleNamespace(**vars(d))  # which tests may change
