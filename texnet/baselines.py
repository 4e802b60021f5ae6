"""Today's displays of a thermal cube: the panchromatic image, CLAHE of it, principal components.

Every picture that TeX vision makes is compared with these three.
"""

import numpy as np

from physics.machinery import scratch

from .metrics import texture_correlation
from .stretch import stretch

SAMPLES = 20_000  # pixels to which the principal components are fitted


def panchromatic(cube):
    """The image of a broadband camera: (height, width) float64 radiance, W m-2 sr-1.

    The trapezoid rule over wavelength; a single band counts as 1 um wide.
    """
    step = np.diff(cube.wavelength_um)
    weight = (np.append(0, step) + np.append(step, 0)) / 2 if cube.bands > 1 else np.ones(1)
    return _weighted(cube, weight[None])[0]


def clahe(picture):
    """Contrast-limited adaptive histogram equalisation (Zuiderveld 1994): (H, W) in 0..1.

    Clip limit 2 over at most 8 x 8 tiles, as is common, of at least 16 pixels. A single row or
    column is duplicated.
    """
    import torch  # which takes a second to load
    from kornia.enhance import equalize_clahe

    unit = stretch(picture).astype(np.float32)
    # kornia's tiles need 2 pixels or more
    unit = np.pad(unit, [(0, 1 if n == 1 else 0) for n in unit.shape], mode="edge")
    grid = tuple(max(1, min(8, n // 16)) for n in picture.shape)
    out = equalize_clahe(torch.from_numpy(unit)[None, None], clip_limit=2.0, grid_size=grid)
    return out[0, 0].numpy()[: picture.shape[0], : picture.shape[1]]


def principal_components(cube):
    """First three principal components of the spectra: (3, height, width) float64.

    Fitted to about SAMPLES evenly spaced pixels. A component's sign is arbitrary; here it is the
    one that correlates positively with brightness, so that pictures are reproducible. Components
    for which the cube has too few bands or pixels are zero.
    """
    from sklearn.decomposition import PCA

    sample = cube.sample(SAMPLES)
    n = min(3, *sample.shape)
    with np.errstate(invalid="ignore"):  # ratios to a zero variance, which are not used
        pca = PCA(n_components=n, svd_solver="full").fit(sample)
    weights = np.zeros((3, cube.bands))
    weights[:n] = pca.components_ * np.where(pca.components_.sum(axis=1) < 0, -1.0, 1.0)[:, None]
    return _weighted(cube, weights, pca.mean_)


def _weighted(cube, weights, mean=None):
    """(n, height, width) sums over bands of weights (n, bands) times radiance minus mean (bands,),
    band by band: the cube may be larger than memory."""
    out = np.zeros((len(weights), *cube.shape))
    for b, band in enumerate(scratch.parts(cube.radiance)):
        off = band.astype(np.float64) - (0.0 if mean is None else mean[b])
        for to, weight in zip(out, weights[:, b], strict=True):
            to += weight * off
    return out


def baseline_pictures(cube):
    """{baseline: (n, height, width)} of a HeatCube: n = 3 for the components, 1 for the others."""
    raw = panchromatic(cube)
    return {
        "panchromatic": raw[None],
        "clahe": clahe(raw)[None],
        "principal_components": principal_components(cube),
    }


def baseline_correlations(pictures, truth, seen=True):
    """{baseline: magnitude of the correlation with the true sky-lit texture} of baseline_pictures,
    over non-sky pixels that were seen (height, width).

    The magnitude, since a baseline's sign is arbitrary; for the components that of the best. NaN if
    the truth has no such texture, as in a room.
    """
    score = lambda picture: abs(texture_correlation(picture, truth, seen))
    return {name: max(map(score, of)) for name, of in pictures.items()}
