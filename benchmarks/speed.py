"""How fast, compared with what people use today, and with the limits.

    texnet bench speed --out DIR [--large]

The workload is a HADAR frame: 1080 x 1920 pixels, 54 bands, 50 mK (path-traced `forest` of half the
size on each side, repeated), the starter library of 30 materials, an estimated environment of k = 4
objects, two threads; to be run on two cores. All in one run, in turn, with the repetitions given in
each row:

    local, net, net+sgd   texnet: all of `decompose` except files and pictures, net in torch
    scipy                 a bounded scipy.optimize.least_squares per pixel and material, as the
                          published MATLAB code is ported, in one thread; J of `local`, on a few
                          pixels that are neither sky nor mixed with it; the median
    solver                the same for `local`: every material and pixel, no glance, one thread
    PAN-ResNet50          the forward pass of the published TeX-Net's architecture: from
                          segmentation-models-pytorch if installed (extra `peers`), else a
                          stand-in with as many parameters and multiply-adds
    read, product         the limits: one pass over the cube's bytes, and the matrix product
                          from pixels to the inner products with all hypotheses
    GPU                   if torch finds one, net, net+sgd and PAN there, and a few draws of
                          training (64 x 64 pixels; extra `train`) there and on the CPU

followed by the simulator (rays per second, traced and shaded, against bare Embree on the same
rays), start-up times and peak memory of whole commands (median and maximum of three runs; for a
frame and larger of one), and `growth`: time against pixels, bands, materials and k, for the
simulator against pixels, bands and paths per pixel, each from one run after one that does not
count, with exponents fitted to log time (growth.png). Writes speed.json. --large adds a cube of
4096 x 4096 pixels to the commands, which takes 20 GB of disk.
"""

import json
import platform
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
import torch
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullFormatter
from threadpoolctl import threadpool_limits

from benchmarks import ONNX
from benchmarks.accuracy import NETD_K
from benchmarks.peers.scipy_fit import cost, fit, pure_hypotheses
from benchmarks.rows import write_csv
from benchmarks.threads import THREADS, on_two_threads
from physics.bands import equidistant_bands
from physics.cube.heat_cube import HeatCube
from physics.errors import InputError
from physics.estimate import estimate_environment
from physics.exact.local import solve_local
from physics.exact.reduced import reduce_model
from physics.library import SKY, MaterialLibrary
from physics.machinery.threads import usual_threads
from physics.machinery.whole_file import whole_file
from physics.simulator import simulate, trace_scene
from physics.simulator.presets import preset
from physics.simulator.sensor import Bands
from physics.simulator.traced import trace_on_demand
from texnet.files.cube_io import truth_path, write_cube
from texnet.learned import torch_model
from texnet.network import TeXNet
from texnet.pipeline import decompose
from texnet.runtime import Runtime
from texnet.solver import HOPELESS_ALONE

FRAME, BANDS, K = (1080, 1920), 54, 4
OUT = 30 + 1 + K  # maps of the published TeX-Net: materials, T and V
PIECE = 2  # ratio of the frame to the traced picture, on each side
SCIPY_PIXELS, SOLVER_PIXELS = 30, 20_000
PART = 544, 960
REPEATS = 3
DRAWS = 16  # of training
SIMULATED, SPP = (256, 384), 16
GROWTH = {
    "pixels": (128, 256, 512, 1024),  # on a side
    "bands": (8, 16, 32, 64, 100),
    "materials": (3, 6, 12, 24, 30),
    "k": (1, 2, 4, 8, 10),
}
SIMULATED_GROWTH = {
    "pixels": (128, 256, 512, 768),  # on a side
    "bands": (10, 40, 160, 400),
    "paths": (4, 16, 64),  # per pixel
}
GROWTH_SIDE, SIMULATED_SIDE = 384, 256  # pixels, unless these are varied
SMALL, LARGE = (256, 256), (4096, 4096)


def frame(traced, library, bands=BANDS, size=FRAME):
    """A HeatCube of that size, made of copies of the traced scene side by side."""
    w, fwhm = equidistant_bands(bands)
    s = traced.shade(library, w, fwhm, NETD_K)[0].radiance
    times = [-(-n // m) for n, m in zip(size, s.shape[1:], strict=True)]
    s = np.tile(s, (1, *times))[:, : size[0], : size[1]]
    return HeatCube(np.ascontiguousarray(s), w, fwhm, NETD_K)


def timed(what, pixels, run, repeats=REPEATS):
    """A row: the median time of some runs, after one that does not count, and their range."""
    run()
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        run()
        seconds.append(time.perf_counter() - start)
    per = np.array(seconds) / pixels * 1e6
    return {
        "what": what, "pixels": pixels, "repeats": repeats, "seconds_per_megapixel": np.median(per),
        "least": per.min(), "most": per.max(),
    }  # fmt: skip


# --- texnet, its peers and its limits -----------------------------------------------------


def methods(cube, library, run):
    """Rows for texnet's methods on the whole frame; run is that of the ONNX file."""
    net = torch_model()
    pixels = cube.shape[0] * cube.shape[1]
    return [
        timed("net+sgd", pixels, lambda: decompose(cube, library, k=K, model=run)),
        timed("net", pixels, lambda: decompose(cube, library, method="net", k=K, model=net)),
        timed("local", pixels, lambda: decompose(cube, library, method="local", k=K)),
    ]


def on_gpu(cube, library):
    """Rows for torch on its first GPU, none without one; for training also on the CPU."""
    if not torch.cuda.is_available():
        return []
    pixels, rows, gpu = cube.shape[0] * cube.shape[1], [], {"device": torch.cuda.get_device_name()}
    model = torch_model(device="cuda")
    for method in ("net+sgd", "net"):
        of = partial(decompose, cube, library, method=method, k=K, model=model)
        rows.append(timed(f"{method}, GPU", pixels, of))
    rows += [pan_forward(cube, "cuda"), training_draws("cuda")]
    return [row | gpu for row in rows] + [training_draws("cpu")]


def training_draws(device):
    """A row for training on draws made beforehand, half of which have a glance."""
    from training.samples import draw, features
    from training.scenes import Settings, make_record
    from training.train import SIDE, Training

    record, rng = make_record(Settings(), "train", 0), np.random.default_rng(0)
    samples = [draw(record, rng, SIDE) for _ in range(DRAWS)]
    batches = [(s, features(s.known, s.radiance)) for s in samples]
    module = Training(TeXNet(), 1).to(device)
    (optimiser,), _ = module.configure_optimizers()

    def run():
        optimiser.zero_grad()
        for batch in batches:
            there = module.transfer_batch_to_device(batch, torch.device(device), 0)
            module.loss(*there).backward()
        optimiser.step()
        _wait(device)

    name = "training" if device == "cpu" else "training, GPU"
    return timed(name, DRAWS * SIDE**2, run)


def scipy_fit(cube, library, environment):
    """A row for the peer, and by how much J of `local`'s answer exceeds that of the peer's best,
    with Planck's law itself and V on the simplex, nats. Pixels that `local` finds to be mixed with
    sky, which the peer does not know, are left out."""
    model = reduce_model(cube, library, environment)
    pure = pure_hypotheses(model)
    pixels = np.random.default_rng(0).permutation(len(cube.spectra))[: 10 * SCIPY_PIXELS]
    local = solve_local(model, cube.spectra[pixels])
    of_best = np.arange(len(pixels)), local.energy.argmin(axis=1)
    row, temperature_k = local.row[of_best], local.temperature_k[of_best]
    excess, seconds = [], []
    with threadpool_limits(1):
        for i in np.flatnonzero(np.isin(row, pure))[:SCIPY_PIXELS]:
            spectrum = cube.spectra[pixels[i]].astype(float)
            start = time.perf_counter()
            fits = [fit(model, spectrum, r, cube.fwhm_um) for r in pure]
            seconds.append(time.perf_counter() - start)
            of = partial(cost, model, spectrum, fwhm_um=cube.fwhm_um)
            theirs = [
                of(r, temperature_k=t, lighting=v / v.sum())
                for r, (_, t, v) in zip(pure, fits, strict=True)
            ]
            ours = of(row[i], temperature_k=temperature_k[i], lighting=local.lighting[i])
            excess.append(ours - min(theirs))
    per = np.array(seconds) * 1e6
    return {
        "what": "scipy", "pixels": len(excess), "repeats": 1,
        "seconds_per_megapixel": np.median(per), "least": per.min(), "most": per.max(),
        "least_excess_nats": min(excess), "most_excess_nats": max(excess),
    }  # fmt: skip


def solver(cube, library, environment):
    """A row for `local` doing the peer's work: all materials, one thread."""
    model = reduce_model(cube, library, environment)
    pixels = np.random.default_rng(0).permutation(len(cube.spectra))[:SOLVER_PIXELS]
    spectra = cube.spectra[pixels]
    run = partial(solve_local, model, spectra, hopeless=HOPELESS_ALONE, threads=1)
    return timed("solver", len(spectra), run)


def pan(bands):
    """The peer's network and its name."""
    try:
        import segmentation_models_pytorch as smp
    except ImportError:
        return _stand_in(bands), "PAN-ResNet50 (stand-in)"
    torch.manual_seed(0)
    return smp.PAN("resnet50", encoder_weights=None, in_channels=bands, classes=OUT), "PAN-ResNet50"


def _stand_in(bands):
    """ResNet-50's own bottleneck layers, 24 M parameters, the last stage dilated as PAN has it."""
    from torch import nn

    def bottleneck(n, width, stride=1, dilation=1):
        out = 4 * width

        class Block(nn.Module):
            def __init__(self):
                super().__init__()
                self.layers = nn.Sequential(
                    nn.Conv2d(n, width, 1, bias=False), nn.BatchNorm2d(width), nn.ReLU(),
                    nn.Conv2d(width, width, 3, stride, dilation, dilation, bias=False),
                    nn.BatchNorm2d(width), nn.ReLU(),
                    nn.Conv2d(width, out, 1, bias=False), nn.BatchNorm2d(out),
                )  # fmt: skip
                same = n == out and stride == 1
                self.skip = nn.Identity() if same else nn.Conv2d(n, out, 1, stride, bias=False)

            def forward(self, x):
                return nn.functional.relu(self.layers(x) + self.skip(x))

        return Block()

    layers = [
        nn.Conv2d(bands, 64, 7, 2, 3, bias=False), nn.BatchNorm2d(64), nn.ReLU(),
        nn.MaxPool2d(3, 2, 1),
    ]  # fmt: skip
    n = 64
    stages = ((64, 3, 1, 1), (128, 4, 2, 1), (256, 6, 2, 1), (512, 3, 1, 2))
    for width, blocks, stride, dilation in stages:
        for i in range(blocks):
            layers.append(bottleneck(n, width, stride if i == 0 else 1, dilation))
            n = 4 * width
    return nn.Sequential(*layers, nn.Conv2d(n, OUT, 1), nn.Upsample(scale_factor=16))


def pan_forward(cube, device="cpu"):
    """A row for the peer's forward pass, on a picture already on the device."""
    network, name = pan(cube.bands)
    network.eval().to(device)
    height, width = (n // 32 * 32 for n in PART)
    x = torch.from_numpy(cube.radiance[None, :, :height, :width].copy()).to(device)

    def run():
        with torch.no_grad():
            network(x)
        _wait(device)

    parameters = sum(p.numel() for p in network.parameters())
    name = name if device == "cpu" else f"{name}, GPU"
    return timed(name, height * width, run) | {"parameters": parameters}


def _wait(device):
    """Wait until a GPU has finished all its work."""
    if device != "cpu":
        torch.cuda.synchronize()


def limits(cube, library, environment):
    """Rows for one pass over the cube's bytes, and for the product with all hypotheses."""
    linear = reduce_model(cube, library, environment).of_all[0].reshape(-1, cube.bands + 1)
    pixels, flat = cube.shape[0] * cube.shape[1], cube.radiance.reshape(-1)
    some = min(pixels, 65536)
    s = np.concatenate([cube.radiance.reshape(cube.bands, -1)[:, :some], np.ones((1, some))])
    out = np.empty((len(linear), some))
    return [
        timed("read", pixels, lambda: flat.sum()),
        timed("product", some, lambda: np.matmul(linear, s, out=out)),
    ]


# --- the simulator, start-up and memory, growth -------------------------------------------


def simulator(library):
    """Rays per second of a whole `simulate`, and of Embree alone on the same rays."""
    scene, (w, fwhm) = preset("forest", 7), equidistant_bands(BANDS)
    run = lambda: simulate(
        scene, wavelength_um=w, fwhm_um=fwhm, size=SIMULATED, spp=SPP, netd_k=NETD_K, seed=7,
        library=library,
    )  # fmt: skip
    pixels = SIMULATED[0] * SIMULATED[1]
    row = timed("simulate", pixels, run)
    w = np.unique(Bands.of(w, fwhm).fine_um)
    fine = replace(library, wavelength_um=w, emissivity=library.at(w))
    traced = trace_on_demand(scene, SIMULATED, SPP, 7, fine)
    embree = _Timed(traced.blocks._tracer._embree)
    traced.blocks._tracer._embree = embree
    for i in range(len(traced.blocks)):
        traced.blocks[i]
    # as if threads never waited for each other
    bare = usual_threads() * embree.rays / embree.seconds
    whole = embree.rays / (row["seconds_per_megapixel"] * pixels / 1e6)
    return row | {
        "rays": embree.rays, "rays_per_second": whole, "embree_rays_per_second": bare,
        "ratio": whole / bare,
    }  # fmt: skip


class _Timed:
    """An Embree scene that counts its rays and seconds."""

    def __init__(self, scene):
        self.scene, self.rays, self.seconds = scene, 0, 0.0

    def run(self, origin, direction, **how):
        start = time.perf_counter()
        hit = self.scene.run(origin, direction, **how)
        self.seconds += time.perf_counter() - start
        self.rays += len(origin)
        return hit


def commands(traced, library, large):
    """Seconds and peak memory of whole commands, each in its own process."""
    rows = [_command("texnet --help", ["--help"], REPEATS)]
    with tempfile.TemporaryDirectory() as folder:
        for what, cube, truth, words in _cubes(traced, library, large):
            path, size, cube_bytes = Path(folder) / "cube.npz", cube.shape, cube.radiance.nbytes
            write_cube(cube, path)
            truth_path(path).unlink(missing_ok=True)
            if truth is not None:
                truth.save(truth_path(path))
            del cube, truth
            row = _command(
                f"texnet decompose, {size[0]} x {size[1]} x {BANDS}{what}",
                ["decompose", str(path), "--out", str(Path(folder) / "out"), *words],
                REPEATS if size == SMALL else 1,
            )
            rows.append(row | {"peak_over_cube": row["peak_bytes"] / cube_bytes})
    return rows


def _cubes(traced, library, large):
    """(what is special about it, HeatCube, Truth or None, further words) for each decompose."""
    for size in (SMALL, FRAME, *([LARGE] if large else [])):
        yield "", frame(traced, library, size=size), None, ["--k", str(K)]
    height, width = SMALL
    cube = frame(traced, library, size=traced.size)
    ground = np.ascontiguousarray(cube.radiance[:, -height:, :width])
    yield ", no sky in view", replace(cube, radiance=ground, dead=None), None, []
    w, fwhm = equidistant_bands(BANDS)
    cube, truth = simulate(
        preset("forest", 7), wavelength_um=w, fwhm_um=fwhm, size=SMALL, spp=SPP, netd_k=NETD_K,
        seed=7, library=library,
    )  # fmt: skip
    yield ", its truth beside it", cube, truth, []


def _command(what, words, repeats):
    """A row: the median time and the peak memory of some runs; InputError if one fails."""
    code = f"import sys; from texnet.cli import main; sys.exit(main({words!r}))"
    probe = (
        "import resource, subprocess, sys, time; t = time.perf_counter();"
        "subprocess.run([sys.executable, '-c', sys.argv[1]], check=True, stdout=2);"
        "print(time.perf_counter() - t, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)"
    )
    seconds, peaks = [], []
    for _ in range(repeats):
        done = subprocess.run([sys.executable, "-c", probe, code], capture_output=True, text=True)
        if done.returncode:
            said = [line for line in done.stderr.splitlines() if line.startswith("texnet: error: ")]
            why = said[-1].removeprefix("texnet: error: ") if said else "it was killed."
            raise InputError(f"speed: {what}: {why}")
        took, peak = done.stdout.split()
        seconds.append(float(took))
        peaks.append(1024 * int(peak))
    return {
        "what": what, "repeats": repeats, "seconds": np.median(seconds), "least": min(seconds),
        "most": max(seconds), "peak_bytes": max(peaks),
    }  # fmt: skip


def growth(traced, library, run):
    """Rows: seconds of local, of net+sgd and of the simulator while one size grows; run is that of
    the ONNX file."""
    for axis, sizes in GROWTH.items():
        for n in sizes:
            side = n if axis == "pixels" else GROWTH_SIDE
            some = library.subset(_some(library, n)) if axis == "materials" else library
            cube = frame(traced, library, n if axis == "bands" else BANDS, (side, side))
            environment = estimate_environment(cube, some, n if axis == "k" else K)
            for method, model in (("local", None), ("net+sgd", run)):
                how = dict(method=method, model=model, environment=environment)
                row = timed(method, side * side, partial(decompose, cube, some, **how), repeats=1)
                size = side * side if axis == "pixels" else n
                seconds = row["seconds_per_megapixel"] * side * side / 1e6
                yield {"axis": axis, "size": size, "method": method, "seconds": seconds}
    scene = preset("forest", 7)
    for axis, sizes in SIMULATED_GROWTH.items():
        for n in sizes:
            side = n if axis == "pixels" else SIMULATED_SIDE
            w, fwhm = equidistant_bands(n if axis == "bands" else BANDS)
            spp = n if axis == "paths" else SPP
            trace = lambda: simulate(
                scene, wavelength_um=w, fwhm_um=fwhm, size=(side, side), spp=spp,  # noqa: B023
                netd_k=NETD_K, seed=7, library=library,
            )  # fmt: skip
            row = timed("simulate", side * side, trace, repeats=1)
            size = side * side if axis == "pixels" else n
            seconds = row["seconds_per_megapixel"] * side * side / 1e6
            yield {"axis": axis, "size": size, "method": "simulate", "seconds": seconds}


def _some(library, n):
    """n materials, the sky among them."""
    names = [m for m in library.names if m != SKY]
    return [SKY, *names[: n - 1]]


def exponents(rows):
    """{axis: {method: exponent of time}}, by least squares on the logarithms."""
    found = {}
    for axis, method in dict.fromkeys((r["axis"], r["method"]) for r in rows):
        of = [r for r in rows if (r["axis"], r["method"]) == (axis, method)]
        x, y = (np.log([r[name] for r in of]) for name in ("size", "seconds"))
        found.setdefault(axis, {})[method] = float(np.polyfit(x, y, 1)[0])
    return found


def _draw(rows, fitted, path):
    marks = {"local": "C0o-", "net+sgd": "C1s--", "simulate": "C2^:"}
    figure = Figure(figsize=(12, 3.2), layout="constrained")
    axes = figure.subplots(1, len(fitted))
    for ax, (axis, exponent) in zip(axes, fitted.items(), strict=True):
        for method, slope in exponent.items():
            of = [r for r in rows if (r["axis"], r["method"]) == (axis, method)]
            size, seconds = [r["size"] for r in of], [r["seconds"] for r in of]
            ax.loglog(size, seconds, marks[method], label=f"{method}: {slope:.2f}")
        ax.set(xlabel=axis)
        ax.xaxis.set_minor_formatter(NullFormatter())
        ax.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        ax.yaxis.set_major_formatter("{x:g}")
        ax.yaxis.set_minor_formatter(NullFormatter())
        ax.set_ylim(top=4 * ax.get_ylim()[1])  # room for the legend
        ax.legend(loc="upper left", title="exponent", fontsize=8, title_fontsize=8)
    axes[0].set(ylabel="seconds")
    with whole_file(path) as part:
        figure.savefig(part, dpi=110)


# --- all of it ----------------------------------------------------------------------------


def measure(out, large=False):
    """Measure everything; write speed.json, growth.csv and growth.png -> content of speed.json.

    large  include a cube of 4096 x 4096 pixels

    Raises InputError if the network cannot be read.
    """
    run = Runtime(ONNX, THREADS).run
    out.mkdir(parents=True, exist_ok=True)
    on_two_threads()
    library = MaterialLibrary.starter()
    traced = trace_scene(preset("forest", 7), tuple(n // PIECE for n in FRAME), 16, 7, library)
    cube = frame(traced, library)
    environment = estimate_environment(cube, library, K)
    rows = methods(cube, library, run)
    rows += [scipy_fit(cube, library, environment), solver(cube, library, environment)]
    rows += [pan_forward(cube)]
    rows += limits(cube, library, environment) + on_gpu(cube, library)
    per = {r["what"]: r["seconds_per_megapixel"] for r in rows}
    peer = next(name for name in per if name.startswith("PAN"))
    ratios = {
        "local, times scipy's pixels per second": per["scipy"] / per["local"],
        "the same work in one thread, times scipy's": per["scipy"] / per["solver"],
        f"net, times the pixels per second of {peer}": per[peer] / per["net"],
        f"net+sgd, times the pixels per second of {peer}": per[peer] / per["net+sgd"],
        "local, times the time of its matrix product": per["local"] / per["product"],
        "net+sgd, times the time of one pass over the cube": per["net+sgd"] / per["read"],
    }
    frames = {m: per[m] * FRAME[0] * FRAME[1] / 1e6 for m in ("local", "net+sgd")}
    for row in rows:
        print(f"{row['what']:24} {row['seconds_per_megapixel']:12.3f} s/Mpx")
    del cube
    whole = commands(traced, library, large)
    for row in whole:
        print(f"{row['what']:56} {row['seconds']:8.2f} s {row['peak_bytes'] / 1e6:8.0f} MB")
    grown = list(growth(traced, library, run))
    fitted = exponents(grown)
    result = {
        "rows": rows, "ratios": ratios, "frame_seconds": frames, "commands": whole,
        "simulator": simulator(library), "growth_exponents": fitted,
        "threads": THREADS, "versions": _versions(), "machine": platform.machine(),
    }  # fmt: skip
    for name, value in ratios.items():
        print(f"{name:60} {value:10.2f}")
    excess = next(r["most_excess_nats"] for r in rows if r["what"] == "scipy")
    print(f"{'J of local above that of the best of scipy, at most, nats':60} {excess:10.1e}")
    write_csv(out / "growth.csv", grown)
    _draw(grown, fitted, out / "growth.png")
    with whole_file(out / "speed.json") as part:
        part.write_text(json.dumps(result, indent=1, default=float), encoding="utf-8")
    return result


def _versions():
    found = {"python": platform.python_version()}
    for name in ("texnet", "torch", "onnxruntime", "numba", "scipy", "segmentation-models-pytorch"):
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = None
    return found
