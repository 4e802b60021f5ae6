"""Bands that tell nothing about the scene, or less than others: found from the cube alone.

Expressed in kelvin at 300 K, a working band shows the scene's contrast and the sensor's noise, the
part that the other bands do not predict (`netd`). A band is bad, and left out, if it is

    stuck   the same everywhere while others vary; or varies by less than STUCK_NOISE times the
            usual noise (the bands' median) and by less than STUCK_SHARE of what the live
            bands on both sides do
    noisy   NOISY times as noisy as usual
    dark    without radiance in more than a few pixels (`dead_pixels`)
    off     OFF_K warmer, or colder, than both neighbouring bands, if these are close to it, in half
            of the pixels; this applies to a tenth of the bands at most, since more of them would
            mean that something else is wrong

With MANY_BANDS, a band that is at least UNEVEN times as noisy as usual is assigned that noise,
unless the cube states how its bands' noise differs.

With fewer than LEAST_BANDS bands, or few pixels, only bands that are the same everywhere can be
recognised. With MANY_BANDS or more, the usual noise replaces the stated NETD if it is at least MORE
times as much (as in a striped cube), or as many times less, also by bands that lie apart: a fit
that is far better than the noise allows would look surer than it is.

On 72 cubes of path-traced scenes outside the test sets, 9 to 54 bands, a good band was at most 2.1
times as noisy as usual, whether their NETD was 0, 5, 20, 50, 200 or 1000 mK; with 54 bands the
usual noise was at most 1.02 times the stated one at 20 mK and more.
"""

from dataclasses import replace

import numpy as np

from ..planck import brightness_temperature
from .dead_pixels import FEW, lit
from .heat_cube import LEAST_NETD_K, MAX_NETD_K, MIN_NETD_K
from .netd import most_noise, noise_of_bands, squares_of, usual_noise

NOISY, UNEVEN, STUCK_NOISE, STUCK_SHARE, MORE = 4.0, 2.2, 2.0, 0.1, 1.2
OUTERMOST = 0.005  # of the pixels at either end
LEAST_BANDS, MANY_BANDS = 8, 30
# K from the nearer of both neighbours, these at most so far apart, um; and the share of the bands
# that may be so. Of bands 0.125 um apart no material of the starter library, lit by the zenith
# alone, nor any sky is 3.2 K off, behind up to 3 km of air or none, and where the gain of each of
# 54 is off by 3 % by itself some are by 5.4; of bands 0.17 um apart limestone is 7.5
OFF_K, BESIDE_UM, MOST_OFF = 6.0, 0.13, 0.1
SAMPLES = 3000  # pixels whose levels are compared
NO_RADIANCE = f"no radiance in more than {FEW:.0%} of the pixels"


def without_bad_bands(cube):
    """A HeatCube less its bad bands, of the noise that they show (itself if nothing is amiss), and
    {wavelength_um: why} of the bad bands."""
    w, relative = cube.wavelength_um, cube.relative_noise
    squares = squares_of(cube) / cube.sigma_at(1.0)
    squares[..., ~lit(squares).all(axis=(0, 1))] = 0
    bad = {}
    while found := _bad(w, squares, relative, [b for b in range(len(w)) if b not in bad]):
        bad |= found
    bad |= _off(cube, [b for b in range(len(w)) if b not in bad])
    good = np.array([b not in bad for b in range(len(w))])
    if bad:
        cube = cube.only(good)
    squares = squares[..., good]
    noise = _noise(squares) if cube.bands >= MANY_BANDS and (relative == 1).all() else None
    if noise is not None:
        noise = noise / max(np.median(noise), LEAST_NETD_K)
        if (noise > UNEVEN).any():
            cube = replace(cube, relative_noise=np.where(noise > UNEVEN, noise, 1.0))
            squares = squares / cube.relative_noise
    if cube.bands >= MANY_BANDS and cube.netd_k:
        usual, most = usual_noise(squares), most_noise(squares)
        if usual is not None and usual > MORE * max(cube.netd_k, LEAST_NETD_K):
            cube = replace(cube, netd_k=min(usual, MAX_NETD_K))
        elif most is not None and MORE * max(most, LEAST_NETD_K) < cube.netd_k:
            cube = replace(cube, netd_k=max(most, MIN_NETD_K))
    return cube, {float(w[b]): bad[b] for b in sorted(bad)}


def _bad(wavelength_um, squares, relative_noise, good):
    """{index: why} of what is bad among the bands that are good so far; squares (4, n, bands) in K
    at 300 K over the bands' relative_noise, 0 in bands without light."""
    k = relative_noise[good]
    w, s = wavelength_um[good], squares[0][:, good]
    varies = np.ptp(s, axis=0) > 0
    same = ~varies & (varies.any() | (s[0] == 0))
    if same.any():
        return {
            good[i]: "the same everywhere" if s[0, i] else NO_RADIANCE for i in np.flatnonzero(same)
        }
    noise = _noise(squares[..., good])
    if noise is None:
        return {}
    usual = max(np.median(noise), LEAST_NETD_K)
    # a few pixels that flare up in one band say nothing of it
    spread = np.clip(s, *np.quantile(s, [OUTERMOST, 1 - OUTERMOST], axis=0)).std(axis=0)
    live = spread > STUCK_NOISE * usual
    # a band without contrast at the end of the range may just see opaque air: live bands must lie
    # on both sides. If only a few bands are live, the others are not compared with them
    in_k = k * spread
    near = np.interp(w, w[live], in_k[live], 0, 0) if 2 * live.sum() > len(w) else in_k
    found = {
        good[i]: f"varies by {in_k[i]:.2g} K where its neighbours vary by {near[i]:.2g} K"
        for i in np.flatnonzero(in_k < STUCK_SHARE * near)
    }
    return found or {
        good[i]: f"noise of {k[i] * noise[i]:.2g} K where {k[i] * usual:.2g} K is usual"
        for i in np.flatnonzero(noise > NOISY * usual)
    }


def _off(cube, good):
    """{index: why} of what is off in level among the bands of a HeatCube that are good so far."""
    w = cube.wavelength_um[good]
    near = np.diff(w) <= BESIDE_UM
    if not (near[1:] & near[:-1]).any():
        return {}
    t = brightness_temperature(w, cube.sample(SAMPLES)[:, good])
    before, after = t[:, 1:-1] - t[:, :-2], t[:, 1:-1] - t[:, 2:]
    # than the nearer of the two; on a slope, nothing
    beyond = np.where(before * after > 0, np.minimum(np.abs(before), np.abs(after)), 0)
    k = np.median(np.sign(before) * beyond, axis=0)
    found = np.flatnonzero((np.abs(k) >= OFF_K) & near[1:] & near[:-1])
    if len(found) > MOST_OFF * len(good):
        return {}
    return {
        good[i + 1]: f"{abs(k[i]):.2g} K {'above' if k[i] > 0 else 'below'} both its neighbours"
        for i in found
    }


def _noise(squares):
    """`noise_of_bands`, or None where there are too few of them to tell one from another. Calm is
    here where these differences themselves are least: a pixel that flares up stays out."""
    d = squares[0] - squares[3]
    if d.shape[1] < LEAST_BANDS:
        return None
    return noise_of_bands(d, np.median(np.abs(d), axis=1), alike=False)
