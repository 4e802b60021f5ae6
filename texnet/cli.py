"""The command line. Every command prints plain text or, with --json, one object last.

Wrong input gives one sentence on stderr, `texnet: error: ...`, and exit code 2. The commands are
implemented in `commands` and `decompose_command`.
"""

import argparse
import json
import math
import os
import re
import signal
import sys
from importlib.resources import files
from pathlib import Path

import numpy as np

from physics.cube.heat_cube import MAX_NETD_K
from physics.environment import MOST_OBJECTS
from physics.errors import InputError

from . import commands
from .decompose_command import decompose, demo
from .methods import METHODS, WEIGHTS

GRACE_S = 60  # for cleaning up
FIGURES = (  # modules of benchmarks.reproduce, which are slow to import
    "ghosting", "sgd-flow", "distill", "tex-vision", "temperature", "bands", "bayer",
    "environment-method", "environment-count",
)  # fmt: skip


def main(argv=None):
    """Run one command; returns the exit code: 0, 2 for wrong input, 130 for Ctrl-C."""
    if argv is None:  # delete half-written files before the process ends
        for name in ("SIGTERM", "SIGHUP"):  # Windows has no SIGHUP, nohup ignores it
            if signal.getsignal(number := getattr(signal, name, signal.SIGTERM)) != signal.SIG_IGN:
                signal.signal(number, _end)
    os.environ["MPLBACKEND"] = "agg"  # files only: a notebook's own backend may be missing here
    for stream in (sys.stdout, sys.stderr):  # a file's name may not fit their encoding
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")
    args = None
    try:
        args = _parsed(argv)
        text, result = args.run(args)
        _say(text, *([json.dumps(_plain(result), allow_nan=False)] if args.json else []))
    except (InputError, OSError) as e:
        said = _of_disk(e, getattr(args, "out", None)) if isinstance(e, OSError) else str(e)
        print(f"texnet: error: {' '.join(said.split())}", file=sys.stderr)
        return 2
    except MemoryError:
        print("texnet: error: not enough memory; use fewer pixels or bands.", file=sys.stderr)
        return 2
    except KeyboardInterrupt as e:  # a command that can be resumed says so in it
        print(f"texnet: {e}" if str(e) else "texnet: interrupted", file=sys.stderr)
        return 130
    return 0


def _of_disk(error, out):
    """The message of an OSError, as for a full disk or read-only folder, on its file or on out."""
    where = error.filename or out
    said = error.strerror or str(error)
    return f"cannot write {where}: {said.removesuffix('.')}." if where else said


def _end(number, _):
    """Leave by SystemExit, so that half-written files are deleted; at the latest by SIGALRM, since
    an interrupted import may keep its lock, for which another thread would wait forever."""
    if hasattr(signal, "alarm"):
        signal.alarm(GRACE_S)
    sys.exit(128 + number)


def _parsed(argv):
    try:
        return _parser().parse_args(argv)
    except SystemExit:  # after --help or --version
        _say()
        raise


def _say(*lines):
    try:
        # an error on the flush at exit would go unnoticed
        print(*lines, sep="\n", end="\n" if lines else "", flush=True)
    except OSError as e:
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # discards the rest at exit
        if not isinstance(e, BrokenPipeError):  # the reader, such as head, has seen enough
            raise InputError(f"cannot write to the standard output: {e.strerror}.") from e


def _plain(value):
    """The value as JSON types; numbers that are not finite become null."""
    if isinstance(value, dict):
        return {str(key): _plain(v) for key, v in value.items()}
    if isinstance(value, (list, tuple, np.ndarray)):
        return [_plain(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return str(value) if isinstance(value, Path) else value


# --- arguments ---------------------------------------------------------------------------


class _Parser(argparse.ArgumentParser):
    def error(self, message):
        raise InputError(f"{message} (see {self.prog} --help).")


class _Version(argparse.Action):
    def __call__(self, parser, *_):
        from importlib.metadata import version  # slow to look up, so only when asked

        _say(f"texnet {version('texnet')}")
        parser.exit()


def _parser():
    parser = _Parser(prog="texnet", description="TeX vision from thermal hyperspectral cubes.")
    parser.add_argument("--version", action=_Version, nargs=0, help="print the version")
    to = parser.add_subparsers(required=True, metavar="COMMAND", dest="command")
    for add in (_demo, _cubes, _decompose, _training, _measuring, _library):
        add(to)
    return parser


def _add(to, name, run, text):
    """Add a command of that name."""
    command = to.add_parser(name, help=text, description=text)
    command.add_argument("--json", action="store_true", help="print one JSON object last")
    command.set_defaults(run=run)
    return command


def _add_device(p):
    p.add_argument(
        "--device", choices=("cpu", "cuda"), default="cpu",
        help="where the network runs, default: cpu",
    )  # fmt: skip


def _add_seed(p, of):
    p.add_argument(
        "--seed", metavar="N", type=_integer(0, 2**32 - 1), default=0,
        help=f"random seed of {of}, default: 0",
    )  # fmt: skip


def _demo(to):
    p = _add(to, "demo", demo, "decompose the packaged night scene and draw the pictures")
    p.add_argument("--out", metavar="DIR", type=_folder, default=Path("demo"), help="default: demo")
    p.set_defaults(
        library=None, method=None, k=None, model=None, compare=False, budget=None, device="cpu",
        calibration_error=0.0, environment=None,
    )  # fmt: skip


def _cubes(to):
    text = "turn a third-party cube, or a part of one, into one for decompose"
    p = _add(to, "import", commands.import_, text)
    p.add_argument(
        "file", metavar="FILE", type=Path,
        help="ENVI .hdr or its binary, HADAR or TeX-1500 .mat, .npz, .npy (bands first), or a "
        "file that is already a heat cube",
    )  # fmt: skip
    p.add_argument("--out", metavar="CUBE", type=Path, required=True, help=".exr or .npz")
    p.add_argument(
        "--unit", metavar="UNIT",
        help="unit of the radiance: W/m2/sr/um, mW/m2/sr/um, microflick, W/m2/sr/cm-1 ..., or K "
        "for brightness temperatures; HADAR files do not need it",
    )  # fmt: skip
    for name, example in (("--wavelengths", "um, such as 8.06:13.94"), ("--wavenumbers", "cm-1")):
        p.add_argument(
            name, metavar="FIRST:LAST", type=_first_last,
            help="if the file does not state its bands: centres, not edges, of the first and last "
            f"of equidistant bands in {example}",
        )  # fmt: skip
    p.add_argument(
        "--fwhm", metavar="WIDTH", type=_width,
        help="if the file does not state it: width of each band in um, or in cm-1 if the bands are "
        "in cm-1",
    )  # fmt: skip
    p.add_argument(
        "--response", choices=("box", "gaussian"),
        help="spectral response of the bands, whose widths are at half maximum; default: as the "
        "file states, else box",
    )  # fmt: skip
    p.add_argument(
        "--netd", metavar="K", type=_above_0, help="sensor noise in K at 300 K, if known"
    )
    for name in ("--rows", "--columns"):
        p.add_argument(
            name, metavar="FROM:TO", type=_slice,
            help=f"keep these {name[2:]}, counted from 0, TO excluded; either end may be left out",
        )  # fmt: skip
    p.add_argument(
        "--range",
        metavar="LOW:HIGH",
        type=_low_high,
        help="keep the bands whose centres lie in this range, um",
    )

    p = _add(to, "simulate", commands.simulate, "path-trace a cube and write its truth beside it")
    p.add_argument(
        "scene", metavar="SCENE",
        help="forest, street, patches, patterned, room, random or enclosed, or a .json scene file",
    )  # fmt: skip
    p.add_argument("--out", metavar="CUBE", type=Path, required=True, help=".exr or .npz")
    p.add_argument(
        "--bands", metavar="N|FILE", type=_bands, default=54,
        help="number of adjoining bands, or a .json file from texnet bands, default: 54",
    )  # fmt: skip
    p.add_argument(
        "--size", metavar="HxW", type=_size, default=(256, 384), help="pixels, default: 256x384"
    )
    p.add_argument(
        "--spp", metavar="N", type=_integer(1, 100_000), default=64,
        help="light paths per pixel, default: 64",
    )  # fmt: skip
    p.add_argument(
        "--netd", metavar="K", type=_kelvin, default=0.05,
        help="sensor noise in K at 300 K, 0 for none, default: 0.05",
    )  # fmt: skip
    _add_seed(p, "light paths, noise and, if it is random, the scene")

    text = "find N filters, of one width up to 2 um, that best tell materials and temperatures"
    p = _add(to, "bands", commands.bands, text)
    p.add_argument("--n", metavar="N", type=_integer(3, 16), required=True, help="3-16")
    p.add_argument("--library", metavar="FILE", type=Path, help="JSON; default: starter library")
    p.add_argument("--out", metavar="FILE", type=Path, help="JSON, for simulate --bands")


def _decompose(to):
    p = _add(to, "decompose", decompose, "decompose a cube into TeX")
    p.add_argument("cube", metavar="CUBE", type=Path, help=".exr or .npz")
    p.add_argument("--out", metavar="DIR", type=_folder, required=True, help="made if not there")
    p.add_argument("--library", metavar="FILE", type=Path, help="JSON; default: starter library")
    p.add_argument(
        "--method", choices=METHODS,
        help="local: each pixel by itself; sgd: local, smoothed over neighbours; net: the network "
        "alone; net+sgd: the network, refined (default)",
    )  # fmt: skip
    p.add_argument(
        "--budget", metavar="S", type=_seconds,
        help="take the most accurate method that needs at most S seconds per megapixel on this "
        "machine",
    )  # fmt: skip
    p.add_argument(
        "--compare", action="store_true",
        help="write comparison.png, TeX vision beside CLAHE and principal components, even if no "
        "truth lies beside the cube",
    )  # fmt: skip
    p.add_argument(
        "--model", metavar="FILE", type=Path,
        help=".onnx, or .safetensors from train or finetune; default: the package's",
    )  # fmt: skip
    _add_device(p)
    p.add_argument(
        "--calibration-error", metavar="K", type=_kelvin, default=0.0,
        help="calibration uncertainty, in offset or gain, common to all radiance, as the camera's "
        "maker states it, in K at 300 K; sigma of T includes it; default: 0",
    )  # fmt: skip
    p.add_argument(
        "--k", metavar="N", type=_count,
        help="number of objects that stand for the environment, 1-10, or auto: as many as the "
        "scene supports; default: 5 if the sky is in view, else auto",
    )  # fmt: skip
    p.add_argument(
        "--environment", metavar="FILE", type=Path,
        help="use these measured objects instead: a text table of spectra, W m-2 sr-1 um-1, headed "
        "wavelength_um,sky,...; if all are sky, the other objects are found in the cube",
    )  # fmt: skip


def _training(to):
    # the defaults of training.train and training.finetune, which are slow to import
    text = "train a network on simulated scenes; about an hour"
    _add_training(to, "train", commands.train, text, 1600, 60, 320, "draws and first weights")
    text = "adapt a network to a library; minutes"
    p = _add_training(
        to, "finetune", commands.finetune, text, 48, 3, 160, "draws and the materials of objects"
    )
    p.add_argument("--library", metavar="FILE", type=Path, required=True, help="JSON")
    p.add_argument(
        "--model", metavar="FILE", type=Path, default=files("texnet") / "data" / WEIGHTS,
        help="weights to start from, default: the package's",
    )  # fmt: skip
    p.set_defaults(scenes=None)  # with --cubes there are none
    p.add_argument(
        "--cubes", metavar="CUBE", type=Path, nargs="+", default=[],
        help="train on these cubes only, without truth; .exr or .npz",
    )  # fmt: skip

    p = _add(to, "export", commands.export, "write a network as one ONNX file; minutes")
    p.add_argument("model", metavar="MODEL", type=Path, help=".safetensors")
    p.add_argument("--out", metavar="FILE", type=Path, required=True, help=".onnx")


def _add_training(to, name, run, text, scenes, epochs, per_epoch, seed):
    p = _add(to, name, run, text)
    p.add_argument("--out", metavar="FILE", type=Path, required=True, help=".safetensors")
    p.add_argument(
        "--scenes", metavar="N", type=_integer(1, 100_000), default=scenes,
        help=f"simulated scenes to train on, default: {scenes}",
    )  # fmt: skip
    p.add_argument(
        "--epochs", metavar="N", type=_integer(1, 10_000), default=epochs,
        help=f"number of epochs of {per_epoch} draws each, default: {epochs}",
    )  # fmt: skip
    p.add_argument(
        "--cache", metavar="DIR", type=_folder,
        default=Path(os.path.expanduser("~"), ".cache", "texnet"),
        help="folder of scenes and checkpoints, default: ~/.cache/texnet",
    )  # fmt: skip
    _add_seed(p, seed)
    _add_device(p)
    return p


def _measuring(to):
    p = to.add_parser("bench", help="measure this machine")
    actions = p.add_subparsers(required=True, metavar="ACTION", dest="action")
    text = "speed compared with the peers and the limits; up to fifteen minutes"
    p = _add(actions, "speed", commands.bench_speed, text)
    p.add_argument("--out", metavar="DIR", type=_folder, required=True, help="made if not there")
    p.add_argument(
        "--large", action="store_true",
        help="also measure a cube of 3.6 GB: five more minutes, and 20 GB of disk",
    )  # fmt: skip
    text = "accuracy on the test scenes; a quarter of an hour"
    p = _add(actions, "accuracy", commands.bench_accuracy, text)
    p.add_argument("--out", metavar="DIR", type=_folder, required=True, help="made if not there")
    p.add_argument(
        "--scenes", metavar="N", type=_integer(1, 999), default=24, help="1-999, default: 24"
    )
    p.add_argument(
        "--bands", metavar="N", type=_integer(1, 999), nargs="+", default=[4, 9, 18, 54, 100],
        help="numbers of bands, default: 4 9 18 54 100",
    )  # fmt: skip
    p.add_argument(
        "--methods", metavar="M", choices=METHODS, nargs="+", default=list(METHODS),
        help=f"some of {', '.join(METHODS)}; default: all",
    )  # fmt: skip
    p.add_argument(
        "--enclosed", action="store_true", help="enclose the same scenes in woods and streets"
    )
    p.add_argument(
        "--finer", metavar="TIMES", type=_integer(1, 8), default=1,
        help="multiply the pixels on each side by it, 1-8, default: 1",
    )  # fmt: skip
    text = "where methods fail, and whether they say so; about two hours"
    p = _add(actions, "stability", commands.bench_stability, text)
    p.add_argument("--out", metavar="DIR", type=_folder, required=True, help="made if not there")
    p.add_argument(
        "--axes", metavar="AXIS", nargs="+",
        help="some of the difficulties, by their names in docs/atlas.md (before the colon), "
        "default: all",
    )  # fmt: skip
    text = "accuracy against time, compared with the peers; up to half an hour"
    p = _add(actions, "chart", commands.bench_chart, text)
    p.add_argument("--out", metavar="DIR", type=_folder, required=True, help="made if not there")
    p.add_argument(
        "--network", metavar="FILE", type=Path, action="append", default=[],
        help=".safetensors of one more network to chart; may be given several times",
    )  # fmt: skip

    text = "reproduce one of the paper's results on our own scenes"
    p = _add(to, "reproduce", commands.reproduce, text)
    p.add_argument("figure", metavar="FIGURE", choices=FIGURES, help=", ".join(FIGURES))
    p.add_argument(
        "--out", metavar="DIR", type=_folder, default=Path("reproduce"), help="default: reproduce"
    )
    p.add_argument("--full", action="store_true", help="more pixels and scenes; minutes to hours")


def _library(to):
    p = to.add_parser("library", help="list, import or make libraries of materials")
    actions = p.add_subparsers(required=True, metavar="ACTION", dest="action")
    of = "JSON; default: starter library"
    p = _add(actions, "list", commands.library_list, "name every material")
    p.add_argument("--library", metavar="FILE", type=Path, help=of)
    p = _add(actions, "show", commands.library_show, "show one material: sources and emissivity")
    p.add_argument("name", metavar="NAME")
    p.add_argument("--library", metavar="FILE", type=Path, help=of)
    text = "compute the starter library from optical constants"
    p = _add(actions, "rebuild", commands.library_rebuild, text)
    p.add_argument(
        "--out", metavar="FILE", type=Path,
        default=files("physics") / "data" / "starter_library.json", help="default: the package's",
    )  # fmt: skip
    text = "turn a third-party library into one for --library"
    p = _add(actions, "import", commands.library_import, text)
    p.add_argument(
        "file", metavar="FILE", type=_file_or_folder,
        help="HADAR .mat, ECOSTRESS .txt or a folder of them, ENVI .hdr or .sli, .csv, or .json to "
        "add or name a sky",
    )  # fmt: skip
    p.add_argument("--out", metavar="FILE", type=Path, required=True, help="JSON")
    p.add_argument(
        "--wavenumbers", metavar="FIRST:LAST", type=_first_last,
        help="for .mat: first and last of equidistant bands in cm-1, such as 760:1240",
    )  # fmt: skip
    p.add_argument("--names", metavar="FILE", type=Path, help="for .mat: text, one name per line")
    p.add_argument("--sky", metavar="NAME", help="which material is the sky, if none is named sky")
    p.add_argument(
        "--add-sky", action="store_true", help="add the starter library's sky if the file has none"
    )

    text = "make a library from just a cube with sky in view"
    p = _add(actions, "from-cube", commands.library_from_cube, text)
    p.add_argument("cube", metavar="CUBE", type=Path, help=".exr or .npz, 20 bands or more")
    p.add_argument("--out", metavar="FILE", type=Path, required=True, help="JSON")
    p.add_argument(
        "--materials", metavar="N", type=_integer(1, 30),
        help="number of materials besides the sky; default: as many as its pixels need",
    )  # fmt: skip


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
    return text if text == "auto" else _integer(1, MOST_OBJECTS)(text)


def _bands(text):
    return Path(text) if Path(text).suffix.lower() == ".json" else _integer(1, 1000)(text)


def _size(text):
    match = re.fullmatch(r"([1-9][0-9]{0,3})x([1-9][0-9]{0,3})", text)
    if match is None:
        raise argparse.ArgumentTypeError(f"need HEIGHTxWIDTH such as 256x384, got {text!r}")
    return int(match[1]), int(match[2])


def _file_or_folder(text):
    if not text:  # would mean the current folder
        raise argparse.ArgumentTypeError("its name is empty")
    return Path(text)


def _first_last(text):
    match = re.fullmatch(r"([0-9]{1,6}\.?[0-9]{0,9}):([0-9]{1,6}\.?[0-9]{0,9})", text)
    if match is None:
        raise argparse.ArgumentTypeError(
            f"need FIRST:LAST, such as 8:14 in um or 760:1240 in cm-1, got {text!r}"
        )
    return float(match[1]), float(match[2])


def _low_high(text):
    match = re.fullmatch(r"([0-9]{1,3}\.?[0-9]{0,9}):([0-9]{1,3}\.?[0-9]{0,9})", text)
    if match is None or float(match[1]) > float(match[2]):
        raise argparse.ArgumentTypeError(f"need LOW:HIGH such as 8:13, in um, got {text!r}")
    return float(match[1]), float(match[2])


def _slice(text):
    match = re.fullmatch(r"([0-9]{0,9}):([0-9]{0,9})", text)
    if match is None:
        raise argparse.ArgumentTypeError(
            f"need FROM:TO such as 10:500, 10: or :500, counted from 0, got {text!r}"
        )
    return slice(*(int(end) if end else None for end in match.groups()))


def _kelvin(text):
    return _number(text, lambda k: 0 <= k <= MAX_NETD_K, f"need 0 to {MAX_NETD_K:g} K")


def _above_0(text):
    value = _kelvin(text)
    if value == 0:
        raise argparse.ArgumentTypeError("need more than 0 K; leave it out if it is not known")
    return value


def _width(text):
    return _number(text, lambda w: 0 < w < math.inf, "need a width above 0")


def _seconds(text):
    return _number(text, lambda s: 0 < s < math.inf, "need a number of seconds above 0")


def _number(text, fits, need):
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not fits(value):
        raise argparse.ArgumentTypeError(f"{need}, got {text!r}")
    return value


if __name__ == "__main__":
    sys.exit(main())
