"""The commands decompose and demo: a cube in, its answer on disk, and what to say of it."""

import math
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache
from importlib.resources import as_file, files

import numpy as np

from physics.errors import InputError

from .commands import chosen_library
from .files.answer_folder import check_directory
from .files.cube_io import read_cube, truth_path
from .loading import loading
from .methods import NETS
from .metrics import evaluate, names_lacking
from .report import lines, numbers_of

# in texnet/data, its truth beside it; `texnet simulate forest --seed 1 --size 160x240 --bands 36
# --spp 256` made both
DEMO_CUBE = "forest.exr"


def demo(args):
    """decompose, of the scene that comes with the package."""
    with as_file(files("texnet") / "data") as folder:
        args.cube = folder / DEMO_CUBE
        text, result = decompose(args)
    return text, result | {"command": "demo"}


def decompose(args):
    """From the arguments of `texnet decompose` -> what to say and what --json gives."""
    budget, k = args.budget, args.k
    if budget is not None and (args.method or args.model):
        raise InputError("--budget chooses the method; leave out --method and --model.")
    if args.environment is not None and k is not None:
        raise InputError("--environment: the file's columns are the objects; leave out --k.")

    @cache
    def runner(method):
        # a budget tries all methods, and local and sgd run on the CPU alone
        on_cpu = budget is not None and method not in NETS
        return _runner(method, args.model, "cpu" if on_cpu else args.device)

    inputs = args.cube, truth_path(args.cube), args.library, args.model, args.environment
    check_directory(args.out, *inputs)
    with ThreadPoolExecutor(1) as beside:  # the network loads while the cube is read
        if budget is None:
            method = args.method or "net+sgd"
            network = beside.submit(runner, method)
        cube = read_cube(args.cube)
        library = chosen_library(args)
        truth = _truth(args.cube)
        if truth is not None:
            truth.check_cube(cube)

        with loading():
            from .baselines import baseline_pictures
            from .outputs import write_decomposition
            from .pipeline import decompose
            from .progress import progress_bar

        environment, objects = None, ()
        if args.environment is not None:
            from .files.environment_file import read_environment

            environment, objects = read_environment(args.environment, cube)
    with progress_bar() as report:
        if budget is None:
            run = network.result()
            del network
        else:
            from .budget import choose

            as_many = k
            if environment is not None:
                from physics.environment import MOST_OBJECTS
                from physics.estimate import objects_completed

                as_many = min(objects_completed(environment), MOST_OBJECTS)
            method, foreseen = choose(cube, library, as_many, budget, runner, report)
            run = runner(method)
        d = decompose(
            cube, library, method=method, k=k, environment=environment,
            calibration_error_k=args.calibration_error, model=run, progress=report,
        )  # fmt: skip
    files_by_what = {
        "cube": args.cube, "library": args.library, "environment": args.environment,
        "model": args.model,
    }  # fmt: skip
    named = {what: path and path.name for what, path in files_by_what.items()}
    d = replace(d, made_by=d.made_by | named)
    del run, runner  # and the memory that it keeps for the next tile
    if d.left_out:
        cube = cube.only(np.isin(cube.wavelength_um, d.wavelength_um))
    pictures = baseline_pictures(cube) if args.compare or truth is not None else None
    metrics = None if truth is None else _metrics(d, pictures, truth)
    paths = write_decomposition(d, args.out, pictures, truth)
    result = {
        "command": "decompose", "cube": args.cube, **numbers_of(d, cube, objects),
        "metrics": metrics, "files": paths,
    }  # fmt: skip
    if environment is not None:
        result["environment"]["file"] = args.environment
    if budget is not None:
        result["budget"] = {
            "seconds_per_megapixel": budget, "foreseen_seconds_per_megapixel": foreseen,
        }  # fmt: skip
    return _text(result), result


def _truth(cube_path):
    """The Truth beside a cube, or None."""
    path = truth_path(cube_path)
    if not path.exists():
        return None
    from physics.truth import Truth

    return Truth.load(path)


def _metrics(d, pictures, truth):
    from .baselines import baseline_correlations

    metrics = evaluate(d, truth)
    lacking, whole = names_lacking(d, truth)
    if whole:  # by other names no material could be right
        of_names = "material_accuracy", "mean_iou", "cross_entropy", "accuracy_answered"
        metrics |= dict.fromkeys(of_names, math.nan)
    return metrics | {
        "not_in_library": lacking, "baselines": baseline_correlations(pictures, truth, ~d.dead),
    }  # fmt: skip


def _runner(method, model, device):
    """What runs the network: ONNX Runtime for net+sgd; torch for other weights, net and GPUs."""
    if device != "cpu" and method not in NETS:
        raise InputError(f"--device: {method} runs on the CPU only; take --method net+sgd.")
    if method not in NETS:
        if model is not None:
            raise InputError(f"--model: {method} uses no network; take --method net+sgd.")
        return None
    if model is not None and model.suffix.lower() != ".onnx":
        from .files.weights import load_network
        from .learned import torch_model

        return torch_model(load_network(model)[0], device=device)
    if model is not None and method == "net":
        raise InputError(f"--model: {model} runs net+sgd only; --method net needs .safetensors.")
    if model is not None and device != "cpu":
        raise InputError(f"--model: {model} runs on the CPU only; give .safetensors.")
    if device != "cpu":
        from .learned import torch_model

        return torch_model(device=device)
    with loading():
        from .pipeline import shipped_model
        from .runtime import Runtime

    return shipped_model(method) if model is None else Runtime(model).run


def _text(r):
    """What to say of what --json gives."""
    said = lines(r)
    if "budget" in r:
        foreseen, allowed = (
            r["budget"][f"{which}seconds_per_megapixel"] for which in ("foreseen_", "")
        )
        said.append(
            f"Method       {r['method']}: {foreseen:.1f} s per megapixel foreseen, {allowed:g} "
            "allowed"
        )
    if r["metrics"] is not None:
        m, today = r["metrics"], r["metrics"]["baselines"]
        lacks = ", ".join(m["not_in_library"][:4]) + (", ..." if m["not_in_library"][4:] else "")
        right = f"{100 * m['material_accuracy']:.1f} % of the pixels get their material"
        if lacks:
            right += f" (the library lacks {lacks})"
        if math.isnan(m["material_accuracy"]):
            right = f"materials not compared: the library lacks {lacks} of the truth"
        said.append("Against the truth beside the cube:")
        if math.isfinite(m["temperature_rmse_k"]):  # all sky has none
            off = f"temperature off by {m['temperature_rmse_k']:.2f} K (root mean square)"
            said.append(f"             {off}")
        said.append(f"             {right}")
        if math.isfinite(m["texture_correlation"]):
            said.append(
                f"             sky-lit texture correlates at {m['texture_correlation']:.2f} "
                f"(raw thermal {today['panchromatic']:.2f}, CLAHE {today['clahe']:.2f}, "
                f"PCA {today['principal_components']:.2f})"
            )
    said += ["Files        " + str(r["files"]["tex_vision"]) + "   <- look at this first"]
    said += [f"             {p}" for key, p in r["files"].items() if key != "tex_vision"]
    return "\n".join(said)
