"""All of TeXModel in one ONNX file: evidence, network, refinement, texture, with the weights. The
scene's setup (`physics.hypotheses`) is an input.

torch.export traces the model once with all sizes symbolic, so one file serves any image, bands,
library and environment. If torch meets a size of 1, or two equal sizes, it may take that for a
rule; so the sizes it sees here are all different and above 1, and it is checked that no two sizes
became one in the file.

The file describes itself: see `about` of `texnet.runtime.Runtime`.
"""

import json
import logging
import warnings
from contextlib import contextmanager
from copy import deepcopy
from importlib.metadata import version

import onnx
import torch
from onnxscript.optimizer import fold_constants, optimize_ir, remove_unused_nodes
from torch import nn

from physics.expected import SKY_NEAR
from physics.hypotheses import COMPARED, INTERNAL, Blocks, Hypotheses
from physics.known import TERMS, Known
from physics.library import MaterialLibrary
from physics.machinery.whole_file import check_writable, whole_file
from texnet.model import TeX, TeXModel
from texnet.runtime import FORMAT

OPSET = 23
SPECTRUM = "W m-2 sr-1 um-1"
# name: sizes, meaning
INPUTS = {
    "nodes_um": (("bands", "nodes"), "um, quadrature nodes of every band"),
    "sigma": (("bands",), f"{SPECTRUM}, sensor noise"),
    "emissivity": (("materials", "bands", "nodes"), "0..1, the library at the nodes"),
    "is_sky": (("materials",), "1 for the sky, else 0"),
    "environment": (("k", "bands"), f"{SPECTRUM}, spectra of the environment objects"),
    "light": (("k", "bands", "nodes"), f"{SPECTRUM}, the same at the nodes"),
    "sky_object": (("k",), "1 for the objects that stand for the sky, else 0"),
    "usual_lighting": (("k",), "V in the mean over the scene, a priori"),
    "spread": (("spreads", "bands"), f"{SPECTRUM}, deviations of the surroundings"),
    "skylight_spread": (("skylight_spreads", "bands"), f"{SPECTRUM}, those of the sky's light"),
    "curve_spread": (("curve_spreads", "bands"), f"{SPECTRUM}, those of curves that are off"),
    "sky_spread": (("sky_spreads", "bands"), f"{SPECTRUM}, those of the sky's own pixels"),
    "sky_mean": (("bands",), f"{SPECTRUM}, mean of the sky's pixels, 0 if none"),
    "prior_k": ((2,), "K, mean and standard deviation of T's prior"),
    "basis": (
        ("components", "bands"),
        "orthogonal directions of noise-scaled spectra, each over the deviation along it",
    ),
    # for every hypothesis: all materials, each filling a pixel; then, if there is sky, all of them
    # sharing the pixel with it (too few are repeated as impossible, with an offset of -1e15)
    "sky_share": (("hypotheses",), "0..1, of the sky in the pixel, of materials pure, then mixed"),
    "alpha_step": (("hypotheses", "bands"), f"{SPECTRUM}, a standard deviation of the sky's share"),
    "centre": (("bands",), "of spectra s in noise units: components are z = basis (s - centre)"),
    "to_w": (("hypotheses", "components", "components + 1"), "w of z and 1: -|w|^2 / 2 nats"),
    "to_x": (("hypotheses", "unknowns", "components + 1"), "likeliest x, V and T, of z and 1"),
    "offset": (("hypotheses",), "nats, the log evidence where w is 0"),
    "to_deviation": (("hypotheses", "deviations", "components"), "likeliest deviations, of z"),
    "deviation_0": (("hypotheses", "deviations"), "likeliest deviations where z is 0"),
    "sensitivity": (("hypotheses", "deviations", "unknowns"), "of likeliest deviations to x"),
    "determinant": (("hypotheses",), "nats, what a prior about a guess of V changes"),
    "pulled": (("hypotheses", "unknowns", "k"), "how a guess of V moves x"),
    "vv": (("hypotheses", "k", "k"), "V's block of a root of the precision of x"),
    "vt": (("hypotheses", "k", TERMS), "T's block of V's rows of that root"),
    "tt": (("hypotheses", TERMS, TERMS), "T's block of that root, V being free"),
    "solve": (("hypotheses", "k", "k"), "the inverse of vv"),
    "covariance": (("hypotheses", "k", "k"), "of V given T"),
    "radiance": (("bands", "height", "width"), SPECTRUM),
    "log_expected": (
        ("materials", "height", "width"),
        "nats by which a material is expected: half a log probability; 0 of all if nothing is; "
        f"where that of the sky is below {SKY_NEAR:g}, no pixel is partly sky",
    ),
    "inner": ((4,), "int64: top, left, rows and columns of the part to be answered, in pixels"),
}
PART = ("rows", "columns")
OUTPUTS = {
    "material_probability": (("materials", *PART), "0..1"),
    "material": (PART, "index into the library"),
    "temperature_k": (PART, "K; of sky: of what stands before it, or the air"),
    "temperature_sigma_k": (PART, "K, one standard deviation"),
    "thermal_lighting": (
        ("k", *PART), "V, sums to 1; of sky 0, or that of what may stand before it",
    ),
    "texture": (("bands", *PART), f"{SPECTRUM}, X; of sky likewise"),
    "sky_texture": (
        PART, f"{SPECTRUM}, band mean of X's sky-lit part; if no object is sky the residual",
    ),
    "residual": (PART, "noise units, root mean square"),
    "log_evidence": (PART, "nats, of all materials together"),
    "unknown": (PART, "true where the answer should not be trusted"),
}  # fmt: skip
EXAMPLE = dict(  # deviations: torch would take the sum of three sizes for one of its own
    bands=17, nodes=3, materials=8, hypotheses=2 * 8, k=4, spreads=6, skylight_spreads=2,
    curve_spreads=7, sky_spreads=10, deviations=6 + 2 + 7 + 10 + 1, components=14, height=12,
    width=13,
)  # fmt: skip
FOLLOWING = {  # computed from those
    "unknowns": lambda n: n["k"] + TERMS,
    "components + 1": lambda n: n["components"] + 1,
}
EXAMPLE |= {size: of(EXAMPLE) for size, of in FOLLOWING.items()}


def export_onnx(network, history, path):
    """Write a TeXNet as an ONNX file.

    history  dict of plain values, as returned by `texnet.files.weights.load_network`

    Takes a few minutes. Raises InputError if path cannot be written.
    """
    check_writable(path)
    with _quiet():
        # for weights that require gradients, Scan would keep what these need
        model = _trace(TeXModel(deepcopy(network).requires_grad_(False)).eval())
    _name_sizes(model)
    _forget_origin(model)
    for key, value in _metadata(network, history).items():
        model.metadata_props.add(key=key, value=value)
    onnx.checker.check_model(model, full_check=True)
    with whole_file(path) as part:
        part.write_bytes(model.SerializeToString(deterministic=True))


@contextmanager
def _quiet():
    """Suppress messages of torch's exporter about itself and packages that are not needed."""
    loggers = [logging.getLogger(n) for n in ("torch.onnx._internal.exporter", "onnx_ir")]
    levels = [logger.level for logger in loggers]
    for logger in loggers:
        logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    finally:
        for logger, level in zip(loggers, levels, strict=True):
            logger.setLevel(level)


class _Agreeing(nn.Module):
    """A TeXModel whose input sizes are declared to agree, which torch.export cannot infer."""

    def __init__(self, model):
        super().__init__()
        self.model = model

    def forward(self, scene, radiance, log_expected, inner):
        n = {}
        for name, a in (scene | dict(radiance=radiance, log_expected=log_expected)).items():
            for size, here in zip(INPUTS[name][0], a.shape, strict=True):
                if size in EXAMPLE:
                    of = FOLLOWING.get(size)
                    torch._check(here == (n.setdefault(size, here) if of is None else of(n)))
        torch._check(n["hypotheses"] >= n["materials"])
        return self.model(scene, radiance, log_expected, inner)


def _trace(model):
    told = {*Known._fields, *Hypotheses._fields, *Blocks._fields} - {*INTERNAL}
    if {*INPUTS} != told | {"radiance", "log_expected", "inner"} or TeX._fields != tuple(OUTPUTS):
        raise RuntimeError("export: INPUTS and OUTPUTS here are not what the model takes and gives")
    scene, *image = _example()
    inner = torch.tensor([2, 3, 5, 8])
    dynamic = {
        name: {i: torch.export.Dim.DYNAMIC for i, size in enumerate(sizes) if size in EXAMPLE}
        for name, (sizes, _) in INPUTS.items()
    }
    program = torch.export.export(
        _Agreeing(model), (scene, *image, inner),
        dynamic_shapes=(
            {name: dynamic[name] for name in scene}, dynamic["radiance"], dynamic["log_expected"],
            None,
        ),
        # nor need it check what torch cannot prove about sizes
        prefer_deferred_runtime_asserts_over_guards=True,
    )  # fmt: skip
    traced = torch.onnx.export(
        program, dynamo=True, opset_version=OPSET, verbose=False, optimize=False,
        input_names=list(INPUTS), output_names=list(OUTPUTS),
    )  # fmt: skip
    _simplify(traced.model)  # otherwise the next step would take twice as long
    optimize_ir(traced.model, num_iterations=1)
    _simplify(traced.model)  # removes another tenth of what is left
    return traced.model_proto


def _simplify(model):
    """Remove what is constant or unused from an onnx_ir.Model."""
    fold_constants(model)
    remove_unused_nodes(model)


def _example():
    """scene, radiance and log_expected of the EXAMPLE sizes; only their sizes matter."""
    r = torch.Generator().manual_seed(0)
    x = {
        name: torch.rand([EXAMPLE.get(size, size) for size in sizes], generator=r)
        for name, (sizes, _) in INPUTS.items()
        if name != "inner"
    }
    x["nodes_um"] += 10.0
    x["prior_k"] += 300.0
    image = [x.pop(name) for name in ("radiance", "log_expected")]
    return x, *image


def _name_sizes(model):
    """Name the sizes, after checking that torch kept them apart."""
    symbol_of = {}
    for value, (sizes, _) in zip(
        [*model.graph.input, *model.graph.output],
        [*INPUTS.values(), *OUTPUTS.values()],
        strict=True,
    ):
        for axis, size in zip(value.type.tensor_type.shape.dim, sizes, strict=True):
            if size in EXAMPLE or size in PART:
                if symbol_of.setdefault(size, axis.dim_param) != axis.dim_param:
                    raise AssertionError(f"{value.name}: {size} is {axis}")
                axis.dim_param = size
    if "" in symbol_of.values() or len(set(symbol_of.values())) < len(symbol_of):
        raise AssertionError(f"torch did not keep all sizes apart: {symbol_of}")


def _forget_origin(model):
    """Drop traces of this machine's source files, which only the exporter's authors need."""
    del model.metadata_props[:]
    for graph in _graphs(model.graph):
        del graph.value_info[:]
        del graph.metadata_props[:]
        for node in graph.node:
            node.doc_string = ""
            del node.metadata_props[:]
        for value in [*graph.input, *graph.output, *graph.initializer]:
            value.doc_string = ""
            del value.metadata_props[:]


def _graphs(graph):
    """A graph and those within its nodes."""
    yield graph
    for node in graph.node:
        for attribute in node.attribute:
            if attribute.HasField("g"):
                yield from _graphs(attribute.g)


def _metadata(network, history):
    library = MaterialLibrary.starter()
    curves = {
        "wavelength_um": library.wavelength_um.round(4).tolist(),
        "materials": [
            {"name": n, "emissivity": e.round(4).tolist(), "hue_deg": float(hue)}
            for n, e, hue in zip(library.names, library.emissivity, library.hue_deg, strict=True)
        ],
    }
    limits = {"least": {"materials": -(-COMPARED // 2)}}
    meaning = {n: {"sizes": s, "meaning": m} for n, (s, m) in {**INPUTS, **OUTPUTS}.items()}
    return {
        "format": FORMAT,
        "texnet_version": version("texnet"),
        "history": json.dumps(history),
        "meaning": json.dumps(meaning),
        "library": json.dumps(curves, ensure_ascii=False),
        "halo_px": str(network.halo),
        "cell_px": str(network.config["stride"]),
        "limits": json.dumps(limits),
    }
