"""Whether radiance is plausible for a scene; if not, its unit or the order of its numbers is
probably wrong."""

import numpy as np

from ..planck import brightness_temperature
from .dead_pixels import lit

USUAL_K = (220.0, 400.0)  # of half of a scene: by night or day, out of doors or in
UNEVEN_K = 2.5  # or less is their deviation in the EVENEST of the pixels of a scene
EVENEST = 0.1


def uneven_k(wavelength_um, spectra):
    """K by which bands differ in brightness temperature even in the pixels where they differ least;
    0 if that is as usual. spectra (bands, n) W m-2 sr-1 um-1, of which those without light in some
    band do not count."""
    s = spectra[:, lit(spectra).all(axis=0)]
    if not s.size:
        return 0.0
    apart = brightness_temperature(wavelength_um[:, None], s).std(axis=0)
    differ = float(np.quantile(apart, EVENEST))
    return differ if differ > UNEVEN_K else 0.0
