"""texnet: temperature, emissivity and texture from thermal hyperspectral cubes.

    >>> import texnet
    >>> cube = texnet.read_cube("night.exr")
    >>> cube, note = texnet.import_cube("flight.hdr", unit="microflick")  # of third parties
    >>> answer = texnet.decompose(cube)
    >>> answer.temperature_k, answer.temperature_sigma_k, answer.material, answer.unknown
    >>> print(texnet.summary(answer, cube))  # what `texnet decompose` prints
    >>> picture = texnet.tex_vision(answer)
    >>> texnet.write_decomposition(answer, "answer")  # what `texnet decompose` writes
    >>> answer = texnet.read_decomposition("answer")

What to give `decompose`, and what else an answer holds, their docstrings say. The map:

pipeline    the pipeline: HeatCube in, Decomposition out
decomposition  the Decomposition
circumstances  what lights a scene and what is wrong with or before the camera, from the cube
camera      a package: what is wrong with or before the camera
glance      which materials the scene holds, and where, from afar
methods     the four methods
solver      local and sgd
model       net and net+sgd as one module: evidence, network, refinement, texture
network     TeXNet
texture     the light on a pixel that is solved, and what is left of its spectrum
chunks      what pixels do by themselves, some thousand at a time
budget      the most accurate method that fits a time budget
uncertainty  what adds to sigma, and when an answer should not be trusted
by_tiles    a picture by the model, tile by tile
runtime     the model in ONNX Runtime
learned     the same in torch, with the shipped weights or others
files       a package: cubes, libraries, environments, filters and weights on disk
outputs     what `texnet decompose` writes
vision      the TeX-vision picture
report      what is said of an answer
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
