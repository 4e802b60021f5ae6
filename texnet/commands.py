"""The commands except `decompose`: each takes the parsed arguments and returns the text to print
and the object for --json.

What a command needs is imported inside it, so that `texnet --help` starts at once.
"""

import os
from contextlib import contextmanager
from pathlib import Path

from physics.errors import InputError
from physics.library import MaterialLibrary

from .loading import loading

EDGE_SHARE = 0.01  # of a picture that looks past the end of the ground
COINCIDENT_SHARE = 0.001  # of a picture that shows coincident objects


def import_(args):
    from .files.cube_import import import_cube
    from .files.cube_io import check_cube_path, truth_path, write_cube
    from .progress import progress_bar

    check_cube_path(args.out, args.file)
    if (beside := truth_path(args.out)).exists():
        raise InputError(
            f"{beside} would be taken for the truth of {args.out}; choose another name, or move "
            "it away."
        )
    with progress_bar() as report:
        cube, note = import_cube(
            args.file, args.unit, args.wavelengths, args.wavenumbers, args.netd, report,
            fwhm=args.fwhm, response=args.response, rows=args.rows, columns=args.columns,
            range_um=args.range,
        )  # fmt: skip
    write_cube(cube, args.out)
    text = f"{note}\n{_size(args.out, cube)}"
    if (truth := truth_path(args.file)).exists():
        text += f"\n{truth} does not belong to {args.out}: an imported cube has no truth beside it."
    return text, {
        "command": "import", "cube": args.out, "note": note, "bands": cube.bands,
        "size": cube.shape, "wavelength_um": cube.wavelength_um, "netd_k": cube.netd_k,
    }  # fmt: skip


def simulate(args):
    with loading():
        from physics.bands import BOX, equidistant_bands
        from physics.machinery.whole_file import check_writable, whole_file
        from physics.simulator import simulate as trace
        from physics.simulator.presets import preset
        from physics.simulator.scene_file import load_scene

        from .files.band_file import read_bands
        from .files.cube_io import check_cube_path, truth_path, write_cube
        from .metrics import non_sky
        from .progress import progress_bar

    named = isinstance(args.bands, Path)
    check_cube_path(args.out, args.scene, args.bands if named else None)
    beside = truth_path(args.out)
    check_writable(beside, args.scene, args.bands if named else None)
    for other in (args.out.with_suffix(s) for s in (".exr", ".npz")):
        if other != args.out and other.exists():
            raise InputError(
                f"{beside} would be taken for the truth of {other}, too; choose another name."
            )
    bands = read_bands(args.bands) if named else (*equidistant_bands(args.bands), BOX)
    wavelength_um, fwhm_um, response = bands
    is_file = Path(args.scene).suffix.lower() == ".json"
    scene = load_scene(args.scene) if is_file else preset(args.scene, args.seed)
    with progress_bar() as report:
        cube, truth = trace(
            scene, wavelength_um=wavelength_um, fwhm_um=fwhm_um, size=args.size, spp=args.spp,
            netd_k=args.netd, seed=args.seed, progress=lambda n, of: report(n, of, "simulate"),
            response=response,
        )  # fmt: skip
    with whole_file(beside) as truth_part, whole_file(args.out) as cube_part:
        write_cube(cube, cube_part)
        truth.save(truth_part)
        # never leave a truth beside another scene's cube if only one of the two can be replaced
        Path(os.path.realpath(beside)).unlink(missing_ok=True)
    text = f"{_size(args.out, cube)}\n{beside}: its truth."
    text += _past_the_ground(scene.camera, ~non_sky(truth))
    text += _coincident(scene, cube.shape) if is_file else ""
    result = {
        "command": "simulate", "scene": args.scene, "cube": args.out, "truth": beside,
        "bands": cube.bands, "size": cube.shape, "spp": args.spp, "netd_k": cube.netd_k,
        "seed": args.seed,
    }  # fmt: skip
    return text, result


def _past_the_ground(camera, is_sky):
    """A warning if sky pixels (height, width) look below the horizon; else ""."""
    from physics.simulator.trace import view_directions

    falls = view_directions(camera, is_sky.shape)[:, 2].reshape(is_sky.shape) < 0
    share = (falls & is_sky).mean()
    if share < EDGE_SHARE:
        return ""
    return (
        f"\nWarning: {share:.1%} of the picture looks past the ground's end and below the horizon, "
        "where it sees the horizon's sky; extend the ground."
    )


def _coincident(scene, size):
    """A warning if objects of a scene coincide; else ""."""
    from physics.simulator.coincident import coincident

    share, pair = coincident(scene, MaterialLibrary.starter(), size)
    if share < COINCIDENT_SHARE:
        return ""
    one, other = (scene.objects[i].name for i in pair)
    return (
        f"\nWarning: in {share:.1%} of the picture two objects coincide, such as {one!r} and "
        f"{other!r}, and rounding decides which is seen; move one by a few millimetres."
    )


def _size(path, cube):
    bands, (height, width) = cube.bands, cube.shape
    return f"{path}: {bands} band{'s' * (bands > 1)}, {height} x {width} pixels."


def chosen_library(args):
    """The MaterialLibrary of --library, or the starter library if none is given."""
    return MaterialLibrary.load(args.library) if args.library else MaterialLibrary.starter()


def bands(args):
    from physics.bands import equidistant_bands
    from physics.filters import design_filters, filter_range, rate_filters
    from physics.machinery.whole_file import check_writable

    from .files.band_file import write_bands
    from .progress import progress_bar

    if args.out is not None:
        check_writable(args.out, args.library, suffix=".json")
    library = chosen_library(args)
    with progress_bar() as report:
        best = design_filters(library, args.n, progress=report)
    centres, width = equidistant_bands(args.n, *filter_range(library))
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
        "material: its remaining uncertainty; sigma of T: the least error; loss: the uncertainty",
        "of both; less is better. A wider filter lets in more light, so its NETD is lower. On",
        "path-traced outdoor scenes, four or more filters side by side do as well.",
    ]
    if args.out is not None:
        lines.append(f"{args.out}: use with simulate --bands and --netd {best.netd_k:.3g}.")
    return "\n".join(lines), {
        "command": "bands", "file": args.out, "designed": best._asdict(),
        "equidistant": equidistant._asdict(),
    }  # fmt: skip


def library_list(args):
    library = chosen_library(args)
    mean = library.emissivity.mean(axis=1)
    lines = [f"{n:24s} mean emissivity {e:.3f}" for n, e in zip(library.names, mean, strict=True)]
    rows = [{"name": n, "mean_emissivity": e} for n, e in zip(library.names, mean, strict=True)]
    return "\n".join(lines), {"command": "library list", "materials": rows}


def library_show(args):
    library = chosen_library(args)
    i = library.index(args.name)
    curve = list(zip(library.wavelength_um, library.emissivity[i], strict=True))
    step = max(1, len(curve) // 16)
    lines = [f"{args.name}: {library.descriptions[i]}", "wavelength (um)  emissivity"]
    lines += [f"{w:15.3f}  {e:.4f}" for w, e in curve[::step]]
    if step > 1:
        lines.append(f"One row in {step} is shown; --json has all {len(curve)}.")
    return "\n".join(lines), {
        "command": "library show", "name": args.name, "description": library.descriptions[i],
        "hue_deg": library.hue_deg[i], "wavelength_um": library.wavelength_um,
        "emissivity": library.emissivity[i],
    }  # fmt: skip


def library_rebuild(args):
    from physics import starter
    from physics.machinery.whole_file import check_writable

    check_writable(args.out)
    starter.write(args.out)
    return f"{args.out}: written.", {"command": "library rebuild", "library": args.out}


def library_import(args):
    from physics.machinery.whole_file import check_writable

    from .files.library_io import import_library, read_names

    texts = args.file.glob("*.[tT][xX][tT]")
    check_writable(args.out, args.file, args.names, *texts, suffix=".json")
    names = None if args.names is None else read_names(args.names)
    library, note = import_library(args.file, args.wavenumbers, names, args.sky, args.add_sky)
    return _saved(library, args.out, note, note, "library import")


def library_from_cube(args):
    from physics.blind import library_from_cube
    from physics.machinery.whole_file import check_writable

    from .files.cube_io import read_cube
    from .progress import progress_bar

    check_writable(args.out, args.cube, suffix=".json")
    cube = read_cube(args.cube)
    with progress_bar() as report:
        library, note = library_from_cube(cube, args.materials, progress=report)
    return _saved(library, args.out, note, f"{args.cube}: {note}", "library from-cube")


def _saved(library, path, note, said, command):
    library.save(path)
    return f"{said}\n{path}: {', '.join(library.names)}.", {
        "command": command, "library": path, "note": note,
        "materials": library.names, "wavelength_um": library.wavelength_um,
    }  # fmt: skip


# --- training ----------------------------------------------------------------------------


def train(args):
    from physics.machinery.whole_file import check_writable

    check_writable(args.out, suffix=".safetensors")
    with _training(args.cache) as report:
        from training.train import train

        history = train(
            args.out, args.cache, scenes=args.scenes, epochs=args.epochs, seed=args.seed,
            device=args.device, progress=report,
        )  # fmt: skip
    text = f"{_scores('validation scenes', history['validation'])}\n{args.out}: the weights."
    return text, {"command": "train", "model": args.out} | history


def finetune(args):
    from physics.machinery.whole_file import check_writable

    from .files.cube_io import read_cube
    from .files.weights import load_network, save_network

    if args.cubes and args.scenes is not None:
        raise InputError("--cubes: training uses these cubes only; leave out --scenes.")
    check_writable(args.out, args.library, args.model, *args.cubes, suffix=".safetensors")
    library = MaterialLibrary.load(args.library)
    cubes = [read_cube(path) for path in args.cubes]
    network, past = load_network(args.model)
    with _training(args.cache) as report:
        from training.finetune import SCENES, finetune

        network, history = finetune(
            network, library, args.cache, scenes=args.scenes or SCENES, epochs=args.epochs,
            cubes=cubes, seed=args.seed, device=args.device, progress=report,
        )  # fmt: skip
    save_network(network, args.out, history | {"from": past})
    before, after = history["before"], history["after"]
    on = "half of the cubes' bands, against all" if cubes else "scenes held out"
    lines = [_scores(f"{on}, before", before), _scores("after", after)]
    if cubes:
        lines.append(
            "The reference is its own earlier answer from all bands, no truth: compare on a cube "
            "with one."
        )
    elif after["cross_entropy"] > before["cross_entropy"]:
        lines.append(
            "The cross entropy is worse than before: keep the model that it started from, or train "
            "for longer."
        )
    if history["sky"] != "the library's":
        lines.insert(0, f"{args.library} has no sky; the starter library's was used in training.")
    text = "\n".join([*lines, f"{args.out}: the weights."])
    return text, {"command": "finetune", "model": args.out} | history


@contextmanager
def _training(cache):
    """Yield a progress report; says what is missing or, after Ctrl-C, how to resume."""
    try:
        cache.mkdir(parents=True, exist_ok=True)
    except OSError as e:
        raise InputError(f"--cache: cannot make the folder {cache}: {e.strerror}.") from e
    if not os.access(cache, os.W_OK):
        raise InputError(f"--cache: the folder {cache} is read-only.")
    try:
        with _resumable("from the last epoch") as report:
            yield report
    except ModuleNotFoundError as e:
        if e.name != "pytorch_lightning":
            raise
        raise InputError(
            "training needs pytorch-lightning; pip install -e '.[train]' in the checkout."
        ) from e


@contextmanager
def _resumable(where):
    """Yield a progress report; says after Ctrl-C where the same command resumes."""
    from .progress import progress_bar

    try:
        with progress_bar() as report:
            yield report
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"stopped; run the same command again to resume {where}.") from None


def _scores(what, m):
    return (
        f"{what}: {100 * m['accuracy']:.1f} % of the pixels get their material, cross entropy "
        f"{m['cross_entropy']:.3f}, temperature off by {m['temperature_rmse_k']:.2f} K"
    )


def export(args):
    from physics.machinery.whole_file import check_writable

    from .files.weights import load_network

    check_writable(args.out, args.model, suffix=".onnx")
    network, history = load_network(args.model)
    try:
        from export.to_onnx import export_onnx
    except ModuleNotFoundError as e:
        if e.name not in ("onnx", "onnxscript"):
            raise
        raise InputError(
            "export needs onnx and onnxscript; pip install -e '.[export]' in the checkout."
        ) from e
    export_onnx(network, history, args.out)
    size = args.out.stat().st_size
    text = f"{args.out}: {args.model} and all that decomposes a cube with it, {size / 1e6:.1f} MB."
    return text, {"command": "export", "model": args.model, "file": args.out, "bytes": size}


def bench_speed(args):
    from benchmarks.speed import measure

    from .files.answer_folder import check_directory

    check_directory(args.out, names=("speed.json", "growth.csv", "growth.png"))
    result = measure(args.out, args.large)
    return f"{args.out}: speed.json, growth.csv, growth.png.", {"command": "bench speed"} | result


def bench_accuracy(args):
    from benchmarks.accuracy import run, summary

    from .files.answer_folder import check_directory

    files = "accuracy.csv", "confusion.csv", "methods.csv"
    check_directory(args.out, names=files)
    with _resumable("after the last scene") as report:
        rows, named = run(
            args.out, args.scenes, args.bands, args.methods, args.finer,
            "enclosed" if args.enclosed else "random", report,
        )  # fmt: skip
    text = "\n".join([*summary(rows, named), f"{args.out}: {', '.join(files)}."])
    return text, {"command": "bench accuracy", "rows": rows}


def bench_stability(args):
    from benchmarks.stability import measure

    from .files.answer_folder import check_directory

    check_directory(args.out, names=("stability.csv", "missing.csv", "atlas.png", "atlas.md"))
    with _resumable("after the last level") as report:
        rows, missing, faults = measure(args.out, args.axes, report)
    files = ["stability.csv", *["missing.csv"] * bool(missing), "atlas.png", "atlas.md"]
    text = "\n".join([*faults, f"{args.out}: {', '.join(files)}."])
    return text, {"command": "bench stability", "rows": rows, "missing": missing, "faults": faults}


def bench_chart(args):
    from benchmarks.chart import measure, table

    from .files.answer_folder import check_directory

    check_directory(args.out, names=("chart.csv", "chart.png"))
    with _resumable("after the last scene") as report:
        result = measure(args.out, args.network, report)
    text = "\n".join([*table(result["medians"]), f"{args.out}: chart.csv, chart.png."])
    return text, {"command": "bench chart"} | result


def reproduce(args):
    from benchmarks.reproduce import reproduce as make

    from .files.answer_folder import check_directory
    from .progress import progress_bar

    check_directory(args.out, names=())
    with progress_bar() as report:
        text, result = make(args.figure, args.out, args.full, report)
    return text, {"command": "reproduce", "figure": args.figure} | result
