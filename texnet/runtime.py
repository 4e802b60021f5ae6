"""Answers from a texnet ONNX file with numpy and onnxruntime alone, in bounded memory.

A pixel needs some 2 kB of working memory (`physics.known`), so an image is answered tile by tile,
several at once, with one thread each, which wastes less than many threads on one tile.
"""

import json
from importlib.resources import as_file, files
from threading import BoundedSemaphore

import numpy as np
import onnxruntime

from physics.errors import InputError
from physics.known import Known
from physics.machinery.threads import usual_threads
from physics.machinery.tiles import MOST_AT_ONCE, TILE_BYTES

from .by_tiles import by_tiles
from .methods import ONNX

AS_JSON = "history", "meaning", "library", "halo_px", "cell_px", "limits"
FORMAT = "9"  # of the file; changes whenever the same weights answer differently, or more
BROKEN = "it is not an ONNX file that texnet wrote"


class Runtime:
    """A texnet ONNX file, ready to answer.

    path     as written by `texnet export`; each tile keeps the memory it used, half of TILE_BYTES
    threads  tiles at once, whatever the number of calling threads; if None, the number of cores, or
             OMP_NUM_THREADS, and at most MOST_AT_ONCE

    at_once is that number of tiles. about is the file's metadata, with JSON parsed: format,
    texnet_version, history (the origin of the weights), meaning (of inputs and outputs), library
    (the starter library, as a library file), halo_px (how far around it a pixel's answer depends on
    the image), cell_px (tiles begin at multiples of it), limits (least sizes).

    Raises InputError if path cannot be read or is not a texnet ONNX file of this FORMAT.
    """

    def __init__(self, path, threads=None):
        onnxruntime.disable_telemetry_events()
        options = onnxruntime.SessionOptions()
        self.at_once = threads or min(usual_threads(), MOST_AT_ONCE)
        self._slots = BoundedSemaphore(self.at_once)
        options.intra_op_num_threads = 1
        options.log_severity_level = 3  # errors, which are raised too
        # export leaves nothing to simplify, and looking for it would take most of a second
        options.graph_optimization_level = onnxruntime.GraphOptimizationLevel.ORT_DISABLE_ALL
        options.enable_mem_pattern = False  # a third more memory, as tiles differ in size
        try:
            with open(path, "rb") as file:
                content = file.read()
        except OSError as e:
            raise InputError(f"model: cannot read {path}: {e.strerror}.") from e
        try:
            self._session = onnxruntime.InferenceSession(
                content, options, providers=["CPUExecutionProvider"]
            )
        except Exception as e:  # onnxruntime's exceptions have no other common base
            raise InputError(f"model: cannot read {path}: {BROKEN}.") from e
        about = self._session.get_modelmeta().custom_metadata_map
        try:
            self.about = about | {name: json.loads(about[name]) for name in AS_JSON}
        except (KeyError, ValueError) as e:
            raise InputError(f"model: cannot read {path}: {BROKEN}.") from e
        if self.about.get("format") != FORMAT:
            raise InputError(f"model: {path} is of another version of texnet; export it again.")

    def run(self, radiance, known, progress=None, expected=None, regions=None):
        """Answer a cube -> dict of maps (..., height, width) by name; see about["meaning"].

        radiance  (bands, height, width) W m-2 sr-1 um-1
        known     dict of arrays as `physics.known.known_arrays` makes it
        progress  called as progress(done, total) after each tile
        expected  physics.expected.Expected of the materials, or None
        regions   physics.expected.Regions of the picture, or None: all materials everywhere

        material is int16, unknown bool, the others float32. Raises InputError if sizes do not agree
        or are too small, and as `physics.hypotheses.set_up` does.
        """
        given = {name: np.ascontiguousarray(a, np.float32) for name, a in known.items()}
        given["radiance"] = np.asarray(radiance, np.float32)  # in any order: avoids a full copy
        self._check(given)
        return by_tiles(
            self._answer, given.pop("radiance"), given, expected, regions,
            halo=self.about["halo_px"], cell=self.about["cell_px"], tile_bytes=TILE_BYTES / 2,
            at_once=self.at_once, progress=progress,
        )  # fmt: skip

    def _answer(self, scene, tile, log_expected, inner):
        of_tile = {"radiance": tile, "log_expected": log_expected, "inner": inner}
        with self._slots:
            maps = self._session.run(None, scene | of_tile)
        return {o.name: a for o, a in zip(self._session.get_outputs(), maps, strict=True)}

    def _check(self, given):
        """Raise InputError unless these are radiance and Known's fields, and agree."""
        names = {"radiance", *Known._fields}
        if given.keys() != names:
            wrong = ", ".join(sorted(given.keys() ^ names))
            raise InputError(f"model: its inputs are radiance and Known's fields; see {wrong}.")
        axes_of = {i.name: i.shape for i in self._session.get_inputs() if i.name in names}
        sizes = {}
        for name, axes in (axes_of | dict.fromkeys(("error", "quiet"), axes_of["sigma"])).items():
            shape = given[name].shape
            for size, n in zip(axes, shape, strict=False):
                if isinstance(size, str):
                    sizes.setdefault(size, n)
            wanted = tuple(sizes.get(size, size) for size in axes)
            if shape != wanted:
                named = ", ".join(map(str, axes))
                raise InputError(f"model: {name} must be ({named}) = {wanted}, got {shape}.")
        for size, least in self.about["limits"]["least"].items():
            if sizes[size] < least:
                raise InputError(f"model: {size} must be at least {least}, got {sizes[size]}.")
        if 0 in (sizes[s] for s in ("bands", "components", "nodes", "k", "height", "width")):
            raise InputError("model: an image, its bands and its environment must not be empty.")


def shipped_runtime():
    """A Runtime of the network that comes with the package."""
    with as_file(files("texnet") / "data" / ONNX) as path:
        return Runtime(path)
