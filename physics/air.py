"""The air between scene and camera: it lets a part of the light through, and glows itself.

Seen through it, a surface of radiance S shows

    S' = t S + (1 - t) B(T_air)

t, the transmittance of so many metres of usual air near the ground (`sky`), is least where carbon
dioxide and water vapour absorb, beyond 13 um and below 8.5 um. A clear sky looks as bright with
that air as without: it is part of the sky's own path.
"""

from typing import NamedTuple

import numpy as np

from .bands import at_nodes
from .planck import planck
from .sky import level_transmittance, usual_atmosphere

OPAQUE = 0.005  # transmittance below which nothing is seen through air but its noise


class Air(NamedTuple):
    """So many metres of air of temperature_k, K, in front of a camera: per band its transmittance,
    OPAQUE at least, and its path radiance (1 - t) B(T_air), W m-2 sr-1 um-1; and its optical depth
    as a multiple of usual air's, () if it is that."""

    metres: float
    temperature_k: float
    transmittance: tuple[float, ...]
    path_radiance: tuple[float, ...]
    absorption: tuple[float, ...] = ()

    @staticmethod
    def of(metres, temperature_k, nodes_um, absorption=()):
        """Air of usual humidity, at bands of nodes (bands, n) in um (`HeatCube.nodes_um`), whose
        optical depth is so many times as much in each, if that is not ()."""
        atmosphere = usual_atmosphere(temperature_k)
        t = at_nodes(lambda w: level_transmittance(w, metres, atmosphere), nodes_um)
        t = np.maximum(t ** np.array(absorption)[:, None] if len(absorption) else t, OPAQUE)
        path_radiance = (1 - t) * at_nodes(lambda w: planck(w, temperature_k), nodes_um)
        means = (tuple(a.mean(axis=-1).tolist()) for a in (t, path_radiance))
        return Air(float(metres), float(temperature_k), *means, tuple(absorption))
