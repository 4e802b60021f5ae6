"""Four filters over one sensor, like Bayer's three: every pixel measures only one band.

    0 1
    2 3     in every cell of 2 x 2 pixels

Two ways to four full pictures, and one that needs none. `bilinear` interpolates every band from its
own samples. `edge_aware` adds to a pixel's own sample the nearby difference of the other bands from
its band, "nearby" being weighted by distance and by similarity (Tomasi and Manduchi 1998, bilateral
filtering), so that nothing is averaged across an edge; similarity is first that of the samples,
then that of the result. Both work on brightness temperatures, which differ little between bands.
`cells` takes the four samples of a cell for one spectrum, as if T, m and V were the same in all of
it: least squares of Eq. 1 itself, at half the resolution.
"""

import numpy as np
from scipy.ndimage import convolve

from physics.cube.heat_cube import HeatCube
from physics.planck import brightness_temperature, planck

PATTERN = np.array([[0, 1], [2, 3]])
TENT = np.outer([1, 2, 1], [1, 2, 1]) / 4.0  # interpolates a band linearly between its samples
REACH, NEAR, LIKE_K, ROUNDS = 3, 1.5, 5.0, 2  # pixels, pixels, K; tuned on other scenes
FAR = 1e-6  # weight of dissimilar pixels, used if no others are in reach


def measures(shape):
    """(4, height, width) bool: which pixels measure which band."""
    row, column = np.indices(shape) % 2
    return PATTERN[row, column] == np.arange(4)[:, None, None]


def sample(cube):
    """(height, width) readings of a sensor under the four filters, of a four-band HeatCube."""
    return (cube.radiance * measures(cube.shape)).sum(axis=0)


def demosaic(raw, like, method):
    """HeatCube from raw (height, width) samples of a sensor with the bands and NETD of `like`.

    method  bilinear or edge_aware. The NETD is that of the sensor's noise after processing, root
    mean square; errors at edges are not included.
    """
    w = like.wavelength_um[:, None, None]
    t = (brightness_temperature(w, raw) * measures(raw.shape)).sum(axis=0)
    noise = np.random.default_rng(0).normal(300.0, like.netd_k, (64, 64))
    netd_k = float(np.sqrt(((method(noise) - 300.0) ** 2).mean()))
    return HeatCube(planck(w, method(t)), like.wavelength_um, like.fwhm_um, netd_k)


def bilinear(t):
    """(height, width) samples -> (4, height, width), each band interpolated from its own."""
    own = measures(t.shape)
    total = [convolve(np.where(o, t, 0.0), TENT, mode="mirror") for o in own]
    return np.stack(total) / [convolve(o.astype(float), TENT, mode="mirror") for o in own]


def edge_aware(t):
    """(height, width) samples, K -> (4, height, width), the samples themselves kept."""
    own, guide = measures(t.shape), t
    offsets = [(i, j) for i in range(-REACH, REACH + 1) for j in range(-REACH, REACH + 1)]
    samples = _neighbours(t)
    owners = _neighbours(own)
    for _ in range(ROUNDS):
        total, weight = np.zeros(own.shape), np.zeros(own.shape)
        guides = _neighbours(guide)
        for i, j in offsets:
            like = np.exp(-0.5 * ((guides(i, j) - guide) / LIKE_K) ** 2) + FAR
            w = np.exp(-0.5 * (i * i + j * j) / NEAR**2) * like * owners(i, j)
            total, weight = total + w * samples(i, j), weight + w
        nearby = total / weight
        full = nearby + (t - (nearby * own).sum(axis=0))
        guide = full.mean(axis=0)
    return full


def _neighbours(a):
    """at(i, j): a (..., height, width) moved by so many rows and columns, mirrored outside."""
    h, w = a.shape[-2:]
    edges = [(0, 0)] * (a.ndim - 2) + [(REACH, REACH)] * 2
    padded = np.pad(a, edges, mode="reflect")
    return lambda i, j: padded[..., REACH + i : REACH + i + h, REACH + j : REACH + j + w]


def cells(raw, like):
    """HeatCube (4, height / 2, width / 2) whose spectra are the four samples of each cell.

    raw (height, width), both even.
    """
    h, w = raw.shape
    parts = raw.reshape(h // 2, 2, w // 2, 2).transpose(1, 3, 0, 2).reshape(4, h // 2, w // 2)
    return HeatCube(parts, like.wavelength_um, like.fwhm_um, like.netd_k)
