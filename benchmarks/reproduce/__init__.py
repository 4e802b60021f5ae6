"""The paper's results on our own path-traced scenes: one file per figure.

    texnet reproduce FIGURE --out DIR [--full]

Every module has reproduce(out, full, progress) -> (text, result): it writes FIGURE.csv and
FIGURE.png into the folder out and returns the text to print and the object for --json. full uses
the published size instead of one that two cores finish in minutes; progress(done, total, what) or
None is called during the work. The map:

ghosting             why a thermal image has no texture
sgd_flow             how TeX-SGD decides what a pixel is
distill              the texture that the sky alone lights
tex_vision           TeX vision beside its truth
temperature          geometry or temperature, and the contributions to contrast
bands                errors against the number of bands
bayer                four bands, and a mosaic of four filters (mosaic)
environment_method   how the environment is found
environment_count    errors against the number of its objects
common, pictures     scenes and panels; TeX vision with its errors below
curves, errors       errors as curves; the paper's three errors and their bounds
"""

from importlib import import_module


def reproduce(figure, out, full=False, progress=None):
    """Make one figure in the folder out; returns text and a dict of plain values."""
    module = import_module(f"{__name__}.{figure.replace('-', '_')}")
    out.mkdir(parents=True, exist_ok=True)
    return module.reproduce(out, full, progress)
