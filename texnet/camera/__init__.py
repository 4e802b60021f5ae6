"""Errors of the camera and of the air before it, as far as the scene itself shows them. The map:

calibration  all of them, and how much noise there is
one_error    a gain or an offset of all bands, or wavelength errors
air_between  how much air lies before the camera
air_error    how much it may differ from usual air in absorption
distances    how much of it is before each pixel
band_gains   gains of the bands relative to each other
curve_error  how far the library's curves may be off
misfit       what nothing explains, and how much noise it is taken for
missing_sky  whether a sky that is not in view lights the scene, and of which air
mistaken_sky  whether a little sky in view is metal
given_environment  how far a given environment may be off
correction   correcting a cube for the camera and the air
pixels       the sampled pixels
nats         how likely they are, given what may be wrong
"""
