"""How many environment objects a scene supports: no more of them than its pixels' evidence asks.

For k = 1, 2, ... the environment is estimated and held against a sample of pixels: their
evidence, summed over all materials,

    F_k = -mean over pixels of log sum_m exp(-E_m),    E as in `exact.local`, nats per pixel

has in it what the pixel had to tune of V (Occam, see `exact.reduced`) and how far true surroundings
scatter about k objects (`Environment.spread`), so it rises again where more objects only fit
better. Of all k the smallest is taken that is worse than the best by less than one standard error
of their difference (Breiman et al. 1984). After PATIENCE values of k that are worse than the best
the search ends.

Where the sky is in view the search begins with UNDER_SKY objects, two for the sky and two for what
else there is. The evidence would now and then take fewer: on 24 scenes outside the test sets T of
`net+sgd` was then off by a fifth more in the mean at 54 bands, and by half as much again at 9.
Where one is assumed, it begins with two, and mirrors, which may be of anything, even of themselves,
do not count.
"""

import numpy as np

from .environment import MOST_OBJECTS
from .exact.local import solve_local
from .exact.reduced import reduce_model

SAMPLES, PATIENCE = 600, 2
UNDER_SKY = 4


def supported_count(sample, assume_sky=None):
    """k, 1..10, for an `estimate.Sample`; assume_sky as of the estimate."""
    cube, library, found = sample.cube, sample.library, {}
    assumed = assume_sky is not None and sample.may_assume_sky
    pixels = cube.measured_count
    pick = cube.random_pixels(np.random.default_rng([sample.seed, 1]), SAMPLES)
    spectra = cube.pixels(pick).astype(np.float32)
    solid = np.flatnonzero(~library.is_mirror(cube.wavelength_um))
    if assumed and len(solid) > 1:
        library = library.subset([library.names[i] for i in solid])
    least = UNDER_SKY if sample.sky.any() else 2 if assumed else 1
    most = min(MOST_OBJECTS, pixels + assumed)
    for k in range(min(least, most), most + 1):
        found[k] = free_energy(cube, library, sample.environment(k, assume_sky), spectra)
        best = min(found, key=lambda k: found[k].mean())
        if k - best >= PATIENCE:
            break
    excess = {k: f - found[best] for k, f in found.items()}
    return min(k for k, x in excess.items() if x.mean() <= x.std() / np.sqrt(len(x)))


def free_energy(cube, library, environment, spectra):
    """F of each of spectra (P, bands) in an Environment, nats (P,)."""
    model = reduce_model(cube, library, environment)
    energy = solve_local(model, np.ascontiguousarray(spectra)).energy.astype(np.float64)
    return -np.logaddexp.reduce(-energy, axis=1)
