"""Heat cubes on disk: spectral OpenEXR and npz, read into and written from a HeatCube.

`.exr`: one float32 channel per band, in the layout of Fichet, Pacanowski and Wilkie, "An
OpenEXR Layout for Spectral Images" (JCGT 2021): `S0.8055,555556nm` is the emitted radiance
at 8055.555556 nm. That layout says W m-2 sr-1 but not per what, so attributes of our own complete
it:

    texnetSpectralDensity  "um^-1": the radiance is per um of wavelength
    texnetFwhmUm           one band width in um per band, ascending, space-separated
    texnetResponse         of the bands: "box" (if left out) or "gaussian"
    texnetNetdK            NETD in K at 300 K; left out if unknown

`.npz`: arrays radiance (bands, height, width) in W m-2 sr-1 um-1, wavelength_um (bands,)
and, if known, fwhm_um (bands,), netd_k (a scalar; NaN: unknown) and response (a text: "box" or
"gaussian").
"""

import io
import os
import re
import sys
import threading
import zipfile
from contextlib import contextmanager, redirect_stdout
from decimal import Decimal
from difflib import get_close_matches
from pathlib import Path
from tempfile import TemporaryFile

import numpy as np

from physics.bands import BOX
from physics.cube.heat_cube import HeatCube
from physics.errors import InputError
from physics.machinery import scratch
from physics.machinery.array_file import BROKEN_NPZ, save_arrays
from physics.machinery.whole_file import check_writable, whole_file

from .exr_file import check_exr_name, write_exr

# Fichet et al. 2021, as their own library spells it.
CHANNEL = re.compile(
    r"^((S([0-3]))|T)\.(\d*,?\d*([Ee][+-]?\d+)?)(Y|Z|E|P|T|G|M|k|h|da|d|c|m|u|n|p)?(m|Hz)$"
)
EXPONENT = {
    None: 0, "Y": 24, "Z": 21, "E": 18, "P": 15, "T": 12, "G": 9, "M": 6, "k": 3, "h": 2,
    "da": 1, "d": -1, "c": -2, "m": -3, "u": -6, "n": -9, "p": -12,
}  # fmt: skip
EXR_UNITS = "W.m^-2.sr^-1"
# W m-2 sr-1 per this unit, times the factor, is W m-2 sr-1 per um.
EXR_DENSITIES = {".um^-1": 1.0, ".nm^-1": 1e3, ".m^-1": 1e-6}
READ_BYTES = 1 << 26  # at once
RESPONSE = "response"
BESIDE_RADIANCE = ("wavelength_um", "fwhm_um", "netd_k", RESPONSE)
SPEED_OF_LIGHT_UM = Decimal("2.99792458e14")  # um s-1


def truth_path(cube_path):
    """Path of the truth of a simulated cube, beside the cube."""
    return Path(cube_path).with_suffix(".truth.npz")


def read_cube(path: Path | str) -> HeatCube:
    """Read a heat cube from an .exr or .npz file (see the module for their layouts).

    Bands are returned in um and W m-2 sr-1 um-1 whatever the file's units, those of an .exr in
    ascending order (those of an .npz must be). A large cube is not held in memory but unpacked into
    a temporary file.

    Raises InputError if the file is missing, damaged, or leaves its units open.
    """
    path = Path(path)
    read, _ = _format(path)
    if not os.path.exists(path):  # unlike Path.exists, False where access is denied
        raise InputError(f"cube: there is no file {path}.")
    if path.is_dir():
        raise InputError(f"cube: {path} is a folder, not a cube.")
    if not os.access(path, os.R_OK):
        raise InputError(f"cube: {path} may not be read; check its permissions.")
    try:
        return read(path)
    except UnicodeDecodeError as e:  # some are raised only on access
        raise InputError(f"cube: {path} holds names or attributes that are not UTF-8.") from e


def write_cube(cube: HeatCube, path: Path | str) -> None:
    """Write a HeatCube to path, .exr or .npz, whole or not at all."""
    path = Path(path)
    _, write = _format(path)
    if not isinstance(cube, HeatCube):
        raise InputError(f"cube: write_cube takes a HeatCube, got {type(cube).__name__}.")
    with whole_file(path) as part:
        write(cube, part)


def check_cube_path(path, *inputs):
    """Raise InputError, before the work, if no cube could be written at path, or if it is one of
    inputs, paths that are read, or None."""
    check_writable(path, *inputs, suffix=_FORMATS)
    _format(Path(path))
    if Path(path).suffix.lower() == ".exr" and os.path.islink(path):  # the target is written
        check_exr_name(os.path.realpath(path))


def channel_name(wavelength_um):
    """Fichet's name of a band: S0, decimal comma, nm to six decimals."""
    return f"S0.{wavelength_um * 1e3:.6f}nm".replace(".", ",").replace("S0,", "S0.")


def channel_wavelength_um(name):
    """Wavelength in um of an emitted-radiance (S0) channel; None for any other channel."""
    match = CHANNEL.match(name)
    if match is None or match[3] != "0":
        return None
    number, prefix, unit = match[4].replace(",", "."), match[6], match[7]
    if not any(c in "123456789" for c in re.split("[Ee]", number)[0]):
        raise InputError(f"cube: channel {name!r} names no wavelength or frequency.")
    # Decimal, so that 8055,555556nm is read as exactly the float that 8.055555556 is.
    try:
        value = Decimal(number).scaleb(EXPONENT[prefix])
        return float(value.scaleb(6) if unit == "m" else SPEED_OF_LIGHT_UM / value)
    except ArithmeticError as e:  # a number with too many digits
        raise InputError(f"cube: channel {name!r} names no wavelength or frequency.") from e


def _format(path):
    if path.suffix.lower() not in _FORMATS:
        kinds = " or ".join(_FORMATS)
        raise InputError(
            f"cube: {path} is not a known kind of cube file; use {kinds} (texnet import "
            "converts ENVI, .mat and .npy)."
        )
    if path.suffix.lower() == ".exr":
        check_exr_name(path)
    return _FORMATS[path.suffix.lower()]


# --- npz ---------------------------------------------------------------------------------


def _read_npz(path):
    held, arrays = some_arrays(path, BESIDE_RADIANCE)
    missing = {"radiance", "wavelength_um"} - set(held)
    if missing:
        raise InputError(
            f"cube: {path} lacks {' and '.join(sorted(missing))}; "
            f"it holds {', '.join(sorted(held)) or 'nothing'}."
        )
    for key in set(held) - {"radiance", *BESIDE_RADIANCE}:
        if meant := get_close_matches(key, set(BESIDE_RADIANCE) - set(held), n=1):
            raise InputError(f"cube: {path} holds {key}; call it {meant[0]}, or leave it out.")
    response = arrays.pop(RESPONSE, np.array(BOX))
    for key, array in arrays.items():
        _check_numbers(array.dtype, key, path)
    netd = arrays.pop("netd_k", np.array(np.nan))
    if netd.size != 1:
        raise InputError(f"cube: netd_k in {path} must be one number, got shape {netd.shape}.")
    netd = netd.item()
    return HeatCube(
        unpacked(path, "radiance"), **arrays, netd_k=None if np.isnan(netd) else netd,
        response=response_of(response),
    )  # fmt: skip


def response_of(array):
    """The text in an array, and whether that is a response that HeatCube supports."""
    return str(array.item() if array.size == 1 else array)


def some_arrays(path, keys):
    """Names of all arrays in an npz, and those with these keys, if present -> list, dict."""
    try:
        # Opened here, because np.load leaks the file if the zip is incomplete.
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as data:
            return data.files, {key: _plain(data, key, path) for key in keys if key in data.files}
    except InputError:
        raise
    except PermissionError as e:
        raise InputError(f"cube: {path} may not be read; check its permissions.") from e
    except BROKEN_NPZ as e:
        raise InputError(f"cube: {path} is not a whole npz file of plain arrays.") from e


def _plain(data, key, path):
    try:
        return data[key]
    except ValueError as e:
        if "Object arrays" not in str(e):
            raise
        said = f"cube: {key} in {path} holds None or other objects; leave it out, or give numbers."
        raise InputError(said) from e


def unpacked(path, key):
    """An array of real numbers in an npz as read-only float32, read part by part."""
    try:
        with zipfile.ZipFile(path) as archive, archive.open(f"{key}.npy") as npy:
            version = np.lib.format.read_magic(npy)
            read_header = {
                (1, 0): np.lib.format.read_array_header_1_0,
                (2, 0): np.lib.format.read_array_header_2_0,
            }[version]
            shape, fortran, dtype = read_header(npy)
            _check_numbers(dtype, key, path)
            radiance = scratch.zeros(shape[::-1] if fortran else shape, np.float32)
            flat, n = radiance.reshape(-1), READ_BYTES // dtype.itemsize
            for start in range(0, flat.size, n):
                part = flat[start : start + n]
                values = np.frombuffer(npy.read(part.size * dtype.itemsize), dtype)
                if len(values) < len(part):
                    raise EOFError
                with np.errstate(over="ignore"):  # infinity is reported later
                    part[:] = values
                scratch.release(radiance)
            npy.read(1)  # the checksum is verified at its end
    except InputError:
        raise
    except (*BROKEN_NPZ, KeyError) as e:
        raise InputError(f"cube: {path} is not a whole npz file of plain arrays.") from e
    radiance.setflags(write=False)
    return radiance.T if fortran else radiance


def _check_numbers(dtype, key, path):
    if dtype.kind not in "fiu":
        raise InputError(f"cube: {key} in {path} must be real numbers, not {dtype}.")


def _write_npz(cube, path):
    arrays = {
        "radiance": cube.measured(),
        "wavelength_um": cube.wavelength_um,
        "fwhm_um": cube.fwhm_um,
        "netd_k": np.nan if cube.netd_k is None else cube.netd_k,
        RESPONSE: cube.response,
    }
    save_arrays(path, arrays, compress=False)


# --- spectral OpenEXR --------------------------------------------------------------------


_ALONE = threading.Lock()  # stdout and stderr belong to the process, not to a thread


@contextmanager
def _quiet_library():
    """Keep OpenEXR's messages on damaged files from stdout (Python's) and stderr (C's). It has none
    on a sound file: what other threads wrote meanwhile is written afterwards."""
    out = io.StringIO()
    with _ALONE:
        try:
            saved = os.dup(2)
        except OSError:  # closed already
            with redirect_stdout(out):
                yield
        else:
            with _unheard() as words, redirect_stdout(out):
                os.dup2(words.fileno(), 2)
                try:
                    yield
                finally:
                    os.dup2(saved, 2)
                    os.close(saved)
                words.seek(0)
                if err := words.read():
                    os.write(2, err)
    if out.getvalue():
        sys.stdout.write(out.getvalue())


def _unheard():
    """A file for the messages or, if there is no room for one, the null device."""
    try:
        return TemporaryFile()
    except OSError:
        return open(os.devnull, "w+b")


def _read_exr(path):
    import OpenEXR

    try:
        with _quiet_library(), OpenEXR.File(str(path), header_only=True) as file:
            header, parts = dict(file.header()), len(file.parts)
    except UnicodeDecodeError:
        raise
    except (RuntimeError, ValueError, TypeError, OSError, MemoryError) as e:
        raise InputError(f"cube: {path} is not a whole OpenEXR file.") from e

    if parts > 1:
        raise InputError(
            f"cube: {path} has {parts} parts; give one with all bands in a single part."
        )
    channels = {c.name: c for c in header["channels"]}
    bands = {name: w for name in channels if (w := channel_wavelength_um(name)) is not None}
    if not bands:
        raise InputError(
            f"cube: {path} has no spectral channels such as S0.8000,0nm; "
            f"it holds {', '.join(sorted(channels)) or 'nothing'}."
        )
    names = sorted(bands, key=bands.get)
    if len({(channels[name].xSampling, channels[name].ySampling) for name in names}) > 1:
        raise InputError(
            f"cube: the bands of {path} differ in size (subsampled channels); save them alike."
        )
    to_per_um = np.float32(_to_per_um(header, path))
    return HeatCube(
        _scanlines(path, names, header["dataWindow"], to_per_um),
        [bands[name] for name in names],
        _numbers(header.get("texnetFwhmUm"), "texnetFwhmUm", path),
        (_numbers(header.get("texnetNetdK"), "texnetNetdK", path) or [None])[0],
        response=str(header.get("texnetResponse", BOX)),
    )


def _scanlines(path, names, window, scale):
    """(bands, height, width) float32 of these channels, times scale, read a few lines at a time."""
    import Imath  # comes with OpenEXR
    import OpenEXR

    (left, top), (right, bottom) = (corner.tolist() for corner in window)
    width, height = right - left + 1, bottom - top + 1
    step = max(16, READ_BYTES // (4 * width * len(names)) // 16 * 16)  # packed in 16 lines
    cube = scratch.zeros((len(names), height, width), np.float32)
    kind = Imath.PixelType(Imath.PixelType.FLOAT)
    try:
        with _quiet_library():
            file = OpenEXR.InputFile(str(path))
            for y in range(0, height, step):
                end = min(y + step, height)
                lines = file.channels(names, kind, top + y, top + end - 1)
                for band, line in zip(cube, lines, strict=True):
                    band[y:end] = np.frombuffer(line, np.float32).reshape(-1, width)
                    with np.errstate(over="ignore", invalid="ignore"):  # for meaningless values
                        band[y:end] *= scale
                scratch.release(cube)
            file.close()
    except (RuntimeError, ValueError, TypeError, OSError, MemoryError) as e:
        raise InputError(f"cube: {path} is not a whole OpenEXR file.") from e
    cube.setflags(write=False)
    return cube


def _write_exr(cube, path):
    # OpenEXR ignores strides
    bands = zip(cube.wavelength_um, map(np.ascontiguousarray, cube.measured()), strict=True)
    channels = {channel_name(w): s for w, s in bands}
    if len(channels) < cube.bands:
        raise InputError("cube: bands closer than 1e-6 nm cannot be told apart in an .exr file.")
    header = {
        "spectralLayoutVersion": "1.0",
        "emissiveUnits": EXR_UNITS,
        "texnetSpectralDensity": "um^-1",
        # As text, because a float attribute holds 32 bits and these are 64.
        "texnetFwhmUm": " ".join(repr(float(w)) for w in cube.fwhm_um),
        "texnetResponse": cube.response,
    }
    if cube.netd_k is not None:
        header["texnetNetdK"] = repr(float(cube.netd_k))
    write_exr(header, channels, path)


def _to_per_um(header, path):
    """Factor from the file's radiance to W m-2 sr-1 um-1; InputError if it is not stated."""
    units = str(header.get("emissiveUnits", "")).replace("\u00b5", "u").replace("\u03bc", "u")
    density = header.get("texnetSpectralDensity")
    if units == EXR_UNITS and density == "um^-1":
        return 1.0
    if density is None and units.startswith(EXR_UNITS) and units[len(EXR_UNITS) :] in EXR_DENSITIES:
        return EXR_DENSITIES[units[len(EXR_UNITS) :]]
    raise InputError(
        f"cube: {path} does not say per what unit of wavelength its radiance is "
        f"(emissiveUnits is {units!r}); set emissiveUnits to {EXR_UNITS}.um^-1, .nm^-1 or .m^-1."
    )


def _numbers(text, attribute, path):
    """The numbers in one of our text attributes; None if the file lacks it."""
    if text is None:
        return None
    try:
        return [float(word) for word in str(text).split()]
    except ValueError as e:
        raise InputError(f"cube: {attribute} of {path} must hold numbers, got {text!r}.") from e


_FORMATS = {".exr": (_read_exr, _write_exr), ".npz": (_read_npz, _write_npz)}
