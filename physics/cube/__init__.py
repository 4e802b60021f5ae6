"""The measurement: a heat cube, and what its own pixels tell about it. The map:

heat_cube       HeatCube
netd            how noisy it is
bad_bands       which of its bands are dead or hot
spectral_shift  by how much its wavelengths are off, by the sky's ozone
dead_pixels     which of its pixels hold no measurement, and what they get instead
saturation      which are brighter than the camera can show
unusual         whether its radiance is plausible for a scene
hot             which are far hotter than the rest, and how they are solved separately
prepared        a cube ready to be decomposed, after all of these
"""
