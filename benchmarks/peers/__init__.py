"""What a user of thermal spectra would take instead of texnet. The map:

band_planck  Planck's law as box bands see it, and its inverse
brightness   brightness temperature with an assumed emissivity
nem          the normalised emissivity method
isstes       iterative spectrally smooth temperature-emissivity separation
naming       from an emissivity spectrum to a material and to X
surroundings  what they are told of X
scipy_fit    Eq. 6 per pixel and material by scipy's bounded least squares

The first three methods separate temperature from emissivity. Each has

    separate(spectra, law, sky) -> T (pixels,) K, e (pixels, bands)

of spectra (pixels, bands), W m-2 sr-1 um-1, a BandPlanck of these bands, and the downwelling
radiance sky (bands,) of which all X is assumed to be.
"""
