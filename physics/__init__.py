"""Physics of thermal images. The map:

eq1          Eq. 1: the differentiable renderer and the physics loss
planck       Eq. 3 and its inverse
contrast     Eq. 7: what the contrast of a thermal image is made of
bands        bands of finite width
cube         a package: HeatCube, and what its own pixels say of it
library      MaterialLibrary (starter: how the shipped one is built from optical constants)
sky          the spectrum of the sky
air          the air between scene and camera
overhead     the sky overhead, from the sky in view
environment  Environment: the k objects that light a scene
sky_in_view  which pixels of a cube are sky
estimate     the environment from the cube's own pixels
lighting     how much of the light is the sky's
support      how many of them a scene supports
prior        what is known of temperatures, lighting and mixed pixels before any is solved
exact        a package: Eq. 6 solved exactly, and with smoothness
known        what the network is told of a scene
expected     which materials are expected where, from afar, and which are looked for
hypotheses   every material, pure or partly sky, by Gaussian priors: what no pixel changes
evidence     of every one for every pixel at once
refinement   Gauss-Newton steps on Eq. 1 for the likeliest hypotheses
blind        a library from the cube alone
identifiability  Fisher information and the Cramer-Rao bound
filters      which bands tell materials and temperatures best
truth        Truth: what is so in every pixel of a simulated cube
simulator    a package: path-traced cubes with it
errors       InputError: one sentence for bad input
machinery    a package: how large things are held and worked on
"""

from .cube.heat_cube import HeatCube
from .environment import Environment
from .errors import InputError
from .library import MaterialLibrary

__all__ = ["Environment", "HeatCube", "InputError", "MaterialLibrary"]
