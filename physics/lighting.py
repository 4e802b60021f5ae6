"""How much the sky lights a scene, from the cube's own pixels: an empirical Bayes prior on V.

The default prior mean of V is 1/k for each object, and of the usual k = 5 objects three stand for
the sky. That suits open ground. In a wood or a street less of the hemisphere is sky: reflective
materials such as bark and brick then need a V far from the prior, blacker ones such as grass and
soil do not, and with few bands the blacker ones would be likelier in all pixels. So the sky's share
of the usual V is lowered to where the pixels are likelier, by steps of EM (Dempster et al. 1977) in
the model of `hypotheses`,

    share  <-  sum_pixels sum_h p(h | z) E[V_sky | z, h]  /  sum_pixels sum_h p(h | z),

where h runs over all hypotheses except the sky.

The constants were chosen on 78 scenes used for tuning (3 to 54 bands, `net+sgd`). Three steps are
nearly enough. The share is moved only if that makes pixels likelier by WORTH, and below that part
of the way. With four bands, pixels of woods and streets became likelier by up to 0.06 nats, with at
most 5 points more materials right, or by 0.13 to 0.41 nats, with 5 to 20 points more; elsewhere by
up to 0.08 nats, but in two scenes, at 0.08, with 33 and 38 points fewer right. With six bands and
more it did no harm anywhere, and helped from 0.03 nats on. With three bands, where most pixels are
`unknown`, it was wrong at 0.06 and 0.3 nats (three scenes, 9 to 13 points), and better by 5 to 23
points in all others from 0.15 nats on. Raising the share, too, or moving each object's share
separately gave up to 4 points fewer right on open ground and in rooms, and no more in woods and
streets.
"""

from dataclasses import replace

import numpy as np

from .cube.heat_cube import sampling_step
from .hypotheses import hypotheses_of
from .known import known_arrays
from .prior import lighting_scale

STEPS = 3
PIXELS = 1000  # that are looked at
LEAST = 0.03  # of the sky's share: where no pixel seems to see it, one may
# nats per pixel, from which on it is moved, and all the way; of fewer than so many bands
WORTH, WORTH_OF_FEW, FEW = (0.03, 0.09), (0.09, 0.17), 6
WORK = 1 << 22  # pixels times components of all hypotheses, at once


def as_lit(environment, cube, library, left_out=None, *, error_k=0.0, objects=None, curves=0.0):
    """The Environment of a HeatCube with the V that is usual in its scene (`with_usual_lighting`),
    with all or some objects possibly error_k K off, and the materials' curves possibly off by so
    much (`Environment.off_by` and `with_curves_off_by`, which depend on that V)."""

    def allowing(environment):
        environment = environment.off_by(error_k, objects) if error_k else environment
        return environment.with_curves_off_by(curves) if curves else environment

    lit = with_usual_lighting(allowing(environment), cube, library, left_out)
    return allowing(replace(environment, usual_lighting=lit.usual_lighting))


def with_usual_lighting(environment, cube, library, left_out=None):
    """The Environment of a HeatCube from a calibrated camera, with the V that is usual in its scene
    according to a MaterialLibrary; unchanged if it states what is usual, if all or none of it is
    sky, or if there is nothing to choose.

    left_out  (height, width) bool: pixels that say nothing, the dead ones among them
    """
    k = len(environment)
    sky = np.isin(np.arange(k), environment.sky)
    nothing = not sky.any() or sky.all() or library.is_sky.sum() > len(library) - 2
    if nothing or environment.usual_lighting is not None:
        return environment
    there = np.flatnonzero(~(cube.dead if left_out is None else left_out))
    if not there.size:
        return environment
    some = cube.pixels(there[:: sampling_step(cube.shape, PIXELS * cube.dead.size // there.size)]).T
    part = replace(cube, radiance=some[:, None], dead=None)
    known = known_arrays(part, library, environment)
    even = share = sky.mean()
    usual, nats = np.full(k, 1 / k), []
    try:
        for _ in range(STEPS):
            shift, likely = _step(known | {"usual_lighting": usual}, some)
            nats.append(likely)
            share = max(share + shift[sky].sum(), LEAST)
            if share >= even:
                return environment
            usual = np.where(sky, share / sky.sum(), (1 - share) / (~sky).sum())
        nats.append(_step(known | {"usual_lighting": usual}, some)[1])
    except np.linalg.LinAlgError:  # too little noise to tell: whoever answers says so
        return environment
    least, most = WORTH_OF_FEW if cube.bands < FEW else WORTH
    way = np.clip((nats[-1] - nats[0] - least) / (most - least), 0, 1)
    return replace(environment, usual_lighting=(1 - way) / k + way * usual) if way else environment


def _step(known, spectra):
    """(k,) how far the mean of V, of spectra (bands, n), is from the usual one of known_arrays; and
    the mean log evidence of all hypotheses with that one, nats."""
    h, k = hypotheses_of(known), len(known["environment"])
    s = spectra / known["sigma"][:, None] - h.centre[:, None]
    material = np.arange(len(h.offset)) % len(known["is_sky"])
    ground = known["is_sky"][material] == 0
    total, weight, nats = np.zeros(k), 0.0, 0.0
    parts = -(-len(h.offset) * len(h.basis) * s.shape[1] // WORK)
    for part in np.array_split(s, parts, axis=1):
        z = np.concatenate([h.basis @ part, np.ones((1, part.shape[1]), np.float32)])
        log_p = h.offset[:, None] - 0.5 * ((h.to_w @ z) ** 2).sum(axis=1)
        most = log_p.max(axis=0)
        p = np.exp(log_p - most)
        nats += (most + np.log(p.sum(axis=0))).sum(dtype=np.float64)
        p = (p / p.sum(axis=0))[ground]
        total += np.einsum("rp,rkp->k", p, h.to_x[ground, :k] @ z)
        weight += p.sum()
    shift = lighting_scale(k) * total / max(weight, 1e-9)
    return shift - shift.mean(), nats / s.shape[1]
