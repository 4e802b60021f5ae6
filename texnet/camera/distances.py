"""How far away each part of a picture is, from the air before it.

Air of one temperature pulls what is seen through it the more towards its own glow, the more air
there is. So once air is found for the whole picture (`air_between`), each patch is tested behind
half as much of it, twice as much and so on, and the likeliest distance d, with its neighbours, is
taken:

    E(d)  =  mean over 3 x 3 patches of -log p(S | d)  +  ln^2(d / d_0) / (2 SPREAD^2)

where d_0 is that of the whole picture. What is as warm as the air looks the same behind any amount,
and is taken to be at the usual distance; there it matters least.
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
SPREAD = 1.0  # of ln d within a picture, one standard deviation; in eleven scenes 0.3 to 1.2
PATCHES = 8000  # about the most used
FAR = 0.75  # share of the ground nearer than the distance for which noise is computed
FEW = 0.1  # with a smaller share of pixels unlike the sky, noise may hide the rest of the ground
ENOUGH = 20.0  # nats, at most, against a distance


def distances(cube, environment, clear, look, materials, found):
    """Distances of what each pixel of a HeatCube shows, float32.

    environment  Environment as the camera shows it;  clear  without air and the camera's errors
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
    """Distance, m, of a far pixel of a HeatCube's ground, given metres (height, width); dead pixels
    and those like an Environment's visible sky are excluded, unless only FEW would remain."""
    sky = like_sky(cube.spectra, environment, cube.sigma).reshape(cube.shape)
    ground = ~sky & ~cube.dead
    return float(np.quantile(metres[ground] if ground.mean() >= FEW else metres, FAR))


def among_neighbours(nats):
    """(octaves, height, width) mean nats of 3 x 3 patches."""
    from scipy.ndimage import uniform_filter  # few cubes need it

    return uniform_filter(nats, (1, 3, 3), mode="nearest")


def likeliest_octaves(found, nats_of, cube, among=lambda nats: nats):
    """(height, width) octaves by which what a HeatCube shows is farther than found says, a
    Calibration with the Air of the whole picture.

    nats_of  NegativeLogEvidence of the pixels, corrected by a Calibration
    among    (octaves, height, width) nats -> their mean among pixels likely to be as far
    """
    # with one error for all: with its own, more air would be likelier just for its noise
    found = found._replace(error_at=found.air)
    tried = [behind(found, metres, cube.nodes_um) for metres in found.air.metres * 2**OCTAVES]
    nats = nats_of.each(tried)
    nats = np.array([nats[c].reshape(cube.shape) for c in tried])
    nats = np.where(np.isfinite(nats), nats, np.inf)
    least = nats.min(axis=0)
    nats = np.minimum(nats - np.where(np.isfinite(least), least, 0), ENOUGH)
    farther = (OCTAVES * math.log(2))[:, None, None]
    energy = among(nats) + farther**2 / (2 * SPREAD**2)
    # the minimum of a parabola about the best, unless that is the nearest or the farthest
    best = energy.argmin(axis=0)
    at = np.clip(best, 1, len(OCTAVES) - 2)
    below, here, above = (np.take_along_axis(energy, at[None] + i, 0)[0] for i in (-1, 0, 1))
    return np.where(at == best, OCTAVES[at] + lowest(below, here, above), OCTAVES[best])
