"""The one module of metrics: how far a decomposition is from the simulator's truth.

Materials are matched by name, so the order of a library never matters. "Non-sky" is what
the truth calls non-sky: there alone temperature and texture have a meaning. Pixels that were not
measured (`dead`) count nowhere.
"""

import numpy as np

from physics.errors import InputError
from physics.library import SKY

from .stretch import stretch

PROBABILITY_FLOOR = 1e-6  # one confident error costs 13.8 nats, not infinity
SSIM_WINDOW = 11


def evaluate(decomposition, truth):
    """Every metric of a Decomposition against a Truth of the same scene, as floats.

    temperature_rmse_k, temperature_mae_k   K, non-sky
    material_accuracy       fraction of measured pixels; see `names_lacking`
    mean_iou                intersection over union, averaged over the materials in the truth
    cross_entropy           mean -ln p(true material), measured pixels, p floored at 1e-6; a
                            material that the library lacks has p = 0
    texture_mse_per_band    (W m-2 sr-1 um-1)^2, non-sky, squared error over all bands
                            divided by their number
    texture_correlation, texture_gradient_correlation, texture_ssim
                            the sky-lit texture, see texture_scores
    within_1_sigma, within_2_sigma
                            fraction of non-sky |T error| within its own 1 and 2 sigma;
                            0.683 and 0.954 if calibrated
    abstention              fraction of measured pixels marked unknown
    accuracy_answered       material accuracy of the others

    Bands that the decomposition left out do not count. NaN where there is nothing to compare.
    Raises InputError if sizes or bands differ.
    """
    d, texture = decomposition, texture_at(truth, decomposition.wavelength_um)
    if d.texture.shape != texture.shape:
        raise InputError(
            f"metrics: (bands, height, width) is {d.texture.shape} in the decomposition, but its "
            f"truth has {texture.shape} at these bands."
        )
    seen = ~d.dead
    ground = non_sky(truth) & seen
    predicted, true = _matched(d, truth)
    error = (d.temperature_k - truth.temperature_k)[ground].astype(np.float64)
    sigma = d.temperature_sigma_k[ground]
    right = (predicted == true)[seen]
    scores = texture_scores(d.sky_texture, truth, seen)
    return {
        "temperature_rmse_k": float(np.sqrt(_mean(error**2))),
        "temperature_mae_k": _mean(np.abs(error)),
        "material_accuracy": _mean(right),
        "mean_iou": _mean(
            [_iou((predicted == m)[seen], (true == m)[seen]) for m in np.unique(true[seen])]
        ),
        "cross_entropy": _mean(-np.log(_true_probability(d, true))[seen]),
        "texture_mse_per_band": _mean(
            (d.texture[:, ground].astype(np.float64) - texture[:, ground]) ** 2
        ),
        "texture_correlation": scores["correlation"],
        "texture_gradient_correlation": scores["gradient_correlation"],
        "texture_ssim": scores["ssim"],
        "within_1_sigma": _mean(np.abs(error) <= sigma),
        "within_2_sigma": _mean(np.abs(error) <= 2 * sigma),
        "abstention": _mean(d.unknown[seen]),
        "accuracy_answered": _mean(right[~d.unknown[seen]]),
    }


def texture_at(truth, wavelength_um):
    """X (bands, height, width) of a Truth at those of its bands that are among wavelength_um."""
    at = np.isclose(truth.wavelength_um[:, None], wavelength_um, rtol=0, atol=1e-3).any(axis=1)
    return truth.texture if at.all() else truth.texture[at]


def texture_scores(picture, truth, seen=True):
    """How much of the true sky-lit texture a (height, width) picture shows, non-sky, of pixels
    that were seen (height, width).

    correlation           Pearson, blind to brightness and contrast
    gradient_correlation  Pearson of the differences between neighbours, down and across,
                          where both are non-sky: edges instead of areas
    ssim                  structural similarity (Wang et al. 2004), both pictures stretched
                          to 0..1; NaN below 11 x 11 pixels, the size of its window

    All NaN where the truth has no such texture, as in a room.
    """
    r, ground = texture_correlation(picture, truth, seen), non_sky(truth) & seen
    if np.isnan(r):
        return dict.fromkeys(("correlation", "gradient_correlation", "ssim"), r)
    picture, texture = (np.asarray(a, dtype=np.float64) for a in (picture, truth.sky_texture))
    return {
        "correlation": r,
        "gradient_correlation": correlation(
            _differences(picture),
            _differences(texture),
            np.concatenate(
                [(ground[1:] & ground[:-1]).ravel(), (ground[:, 1:] & ground[:, :-1]).ravel()]
            ),
        ),
        "ssim": _ssim(picture, texture, ground),
    }


def texture_correlation(picture, truth, seen=True):
    """The correlation of texture_scores alone."""
    ground = non_sky(truth) & seen
    if not ground.any() or np.ptp(truth.sky_texture[ground]) == 0:
        return float("nan")
    return correlation(picture, truth.sky_texture, ground)


def correlation(a, b, mask):
    """Pearson correlation of two arrays over mask; 0 if either is constant there."""
    a, b = (np.asarray(x, dtype=np.float64)[mask] for x in (a, b))
    if a.size == 0 or np.ptp(a) == 0 or np.ptp(b) == 0:
        return 0.0
    a, b = a - a.mean(), b - b.mean()
    return float((a @ b) / np.sqrt((a @ a) * (b @ b)))


def non_sky(answer):
    """(height, width) bool: pixels whose material, in a Truth or Decomposition, is not sky."""
    return np.asarray(answer.material_names)[answer.material] != SKY


def names_lacking(decomposition, truth):
    """(names, all): the truth's materials in view, but the sky, that the library does not have,
    most pixels first; and whether these are all of them, so that materials cannot be compared."""
    seen = ~decomposition.dead
    there = [name for name in names_in_view(truth, seen=seen) if name != SKY]
    lacking = [name for name in there if name not in decomposition.material_names]
    return lacking, bool(lacking) and len(lacking) == len(there)


def names_in_view(answer, least=0.0, seen=True):
    """Names of a Truth's or Decomposition's materials, most pixels first, of those with more
    than a fraction `least` of the pixels; seen (height, width) bool are those that count."""
    names = answer.material_names
    material = answer.material[np.broadcast_to(seen, answer.material.shape)]
    share = np.bincount(material, minlength=len(names)) / max(1, material.size)
    return [names[i] for i in np.argsort(-share, kind="stable") if share[i] > least]


def _mean(values):
    values = np.asarray(values, dtype=np.float64)
    return float(values.mean()) if values.size else float("nan")


def _matched(decomposition, truth):
    """Both material maps as indices into one list of names: the library's, then the rest."""
    names = list(decomposition.material_names)
    names += [n for n in truth.material_names if n not in names]
    to_common = np.array([names.index(n) for n in truth.material_names])
    return np.asarray(decomposition.material), to_common[truth.material]


def _true_probability(decomposition, true):
    p = decomposition.material_probability
    known = true < len(p)
    p_true = np.take_along_axis(p, np.where(known, true, 0)[None], axis=0)[0]
    return np.maximum(np.where(known, p_true, 0.0), PROBABILITY_FLOOR)


def _iou(a, b):
    return np.count_nonzero(a & b) / np.count_nonzero(a | b)


def _differences(picture):
    return np.concatenate([np.diff(picture, axis=0).ravel(), np.diff(picture, axis=1).ravel()])


def _ssim(picture, texture, ground):
    if min(ground.shape) < SSIM_WINDOW or not ground.any():
        return float("nan")
    import torch  # which takes a second to load
    from kornia.metrics import ssim

    # The sky counts as black in both, so it neither helps nor hurts except at its edge.
    a, b = (
        torch.from_numpy(np.where(ground, stretch(x, ground), 0.0))[None, None]
        for x in (picture, texture)
    )
    return _mean(ssim(a, b, SSIM_WINDOW)[0, 0].numpy()[ground])
