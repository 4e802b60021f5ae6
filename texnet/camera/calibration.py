"""Errors of the camera and the air before it, and the noise, as far as the scene shows them.

A sample of the pixels (`pixels`) is tested in this order:

1. Are the wavelengths off, or is there a gain or an offset of all bands (`one_error`)? If the
   wavelengths are off, all else waits until they are right. Under an assumed sky this is not asked
   of few bands.
2. Do the pixels fit with that gain or offset? If not, do they through air (`air_between`), each
   behind the likeliest amount of it? Air is also accepted if it removes most of the misfit, since
   real air absorbs differently from ours (`air_error`), or if it makes the pixels likelier by
   AIR_WORTH and is as warm as the sky's opaque bands say. It must also make them likelier at the
   noise that would be needed without air: at the stated noise, band errors pass for hot air,
   behind which mirrors fit nearly everything.
3. Is anything left (`misfit`)? It may be relative gains of the bands, if nothing is left with them
   (`band_gains`).
4. Are the library's curves off (`curve_error`)? That is always asked, since mirrors make up for
   wrong curves best; but not behind air, which absorbs differently from ours, nor with few bands,
   which tell materials by little but their level, nor with a single object.
5. What is still left is called noise: curves are off by more, a material is missing, or k is too
   small.

Errors that are likelier than none but not accepted, or likelier without fitting, are suspected: T
is in doubt by the change they would cause, unless what was accepted is likelier by SUSPECT nats.

The constants, here and in the files named above, were tuned on scenes outside the test sets with 9
and 54 bands: perfect cameras, gains and offsets off by 1 to 10 % and 1 to 3 K, relative band gains
off by 0.1 to 1 %, libraries whose curves are 0.5 to 10 % wrong or that lack a common material,
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

# largest share of the misfit beyond noise that accepted air may leave, and suspected air: on scenes
# used for tuning 0 to 0.3 behind air (in one scene 0.2 and 0.7), 0.77 and more where curves were
# wrong
AIR_LEAVES, AIR_MAY_LEAVE = 0.5, 0.8
# for air: least nats per pixel at the noise needed without it, largest difference in K from what
# shows its temperature, and most noise units that it leaves. On scenes used for tuning 0.19 and
# more, 1.6 and 1.8 at most (or less than AIR_LEAVES). Elsewhere, where the temperature was as near,
# no nats, except with bands off by 3 %, of which it left 3.6 and more
AIR_WORTH, AIR_NEAR_K, AIR_LEFT = 0.1, 2.5, 2.0
# largest ratio of what the best-fitting pixels leave to what noise leaves, for curve errors to be
# accepted, if half of the materials ask for them and if fewer do: on scenes used for tuning 0.84 to
# 1.07 where curves were wrong by 2 % and less, 1.04 to 2 where a common material was missing, 1.3
# to 6.6 where bands were off
CURVES_LEAVE, CURVES_ALONE_LEAVE = 1.1, 1.0
OPAQUE_UM = 13.0  # from here on the sky is as warm as the air near the ground


def calibration(cube, environment, looks, library, left_out=None, moved=False):
    """The Calibration of a HeatCube with its NETD in an Environment; RIGHT if nothing is wrong, or
    there is too little to say so. If the wavelengths are off it contains only that: all else must
    be asked again with the cube and its environment at the wavelengths found.

    looks     as in a `methods.Method`
    library   MaterialLibrary of what may be seen
    left_out  (height, width) bool: pixels that say nothing: saturated, dead or far hotter
    moved     whether that was done, and wavelengths are not asked for again
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
    taken = found if found.curves else fit.found  # both at the stated noise
    return found._replace(
        suspected_k=_suspected_k(pixels, nats_of, taken, rivals, fit.noise),
        air_error_k=air_error_k(pixels, taken, fit.noise),
    )


class _Fit(NamedTuple):
    """found: the first Calibration that makes pixels likelier and fits, or RIGHT; left: its misfit,
    in noise units; unfit: likelier ones that do not fit; noise: what is needed if nothing is
    wrong."""

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
        if not left:  # too little ground would be left
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
    """Calibrations that make pixels likelier than a perfect camera: the one error of camera and,
    if the sky is in view, that plus air, or air alone."""
    yield camera
    if sky and len(pixels.environment) >= LEAST_OBJECTS:
        air_of = partial(Air.of, nodes_um=pixels.cube.nodes_um)
        for start in dict.fromkeys((camera, RIGHT)):
            yield air_between(nats_of, air_of, _about_air_k(pixels, start), start)


def _likelier_without_air(nats_of, c, noise):
    """Whether pixels are likelier, at this noise, by a Calibration without its Air."""
    return _worth_of_air(nats_of, c, noise) < 0


def _is_air(nats_of, c, pixels, noise):
    """Whether a Calibration's Air gains AIR_WORTH at this noise, and is as warm as what shows its
    temperature."""
    about_k = _about_air_k(pixels, c._replace(air=None))
    near = abs(c.air.temperature_k - about_k) <= AIR_NEAR_K
    return near and _worth_of_air(nats_of, c, noise) >= AIR_WORTH


def _worth_of_air(nats_of, c, noise):
    """Nats per pixel gained by a Calibration's Air at this noise."""
    through = c._replace(noise=noise)
    clear = through._replace(air=None)
    loss = losses(nats_of.each([through, clear]))
    return loss[clear] - loss[through]


def _about_air_k(pixels, c):
    """K, from the sky's opaque bands; if there are none, the warmer of the sky and the median of
    all pixels, as corrected by a Calibration."""
    w = pixels.cube.wavelength_um
    sky_k = brightness_temperature(w, corrected_environment(pixels.environment, c).sky_mean).max()
    if w[-1] >= OPAQUE_UM:
        return sky_k
    seen = corrected(pixels.cube, c).radiance
    return max(sky_k, np.median(brightness_temperature(w[:, None, None], seen)))


def explained(pixels, nats_of, found, left, rivals=()):
    """A Calibration found, extended by what explains the rest: curve errors, if nothing is left
    with them and no rival explains it better, or noise."""
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
    """K by which T of pixels may differ from that with the Calibration found: rms over those
    suspected that are as likely; 0 if none is. Distances are the likeliest at a noise."""
    if found.bands:  # these gains are numerous enough to make up for any error of all bands
        left = lambda c: pixels.left(c, pixels.distances(c, noise))
        suspected = [c for c in suspected if fits(left(c), pixels.cube)]
    else:
        # extra noise in single bands (air_error) makes anything likelier
        loss = losses(nats_of.each([found._replace(air_error=0.0), *suspected]))
        suspected = [c for c in suspected if loss[c] <= min(loss.values()) + SUSPECT]
    if not suspected:
        return 0.0
    here = pixels.corrected_maps(found, noise)
    moved_k = [pixels.moved_k(pixels.corrected_maps(c, noise), here) for c in suspected]
    return float(np.sqrt(np.mean(np.square(moved_k))))
