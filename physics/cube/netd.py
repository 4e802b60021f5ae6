"""The sensor's noise, from a cube's own pixels.

Diagonal neighbours differ by the picture's texture and by noise. Where the picture is calm, spectra
of texture fill few dimensions: with C the covariance of such differences, row b of its inverse, as
a weighted sum of bands, is band b minus all that the other bands predict of it. The sum also
contains the others' noise; scaled to a length of 1 it has the noise of one band, if all are equally
noisy. The calm pixels are those where the other diagonal of the same square, whose noise is
independent, differs least.

Noise that bands share, as in a spectrum that was apodised or resampled, is predicted by the other
bands. If there are so many bands that those which lie APART predict the texture, too, noise is also
estimated from these, and that estimate is taken if it is SHARED times as large. With many bands,
scenes fill less than half of the principal components, and noise is at least the median of these,
without the few pixels that differ in that half far more than most: defective detectors, which would
dominate it. A single band predicts nothing: there noise is estimated from second differences down
the rows, where they are least.

What varies from pixel to pixel in all bands in the same way looks like noise, so with few bands and
a quiet camera the estimate is too large (`benchmarks.netd`).
"""

import numpy as np

from ..errors import InputError
from .dead_pixels import lit
from .saturation import saturated

SAMPLES = 6000  # pixels
CALM, PER_BAND = 0.25, 4  # of the pixels, or so many for each band, if that is more
LEAST_PER_BAND = 2
APART, SHARED = 4, 1.3  # bands; over what they seem to have beside each other
COMPONENTS, MANY_BANDS = 12, 30  # bands of whose components half may be, and are, noise
# pixels of so many times most pixels' variance in that half are defective; sweeps to find them
DEFECTIVE, SWEEPS = 4.0, 6
LEAST_K = 1e-3  # keeps spectra without noise from being singular
MEDIAN, QUARTILE = 0.67449, 0.31864  # of a Gaussian's magnitude


def estimated_netd(cube):
    """K at 300 K, of a HeatCube.

    Raises InputError where there are too few pixels.
    """
    squares = squares_of(cube)
    shows = lit(squares).all(axis=(0, 1))
    in_k = cube.sigma_at(1.0)[shows]
    if len(in_k) == 1:
        noise = _of_one_band(cube, np.flatnonzero(shows)[0])
    else:
        squares = squares[..., shows] / in_k
        noise = usual_noise(squares)
        if noise is not None and len(in_k) >= APART * COMPONENTS:  # else texture is not predicted
            apart = _noise_apart(squares)
            noise = apart if apart > SHARED * noise else noise
    if noise is None:  # too few squares without a hole
        noise = _of_components(cube.sample(SAMPLES)[:, shows] / in_k)
    if noise is None:
        raise InputError(
            "cube: its NETD is not known, and estimating it needs twice as many measured pixels as "
            "bands, or three in a column for one band; state it as netd_k in an npz file or by "
            "texnet import --netd."
        )
    return noise


def squares_of(cube):
    """(4, n, bands) spectra of some pixels of a HeatCube and of those to the right, below, and
    below to the right of each (of a single row or column, of four on end; so, too, of measured
    pixels that hardly lie in squares); if it can be, none of them dead or at a ceiling, which is
    calm, nor the same twice, as where a picture was resampled."""
    size, width, dead = cube.dead.size, cube.shape[1], (cube.dead | saturated(cube)).reshape(-1)
    some, on_end = cube.regular_pixels(SAMPLES), np.array([[0], [2], [3], [1]])
    square = np.array([[0], [1], [width], [width + 1]])
    of = (some + (square if min(cube.shape) > 1 else on_end)) % size
    whole, measured = ~dead[of].any(axis=0), np.flatnonzero(~dead)
    if np.count_nonzero(whole) >= min(len(some), LEAST_PER_BAND * cube.bands):
        of = of[:, whole]
    elif measured.size:
        of = measured[(np.searchsorted(measured, some) + on_end) % measured.size]
    squares = cube.pixels(of.ravel()).reshape(*of.shape, cube.bands)
    differ = (squares[0] != squares[3]).any(axis=1) & (squares[1] != squares[2]).any(axis=1)
    return squares[:, differ] if differ.sum() >= LEAST_PER_BAND * cube.bands else squares


def usual_noise(squares):
    """The median of the bands' noise in squares (4, n, bands), None where these are too few."""
    texture = np.median(np.abs(squares[1] - squares[2]), axis=1)
    noise = noise_of_bands(squares[0] - squares[3], texture, alike=True)
    if noise is None:
        return None
    noise = float(np.median(noise))
    if squares.shape[-1] < MANY_BANDS:
        return noise
    return max(noise, _of_components(squares[0]) or 0.0)


def most_noise(squares):
    """The same of bands that lie APART: what only those beside them share, as of a spectrum that
    was apodised or resampled, they do not predict, nor all of the texture."""
    some = _of_apart(squares)
    return None if None in some else max(some)


def _of_apart(squares):
    return [usual_noise(squares[..., first::APART]) for first in range(APART)]


def _noise_apart(squares):
    """What is usual of bands that lie APART, but for defective pixels; 0 if too little is left."""
    sound = [_sound(spectra) for spectra in squares]
    if any(which is None for which in sound):
        return 0.0
    some = _of_apart(squares[:, np.all(sound, axis=0)])
    return 0.0 if None in some else float(np.median(some))


def _of_components(spectra):
    """The median of the principal components of spectra (n, bands), half of which are of noise
    where bands are many, be it shared by some of them or not; None where they are too few."""
    if spectra.shape[1] < COMPONENTS:
        return None
    sound = _sound(spectra)
    if sound is None:
        return None
    variance = np.linalg.eigvalsh(np.cov(spectra[sound].T))
    return float(np.sqrt(max(0.0, np.median(variance))))  # rounding can bring it below 0


def _sound(spectra):
    """(n,) bool, which of spectra (n, bands) are no defective pixels', by the half of their
    principal components that is noise; None where these are too few."""
    bands = spectra.shape[1]
    off, sound = spectra - np.median(spectra, axis=0), np.ones(len(spectra), bool)
    for _ in range(SWEEPS):
        if np.count_nonzero(sound) < LEAST_PER_BAND * bands:
            return None
        axes = np.linalg.eigh(np.cov(spectra[sound].T))[1]
        square = ((off @ axes[:, : bands // 2]) ** 2).sum(axis=1)
        before, sound = sound, square <= DEFECTIVE * np.median(square)
        if (sound == before).all():
            break
    return sound


def noise_of_bands(differences, texture, alike):
    """(bands,) standard deviations of the noise in differences (n, bands) of neighbours, taken
    where texture (n,) is least; None where these are too few.

    alike  whether all bands are taken to be as noisy, and what others' noise adds taken out
    """
    share = max(CALM, min(1.0, PER_BAND * differences.shape[1] / len(differences)))
    d = differences[texture <= np.quantile(texture, share)]
    n, bands = d.shape
    if bands < 2 or n < LEAST_PER_BAND * bands:
        return None
    precision = np.linalg.inv(d.T @ d / n + LEAST_K**2 * np.eye(bands))
    scale = np.linalg.norm(precision, axis=0) if alike else np.diag(precision)
    # of few pixels the covariance is fitted to their noise
    fitted = ((n - bands) / n) ** (1.0 if alike else 0.5)
    return np.median(np.abs(d @ (precision / scale)), axis=0) / MEDIAN / np.sqrt(2) / fitted


def _of_one_band(cube, band):
    """K, or None where no column has three measured pixels on end."""
    s = cube.radiance[band].astype(np.float64) / cube.sigma_at(1.0)[band]
    dead = cube.dead | saturated(cube)
    measured = ~(dead[:-2] | dead[1:-1] | dead[2:])
    second = np.abs(s[1:-1] - 0.5 * (s[:-2] + s[2:]))[measured]
    if not second.size:
        return None
    return float(np.quantile(second, 0.25) / QUARTILE / np.sqrt(1.5))
