"""What of the measurement nothing in the library explains, and how much noise that is taken for.

What is left is asked of the quarter of the pixels that fit best, so that neither mixed pixels nor a
missing material decide, and at more noise than is stated: wrong materials, mirrors above all, make
up for wrong curves and wrong bands, and the less noise, the more they have to make up for. So the
noise is first taken to be FIRST times as much as stated (with few bands, which then tell no
materials apart, MORE times), and then MORE times what is left, until that no longer changes. That
may end at much noise where nothing is wrong, among many alike materials above all: so under a sky
nothing is left if nothing is at MORE times the noise. Where no sky lights a scene, mirrors of its
own objects fit everything then.

What is left beyond noise is wrong in many bands and pixels alike, and misleads more than noise
does. So MORE times what is left is called noise, and T, to which all bands add up, may be off by
SHARED times as much in all pixels alike; less near what just fits, so that there is no step.
"""

from physics.cube.heat_cube import MAX_NETD_K

JUST, PER_BAND = 1.03, 3.0  # noise units left of a right camera: JUST + PER_BAND / bands at most
RISE = 0.1  # more than that, and it is not right
RAMP = 0.3  # so much more, and all that is left is noise
FIRST, MORE, MORE_OF_FEW = 64.0, 4.0, 2.8  # times the noise
SHARED = 1.5  # times that, by which T is misled, in all pixels of a material alike
LESS, LOOKS = 0.9, 24  # of the noise, and no longer the same; at most
LEAST_BANDS_TO_TELL = 12  # fewer tell materials by little but their level


def few(cube):
    """Whether a HeatCube has few bands."""
    return cube.bands < LEAST_BANDS_TO_TELL


def just(cube):
    """What is left of a HeatCube, in noise units, if all is right, at most."""
    return JUST + PER_BAND / cube.bands


def fits(left, cube):
    """Whether that is all right of which so much is left of a HeatCube."""
    return left <= just(cube) + RISE


def left_of(at, rises):
    """What is left even of the pixels that fit best, in noise units as stated; at(noise) is that
    where the noise is taken to be so many times as much, from FIRST down or from MORE up."""
    noise = MORE if rises else FIRST
    left = at(noise)
    for looked in range(LOOKS):
        last, noise = noise, min(MORE * max(left, 1.0), FIRST)
        if not looked and not rises:  # one look, at so much noise, decides nothing
            noise = min(noise, FIRST / MORE)
        if (noise < last / LESS) if rises else (noise > LESS * last):
            break
        before, left = left, at(noise)
        if rises and left / before >= noise / last:  # it is the noise that is assumed, no more
            return before
    return left


def with_noise(found, left, cube):
    """A Calibration of a HeatCube with the noise that it takes to explain what is left."""
    if left <= just(cube):
        return found
    share = min((left - just(cube)) / RAMP, 1.0)
    most, all_of_it = MAX_NETD_K / cube.netd_k, left * (MORE_OF_FEW if few(cube) else MORE)
    noise = min(round(all_of_it**share, 3), most)
    shared = min(SHARED * share**0.5 * all_of_it, most)
    return found._replace(noise=noise, misfit=left, shared=shared) if noise > 1 else found
