"""What a user of thermal spectra would take instead of texnet. The map:

band_planck  Planck's law averaged over box bands, and its inverse
brightness   brightness temperature with an assumed emissivity
nem          the normalised emissivity method
isstes       iterative spectrally smooth temperature-emissivity separation
naming       from an emissivity spectrum to a material and to X
surroundings  the X that they are given
scipy_fit    Eq. 6 per pixel and material by scipy's bounded least squares

brightness, nem and isstes separate temperature from emissivity. Each has

    separate(spectra, law, sky) -> T (pixels,) K, e (pixels, bands)

for spectra (pixels, bands), W m-2 sr-1 um-1, a BandPlanck of these bands, and the downwelling
radiance sky (bands,), which is assumed to be all of X.
"""
