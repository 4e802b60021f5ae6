"""texnet: temperature, emissivity and texture from thermal hyperspectral cubes.

    >>> import texnet
    >>> cube = texnet.read_cube("night.exr")
    >>> cube, note = texnet.import_cube("flight.hdr", unit="microflick")  # third-party format
    >>> answer = texnet.decompose(cube)
    >>> answer.temperature_k, answer.temperature_sigma_k, answer.material, answer.unknown
    >>> print(texnet.summary(answer, cube))  # what `texnet decompose` prints
    >>> picture = texnet.tex_vision(answer)
    >>> texnet.write_decomposition(answer, "answer")  # what `texnet decompose` writes
    >>> answer = texnet.read_decomposition("answer")

The docstrings of `decompose` and `Decomposition` describe all arguments and results. The map:

pipeline    the pipeline: HeatCube in, Decomposition out
decomposition  the Decomposition
circumstances  the environment, and errors of the camera and the air before it, from the cube
camera      a package: errors of the camera, and the air before it
glance      a coarse first look at which materials the scene holds, and where
methods     the four methods
solver      local and sgd
model       net and net+sgd as one module: evidence, network, refinement, texture
network     TeXNet
texture     the light on a solved pixel, and what stays unexplained of its spectrum
chunks      independent per-pixel work, some thousand pixels at a time
budget      the most accurate method that fits a time budget
uncertainty  further contributions to sigma, and when an answer should not be trusted
by_tiles    the model applied to an image, tile by tile
runtime     the model in ONNX Runtime
learned     the model in torch, with the shipped or other weights
files       a package: cubes, libraries, environments, filters and weights on disk
outputs     what `texnet decompose` writes
vision      the TeX-vision picture
report      an answer in words
figures     every map beside its truth; TeX vision beside today's displays
baselines   today's displays: panchromatic, CLAHE, principal components
metrics     the one module of metrics
stretch     the one contrast stretch
progress    a progress bar
loading     package imports that signals do not interrupt
cli         the command line (and __main__); its commands are implemented in commands and
            decompose_command
"""

import importlib

_HOMES = {
    "Decomposition": "texnet.decomposition", "decompose": "texnet.pipeline",
    "Environment": "physics", "HeatCube": "physics", "InputError": "physics",
    "MaterialLibrary": "physics",
    "import_cube": "texnet.files.cube_import", "read_cube": "texnet.files.cube_io",
    "read_decomposition": "texnet.files.answer_file",
    "summary": "texnet.report", "tex_vision": "texnet.vision", "write_cube": "texnet.files.cube_io",
    "write_decomposition": "texnet.outputs",
}  # fmt: skip
__all__ = list(_HOMES)


def __getattr__(name):
    # Lazy, because the pipeline loads sklearn and the command line must start at once.
    if name in _HOMES:
        return getattr(importlib.import_module(_HOMES[name]), name)
    if name == "__version__":
        return importlib.import_module("importlib.metadata").version(__name__)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__():
    return [*(name for name in globals() if name.startswith("__")), *__all__]
