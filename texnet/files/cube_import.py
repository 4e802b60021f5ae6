"""Third-party cubes, turned into a HeatCube, with a note of what was converted.

ENVI: `.hdr` beside its binary; see `envi`. The caller states the unit of radiance.

HADAR `.mat` (up to v7): `S` or `HSI`, height x width x bands, W m-2 sr-1 per cm-1. The bands are
not in the file, so the caller states them: equidistant in wavenumber, in the file's order.

TeX-1500 `.mat` or `.npz`: a cube of either axis order; wavelengths in um, of all its bands or of
the good ones only; and these bands' indices or a mask. Of the lists of keys below the first key
present is used, for wavelengths the first that fits. Widths of the same bands and NETD are used if
present. The caller states the unit.

`.npy`: (bands, height, width); the caller states bands and unit.

Parts of heat cubes themselves (`cube_io`).
"""

import os
import re
from pathlib import Path

import numpy as np
from numpy.lib.format import open_memmap

from physics.cube.heat_cube import HeatCube, numbers
from physics.errors import InputError
from physics.machinery.array_file import BROKEN_NPY

from .cube_io import RESPONSE, read_cube, response_of, some_arrays, unpacked
from .envi import header_of, read_envi
from .library_io import PUBLISHED_CM1
from .mat_file import read_mat
from .raw_cube import OUR_UNIT, RawCube, heat_cube, part_of
from .units import UNIT_NAMES, unit_of
from .wavelengths import PER_UM

HEAT_CUBE = "heat cube"
TEMPERATURE = re.compile(  # in a header
    r"kelvin|celsius|°C|deg(rees)?\s*C\b|temperature|^\s*m?K\s*$", re.IGNORECASE
)
HADAR_MAT, HADAR = "HADAR .mat", ("S", "HSI")
CUBE = ("denoised_hsi_original", "denoised_hsi", "hsi", "HSI", "radiance", "cube")
WAVELENGTH = ("working_wav", "hsi_wav", "wavelength", "wavelength_um", "wav", "lambda")
OUR_ARRAYS = {"radiance", "wavelength_um"}
WIDTH, NETD = ("fwhm_um", "fwhm"), "netd_k"
GOOD_BANDS = ("good_band_indices", "good_bands", "band_indices", "valid_band_indices")


def import_cube(
    path: Path | str,
    unit: str | None = None,
    wavelengths_um: tuple[float, float] | None = None,
    wavenumbers_cm1: tuple[float, float] | None = None,
    netd_k: float | None = None,
    progress=None,
    *,
    fwhm: float | None = None,
    response: str | None = None,
    rows: slice | None = None,
    columns: slice | None = None,
    range_um: tuple[float, float] | None = None,
) -> tuple[HeatCube, str]:
    """Read the cube at path (.hdr or its binary, .mat, .npz, .npy, .exr; see the module).

    unit             of its radiance, one of `units.UNIT_NAMES`; if the file does not state it
    wavelengths_um, wavenumbers_cm1
                     of the first and the last band, equidistant; one of the two, if the file does
                     not state its bands
    netd_k           noise at 300 K, K, if known
    progress         called as progress(done, total, what)
    fwhm             full width of each band at half maximum, if the file does not state it: um, or
                     cm-1 if the bands are in cm-1
    response         of the bands, "box" or "gaussian"; "box" if None, unless the file states one
    rows, columns, range_um
                     a part of it: slices, and the lowest and the highest band centre in um

    Returns (HeatCube, note): one sentence on what was converted from what, followed by a warning
    if the scene's temperature is unusual. A large cube is not held in memory (except from a .mat,
    which is at most 4 GB). Raises InputError if the file is damaged or leaves the meaning of its
    numbers open.
    """
    path = Path(path)
    if not os.path.isfile(path):  # unlike Path.is_file, False where access is denied
        what = "is a folder" if os.path.isdir(path) else "does not exist"
        raise InputError(f"cube: {path} {what}; give a file.")
    if unit is not None and (unit := unit_of(str(said := unit))) is None:
        raise InputError(f"cube: {said!r} is not a known unit; use {', '.join(UNIT_NAMES)}.")
    wavelengths_um = _pair(wavelengths_um, "wavelengths_um")
    wavenumbers_cm1 = _pair(wavenumbers_cm1, "wavenumbers_cm1")
    range_um = _pair(range_um, "range_um")
    for name, part in (("rows", rows), ("columns", columns)):
        try:
            part is None or part.indices(1)
        except (AttributeError, TypeError, ValueError) as e:
            said = f"cube: {name} must be a slice, as slice(0, 100), got {part!r}."
            raise InputError(said) from e
    try:
        raw = _read(path, unit)
        if raw.what == HEAT_CUBE and unit not in (None, raw.unit):
            raise InputError(f"cube: {path} states its unit, {raw.unit}; leave out --unit.")
        if raw.what.startswith(HADAR_MAT) and wavelengths_um is not None:
            raw = raw._replace(unit=None)  # an array of that name, but not a published cube
        raw = _with_bands(raw, path, wavelengths_um, wavenumbers_cm1)
        raw = _with_width(raw, path, fwhm)
        raw = raw if response is None else raw._replace(response=response)
        raw = part_of(raw, rows, columns, range_um)
        if raw.unit is None and unit is None:
            says = "does not say which unit its radiance is in"
            if raw.unit_said:
                says = f"says {raw.unit_said!r}"
            if TEMPERATURE.search(raw.unit_said):
                raise InputError(
                    f"cube: {path} {says}: if these are brightness temperatures in K, give --unit "
                    "K; else use the radiance that they were made from, in which materials differ."
                )
            raise InputError(f"cube: {path} {says}; give --unit, one of {', '.join(UNIT_NAMES)}.")
        cube, note = heat_cube(raw._replace(unit=unit or raw.unit), netd_k, progress)
    except OSError as e:
        raise InputError(f"cube: cannot read {e.filename or path}: {e.strerror or e}.") from e
    return cube, f"{path}: {note}"


def _pair(values, name):
    """Two floats, or None; else InputError."""
    if values is None:
        return None
    pair = numbers(values, f"cube: {name}")
    if pair.shape != (2,) or not np.isfinite(pair).all():
        raise InputError(f"cube: {name} must be two numbers, got {values!r}.")
    return tuple(map(float, pair))


def _read(path, unit):
    kind = path.suffix.lower()
    if kind == ".mat":
        return _read_mat(path)
    if kind == ".npz":
        return _read_npz(path, unit)
    if kind == ".npy":
        return _read_npy(path)
    if kind == ".exr":
        return _read_ours(path)
    if kind == ".hdr" or header_of(path):
        return read_envi(path)
    raise InputError(
        f"cube: {path.name} is not a known kind of cube file; use ENVI (its .hdr must lie beside "
        "it), .mat, .npz or .npy."
    )


def _with_bands(raw, path, wavelengths_um, wavenumbers_cm1):
    """raw with the band centres that the caller states, if the file does not."""
    stated = wavelengths_um is not None or wavenumbers_cm1 is not None
    if raw.centre is not None and stated:
        raise InputError(
            f"cube: {path} states its own bands; leave out --wavelengths and --wavenumbers."
        )
    if raw.centre is not None:
        return raw
    bands = raw.numbers().shape[0]
    if not stated:
        raise InputError(
            f"cube: {path} does not say where its {bands} bands lie; give --wavenumbers FIRST:LAST "
            f"in cm-1 or --wavelengths FIRST:LAST in um, in the file's order{raw.hint}."
        )
    if wavelengths_um is not None and wavenumbers_cm1 is not None:
        raise InputError("cube: give either --wavelengths or --wavenumbers, not both.")
    first, last = wavelengths_um or wavenumbers_cm1
    if bands == 1 and first != last:
        raise InputError(f"cube: {path} has one band; give its centre twice, as in 11:11.")
    centre, words = np.linspace(first, last, bands), raw.words
    usual = PUBLISHED_CM1.get(bands) if raw.what.startswith(HADAR_MAT) else None
    if usual and wavenumbers_cm1 and usual != f"{first:g}:{last:g}":
        words = (*words, f"not the {usual} cm-1 of published cubes of {bands} bands")
    return raw._replace(centre=centre, axis="um" if wavelengths_um else "cm-1", words=words)


def _with_width(raw, path, fwhm):
    """raw with the width of every band that the caller states, if the file does not."""
    if fwhm is None:
        return raw
    width = numbers(fwhm, "cube: fwhm")
    if width.ndim or not 0 < width < np.inf:
        raise InputError(f"cube: fwhm must be one width above 0, got {fwhm!r}.")
    if raw.fwhm is not None and np.any(raw.fwhm):
        raise InputError(f"cube: {path} states the widths of its bands; leave out --fwhm.")
    width = float(width) * PER_UM.get(raw.axis, 1.0)
    return raw._replace(fwhm=np.full(len(raw.centre), width))


# --- .exr, .npz, .mat and .npy -----------------------------------------------------------


def _read_ours(path):
    """A RawCube of what already is a heat cube, of which a part may be wanted."""
    cube = read_cube(path)
    measured, stated = cube.measured(), cube.fwhm_um.any()
    return RawCube(
        HEAT_CUBE, lambda: measured, cube.wavelength_um, cube.fwhm_um if stated else None,
        unit=OUR_UNIT,
        netd_k=cube.netd_k, response=cube.response,
    )  # fmt: skip


def _read_mat(path):
    try:
        held = read_mat(path)
    except InputError as e:
        raise InputError(f"cube: {e}") from e
    arrays = {key: value for key, value in held.items() if isinstance(value, np.ndarray)}
    cubes = (*CUBE, *HADAR) if _first(WAVELENGTH, arrays) else CUBE
    hadar, whole = _first(HADAR, arrays), _first(cubes, arrays) and _first(WAVELENGTH, arrays)
    other = [key for key in (*HADAR, *CUBE, *WAVELENGTH) if key in held and key not in arrays]
    if other and not (hadar or whole):
        raise InputError(
            f"cube: {other[0]} in {path} must be an array of real numbers, not complex, sparse or "
            "a struct."
        )
    if hadar is None or whole:
        one = all(arrays[key].size == 1 for key in WAVELENGTH if key in arrays)
        load = lambda key: _of_one_band(arrays.get(key)) if one else arrays.get(key)
        return _tex1500(path, held, arrays, load, cubes=cubes)
    s = _of_one_band(arrays[hadar])
    if s.ndim != 3:
        raise InputError(f"cube: {hadar} in {path} must be height x width x bands, not {s.shape}.")
    s = s.transpose(2, 0, 1)
    hint = ""
    if len(s) in PUBLISHED_CM1:
        hint = f" (published cubes of {len(s)} bands need --wavenumbers {PUBLISHED_CM1[len(s)]})"
    return RawCube(f"{HADAR_MAT}, {hadar}", lambda: s, unit="W/m2/sr/cm-1", hint=hint)


def _of_one_band(array):
    """An array with the third axis restored that MATLAB drops for a single band."""
    return array[..., None] if array is not None and array.ndim == 2 else array


def _read_npz(path, unit):
    held, arrays = some_arrays(path, (*WAVELENGTH, *GOOD_BANDS, *WIDTH, NETD, RESPONSE))
    # our own files need not state unit and axes
    ours = OUR_ARRAYS <= set(held) and set(held).isdisjoint(GOOD_BANDS)
    if ours and unit is None and _in_order(arrays):
        return _read_ours(path)
    raw = _tex1500(path, held, arrays, lambda key: unpacked(path, key), ours)
    if RESPONSE in arrays:
        raw = raw._replace(response=response_of(arrays[RESPONSE]))
    return raw._replace(unit=OUR_UNIT) if ours else raw


def _in_order(arrays):
    """Whether wavelengths and widths among arrays are those of a heat cube, except for values."""
    w, width = arrays["wavelength_um"], arrays.get(WIDTH[0])
    ordered = w.dtype.kind in "fiu" and w.ndim == 1 and (np.diff(w.astype(float)) > 0).all()
    return ordered and (width is None or width.shape == w.shape)


# if the axis order is ambiguous
OTHERWISE = "; leave out a row, or save it as .npz with radiance (bands first) and wavelength_um"


def _tex1500(path, held, arrays, load, ours=False, cubes=CUBE):
    """A RawCube from a TeX-1500 file that holds arrays of these names, given some of them, and
    load, which reads its cube by one of the names cubes; in our own layout bands come first if
    they can."""
    cube, indices = _first(cubes, held), _first(GOOD_BANDS, arrays)
    found = {key: arrays[key].ravel() for key in WAVELENGTH if key in arrays}
    if cube is None or not found:
        raise InputError(
            f"cube: {path} must hold a cube ({', '.join(CUBE)}, or HADAR's S) and, unless it is "
            f"HADAR's, its wavelengths in um ({', '.join(WAVELENGTH)}); it holds "
            f"{', '.join(held) or 'nothing'}."
        )
    listed = None
    if indices is not None:
        listed = arrays[indices].ravel()
        listed = _real(listed * 1 if listed.dtype == bool else listed, indices, path)
    s = load(cube)
    wavelength, axis, good_alone = _where(s, found, listed, ours)
    w = _real(found[wavelength], wavelength, path)
    if axis is None:
        shape = "no array" if s is None else " x ".join(map(str, s.shape))
        both = s is not None and s.ndim == 3 and s.shape[0] == w.size
        raise InputError(
            f"cube: {cube} in {path} is {shape}, so that its {w.size} bands ({wavelength}) "
            f"{'may be its first axis or' if both else 'are neither its first axis nor'} its last"
            f"{both * OTHERWISE}."
        )
    width, netd = _first(WIDTH, arrays), _known(NETD, arrays, path)
    fwhm = _known(width, arrays, path)
    if netd is not None and netd.size > 1:
        raise InputError(f"cube: {NETD} in {path} must be one number.")
    if fwhm is not None and fwhm.size not in (1, w.size, s.shape[axis]):
        raise InputError(
            f"cube: {width} in {path} holds {fwhm.size} widths for {w.size} bands ({wavelength})."
        )
    s = np.moveaxis(s, axis, 0)
    axes = "height x width x bands" if axis else "bands x height x width"
    words, good, doubt = [], None, ""
    if listed is not None:
        good, words, doubt = _good_bands(listed, indices, len(s))
    if good_alone:
        order = slice(None) if _is_mask(listed, len(s)) else np.argsort(listed)

        def of_all(of_good):  # unknown for bad bands
            every = np.zeros(len(s))
            every[good] = of_good[order]
            return every

        if fwhm is not None and fwhm.size == w.size:
            fwhm = of_all(fwhm)
        w, words = of_all(w), [*words, f"{wavelength} lists only these"]
    if fwhm is not None:
        fwhm = np.broadcast_to(fwhm, len(s))
    what = "npz" if ours else f"TeX-1500 {path.suffix}"
    return RawCube(
        f"{what}, {cube} ({axes}) over {wavelength}", lambda: s, w, fwhm, good=good,
        netd_k=None if netd is None else netd.item(), words=tuple(words), doubt=doubt,
    )  # fmt: skip


def _known(key, arrays, path):
    """(n,) the numbers of an array; None if it is absent, or says nothing."""
    array = np.ravel(arrays.get(key, ()))
    if array.dtype.kind == "f" and np.isnan(array).all():  # or empty
        return None
    return _real(array, key, path)


def _where(s, found, listed, ours):
    """(key, axis, alone) of a cube s, given wavelengths by key and the good bands as listed: the
    first wavelengths that fit one of its ends (the first end, if it is ours); else those of the
    good bands alone, with bands along the shorter end, if both are long enough. axis is None if
    nothing fits."""
    first, ends = next(iter(found)), {}
    if s is not None and s.ndim == 3:
        ends = {0: s.shape[0], 2: s.shape[2]}
    for key, w in found.items():
        if ours and ends.get(0) == w.size:
            return key, 0, False
        if list(ends.values()).count(w.size) == 1:
            return key, next(a for a, size in ends.items() if size == w.size), False
    if found[first].size in ends.values() or listed is None or not listed.size:
        return first, None, False
    for axis, size in sorted(ends.items(), key=lambda end: end[1]):
        mask = _is_mask(listed, size)
        for key, w in found.items():
            if mask and w.size == listed.sum() or w.size == listed.size and listed.max() <= size:
                return key, axis, True
    return first, None, False


def _is_mask(listed, bands):
    """Whether listed is a mask of good bands (if there are three or more: with two, 0 and 1 are
    indices)."""
    return listed.size == bands > 2 and set(listed) <= {0, 1}


def _good_bands(listed, key, bands):
    """((bands,) bool, words, doubt) from a mask of bands, or a list of indices, which count from 0
    if they can."""
    if _is_mask(listed, bands):
        return listed.astype(bool), [f"{key} is a mask"], ""
    count_from = 1 if listed.size and listed.min() >= 1 and listed.max() == bands else 0
    good = np.isin(np.arange(bands) + count_from, listed)
    if np.count_nonzero(good) != listed.size:
        raise InputError(f"cube: {key} must hold indices of its {bands} bands, each once.")
    doubt = ""
    if count_from == 0 and 0 not in listed:
        doubt = (
            f"if {key} counts from 1, as MATLAB does, every band is off by one; subtract 1 from it."
        )
    return good, [f"{key} counts from {count_from}"], doubt


def _read_npy(path):
    try:
        s = open_memmap(path, mode="r")
    except BROKEN_NPY as e:
        raise InputError(f"cube: {path} is not a whole npy file of plain numbers.") from e
    if s.dtype.kind not in "fiu" or s.ndim != 3:
        raise InputError(f"cube: {path} must hold one array of real numbers with three axes.")
    return RawCube("npy (bands x height x width)", lambda: open_memmap(path, mode="r"))


def _first(keys, held):
    return next((key for key in keys if key in held), None)


def _real(array, key, path):
    if array.dtype.kind not in "fiu" or not np.isfinite(array).all():
        raise InputError(f"cube: {key} in {path} must hold finite real numbers.")
    return array
