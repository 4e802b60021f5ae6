"""What `texnet decompose` leaves in its folder: the numbers, the pictures, the maps.

    decomposition.npz  every field of the Decomposition
    tex_vision.png     the TeX-vision picture, pixel for pixel
    maps.png           every map with its units (and truth and error where truth is known)
    comparison.png     TeX vision beside what people look at today, if wanted
    maps.exr           T (K), sigmaT (K), material (index), unknown and dead (0, 1), residual
                       (noise units), skyTexture (W m-2 sr-1 um-1), V.0 ... V.<k-1>; float32

docs/files.md says more of each.
"""

import json
import os
import tempfile
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import matplotlib.image
import numpy as np

from physics.truth import Truth

from .decomposition import Decomposition, check_decomposition
from .figures import comparison_figure, maps_figure, own_style
from .files.answer_file import NPZ, save_decomposition
from .files.answer_folder import check_directory
from .files.exr_file import write_exr
from .vision import tex_vision

PREFIX = ".texnet-"  # of the hidden folder in which files are made


def write_decomposition(
    decomposition: Decomposition,
    directory: Path | str,
    pictures: dict | None = None,
    truth: Truth | None = None,
) -> dict[str, Path]:
    """Write the files of a Decomposition into directory, made if it is not there.

    pictures  texnet.baselines.baseline_pictures of the cube, for comparison.png; None: without
    truth     the cube's physics.truth.Truth; with it the figures show it and the errors

    Returns {"decomposition": path, "tex_vision": ..., "maps": ..., "comparison": ...,
    "maps_exr": ...}. All files are made in a hidden neighbour first, so that a failure or
    Ctrl-C while they are made leaves an older answer as it was. Raises InputError if directory
    is a file, or the decomposition none.
    """
    check_decomposition(decomposition)
    directory = Path(directory)
    check_directory(directory)
    # beside it, or in it where it may be a disk of its own
    near = directory if directory.is_dir() else directory.parent
    with _as_of(directory), tempfile.TemporaryDirectory(dir=near, prefix=PREFIX) as made:
        made = Path(made)
        with ThreadPoolExecutor(1) as beside:  # the disk, zlib and OpenEXR leave a core to Python
            written = beside.submit(_write_numbers, decomposition, made)
            with own_style():
                matplotlib.image.imsave(made / "tex_vision.png", tex_vision(decomposition))
                maps_figure(decomposition, truth, made / "maps.png")
                if pictures is not None:
                    comparison_figure(decomposition, pictures, truth, made / "comparison.png")
            written.result()
        directory.mkdir(exist_ok=True)
        older = (directory / NPZ).exists()  # else the picture is somebody's own
        for file in made.iterdir():
            os.replace(file, directory / file.name)
        if pictures is None and older:
            (directory / "comparison.png").unlink(missing_ok=True)
    paths = {
        "decomposition": directory / NPZ,
        "tex_vision": directory / "tex_vision.png",
        "maps": directory / "maps.png",
        "maps_exr": directory / "maps.exr",
    }
    if pictures is not None:
        paths["comparison"] = directory / "comparison.png"
    return paths


@contextmanager
def _as_of(directory):
    """An OSError of a file in the hidden neighbour of a directory is said of it in that."""
    try:
        yield
    except OSError as e:
        hidden = Path(e.filename or "")
        if hidden.name.startswith(PREFIX):
            e.filename, e.filename2 = str(directory), None
        elif hidden.parent.name.startswith(PREFIX):
            e.filename, e.filename2 = str(directory / hidden.name), None
        raise


def _write_numbers(d, directory):
    save_decomposition(d, directory / NPZ)
    _write_maps_exr(d, directory / "maps.exr")


def _write_maps_exr(d, path):
    maps = {
        "T": d.temperature_k,
        "sigmaT": d.temperature_sigma_k,
        "material": d.material,
        "unknown": d.unknown,
        "dead": d.dead,
        "residual": d.residual,
        "skyTexture": d.sky_texture,
    } | {f"V.{j}": v for j, v in enumerate(d.thermal_lighting)}
    channels = {name: np.ascontiguousarray(m, dtype=np.float32) for name, m in maps.items()}
    header = {"materialNames": json.dumps(d.material_names), "madeBy": json.dumps(d.made_by)}
    write_exr(header, channels, path)
