"""How far off each part of a picture is, by the air before it.

Air of one temperature pulls what is seen through it the farther towards its own glow, the more of
it there is. So once it is found for the whole picture (`air_between`), each patch is looked at
behind half as much of it, twice as much and so on, and the distance d is taken that is likeliest
with its neighbours':

    E(d)  =  mean over 3 x 3 patches of -log p(S | d)  +  ln^2(d / d_0) / (2 SPREAD^2)

d_0 being that of the whole. What is as warm as the air looks the same behind any of it, and is
taken to be as far as usual: there it matters least.
"""

import math

import numpy as np

from physics.errors import Implausible
from physics.expected import Expected
from physics.prior import like_sky

from ..glance import PATCH, from_afar
from .correction import Distances, behind, corrected, lifted_nats
from .nats import NegativeLogEvidence
from .one_error import lowest

OCTAVES = np.arange(-5.0, 5.0)  # of d / d_0 that are tried
SPREAD = 1.0  # of ln d within a picture, one standard deviation; of eleven scenes 0.3 to 1.2
PATCHES = 8000  # at most about so many
FAR = 0.75  # of the ground is nearer than that whose air the noise is of
FEW = 0.1  # fewer pixels unlike the sky, and noise may hide the rest of the ground
ENOUGH = 20.0  # nats: what is unlikely at one distance has no more to say


def distances(cube, environment, clear, look, materials, found):
    """Distances of what each pixel of a HeatCube shows, float32.

    environment  Environment, as the camera has both;  clear  without air and what else is wrong
    look         methods.Look;  materials  how many it chooses from
    found        Calibration with the Air of the whole picture
    """
    step = max(PATCH, math.ceil(math.sqrt(cube.radiance[0].size / PATCHES)))
    afar, every = from_afar(cube, step), np.arange(materials)

    def of(c):
        try:
            nats = -look(clear, corrected(afar, c), every)["log_evidence"]
            return nats + lifted_nats(afar, c)
        except Implausible:  # nothing looks like that
            return np.full(afar.shape, np.inf)

    octaves = likeliest_octaves(
        found, NegativeLogEvidence(of, look.at_once), afar, among_neighbours
    )
    farther = Expected(octaves[None].astype(np.float32), step).of_tile(0, 0, *cube.shape)[0]
    usual = np.float32(found.air.metres)
    return Distances(usual * 2**farther, far(usual * 2**octaves, afar, environment))


def far(metres, cube, environment):
    """m to a far pixel of a HeatCube's ground, metres (height, width) being those to all; what is
    dead or looks like the sky in view of an Environment is left out, unless FEW are left."""
    sky = like_sky(cube.spectra, environment, cube.sigma).reshape(cube.shape)
    ground = ~sky & ~cube.dead
    return float(np.quantile(metres[ground] if ground.mean() >= FEW else metres, FAR))


def among_neighbours(nats):
    """(octaves, height, width) mean nats of 3 x 3 patches."""
    from scipy.ndimage import uniform_filter  # few cubes need it

    return uniform_filter(nats, (1, 3, 3), mode="nearest")


def likeliest_octaves(found, nats_of, cube, among=lambda nats: nats):
    """(height, width) octaves by which what a HeatCube shows is farther than found, a Calibration
    with the Air of the whole picture, says.

    nats_of  NegativeLogEvidence of the pixels, corrected by a Calibration
    among    (octaves, height, width) nats -> their mean among those that are likely as far
    """
    # by one error of its air: by its own, more air would be likelier for its noise alone
    found = found._replace(error_at=found.air)
    tried = [behind(found, metres, cube.nodes_um) for metres in found.air.metres * 2**OCTAVES]
    nats = nats_of.each(tried)
    nats = np.array([nats[c].reshape(cube.shape) for c in tried])
    nats = np.where(np.isfinite(nats), nats, np.inf)
    least = nats.min(axis=0)
    nats = np.minimum(nats - np.where(np.isfinite(least), least, 0), ENOUGH)
    farther = (OCTAVES * math.log(2))[:, None, None]
    energy = among(nats) + farther**2 / (2 * SPREAD**2)
    # the lowest of a parabola about the best, which may be the nearest or the farthest
    best = energy.argmin(axis=0)
    at = np.clip(best, 1, len(OCTAVES) - 2)
    below, here, above = (np.take_along_axis(energy, at[None] + i, 0)[0] for i in (-1, 0, 1))
    return np.where(at == best, OCTAVES[at] + lowest(below, here, above), OCTAVES[best])
