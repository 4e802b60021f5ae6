"""What people look at today: the panchromatic image, CLAHE of it, principal components.

Every picture that TeX vision makes is compared with these three.
"""

import numpy as np

from physics.heat_cube import sampling_step

from .metrics import texture_correlation
from .stretch import stretch


def panchromatic(cube):
    """The image of a broadband camera: (height, width) float64 radiance, W m-2 sr-1.

    The trapezoid rule over wavelength; a single band counts as 1 um wide.
    """
    s = cube.radiance.astype(np.float64)
    if cube.bands == 1:
        return s[0]
    return np.trapezoid(s, cube.wavelength_um, axis=0)


def clahe(picture):
    """Contrast-limited adaptive histogram equalisation (Zuiderveld 1994): (H, W) in 0..1.

    Clip limit 2 over at most 8 x 8 tiles, the usual defaults; tiles of 16 pixels or more. A
    single row or column counts as two of the same.
    """
    import torch  # which takes a second to load
    from kornia.enhance import equalize_clahe

    unit = stretch(picture).astype(np.float32)
    # kornia's tiles are of 2 pixels or more
    unit = np.pad(unit, [(0, 1 if n == 1 else 0) for n in unit.shape], mode="edge")
    grid = tuple(max(1, min(8, n // 16)) for n in picture.shape)
    out = equalize_clahe(torch.from_numpy(unit)[None, None], clip_limit=2.0, grid_size=grid)
    return out[0, 0].numpy()[: picture.shape[0], : picture.shape[1]]


def principal_components(cube):
    """First three principal components of the spectra: (3, height, width) float64.

    Fitted on some 20000 evenly spaced pixels. A component's sign is arbitrary; here it
    is the one that correlates positively with brightness, so that pictures reproduce.
    Components that the cube has no bands or pixels for are zero.
    """
    from sklearn.decomposition import PCA

    spectra = cube.spectra.astype(np.float64)
    sample = spectra[:: sampling_step(cube.shape, 20000)]
    n = min(3, *sample.shape)
    with np.errstate(invalid="ignore"):  # shares of a variance that is 0; they are not used
        pca = PCA(n_components=n, svd_solver="full").fit(sample)
    scores = pca.transform(spectra).T
    scores *= np.where(pca.components_.sum(axis=1) < 0, -1.0, 1.0)[:, None]
    out = np.zeros((3, len(spectra)))
    out[:n] = scores
    return out.reshape(3, *cube.shape)


def baseline_correlations(cube, truth):
    """{baseline: magnitude of its correlation with the true sky-lit texture, non-sky}.

    A baseline's sign is arbitrary, so its magnitude counts; of three components the best. NaN
    where the truth has no such texture, as in a room.
    """
    raw = panchromatic(cube)
    score = lambda picture: abs(texture_correlation(picture, truth))  # noqa: E731
    return {
        "panchromatic": score(raw),
        "clahe": score(clahe(raw)),
        "principal_components": max(score(c) for c in principal_components(cube)),
    }
