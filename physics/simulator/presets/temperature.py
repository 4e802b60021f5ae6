"""Temperatures within an object: plausible fields, and patterns that ignore its shape.

A field is a mean, a lapse with height and smooth noise; patterns have values in -1..1.
"""

import numpy as np

from ..geometry import fractal_noise, value_noise


def temperature_field(mesh, mean_k, seed, *, amplitude_k=1.0, scale_m=1.0, lapse_k_per_m=0.0):
    """(vertices,) K: mean + lapse * (height above the mesh's foot) + amplitude * noise.

    scale_m is the distance over which the noise changes; amplitude_k its peak, roughly.
    """
    v = mesh.vertices.view(np.ndarray)
    t = mean_k + amplitude_k * fractal_noise(v, scale_m, seed, octaves=2)
    return t + lapse_k_per_m * (v[:, 2] - v[:, 2].min())


def _soft(wave, sharpness=4.0):
    """A wave -1..1 with its flanks steepened to soft-edged steps."""
    return np.tanh(sharpness * wave)


def stripes(points, direction, period_m, phase=0.0):
    """(n,) -1..1, stripes across direction (3,)."""
    d = np.asarray(direction, float) / np.linalg.norm(direction)
    return _soft(np.sin(2 * np.pi * (points @ d) / period_m + phase))


def checks(points, period_m, turn=0.4):
    """(n,) -1..1, a three-dimensional chequerboard, turned so that no face lies along it."""
    c, s = np.cos(turn), np.sin(turn)
    turned = points @ np.array([[c, -s, 0.3], [s, c, -0.2], [-0.3, 0.2, 1.0]])
    return _soft(np.prod(np.sin(2 * np.pi * turned / period_m + 0.7), axis=1), 8.0)


def blobs(points, scale_m, seed):
    """(n,) -1..1, warm and cold blobs of a given size."""
    return _soft(value_noise(points, scale_m, seed), 5.0)
