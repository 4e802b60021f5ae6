"""When an answer should not be trusted, and what is said where only sky is seen."""

CHI2_SIGMAS = 6.0  # beyond which nothing in the library fits
OWN_PROBABILITY = 0.2  # of the answer from the pixel's own evidence, below which it is unknown
# off T is beyond what the library's other materials say, where the material is another: found on
# 24 random scenes of no split in 4, 9, 18 and 54 bands
OTHER_K = 1.3
AIR_SIGMA_K = 5.0  # of the air's temperature from the sky's brightness
RIM_NATS = 10.0  # evidence for pure sky below which something may stand before it
