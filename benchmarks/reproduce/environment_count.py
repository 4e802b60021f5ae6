"""The paper's Fig. "env": the errors of TeX against the number k of environment objects, 54 bands.

The bounds separate the cost of the environment (the best V leaves so much of X) from what the
inversion adds. For every k the estimate is passed to `decompose` as a given environment, since
`decompose` itself estimates ten objects at most; so it looks for no errors of the camera.
"""

from .curves import publish, sweep

BANDS, COUNTS = 54, (1, 2, 3, 4, 5, 6, 8, 10, 12)


def reproduce(out, full, progress):
    rows = sweep([(BANDS, k) for k in COUNTS], full, progress)
    return publish(rows, "k", "number k of environment objects", out, "environment-count")
