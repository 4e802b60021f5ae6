"""texnet: temperature, emissivity and texture from thermal hyperspectral cubes.

    >>> import texnet
    >>> cube = texnet.read_cube("night.exr")
    >>> cube, note = texnet.import_cube("flight.hdr", unit="microflick")  # of third parties
    >>> answer = texnet.decompose(cube)
    >>> answer.temperature_k, answer.temperature_sigma_k, answer.material, answer.unknown
    >>> picture = texnet.tex_vision(answer)

What to give `decompose`, and what else an answer holds, their docstrings say. The map:

pipeline    the pipeline: HeatCube in, Decomposition out
circumstances  what lights a scene and what is wrong with or before the camera, from the cube
calibration what is wrong with the camera, and how much noise there is, where the scene shows it
gain_or_offset  a gain or an offset of the camera
band_gains  gains of its bands among each other
air_between  how much air lies before it; distances, before each pixel
correction  what a right camera would have shown
glance      which materials the scene holds, and where, from afar
exact       methods local and sgd
model       net+sgd as one module: evidence, network, refinement, texture
network     TeXNet
chunks      what pixels do by themselves, some thousand at a time
budget      the most accurate method that fits a time budget
doubt       when an answer should not be trusted
learned     the model with the shipped weights
weights     weights on disk
band_file   filters on disk, as `texnet bands` designs them
cube_io     heat cubes on disk (.exr, .npz)
cube_import third-party cubes (ENVI, HADAR, TeX-1500, .npy); envi reads ENVI, raw_cube converts
library_io  third-party libraries (HADAR .mat, ECOSTRESS, ENVI, CSV); mat_file reads .mat
environment_file  a measured environment, at a cube's bands; text_table reads it, and CSV libraries
wavelengths  as all these files state them, in um and in ascending order
outputs     what `texnet decompose` writes
vision      the TeX-vision picture
figures     every map with its truth; TeX vision beside today's pictures
baselines   what people look at today: panchromatic, CLAHE, principal components
metrics     the one module of metrics
stretch     the one contrast stretch
progress    a progress bar
loading     packages load undisturbed
cli         the command line (and __main__); what its commands do is in commands and
            decompose_command
"""

import importlib

_HOMES = {
    "Decomposition": "texnet.pipeline", "decompose": "texnet.pipeline",
    "Environment": "physics", "HeatCube": "physics", "InputError": "physics",
    "MaterialLibrary": "physics",
    "import_cube": "texnet.cube_import", "read_cube": "texnet.cube_io",
    "tex_vision": "texnet.vision", "write_cube": "texnet.cube_io",
}  # fmt: skip
__all__ = list(_HOMES)


def __getattr__(name):
    # Lazy, because the pipeline loads sklearn and the command line must start at once.
    if name in _HOMES:
        return getattr(importlib.import_module(_HOMES[name]), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__():
    return [*(name for name in globals() if name.startswith("__")), *__all__]
