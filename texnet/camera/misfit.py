"""What nothing in the library explains of a measurement, and how much noise it is taken for.

The misfit is that of the best-fitting quarter of the pixels, so that neither mixed pixels nor a
missing material decide. It is measured with more than the stated noise: wrong materials, mirrors
above all, make up for wrong curves and wrong bands, and the less noise, the more. So the noise is
first taken to be FIRST times the stated one (with few bands, which then tell no materials apart,
MORE times), and then MORE times what is left, until that no longer changes. The result may be much
noise where nothing is wrong, above all with many similar materials: so under a sky nothing is left
if nothing is left at MORE times the noise. Without a sky, mirrors of the scene's own objects fit
everything then.

What is left beyond noise is wrong in many bands and pixels alike, and misleads more than noise
does. So MORE times what is left is called noise, and T, which combines all bands, may be off by
SHARED times as much in all pixels alike; by less near what just fits, so that there is no step.
"""

from physics.cube.heat_cube import MAX_NETD_K

JUST, PER_BAND = 1.03, 3.0  # a perfect camera leaves at most JUST + PER_BAND / bands noise units
RISE = 0.1  # above that, something is wrong
RAMP = 0.3  # above that, all that is left is noise
FIRST, MORE, MORE_OF_FEW = 64.0, 4.0, 2.8  # factors on the noise
SHARED = 1.5  # times that: error that misleads T in all pixels of a material alike
LESS, LOOKS = 0.9, 24  # ratio of noises above which they count as the same; most iterations
LEAST_BANDS_TO_TELL = 12  # fewer tell materials by little but their level


def few(cube):
    """Whether a HeatCube has few bands."""
    return cube.bands < LEAST_BANDS_TO_TELL


def just(cube):
    """The most, in noise units, that is left of a HeatCube if all is right."""
    return JUST + PER_BAND / cube.bands


def fits(left, cube):
    """Whether all is right, given what is left of a HeatCube."""
    return left <= just(cube) + RISE


def left_of(at, rises):
    """What even the best-fitting pixels leave, in stated noise units; at(noise) is that for a
    factor on the noise, which falls from FIRST or rises from MORE."""
    noise = MORE if rises else FIRST
    left = at(noise)
    for looked in range(LOOKS):
        last, noise = noise, min(MORE * max(left, 1.0), FIRST)
        if not looked and not rises:  # one look, at so much noise, is not decisive
            noise = min(noise, FIRST / MORE)
        if (noise < last / LESS) if rises else (noise > LESS * last):
            break
        before, left = left, at(noise)
        if rises and left / before >= noise / last:  # that only reflects the assumed noise
            return before
    return left


def with_noise(found, left, cube):
    """A Calibration of a HeatCube with the noise needed to explain what is left."""
    if left <= just(cube):
        return found
    share = min((left - just(cube)) / RAMP, 1.0)
    most, all_of_it = MAX_NETD_K / cube.netd_k, left * (MORE_OF_FEW if few(cube) else MORE)
    noise = min(round(all_of_it**share, 3), most)
    shared = min(SHARED * share**0.5 * all_of_it, most)
    return found._replace(noise=noise, misfit=left, shared=shared) if noise > 1 else found
