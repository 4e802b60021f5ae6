"""The measurement: a heat cube, and what its own pixels say of it. The map:

heat_cube       HeatCube
netd            how noisy it is
bad_bands       which of its bands are dead or hot
spectral_shift  by how much its wavelengths are off, by the sky's ozone
dead_pixels     which of its pixels hold no measurement, and what they get instead
saturation      which are brighter than it can show
unusual         whether its radiance is like a scene's
hot             which are far hotter than the rest, and how they are solved apart
prepared        a cube ready to be explained, by all of these
"""
