"""What is wrong with or before the camera, where the scene itself shows it. The map:

calibration  all of it, and how much noise there is
one_error    a gain or an offset of all bands, or wavelengths that are off
air_between  how much air lies before the camera
air_error    how far that may absorb otherwise than usual air
distances    how much of it before each pixel
band_gains   gains of the bands among each other
curve_error  how far the library's curves may be off
misfit       what nothing explains, and how much noise that is called
missing_sky  whether a sky that is not in view lights the scene, and of which air
mistaken_sky  whether a little sky in view is metal
given_environment  how far an environment that was given may be off
correction   what a right camera, with no air before it, would have shown
pixels       those that are asked
nats         how likely they are, by what may be wrong
"""
