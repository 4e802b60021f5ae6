"""Physics of thermal images. The map:

errors       InputError: one sentence for bad input
whole_file   a file is written whole or not at all
array_file   named arrays in one file
provenance   what made a result that is kept on disk
scratch      large arrays in files without a name
planck       Eq. 3 and its inverse
eq1          Eq. 1: the differentiable renderer and the physics loss
contrast     Eq. 7: what the contrast of a thermal image is made of
heat_cube    HeatCube
netd         how noisy it is, by its own pixels
bad_bands    which of its bands are dead or hot
spectral_shift  by how much its wavelengths are off, by the sky's ozone
dead_pixels  which of its pixels hold no measurement, and what they get instead
saturation   which of its pixels are brighter than it can show
hot          which are far hotter than the rest, and how they are solved apart
prepared     a cube ready to be explained, by all of these
library      MaterialLibrary (starter: how the shipped one is built from optical constants)
sky          the spectrum of a clear sky
air          the air between scene and camera
overhead     the sky overhead, from the sky in view
environment  Environment: the k objects that light a scene
estimate     the environment from the cube's own pixels
support      how many of them a scene supports
bands        bands of finite width
blas         BLAS's own threads, where they would be in the way
prior        what is known of temperatures before any pixel is solved
reduced      the forward model in r dimensions, and the evidence
faces        Eq. 6 where it is known which V are zero, for many pixels at once
simplex      Eq. 6 for one pixel and hypothesis
local        Eq. 6 exactly, pixel by pixel
blind        a library from the cube alone
semiglobal   Eq. 6 with smoothness of T and m
identifiability  Fisher information and the Cramer-Rao bound
filters      which bands tell materials and temperatures best
known        what the network is told of a scene
expected     which materials are expected where, from afar, and which are looked for
evidence     every material's evidence at once, by Gaussian priors
refinement   Gauss-Newton steps on Eq. 6 for the likeliest hypotheses
threads      many items, some at a time
tiles        pictures of any size in tiles
by_tiles     a model's answer to a picture, tile by tile
distill      the texture that the sky alone lights
truth        Truth: what is so in every pixel of a simulated cube
simulator    path-traced cubes with it
"""

from .environment import Environment
from .errors import InputError
from .heat_cube import HeatCube
from .library import MaterialLibrary

__all__ = ["Environment", "HeatCube", "InputError", "MaterialLibrary"]
