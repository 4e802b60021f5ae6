"""Bands that tell nothing of the scene: found from the cube alone, and left out.

In kelvin at 300 K a working band shows the scene's contrast and the sensor's noise. Its noise is
what the other bands do not predict: of some pixels and a neighbour of each, the CALM share that
differ least are taken, and from each band's difference what least squares make of the other bands'
differences. Spectra of a scene fill few dimensions, so the others predict a line of ozone or of
quartz, too; the median of what is left is noise. Bad is a band that is

    stuck   the same everywhere while others vary; or varies by less than STUCK_NOISE times the
            usual noise (the bands' median) and by less than STUCK_SHARE of what the live
            bands on both sides do
    noisy   NOISY times as noisy as usual

With fewer than LEAST_BANDS bands, or few pixels, only what is the same everywhere is certain.

On 72 path-traced cubes of no test with 9 to 54 bands a good band was at most 2.1 times as noisy as
usual, whether their NETD was 0, 5, 20, 50, 200 or 1000 mK.
"""

import numpy as np

from .heat_cube import lit
from .planck import noise_sigma

SAMPLES = 6000  # pixels
CALM = 0.25
NOISY, STUCK_NOISE, STUCK_SHARE = 4.0, 2.0, 0.1
LEAST_BANDS = 8
LEAST_K = 1e-3  # keeps spectra without noise from being singular
FINEST_K = 0.02  # no sensor is better; where a simulated cube is, what is left is not noise


def without_bad_bands(cube):
    """A HeatCube less its bad bands (itself if it has none), and {wavelength_um: why} of these."""
    w, spectra, differences = cube.wavelength_um, *_samples(cube)
    bad = {}
    while found := _bad(w, spectra, differences, [b for b in range(len(w)) if b not in bad]):
        bad |= found
    if not bad:
        return cube, {}
    good = np.array([b not in bad for b in range(len(w))])
    return cube.only(good), {float(w[b]): bad[b] for b in sorted(bad)}


def _samples(cube):
    """(n, bands) spectra of some pixels, and their differences from the next pixel but one row
    down, K at 300 K; zeros in bands without light."""
    size, step = cube.radiance[0].size, cube.shape[1] + 1
    first = np.arange(0, size, max(1, size // SAMPLES))
    both = cube.pixels(np.concatenate([first, (first + step) % size]))
    both[:, ~lit(both).all(axis=0)] = 0
    both /= noise_sigma(cube.wavelength_um, 1.0)
    return both[: len(first)], both[: len(first)] - both[len(first) :]


def _bad(wavelength_um, spectra, differences, good):
    """{index: why} of what is bad among the bands that are good so far."""
    w, s, d = wavelength_um[good], spectra[:, good], differences[:, good]
    varies = np.ptp(s, axis=0) > 0
    same = ~varies & (varies.any() | (s[0] == 0))
    if same.any():
        return {good[i]: "the same everywhere" for i in np.flatnonzero(same)}
    contrast = np.median(np.abs(d), axis=1)
    d = d[contrast <= np.quantile(contrast, CALM)]
    if len(good) < LEAST_BANDS or len(d) < 2 * len(good):
        return {}
    noise = _own_noise(d)
    usual = max(np.median(noise), FINEST_K)
    spread = s.std(axis=0)
    live = spread > STUCK_NOISE * usual
    # beyond the last live band a scene as warm as the air may end, and nothing be broken
    near = np.interp(w, w[live], spread[live], 0, 0) if live.any() else spread
    found = {
        good[i]: f"varies by {spread[i]:.2g} K where its neighbours vary by {near[i]:.2g} K"
        for i in np.flatnonzero(spread < STUCK_SHARE * near)
    }
    return found or {
        good[i]: f"noise of {noise[i]:.2g} K where {usual:.2g} K is usual"
        for i in np.flatnonzero(noise > NOISY * usual)
    }


def _own_noise(differences):
    """(bands,) standard deviation of what the other bands' differences do not predict."""
    d = differences
    precision = np.linalg.inv(d.T @ d / len(d) + LEAST_K**2 * np.eye(d.shape[1]))
    left = d @ precision / np.diag(precision)  # d_b less its least-squares fit by the others
    return np.median(np.abs(left), axis=0) / 0.6745 / np.sqrt(2)
