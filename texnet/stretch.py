"""The one contrast stretch: a picture mapped to 0..1 between two of its percentiles."""

import numpy as np

ROUNDING = 1e-6  # of float32; below it there is no contrast


def stretch(picture, mask=None, low=1.0, high=99.0):
    """Map (..., height, width) linearly so that its low and high percentiles become 0 and 1.

    mask  (height, width) bool: the pixels that set the percentiles; None: all

    Values beyond are clipped. If both percentiles are equal, the least and the largest value take
    their place; a constant picture has no contrast to show and becomes 0.5.
    Returns float64 of the same shape.
    """
    picture = np.asarray(picture, dtype=np.float64)
    seen = picture if mask is None else picture[..., mask]
    seen = seen[np.isfinite(seen)]
    a, b = np.percentile(seen, [low, high]) if seen.size else (0.0, 0.0)
    if not b > a and seen.size:
        a, b = seen.min(), seen.max()
    if not b - a > ROUNDING * max(abs(a), abs(b)):
        return np.full(picture.shape, 0.5)
    return np.clip((np.nan_to_num(picture, nan=a) - a) / (b - a), 0.0, 1.0)
