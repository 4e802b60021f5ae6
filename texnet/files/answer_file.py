"""decomposition.npz: every field of a Decomposition under its own name, written and read again."""

import json
from dataclasses import fields
from pathlib import Path

import numpy as np

from physics.cube.heat_cube import check_wavelength, numbers
from physics.errors import InputError
from physics.machinery.array_file import load_arrays, save_arrays

from ..decomposition import Decomposition
from .answer_folder import FILES

NPZ = FILES[0]
OPTIONAL = "distance_m"  # None where no air was found
WHY = "left_out_why"  # of the bands that are left out: npz without pickle has no dict
TEXTS = "made_by", "seconds"  # JSON
# a letter an axis: of all but single numbers and texts
AXES = {
    "material": "hw", "temperature_k": "hw", "temperature_sigma_k": "hw", "sky_texture": "hw",
    "residual": "hw", "unknown": "hw", "saturated": "hw", "dead": "hw", "hot": "hw",
    OPTIONAL: "hw", "thermal_lighting": "khw", "texture": "bhw", "material_probability": "mhw",
    "material_names": "m", "hue_deg": "m", "emissivity": "mb", "environment": "kb",
    "wavelength_um": "b", "band_gains": "b", "sky": "s", "left_out": "l", WHY: "l",
    "objective": "o",
}  # fmt: skip


def save_decomposition(d: Decomposition, path: Path | str) -> None:
    """Write a Decomposition as an npz of plain arrays, whole or not at all."""
    arrays = {f.name: getattr(d, f.name) for f in fields(Decomposition)}
    arrays |= {name: np.array(json.dumps(arrays[name], ensure_ascii=False)) for name in TEXTS}
    arrays |= {
        "material_names": np.array(d.material_names, np.str_),
        "sky": np.asarray(d.sky, np.int64),
        "band_gains": np.broadcast_to(d.band_gains, len(d.wavelength_um)),
        "left_out": np.array(list(d.left_out), np.float64),
        WHY: np.array(list(d.left_out.values()), np.str_),
    }
    if d.distance_m is None:
        del arrays[OPTIONAL]
    # X is as random as its noise: packing it costs seconds, saves little
    save_arrays(path, arrays, compress=False)


def read_decomposition(path: Path | str) -> Decomposition:
    """The Decomposition that `texnet decompose` or `write_decomposition` wrote, all in memory.

    path  its folder, or the decomposition.npz there

    Raises InputError where that cannot be read, or holds no Decomposition.
    """
    path = Path(path)
    path = path / NPZ if path.is_dir() else path
    names = [*(f.name for f in fields(Decomposition) if f.name != OPTIONAL), WHY]
    a = load_arrays(path, names, "decomposition", [OPTIONAL])
    try:
        _check(a)
        texts = {name: json.loads(a[name].item()) for name in TEXTS}
    except ValueError as e:  # as InputError and JSON's own are
        raise InputError(f"{str(e).rstrip('.')} (in {path}).") from e
    left_out = dict(zip(a["left_out"].tolist(), a.pop(WHY).tolist(), strict=True))
    lists = {name: tuple(a[name].tolist()) for name in ("material_names", "sky", "objective")}
    single = {name: a[name].item() for name in a.keys() - AXES.keys()}
    return Decomposition(**a | single | lists | texts | {"left_out": left_out})


def _check(arrays):
    """InputError unless the file's arrays are of the kinds and sizes that Decomposition says."""
    size = {}
    for name, array in arrays.items():
        what, axes = f"decomposition: {name}", AXES.get(name, "")
        text = name in ("material_names", WHY, *TEXTS)
        if (array.dtype.kind == "U") != text and array.size:
            raise InputError(f"{what} must be {'text' if text else 'numbers'}.")
        if not text and array.dtype.kind != "b":
            numbers(array, what)
        if array.ndim != len(axes):
            raise InputError(f"{what} must have {len(axes)} axes, got {array.ndim}.")
        for axis, n in zip(axes, array.shape, strict=True):
            if size.setdefault(axis, n) != n:
                raise InputError(f"{what} is {array.shape}, which does not fit the others.")
    check_wavelength(arrays["wavelength_um"], "decomposition")
    material = arrays["material"]
    if material.dtype.kind not in "iu" or not ((material >= 0) & (material < size["m"])).all():
        raise InputError(f"decomposition: material must hold whole numbers, 0..{size['m'] - 1}.")
