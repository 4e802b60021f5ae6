"""What is wrong with or before the camera, and how much noise, where the scene itself shows it.

Some pixels are asked (`pixels`), in this order:

1. Are the wavelengths off, or is there a gain or an offset of all bands (`one_error`)? If the
   wavelengths are, all else waits until they are right. Under a sky that is assumed few bands are
   not asked.
2. Do the pixels fit with that gain or offset? If not, do they through air (`air_between`), each
   behind as much of it as is likeliest? Air is also taken if most of what does not fit is gone
   with it, since air absorbs otherwise than ours (`air_error`), or if it makes the pixels likelier
   by AIR_WORTH and is as warm as the sky's opaque bands say. It must make them likelier at the
   noise that it takes without air, too: at the noise that is stated bands that are off pass for
   hot air, behind which mirrors fit nearly everything.
3. Is anything left (`misfit`)? It may be gains of the bands among each other, if nothing is left
   with them (`band_gains`).
4. Are the library's curves off (`curve_error`)? That is asked in any case, since mirrors make up
   for wrong curves best, but not behind air, which absorbs otherwise than ours, nor of few bands,
   which tell materials by little but their level, nor with one object.
5. What is left after that is called noise: curves are off by more, a material is missing, or k is
   too small.

What is likelier than none but not taken, or likelier but does not fit, is suspected: T is in doubt
by as much as it would be another with it, unless what was taken is likelier by SUSPECT nats.

The constants, here and in the files named above, were found on scenes outside the test sets with 9
and 54 bands: right cameras, gains and offsets off by 1 to 10 % and 1 to 3 K, bands off by 0.1 to 1
% among each other, libraries whose curves are 0.5 to 10 % wrong or that lack a common material,
little sky in view, wavelengths off by a tenth of a band.
"""

from functools import partial
from typing import NamedTuple

import numpy as np

from physics.air import Air
from physics.planck import brightness_temperature

from .air_between import air_between
from .air_error import absorbing_otherwise, air_error_k
from .band_gains import band_gains
from .correction import RIGHT, Calibration, corrected, corrected_environment
from .curve_error import asked_by_half, likeliest_curves, what_noise_leaves
from .misfit import fits, just, with_noise
from .one_error import FEW_UNDER_SKY, LEVELS, SUSPECT, losses, one_error, shift_kind
from .pixels import LEAST_OBJECTS, SampledPixels, sample

# of the misfit beyond noise, at most, where air is taken out, and where it is suspected: on scenes
# used for tuning 0 to 0.3 behind air (of one scene 0.2 and 0.7), 0.77 and more where curves were
# wrong
AIR_LEAVES, AIR_MAY_LEAVE = 0.5, 0.8
# of air: nats per pixel at the noise that it takes without, K from what shows how warm it is, and
# noise units that it leaves at most. On scenes used for tuning 0.19 and more, 1.6 and 1.8 at most
# (or less than AIR_LEAVES). Elsewhere, where it was as near, no nats, but with bands off by 3 %, of
# which it left 3.6 and more
AIR_WORTH, AIR_NEAR_K, AIR_LEFT = 0.1, 2.5, 2.0
# times what noise leaves, at most, even of the pixels that fit best, where curves are off, if half
# of the materials ask for it and if fewer do: on scenes used for tuning 0.84 to 1.07 where curves
# were wrong by 2 % and less, 1.04 to 2 where a common material was missing, 1.3 to 6.6 where bands
# were off
CURVES_LEAVE, CURVES_ALONE_LEAVE = 1.1, 1.0
OPAQUE_UM = 13.0  # from here on a sky is as warm as the air near the ground


def calibration(cube, environment, looks, library, left_out=None, moved=False):
    """The Calibration of a HeatCube with its NETD, of whose scene environment is the Environment;
    RIGHT if nothing is wrong, or too little is there to say so. Where its wavelengths are off it
    says that alone: all else is to be asked of the cube and an environment at those it shows.

    looks     as a `methods.Method` has it
    library   MaterialLibrary of what may be seen
    left_out  (height, width) bool: pixels that say nothing, being saturated, dead or far hotter
    moved     whether that was done, and they are not asked for again
    """
    part = sample(cube, left_out)
    if part is None:
        return RIGHT
    sky = bool(environment.sky) and environment.sky_mean is not None
    pixels = SampledPixels(part, environment, library, looks)
    nats_of = pixels.nats_of()
    if environment.sky and not sky and cube.bands < FEW_UNDER_SKY:
        kinds = ()
    else:
        kinds = LEVELS if moved else (*LEVELS, shift_kind(cube.wavelength_um))
    camera, suspected = one_error(nats_of, sky, kinds)
    if camera.shift_um:
        return camera
    fit = _that_fits(pixels, nats_of, camera, sky)
    if not fits(fit.left, cube) and pixels.tell_bands_from_curves:
        evened = band_gains(part, environment, pixels.maps, library, pixels.quartile)
        if evened is not None and 0 < (left := pixels.left(evened)) <= just(cube):
            fit = fit._replace(found=evened, left=left, unfit=())
    rivals = [*suspected, *fit.unfit]
    found = explained(pixels, nats_of, fit.found, fit.left, rivals)
    taken = found if found.curves else fit.found  # all at the noise that is stated
    return found._replace(
        suspected_k=_suspected_k(pixels, nats_of, taken, rivals, fit.noise),
        air_error_k=air_error_k(pixels, taken, fit.noise),
    )


class _Fit(NamedTuple):
    """The first Calibration found by which pixels are likelier and fit, RIGHT if none; what is left
    with it, in noise units; those likelier that do not fit; and the noise that it takes if nothing
    is wrong."""

    found: Calibration
    left: float
    unfit: tuple[Calibration, ...]
    noise: float


def _that_fits(pixels, nats_of, camera, sky):
    """The _Fit of SampledPixels, given their one error."""
    all_left = pixels.left(RIGHT)
    noise = with_noise(RIGHT, all_left, pixels.cube).noise
    share_of = lambda left: (left - 1) / max(all_left - 1, 1e-9)
    tried, unfit = {RIGHT}, []
    for likelier in _likelier(nats_of, camera, pixels, sky):
        if likelier in tried or _likelier_without_air(nats_of, likelier, noise):
            continue
        tried.add(likelier)
        left = pixels.left(likelier, pixels.distances(likelier, noise))
        if not left:  # of the ground too little would be left
            continue
        fit = fits(left, pixels.cube)
        if likelier.air and (
            fit or share_of(left) < AIR_LEAVES or _is_air(nats_of, likelier, pixels, noise)
        ):
            off, less = absorbing_otherwise(pixels, likelier, left, noise)
            if fit or less <= AIR_LEFT or share_of(less) < AIR_LEAVES:
                return _Fit(off, less, tuple(unfit), noise)
        elif fit:
            return _Fit(likelier, left, tuple(unfit), noise)
        if not likelier.air or share_of(left) < AIR_MAY_LEAVE:
            unfit.append(likelier)
    return _Fit(RIGHT, all_left, tuple(unfit), noise)


def _likelier(nats_of, camera, pixels, sky):
    """The Calibrations by which pixels are likelier than by a right camera: its one error, and,
    where the sky is in view, that and air between, or air."""
    yield camera
    if sky and len(pixels.environment) >= LEAST_OBJECTS:
        air_of = partial(Air.of, nodes_um=pixels.cube.nodes_um)
        for start in dict.fromkeys((camera, RIGHT)):
            yield air_between(nats_of, air_of, _about_air_k(pixels, start), start)


def _likelier_without_air(nats_of, c, noise):
    """Whether at so much noise pixels are likelier by a Calibration without its Air."""
    return _worth_of_air(nats_of, c, noise) < 0


def _is_air(nats_of, c, pixels, noise):
    """Whether the Air of a Calibration is likelier by AIR_WORTH than none at so much noise, and as
    warm as what shows how warm it is."""
    about_k = _about_air_k(pixels, c._replace(air=None))
    near = abs(c.air.temperature_k - about_k) <= AIR_NEAR_K
    return near and _worth_of_air(nats_of, c, noise) >= AIR_WORTH


def _worth_of_air(nats_of, c, noise):
    """Nats per pixel by which pixels are likelier by a Calibration with its Air than without it, at
    so much noise."""
    through = c._replace(noise=noise)
    clear = through._replace(air=None)
    loss = losses(nats_of.each([through, clear]))
    return loss[clear] - loss[through]


def _about_air_k(pixels, c):
    """K, of the sky's opaque bands, or, if there are none, of half of the pixels, as corrected by a
    Calibration."""
    w = pixels.cube.wavelength_um
    sky_k = brightness_temperature(w, corrected_environment(pixels.environment, c).sky_mean).max()
    if w[-1] >= OPAQUE_UM:
        return sky_k
    seen = corrected(pixels.cube, c).radiance
    return max(sky_k, np.median(brightness_temperature(w[:, None, None], seen)))


def explained(pixels, nats_of, found, left, rivals=()):
    """A Calibration that was found of some pixels with what explains what it leaves: curves that
    are off, if nothing is left then and no rival explains it better, or noise."""
    off = None
    if pixels.tell_bands_from_curves and not found.air:
        off = likeliest_curves(nats_of, found, rivals)
    if off:
        surroundings = corrected_environment(pixels.environment, off.found)
        taken = corrected(pixels.cube, off.found)
        maps = pixels.maps(surroundings, taken)
        material = maps["material"].ravel()
        ground = material != pixels.library.sky_index
        asked = asked_by_half(off.gained[ground], material[ground])
        leaves = pixels.quartile(maps) / what_noise_leaves(taken, surroundings)
        if 0 < leaves <= (CURVES_LEAVE if asked else CURVES_ALONE_LEAVE):
            return off.found
    return with_noise(found, left, pixels.cube)


def _suspected_k(pixels, nats_of, found, suspected, noise):
    """K by which T of pixels may be another than with the Calibration found, rms of those that are
    suspected and as likely; 0 if none is. Distances are what they are at a noise."""
    if found.bands:  # whose gains are many enough to make up for any error of all
        left = lambda c: pixels.left(c, pixels.distances(c, noise))
        suspected = [c for c in suspected if fits(left(c), pixels.cube)]
    else:
        # noise that is raised band by band makes anything likelier
        loss = losses(nats_of.each([found._replace(air_error=0.0), *suspected]))
        suspected = [c for c in suspected if loss[c] <= min(loss.values()) + SUSPECT]
    if not suspected:
        return 0.0
    here = pixels.corrected_maps(found, noise)
    moved_k = [pixels.moved_k(pixels.corrected_maps(c, noise), here) for c in suspected]
    return float(np.sqrt(np.mean(np.square(moved_k))))
