"""Other plausible libraries, made from one, so that a network cannot memorise curves.

What distinguishes real materials is kept: smooth curves with a few bands of structure, mostly near
1, some metals. Where a band lies, how deep it is and what it is mixed with are random.
"""

from dataclasses import replace

import numpy as np

LOWEST, HIGHEST = 0.02, 0.995  # a polished metal; no surface is quite black
SHIFT_UM = 0.4  # largest shift of a band; silica's shifts as much among the silicates


def vary(library, rng):
    """A MaterialLibrary of the same names with other curves, by a numpy Generator.

    Each curve is mixed with up to three others, shifted, its structure scaled about its
    mean, tilted, given a few smooth bumps, and clipped to 0.02..0.995. The sky's curve is
    the transmittance of air and stays.
    """
    w, solid = library.wavelength_um, ~library.is_sky
    emissivity = library.emissivity.copy()
    for m in np.flatnonzero(solid):
        emissivity[m] = _another(m, library.emissivity, w, solid, rng)
    return replace(library, emissivity=emissivity)


def _another(m, emissivity, w, solid, rng):
    others = np.flatnonzero(solid & (np.arange(len(emissivity)) != m))
    others = rng.permutation(others)[: rng.integers(1, 4)]
    e = emissivity[m]
    if len(others):
        share = 0.7 * rng.random() ** 2  # mostly small, or no metals would be left
        e = (1 - share) * e + share * rng.dirichlet(np.ones(len(others))) @ emissivity[others]
    e = np.interp(w + rng.uniform(-SHIFT_UM, SHIFT_UM), w, e)
    e = e.mean() + rng.uniform(0.4, 2.0) * (e - e.mean())
    e = e + rng.uniform(-0.04, 0.04) * np.linspace(-1, 1, len(w))
    for _ in range(rng.integers(4)):
        centre, width = rng.uniform(w[0], w[-1]), rng.uniform(0.15, 0.9)
        e = e + rng.normal(0, 0.03) * np.exp(-0.5 * ((w - centre) / width) ** 2)
    return np.clip(e, LOWEST, HIGHEST)
