"""What is wrong with or before the camera, where the scene itself shows it. The map:

calibration  all of it, and how much noise there is
one_error    a gain or an offset of all bands, or wavelengths that are off
nats         how likely pixels are, by what may be wrong
band_gains   gains of the bands among each other
curve_error  how far the library's curves may be off
air_between  how much air lies before the camera
distances    how much of it before each pixel
correction   what a right camera, with no air before it, would have shown
"""
