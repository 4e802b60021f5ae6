"""When an answer should not be trusted, and what is said where only sky is seen.

Found on 24 random scenes of no split, in 4, 9, 18 and 54 bands, whole libraries and libraries that
lack one of the scene's three commonest materials, so that of such a material's pixels 90 % are
unknown or have a sigma that covers the error, and few others are unknown.
"""

CHI2_SIGMAS = 4.0  # beyond which nothing in the library fits
# of the answer, below which it is unknown. The network's own probabilities are too low rather than
# too high: where they are 0.3 to 0.5, five of six answers are right
LIKELY, NET_LIKELY = 0.5, 0.3
OWN_PROBABILITY = 0.05  # of the answer from the pixel's own evidence, below which it is unknown
# What a model leaves out, it leaves out in many bands at once, and in neighbours alike: in local
# and sgd log evidence of n bands counts only this times n^-1/2, so that answers are right about
# as often as their probability says
LOCAL_TRUST, SGD_TRUST = 2.0, 1.2
# off T is beyond what the library's other materials say, where the material is another
OTHER_K = 1.3
AIR_SIGMA_K = 5.0  # of the air's temperature from the sky's brightness
RIM_NATS = 10.0  # evidence for pure sky below which something may stand before it
