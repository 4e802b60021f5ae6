"""The paper's results on our own path-traced scenes: a figure a file.

    texnet reproduce FIGURE --out DIR [--full]

Every module has reproduce(out, full, progress) -> (text, result): it writes FIGURE.csv and
FIGURE.png into the folder out and returns what to say and what --json gives. full takes the
published size instead of one that two cores finish in minutes; progress(done, total, what) or
None is told how far it is.
"""

from importlib import import_module


def reproduce(figure, out, full=False, progress=None):
    """Make one figure in the folder out; returns text and a dict of plain values."""
    module = import_module(f"{__name__}.{figure.replace('-', '_')}")
    out.mkdir(parents=True, exist_ok=True)
    return module.reproduce(out, full, progress)
