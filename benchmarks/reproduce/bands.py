"""The paper's Fig. "res": the errors of TeX against the number of bands.

100 narrow bands are rendered over 8-14 um; equidistant subsets of them, all with the sensor's noise
(50 mK in every band, however few), are decomposed with k = 5 objects.
"""

from .curves import publish, sweep

BANDS, K = (2, 3, 4, 6, 9, 14, 20, 33, 54, 100), 5


def reproduce(out, full, progress):
    rows = sweep([(bands, K) for bands in BANDS], full, progress)
    return publish(rows, "bands", "number of bands", out, "bands")
