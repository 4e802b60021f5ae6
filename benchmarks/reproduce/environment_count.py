"""The paper's Fig. "env": the errors of TeX against the number k of environment objects, 54 bands.

The bounds tell apart what the environment costs (the best V leaves so much of X) from what the
inversion adds. Of every k the estimate is handed to `decompose` as an environment that is given,
since it makes ten objects at most by itself; so it does not look for errors of the camera.
"""

from .curves import publish, sweep

BANDS, COUNTS = 54, (1, 2, 3, 4, 5, 6, 8, 10, 12)


def reproduce(out, full, progress):
    rows = sweep([(BANDS, k) for k in COUNTS], full, progress)
    return publish(rows, "k", "number k of environment objects", out, "environment-count")
