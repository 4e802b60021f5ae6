"""The command line. Every command prints plain words, or with --json one object last.

Wrong input is one sentence on stderr, `texnet: error: ...`, and exit code 2. What a command
needs is imported inside it, so that `texnet --help` starts at once.
"""

import argparse
import json
import math
import os
import re
import signal
import sys
from contextlib import contextmanager
from functools import cache
from importlib.resources import as_file, files
from pathlib import Path

import numpy as np

from physics.errors import InputError
from physics.heat_cube import MAX_NETD_K

FIGURES = (  # modules of benchmarks.reproduce, which are slow to import
    "ghosting", "sgd-flow", "distill", "tex-vision", "temperature", "bands", "bayer",
    "environment-method", "environment-count",
)  # fmt: skip
DEMO_CUBE = "forest.exr"  # in texnet/data, its truth beside it
SHIPPED = "texnet.onnx"  # there too
MODEL = "texnet.safetensors"  # in texnet/data


def main(argv=None):
    """Run one command; returns the exit code: 0, 2 for wrong input, 130 for Ctrl-C."""
    try:
        args = _parser().parse_args(argv)
        text, result = args.run(args)
        print(text)
        if args.json:
            print(json.dumps(_plain(result), allow_nan=False))
    except BrokenPipeError:  # the reader, such as head, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    except (InputError, OSError) as e:  # OSError: a full disk, a read-only folder
        print(f"texnet: error: {' '.join(str(e).split())}", file=sys.stderr)
        return 2
    except MemoryError:
        print("texnet: error: not enough memory; take fewer pixels or bands.", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    return 0


# --- the commands: each returns what to say and what --json gives ------------------------


def demo(args):
    with as_file(files("texnet") / "data") as folder:
        text, result = _decompose(folder / DEMO_CUBE, args.out)
    return text, result | {"command": "demo"}


def decompose(args):
    if args.budget is not None and (args.method or args.model):
        raise InputError("--budget chooses the method; leave out --method and --model.")
    return _decompose(
        args.cube, args.out, args.library, args.method, args.k, args.model, args.compare,
        args.budget, args.device,
    )  # fmt: skip


def import_(args):
    from .cube_import import import_cube
    from .cube_io import check_cube_path, write_cube
    from .progress import progress_bar

    check_cube_path(args.out, args.file)
    with progress_bar() as report:
        cube, note = import_cube(
            args.file, args.unit, args.wavelengths, args.wavenumbers, args.netd, report
        )
    write_cube(cube, args.out)
    text = f"{note}\n{args.out}: {cube.bands} bands, {cube.shape[0]} x {cube.shape[1]} pixels."
    return text, {
        "command": "import", "cube": args.out, "note": note, "bands": cube.bands,
        "size": cube.shape, "wavelength_um": cube.wavelength_um, "netd_k": cube.netd_k,
    }  # fmt: skip


def simulate(args):
    with _loading():
        from physics.bands import equidistant_bands
        from physics.simulator import simulate as trace
        from physics.simulator.presets import preset
        from physics.simulator.scene_file import load_scene

        from .band_file import read_bands
        from .cube_io import check_cube_path, write_cube
        from .progress import progress_bar

    named = isinstance(args.bands, Path)
    check_cube_path(args.out, args.scene, args.bands if named else None)
    beside = _truth_path(args.out)
    for other in (args.out.with_suffix(s) for s in (".exr", ".npz")):
        if other != args.out and other.exists():
            raise InputError(
                f"{beside} would be taken for the truth of {other}, too; choose another name."
            )
    wavelength_um, fwhm_um = read_bands(args.bands) if named else equidistant_bands(args.bands)
    is_file = Path(args.scene).suffix == ".json"
    scene = load_scene(args.scene) if is_file else preset(args.scene, args.seed)
    with progress_bar() as report:
        cube, truth = trace(
            scene, wavelength_um=wavelength_um, fwhm_um=fwhm_um, size=args.size, spp=args.spp,
            netd_k=args.netd, seed=args.seed, progress=lambda n, of: report(n, of, "simulate"),
        )  # fmt: skip
    beside.unlink(missing_ok=True)  # never a truth beside another scene's cube
    write_cube(cube, args.out)
    truth.save(beside)
    text = (
        f"{args.out}: {cube.bands} bands, {cube.shape[0]} x {cube.shape[1]} pixels.\n"
        f"{beside}: its truth."
    )
    result = {
        "command": "simulate", "scene": args.scene, "cube": args.out, "truth": beside,
        "bands": cube.bands, "size": cube.shape, "spp": args.spp, "netd_k": cube.netd_k,
        "seed": args.seed,
    }  # fmt: skip
    return text, result


def bands(args):
    from physics.bands import equidistant_bands
    from physics.filters import HIGH_UM, LOW_UM, design_filters, rate_filters
    from physics.library import MaterialLibrary
    from physics.whole_file import check_writable

    from .band_file import write_bands
    from .progress import progress_bar

    if args.out is not None:
        check_writable(args.out, args.library)
    library = _starter() if args.library is None else MaterialLibrary.load(args.library)
    with progress_bar() as report:
        best = design_filters(library, args.n, progress=report)
    centres, width = equidistant_bands(args.n, LOW_UM, HIGH_UM)
    equidistant = rate_filters(library, centres, float(width[0]))
    if args.out is not None:
        write_bands(args.out, best.wavelength_um, best.fwhm_um)
    lines = ["centre (um)  width (um)"]
    lines += [f"{c:11.2f}  {w:10.2f}" for c, w in zip(*best[:2], strict=True)]
    lines.append(f"{'':22s} material (nats)  sigma of T (K)  loss (nats)  NETD (mK)")
    lines += [
        f"{name:22s} {f.material_loss:15.3f}  {f.temperature_k:14.2f}  {f.loss:11.3f}  "
        f"{1e3 * f.netd_k:9.0f}"
        for name, f in (("these", best), (f"{args.n} side by side", equidistant))
    ]
    lines += [
        "material: what stays unknown of it; sigma of T: the least error; loss: what stays unknown",
        "of both; less is better. A wider filter lets in more light, so its NETD is lower.",
    ]
    if args.out is not None:
        lines.append(f"{args.out}: for simulate --bands, with --netd {best.netd_k:.3g}.")
    return "\n".join(lines), {
        "command": "bands", "file": args.out, "designed": best._asdict(),
        "equidistant": equidistant._asdict(),
    }  # fmt: skip


def library_list(args):
    library = _starter()
    mean = library.emissivity.mean(axis=1)
    lines = [f"{n:24s} mean emissivity {e:.3f}" for n, e in zip(library.names, mean, strict=True)]
    rows = [{"name": n, "mean_emissivity": e} for n, e in zip(library.names, mean, strict=True)]
    return "\n".join(lines), {"command": "library list", "materials": rows}


def library_show(args):
    library = _starter()
    i = library.index(args.name)
    curve = list(zip(library.wavelength_um, library.emissivity[i], strict=True))
    step = max(1, len(curve) // 16)
    lines = [f"{args.name}: {library.descriptions[i]}", "wavelength (um)  emissivity"]
    lines += [f"{w:15.3f}  {e:.4f}" for w, e in curve[::step]]
    return "\n".join(lines), {
        "command": "library show", "name": args.name, "description": library.descriptions[i],
        "hue_deg": library.hue_deg[i], "wavelength_um": library.wavelength_um,
        "emissivity": library.emissivity[i],
    }  # fmt: skip


def library_rebuild(args):
    from physics import starter
    from physics.whole_file import check_writable

    check_writable(args.out)

    starter.write(args.out)
    return f"{args.out}: written.", {"command": "library rebuild", "library": args.out}


def library_import(args):
    from physics.whole_file import check_writable

    from .library_io import import_library, read_names

    check_writable(args.out, args.file, args.names, *args.file.glob("*.[tT][xX][tT]"))
    names = None if args.names is None else read_names(args.names)
    library, note = import_library(args.file, args.wavenumbers, names, args.sky)
    library.save(args.out)
    return f"{note}\n{args.out}: {', '.join(library.names)}.", {
        "command": "library import", "library": args.out, "note": note,
        "materials": library.names, "wavelength_um": library.wavelength_um,
    }  # fmt: skip


def library_from_cube(args):
    from physics.blind import library_from_cube
    from physics.whole_file import check_writable

    from .cube_io import read_cube
    from .progress import progress_bar

    check_writable(args.out, args.cube)
    cube = read_cube(args.cube)
    with progress_bar() as report:
        library, note = library_from_cube(cube, args.materials, progress=report)
    library.save(args.out)
    return f"{args.cube}: {note}\n{args.out}: {', '.join(library.names)}.", {
        "command": "library from-cube", "library": args.out, "note": note,
        "materials": library.names, "wavelength_um": library.wavelength_um,
    }  # fmt: skip


# --- training ----------------------------------------------------------------------------


def train(args):
    from physics.whole_file import check_writable

    check_writable(args.out)
    with _training() as report:
        from training.train import train

        history = train(
            args.out, args.cache, scenes=args.scenes, epochs=args.epochs, seed=args.seed,
            device=args.device, progress=report,
        )  # fmt: skip
    text = f"{_scores('validation scenes', history['validation'])}\n{args.out}: the weights."
    return text, {"command": "train", "model": args.out} | history


def finetune(args):
    from physics.library import MaterialLibrary
    from physics.whole_file import check_writable

    from .cube_io import read_cube
    from .weights import load_network, save_network

    check_writable(args.out, args.library, args.model, *args.cubes)
    library = MaterialLibrary.load(args.library)
    cubes = [read_cube(path) for path in args.cubes]
    network, past = load_network(args.model)
    with _training() as report:
        from training.finetune import finetune

        network, history = finetune(
            network, library, args.cache, scenes=args.scenes, epochs=args.epochs, cubes=cubes,
            seed=args.seed, device=args.device, progress=report,
        )  # fmt: skip
    save_network(network, args.out, history | {"from": past})
    on = "the cubes" if cubes else "scenes held out"
    lines = [_scores(f"{on}, before", history["before"]), _scores("after", history["after"])]
    if history["sky"] != "the library's":
        lines.insert(0, f"{args.library} has no sky; the starter library's was used in training.")
    text = "\n".join([*lines, f"{args.out}: the weights."])
    return text, {"command": "finetune", "model": args.out} | history


@contextmanager
def _training():
    """Yield a progress report; says what is missing, or after Ctrl-C how to go on."""
    from .progress import progress_bar

    try:
        with progress_bar() as report:
            yield report
    except ModuleNotFoundError as e:
        if e.name != "pytorch_lightning":
            raise
        raise InputError(
            "training needs the package pytorch-lightning; pip install 'texnet[train]'."
        ) from e
    except KeyboardInterrupt:
        print("texnet: stopped; the same command goes on from the last epoch.", file=sys.stderr)
        raise


def _scores(what, m):
    if "eq1" in m:
        return f"{what}: Eq. 1 loss {m['eq1']:.4f}"
    return (
        f"{what}: {100 * m['accuracy']:.1f} % of the pixels get their material, cross entropy "
        f"{m['cross_entropy']:.3f}, temperature off by {m['temperature_rmse_k']:.2f} K"
    )


def export(args):
    from physics.whole_file import check_writable

    from .weights import load_network

    check_writable(args.out, args.model)
    network, history = load_network(args.model)
    try:
        from export.to_onnx import export_onnx
    except ModuleNotFoundError as e:
        if e.name not in ("onnx", "onnxscript"):
            raise
        raise InputError(
            "export needs the packages onnx and onnxscript; pip install 'texnet[export]'."
        ) from e
    export_onnx(network, history, args.out)
    size = args.out.stat().st_size
    text = f"{args.out}: {args.model} and all that answers a cube with it, {size / 1e6:.1f} MB."
    return text, {"command": "export", "model": args.model, "file": args.out, "bytes": size}


def bench_speed(args):
    from benchmarks.speed import measure

    from .outputs import check_directory

    check_directory(args.out)
    result = measure(args.out)
    return f"{args.out}: speed.json, growth.csv, growth.png.", {"command": "bench speed"} | result


def bench_stability(args):
    from benchmarks.stability import measure, missing_table

    from .outputs import check_directory
    from .progress import progress_bar

    check_directory(args.out)
    with progress_bar() as report:
        rows, missing, faults = measure(args.out, progress=report)
    files = f"{args.out}: stability.csv, missing.csv, atlas.png."
    text = "\n".join([*missing_table(missing), *faults, files])
    return text, {"command": "bench stability", "rows": rows, "missing": missing, "faults": faults}


def bench_chart(args):
    from benchmarks.chart import measure, table

    from .outputs import check_directory
    from .progress import progress_bar

    check_directory(args.out)
    try:
        with progress_bar() as report:
            result = measure(args.out, args.network, report)
    except KeyboardInterrupt:
        print("texnet: stopped; the same command goes on after the last scene.", file=sys.stderr)
        raise
    text = "\n".join([*table(result["medians"]), f"{args.out}: chart.csv, chart.png, methods.csv."])
    return text, {"command": "bench chart"} | result


def reproduce(args):
    from benchmarks.reproduce import reproduce as make

    from .outputs import check_directory
    from .progress import progress_bar

    check_directory(args.out)
    with progress_bar() as report:
        text, result = make(args.figure, args.out, args.full, report)
    return text, {"command": "reproduce", "figure": args.figure} | result


@contextmanager
def _loading():
    """Puts Ctrl-C off: a package that is interrupted while it loads may swallow it, or break."""
    signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


# --- decompose and demo ------------------------------------------------------------------


def _decompose(
    cube_path, directory, library=None, method=None, k=5, model=None, compare=False, budget=None,
    device="cpu",
):  # fmt: skip
    with _loading():
        from concurrent.futures import ThreadPoolExecutor

        from physics.library import MaterialLibrary

        from .cube_io import read_cube

    # a budget tries all methods, and local and sgd run on the CPU alone
    runner = cache(
        lambda m: _runner(m, model, "cpu" if budget and not m.startswith("net") else device)
    )
    inputs = cube_path, _truth_path(cube_path), library, model
    with ThreadPoolExecutor(1) as beside:  # the network loads while the cube is read
        if budget is None:
            method = method or "net+sgd"
            network = beside.submit(runner, method)
        cube = read_cube(cube_path)
        library = _starter() if library is None else MaterialLibrary.load(library)
        truth = _truth(cube_path)
        if truth is not None:
            truth.check_cube(cube)

        with _loading():
            from .outputs import check_directory, write_decomposition
            from .pipeline import decompose
            from .progress import progress_bar

        check_directory(directory, *inputs)
    chosen = k == "auto"
    with progress_bar() as report:
        if budget is None:
            run = network.result()
            del network
        else:
            from .budget import choose

            method, k, foreseen = choose(cube, library, k, budget, runner, report)
            run = runner(method)
        d = decompose(cube, library, method=method, k=k, model=run, progress=report)
    del run, runner  # and the memory that it keeps for the next tile
    if d.left_out:
        cube = cube.only(np.isin(cube.wavelength_um, d.wavelength_um))
    metrics = None if truth is None else _metrics(d, cube, truth)
    paths = write_decomposition(d, cube, truth, directory, compare or truth is not None)

    ground = d.temperature_k[np.asarray(d.material_names)[d.material] != "sky"]
    span = np.percentile(ground, [2, 50, 98]) if ground.size else [math.nan] * 3
    share = np.bincount(d.material.ravel(), minlength=len(d.material_names)) / d.material.size
    shares = {d.material_names[i]: share[i] for i in np.argsort(-share) if share[i] > 0}
    result = {
        "command": "decompose", "cube": cube_path, "method": method, "k": len(d.environment),
        "k_chosen": chosen, "bands": cube.bands, "size": cube.shape,
        "netd_k": d.netd_k, "netd_stated_k": cube.netd_k,
        "left_out": [{"wavelength_um": w, "why": why} for w, why in d.left_out.items()],
        "temperature_k": dict(zip(("p2", "median", "p98"), span, strict=True)),
        "materials": shares, "sky_in_view": bool(d.sky),
        "unknown": d.unknown.mean(), "residual": np.median(d.residual),
        "seconds": d.seconds, "metrics": metrics, "files": paths,
    }  # fmt: skip
    if budget is not None:
        result["budget"] = {
            "seconds_per_megapixel": budget, "foreseen_seconds_per_megapixel": foreseen,
        }  # fmt: skip
    return _summary(result), result


def _truth(cube_path):
    """The Truth beside a cube, or None."""
    path = _truth_path(cube_path)
    if not path.exists():
        return None
    from physics.truth import Truth

    return Truth.load(path)


def _metrics(d, cube, truth):
    from .baselines import baseline_correlations
    from .metrics import evaluate, names_lacking

    metrics = evaluate(d, truth)
    lacking, whole = names_lacking(d, truth)
    if whole:  # by other names no material could be right
        of_names = "material_accuracy", "mean_iou", "cross_entropy", "accuracy_answered"
        metrics |= dict.fromkeys(of_names, math.nan)
    return metrics | {
        "not_in_library": lacking, "baselines": baseline_correlations(cube, truth),
    }  # fmt: skip


def _runner(method, model, device):
    """What runs the network: ONNX Runtime for net+sgd; torch for other weights, net and GPUs."""
    if device != "cpu" and method not in ("net", "net+sgd"):
        raise InputError(f"--device: {method} runs on the CPU alone; take --method net+sgd.")
    if method not in ("net", "net+sgd"):
        if model is not None:
            raise InputError(f"--model: {method} uses no network; take --method net+sgd.")
        return None
    if model is not None and model.suffix != ".onnx":
        from .learned import torch_model
        from .weights import load_network

        return torch_model(method == "net+sgd", load_network(model)[0], device=device)
    if model is not None and method == "net":
        raise InputError(f"--model: {model} holds net+sgd; net alone needs .safetensors.")
    if model is not None and device != "cpu":
        raise InputError(f"--model: {model} runs on the CPU alone; give .safetensors.")
    if method == "net" or device != "cpu":
        from .learned import torch_model

        return torch_model(method == "net+sgd", device=device)
    with _loading():
        from export.runtime import Runtime

    if model is not None:
        return Runtime(model).run
    with as_file(files("texnet") / "data" / SHIPPED) as path:
        return Runtime(path).run


def _summary(r):
    own, said = r["netd_k"], r["netd_stated_k"]
    source = "as stated" if own == said else "estimated"
    if said and said != own:
        source += f", {1e3 * said:.0f} mK stated"
    t, shares = r["temperature_k"], list(r["materials"].items())
    shown = [(name, share) for name, share in shares if share >= 0.005][:6] or shares[:1]
    lines = [
        f"Cube         {r['size'][0]} x {r['size'][1]} pixels, {r['bands']} bands, "
        f"NETD {1e3 * own:.0f} mK ({source})",
        *(f"Left out     {b['wavelength_um']:.4g} um: {b['why']}" for b in r["left_out"]),
        f"Objects      k = {r['k']}" + (", chosen" if r["k_chosen"] else ""),
        f"Temperature  {t['p2']:.1f} to {t['p98']:.1f} K, half of it above {t['median']:.1f} K",
        "Materials    " + ", ".join(f"{name} {100 * s:.0f} %" for name, s in shown),
        f"Not sure     {100 * r['unknown']:.1f} % of the pixels are marked unknown",
        f"Time         {sum(r['seconds'].values()):.1f} s",
    ]
    if "budget" in r:
        foreseen, allowed = (
            r["budget"][f"{which}seconds_per_megapixel"] for which in ("foreseen_", "")
        )
        lines.append(
            f"Method       {r['method']}: {foreseen:.1f} s per megapixel foreseen, {allowed:g} "
            "allowed"
        )
    if not r["sky_in_view"]:
        lines.append(
            "Sky          none in view: texture is the residual; outdoors that is wrong (is the "
            "first row the top?)"
        )
    if r["metrics"] is not None:
        m, today = r["metrics"], r["metrics"]["baselines"]
        lacks = ", ".join(m["not_in_library"][:4]) + (", ..." if m["not_in_library"][4:] else "")
        right = f"{100 * m['material_accuracy']:.1f} % of the pixels get their material"
        if lacks:
            right += f" (the library lacks {lacks})"
        if math.isnan(m["material_accuracy"]):
            right = f"materials not compared: the library lacks {lacks} of the truth"
        lines += [
            "Against the truth beside the cube:",
            f"             temperature off by {m['temperature_rmse_k']:.2f} K (root mean square)",
            f"             {right}",
        ]
        if math.isfinite(m["texture_correlation"]):
            lines.append(
                f"             sky-lit texture correlates at {m['texture_correlation']:.2f} "
                f"(raw thermal {today['panchromatic']:.2f}, CLAHE {today['clahe']:.2f}, "
                f"PCA {today['principal_components']:.2f})"
            )
    lines += ["Files        " + str(r["files"]["tex_vision"]) + "   <- look at this first"]
    lines += [f"             {p}" for key, p in r["files"].items() if key != "tex_vision"]
    return "\n".join(lines)


def _starter():
    from physics.library import MaterialLibrary

    return MaterialLibrary.starter()


def _truth_path(cube_path):
    return Path(cube_path).with_suffix(".truth.npz")


# --- arguments ---------------------------------------------------------------------------


class _Parser(argparse.ArgumentParser):
    def error(self, message):
        raise InputError(f"{message} (see {self.prog} --help).")


class _Version(argparse.Action):
    def __call__(self, parser, *_):
        from importlib.metadata import version  # slow to look up, so only when asked

        print(f"texnet {version('texnet')}")
        parser.exit()


def _parser():
    common = _Parser(add_help=False)
    common.add_argument("--json", action="store_true", help="print one JSON object last")

    parser = _Parser(prog="texnet", description="TeX vision from thermal hyperspectral cubes.")
    parser.add_argument("--version", action=_Version, nargs=0, help="print the version")
    commands = parser.add_subparsers(required=True, metavar="COMMAND", dest="command")

    def add(to, name, run, text):
        command = to.add_parser(name, parents=[common], help=text, description=text)
        command.set_defaults(run=run)
        return command

    def add_device(p):
        p.add_argument(
            "--device", choices=("cpu", "cuda"), default="cpu",
            help="where the network is computed, default: cpu",
        )  # fmt: skip

    p = add(commands, "demo", demo, "decompose the packaged night scene and draw the pictures")
    p.add_argument("--out", metavar="DIR", type=_folder, default=Path("demo"), help="default: demo")

    p = add(commands, "import", import_, "turn a cube of others into one for decompose")
    p.add_argument(
        "file", metavar="FILE", type=Path,
        help="ENVI .hdr or its binary, HADAR or TeX-1500 .mat, .npz, .npy (bands first)",
    )  # fmt: skip
    p.add_argument("--out", metavar="CUBE", type=Path, required=True, help=".exr or .npz")
    p.add_argument(
        "--unit", metavar="UNIT",
        help="of the radiance: W/m2/sr/um, mW/m2/sr/um, microflick, W/m2/sr/cm-1 ...; HADAR's is "
        "known",
    )  # fmt: skip
    for name, example in (("--wavelengths", "um, such as 8:14"), ("--wavenumbers", "cm-1")):
        p.add_argument(
            name, metavar="FIRST:LAST", type=_first_last,
            help=f"where the file does not say: first and last band in {example}; equidistant",
        )  # fmt: skip
    p.add_argument("--netd", metavar="K", type=_netd, help="sensor noise in K at 300 K, if known")

    p = add(commands, "simulate", simulate, "path-trace a cube, its truth beside it")
    p.add_argument("scene", metavar="SCENE", help="name of a preset, or a .json scene file")
    p.add_argument("--out", metavar="CUBE", type=Path, required=True, help=".exr or .npz")
    p.add_argument(
        "--bands", metavar="N|FILE", type=_bands, default=54,
        help="how many, side by side, or a .json file as of bands, default: 54",
    )  # fmt: skip
    p.add_argument(
        "--size", metavar="HxW", type=_size, default=(256, 384), help="pixels, default: 256x384"
    )
    p.add_argument(
        "--spp", metavar="N", type=_integer(1, 100_000), default=64,
        help="light paths per pixel, default: 64",
    )  # fmt: skip
    p.add_argument(
        "--netd", metavar="K", type=_netd, default=0.05,
        help="sensor noise in K at 300 K, 0 for none, default: 0.05",
    )  # fmt: skip
    p.add_argument("--seed", metavar="N", type=_integer(0, 2**32 - 1), default=0)

    p = add(commands, "bands", bands, "which N filters tell materials and temperatures best")
    p.add_argument("--n", metavar="N", type=_integer(4, 16), required=True, help="4-16")
    p.add_argument("--library", metavar="FILE", type=Path, help="JSON; default: the starter one")
    p.add_argument("--out", metavar="FILE", type=Path, help="JSON, for simulate --bands")

    p = add(commands, "decompose", decompose, "decompose a cube into TeX")
    p.add_argument("cube", metavar="CUBE", type=Path, help=".exr or .npz")
    p.add_argument("--out", metavar="DIR", type=_folder, required=True, help="made if not there")
    p.add_argument("--library", metavar="FILE", type=Path, help="JSON; default: the starter one")
    p.add_argument(
        "--method", choices=("local", "sgd", "net", "net+sgd"),
        help="local: each pixel by itself; sgd: local, smoothed over neighbours; net: the network "
        "alone; net+sgd: the network, refined (default)",
    )  # fmt: skip
    p.add_argument(
        "--budget", metavar="S", type=_seconds,
        help="take the most accurate method that needs at most S seconds per megapixel here",
    )  # fmt: skip
    p.add_argument(
        "--compare", action="store_true",
        help="draw it beside CLAHE and principal components, as is done where a truth is known",
    )  # fmt: skip
    p.add_argument(
        "--model", metavar="FILE", type=Path,
        help=".onnx, or .safetensors from train or finetune; default: the one shipped",
    )  # fmt: skip
    add_device(p)
    p.add_argument(
        "--k", metavar="N", type=_count, default=5,
        help="objects that stand for the environment, 1-10, or auto: as many as the scene "
        "supports; default: 5",
    )  # fmt: skip

    def add_training(name, run, text, scenes, epochs):
        p = add(commands, name, run, text)
        p.add_argument("--out", metavar="FILE", type=Path, required=True, help=".safetensors")
        p.add_argument(
            "--scenes", metavar="N", type=_integer(1, 100_000), default=scenes,
            help=f"simulated scenes to train on, default: {scenes}",
        )  # fmt: skip
        p.add_argument(
            "--epochs", metavar="N", type=_integer(1, 10_000), default=epochs,
            help=f"default: {epochs}",
        )  # fmt: skip
        p.add_argument(
            "--cache", metavar="DIR", type=_folder, default=Path.home() / ".cache" / "texnet",
            help="scenes and checkpoints, default: ~/.cache/texnet",
        )  # fmt: skip
        p.add_argument("--seed", metavar="N", type=_integer(0, 2**32 - 1), default=0)
        add_device(p)
        return p

    # the defaults of training.train and training.finetune, which are slow to import
    add_training("train", train, "train a network on simulated scenes; hours", 1600, 60)
    p = add_training("finetune", finetune, "adapt a network to a library; minutes", 48, 3)
    p.add_argument("--library", metavar="FILE", type=Path, required=True, help="JSON")
    p.add_argument(
        "--model", metavar="FILE", type=Path, default=files("texnet") / "data" / MODEL,
        help="weights to start from, default: the package's",
    )  # fmt: skip
    p.add_argument(
        "--cubes", metavar="CUBE", type=Path, nargs="+", default=[],
        help="train on these alone, of which no truth is known, by Eq. 1; .exr or .npz",
    )  # fmt: skip

    p = add(commands, "export", export, "write a network as one ONNX file; minutes")
    p.add_argument("model", metavar="MODEL", type=Path, help=".safetensors")
    p.add_argument("--out", metavar="FILE", type=Path, required=True, help=".onnx")

    p = commands.add_parser("bench", help="measure this machine")
    actions = p.add_subparsers(required=True, metavar="ACTION", dest="action")
    p = add(actions, "speed", bench_speed, "speed beside the peers and the limits; ten minutes")
    p.add_argument("--out", metavar="DIR", type=_folder, required=True, help="made if not there")

    p = add(
        actions, "stability", bench_stability, "where methods fail, and whether they say so; 15 min"
    )
    p.add_argument("--out", metavar="DIR", type=_folder, required=True, help="made if not there")
    p = add(actions, "chart", bench_chart, "accuracy against time beside the peers; minutes")
    p.add_argument("--out", metavar="DIR", type=_folder, required=True, help="made if not there")
    p.add_argument(
        "--network", metavar="FILE", type=Path, action="append", default=[],
        help=".safetensors of one more network to chart; may be given several times",
    )  # fmt: skip

    p = add(commands, "reproduce", reproduce, "one of the paper's results, on scenes of our own")
    p.add_argument("figure", metavar="FIGURE", choices=FIGURES, help=", ".join(FIGURES))
    p.add_argument(
        "--out", metavar="DIR", type=_folder, default=Path("reproduce"), help="default: reproduce"
    )
    p.add_argument("--full", action="store_true", help="the published size; hours")

    p = commands.add_parser("library", help="the starter library of materials")
    actions = p.add_subparsers(required=True, metavar="ACTION", dest="action")
    add(actions, "list", library_list, "name every material")
    p = add(actions, "show", library_show, "one material: sources and emissivity")
    p.add_argument("name", metavar="NAME")
    p = add(actions, "rebuild", library_rebuild, "compute the table from optical constants")
    p.add_argument(
        "--out", metavar="FILE", type=Path,
        default=files("physics") / "data" / "starter_library.json", help="default: the package's",
    )  # fmt: skip
    p = add(actions, "import", library_import, "turn a library of others into one for --library")
    p.add_argument(
        "file", metavar="FILE", type=Path,
        help="HADAR .mat, ECOSTRESS .txt or a folder of them, .csv",
    )  # fmt: skip
    p.add_argument("--out", metavar="FILE", type=Path, required=True, help="JSON")
    p.add_argument(
        "--wavenumbers", metavar="FIRST:LAST", type=_first_last,
        help=".mat: first and last band in cm-1, equidistant, such as 760:1240",
    )  # fmt: skip
    p.add_argument("--names", metavar="FILE", type=Path, help=".mat: text, one name a line")
    p.add_argument("--sky", metavar="NAME", help="the material that is the sky, if none is 'sky'")

    p = add(actions, "from-cube", library_from_cube, "a library from a cube with sky in view alone")
    p.add_argument("cube", metavar="CUBE", type=Path, help=".exr or .npz, 20 bands or more")
    p.add_argument("--out", metavar="FILE", type=Path, required=True, help="JSON")
    p.add_argument(
        "--materials", metavar="N", type=_integer(1, 30),
        help="beside the sky; default: as many as its pixels need",
    )  # fmt: skip
    return parser


def _integer(low, high):
    def parse(text):
        if not (text.isascii() and text.isdigit() and low <= int(text) <= high):
            raise argparse.ArgumentTypeError(f"need a whole number {low}-{high}, got {text!r}")
        return int(text)

    return parse


def _folder(text):
    if not text:
        raise argparse.ArgumentTypeError("need the name of a folder; . is the current one")
    return Path(text)


def _count(text):
    return text if text == "auto" else _integer(1, 10)(text)


def _bands(text):
    return Path(text) if Path(text).suffix == ".json" else _integer(1, 1000)(text)


def _size(text):
    match = re.fullmatch(r"([1-9][0-9]{0,3})x([1-9][0-9]{0,3})", text)
    if match is None:
        raise argparse.ArgumentTypeError(f"need HEIGHTxWIDTH such as 256x384, got {text!r}")
    return int(match[1]), int(match[2])


def _first_last(text):
    match = re.fullmatch(r"([0-9]{1,6}\.?[0-9]{0,9}):([0-9]{1,6}\.?[0-9]{0,9})", text)
    if match is None:
        raise argparse.ArgumentTypeError(f"need FIRST:LAST such as 760:1240, got {text!r}")
    return float(match[1]), float(match[2])


def _netd(text):
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 <= value <= MAX_NETD_K:
        raise argparse.ArgumentTypeError(f"need 0 to {MAX_NETD_K:g} K, got {text!r}")
    return value


def _seconds(text):
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"need a number of seconds above 0, got {text!r}")
    return value


def _plain(value):
    """The value in JSON's own types; numbers that are not finite become null."""
    if isinstance(value, dict):
        return {str(key): _plain(v) for key, v in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [_plain(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value


if __name__ == "__main__":
    sys.exit(main())
