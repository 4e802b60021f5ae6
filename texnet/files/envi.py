"""ENVI cubes and spectral libraries: a text header beside a binary.

The header's first line is ENVI, followed by lines `key = value`; a value in braces is a list, which
may span lines; lines that start with ; are comments. The binary is bare numbers after a number of
bytes, ordered bsq (bands, lines, samples), bil (lines, bands, samples) or bip (lines, samples,
bands). Also used: wavelength, wavelength units, fwhm, bbl (0: a bad band), data ignore value, data
gain values, data offset values, reflectance scale factor (a divisor).

The format has no field for the unit of radiance, but some programs write one as data units,
radiance data units or units: it is used if it is one of radiance in `units.UNITS`. An unknown unit
of wavelength is inferred from the values. The header's sizes are compared with the binary's before
anything is read.

A spectral library has one spectrum per line and one band per sample, spectra names, and y axis
title.
"""

import math
import re
from collections import deque
from pathlib import Path
from typing import NamedTuple

import numpy as np

from physics.errors import InputError

from .raw_cube import RawCube, is_ignored
from .units import KELVIN, unit_of

DTYPES = {
    1: "u1", 2: "i2", 3: "i4", 4: "f4", 5: "f8", 12: "u2", 13: "u4", 14: "i8", 15: "u8",
}  # fmt: skip
ORDERS = {  # in the file, slowest first, of (bands, lines, samples)
    "bsq": (0, 1, 2), "bil": (1, 0, 2), "bip": (1, 2, 0),
}  # fmt: skip
AXES = {
    "um": (
        "micrometers", "micrometer", "micrometres", "micrometre", "microns", "micron", "um",
        "\u00b5m", "\u03bcm",
    ),
    "nm": ("nanometers", "nanometer", "nanometres", "nanometre", "nm"),
    "cm-1": (
        "wavenumber", "wavenumbers", "cm-1", "cm^-1", "1/cm", "wavenumber (cm-1)",
        "wavenumber (cm^-1)",
    ),
}  # fmt: skip
# bands of thermal cameras, in ranges that do not overlap between units
THERMAL = {"um": (5.0, 20.0), "nm": (5e3, 2e4), "cm-1": (500.0, 2000.0)}
BINARY = ("", ".bsq", ".bil", ".bip", ".dat", ".img", ".raw", ".bin", ".sc", ".sli")  # suffixes
CUBES, LIBRARIES = ("envi", "envi standard"), ("envi spectral library",)  # types of files
SCALE = "reflectance scale factor"
UNIT_KEYS = "data units", "radiance data units", "units"
ABSENT = ("file compression", "major frame offsets", "minor frame offsets")  # or zero
MOST_HEADER = 1 << 24  # bytes


def read_envi(path):
    """The RawCube of an ENVI file, given its header or its binary.

    Raises InputError if one of the two is missing, or they do not fit each other.
    """
    header, binary = _pair(Path(path), "cube")
    bands = header.whole("bands", least=1)
    dtype, interleave, numbers, unread = _numbers(header, binary, CUBES)
    words, band = [], header.whole("lines") * header.whole("samples") * dtype.itemsize
    if unread:
        more = (
            f", enough for {unread // band} more bands: is bands right?" if unread >= band else ""
        )
        words = [f"{unread} bytes after the last pixel left unread{more}"]
    gain, offset, scaled = _scale(header, bands)
    centre, fwhm = header.numbers("wavelength", bands), header.numbers("fwhm", bands)
    said, hint = header.word("wavelength units", ""), ""
    axis, not_said = header.axis(centre)
    if axis is None and centre is not None:
        said = f"are {said[:60]!r}" if said else "are missing"
        hint = f", or write Micrometers, Nanometers or Wavenumber where its wavelength units {said}"
    words += not_said
    if axis is None or centre is None:  # fwhm has the same unit
        axis, centre, fwhm = "um", None, None
    bbl, ignore = header.numbers("bbl", bands), header.ignored()
    said = next((header.word(key) for key in UNIT_KEYS if key in header.fields), "")
    unit = unit_of(said)
    unit = None if unit == KELVIN else unit  # of each band, or of the surface?
    return RawCube(
        f"ENVI {interleave} of {dtype.name}", numbers, centre, fwhm, axis, unit, gain,
        offset, good=None if bbl is None else bbl != 0, ignore=ignore, hint=hint,
        words=(*words, *scaled), unit_said=said[:60],
    )  # fmt: skip


class Spectra(NamedTuple):
    """The content of a spectral library.

    names     of the spectra;  values  (spectra, bands) float64, NaN where nothing was measured
    centre    (bands,) in axis: "um", "nm" or "cm-1"; without those that bbl calls bad
    bad       number of bad bands
    quantity  y axis title, or the second of the z plot titles
    scaled    whether a factor in the header was applied
    """

    names: tuple[str, ...]
    values: np.ndarray
    centre: np.ndarray
    bad: int
    axis: str
    quantity: str
    scaled: bool


def read_spectra(path):
    """The Spectra of an ENVI spectral library, given its header or its binary.

    Raises InputError if one of the two is missing, they do not fit each other, or they do not say
    at which wavelengths the spectra are.
    """
    header, binary = _pair(Path(path), "library")
    dtype, _, numbers, _ = _numbers(header, binary, LIBRARIES)
    gain, offset, scaled = _scale(header, 1)
    raw = numbers()
    if len(raw) != 1:
        raise header.error(f"bands must be 1 in a spectral library, not {len(raw)}")
    values = gain * raw[0].astype(np.float64) + offset
    values[is_ignored(raw[0], header.ignored())] = np.nan
    names = header.word("spectra names").strip("{}, ").split(",")
    centre = header.numbers("wavelength", values.shape[1])
    axis, _ = header.axis(centre)
    if len(names) != len(values):
        raise header.error(f"there are {len(names)} spectra names for {len(values)} spectra")
    if centre is None or axis is None:
        raise header.error(
            "it must have wavelength, and wavelength units: Micrometers, Nanometers or Wavenumber"
        )
    names = tuple(name.strip() for name in names)
    titles = header.word("z plot titles", "").strip("{} ").partition(",")
    quantity = header.word("y axis title", titles[2].strip())
    good = header.good(len(centre))
    bad = np.count_nonzero(~good)
    return Spectra(names, values[:, good], centre[good], bad, axis, quantity, bool(scaled))


def _pair(path, of):
    """The _Header and the binary's path of an ENVI file, given the path of either."""
    if path.suffix.lower() == ".hdr":
        return _Header(path, of), _binary_of(path, of)
    header = header_of(path)
    if header is None:
        raise InputError(f"{of}: there is no header, {path.stem}.hdr, beside {path}.")
    return _Header(header, of), path


def header_of(path):
    """The ENVI header beside a binary, NAME.dat.hdr or NAME.hdr; None if there is none."""
    return next(iter(_beside(path, (f"{path.name}.hdr", f"{path.stem}.hdr"))), None)


def _binary_of(header, of):
    found = _beside(header, [f"{header.stem}{suffix}" for suffix in BINARY])
    if len(found) == 1:
        return found[0]
    if found:
        names = " and ".join(p.name for p in found)
        raise InputError(f"{of}: {header} may belong to {names}; give the name of its binary.")
    raise InputError(
        f"{of}: there is no {header.stem} or {header.stem}.dat beside {header}; if its binary has "
        "another name, give that."
    )


def _beside(path, names):
    """The files beside path of these names, in their order; if none is found, ignoring case."""
    there = [p for p in path.parent.iterdir() if p.is_file()]
    exact = [p for name in names for p in there if p.name == name]
    return exact or [p for name in names for p in there if p.name.lower() == name.lower()]


def _numbers(header, binary, kinds):
    """(dtype, interleave, numbers as in RawCube, number of bytes left unread)."""
    shape = tuple(header.whole(size, least=1) for size in ("bands", "lines", "samples"))
    skip, kind = header.whole("header offset", 0), header.whole("data type")
    interleave = header.word("interleave").lower()
    if kind not in DTYPES:
        raise header.error(
            f"data type {kind} is not a known real type; use {', '.join(map(str, DTYPES))}"
        )
    if interleave not in ORDERS:
        raise header.error(f"interleave must be bsq, bil or bip, not {interleave[:60]!r}")
    file_type = header.word("file type", "ENVI")
    if file_type.lower() not in kinds:
        wanted = "ENVI Standard" if kinds is CUBES else "ENVI Spectral Library"
        raise header.error(f"file type must be {wanted}, not {file_type[:60]!r}")
    for key in ABSENT:
        if np.any(header.numbers(key)):
            raise header.error(f"{key} is not supported; save the cube without it")
    dtype = np.dtype(DTYPES[kind])
    order = header.whole("byte order", 0)  # the most common one
    if order > 1:
        raise header.error("byte order must be 0 (little) or 1 (big)")
    dtype = dtype.newbyteorder("<>"[order])
    size, need = binary.stat().st_size, skip + math.prod(shape) * dtype.itemsize
    if size < need:
        raise InputError(
            f"{header.of}: {binary} has {size} bytes where its header asks for {skip} + "
            f"{' x '.join(map(str, shape))} x {dtype.itemsize}; it is cut off, or the header is of "
            "another file."
        )
    stored = ORDERS[interleave]

    def numbers():
        in_file = np.memmap(binary, dtype, "r", skip, tuple(shape[axis] for axis in stored))
        return in_file.transpose(np.argsort(stored))

    return dtype, interleave, numbers, size - need


def _scale(header, bands):
    """(gain, offset, words) per band."""
    gain, offset = (header.numbers(f"data {key} values", bands) for key in ("gain", "offset"))
    factor = header.numbers(SCALE, 1)
    if factor is None or factor[0] == 1:
        words = ["data gain and offset values applied"] * (gain is not None or offset is not None)
    elif gain is not None or offset is not None:
        raise header.error(
            f"there are data gain or offset values and a {SCALE}; keep those that make radiance"
        )
    elif factor[0] == 0:
        raise header.error(f"{SCALE} must not be 0")
    else:
        gain, words = 1 / factor[0], [f"divided by the {SCALE} {factor[0]:g}"]
    others = [key for key in header.fields if key.endswith("scale factor") and key != SCALE]
    words += [f"{key} {header.fields[key][:60]} not applied" for key in others]
    return 1.0 if gain is None else gain, 0.0 if offset is None else offset, words


class _Header:
    """The fields of a header, each checked on access."""

    def __init__(self, path, of):
        self.path, self.of = path, of
        with open(path, "rb") as file:
            raw = file.read(MOST_HEADER + 1)
        try:
            text = raw.decode("utf-8-sig")
        except UnicodeDecodeError:  # older programs' micro sign
            text = raw.decode("latin-1")
        first, *lines = text.splitlines() or [""]
        if len(raw) > MOST_HEADER or first.strip().upper() != "ENVI":
            raise self.error("its first line must be ENVI")
        lines = deque(line.strip() for line in lines if not line.startswith(";"))
        self.fields = {}
        while lines:
            key, equals, value = lines.popleft().partition("=")
            if not equals:
                continue
            parts = [value.strip()]
            if not parts[0] and lines and lines[0].startswith("{"):
                parts = [lines.popleft()]
            if parts[0].startswith("{"):
                while "}" not in parts[-1]:
                    if not lines:
                        raise self.error(f"the list of {key.strip()[:60]!r} has no end }}")
                    parts.append(lines.popleft())
            self.fields[" ".join(key.lower().split())] = " ".join(parts)

    def error(self, text):
        return InputError(f"{self.of}: {self.path}: {text}.")

    def word(self, key, default=None):
        """The text of a field, which must exist if there is no default."""
        text = self.fields.get(key, default)
        if text is None:
            raise self.error(f"the field {key} is missing")
        return text

    def axis(self, centre):
        """The unit of its wavelengths, centre: "um", "nm" or "cm-1", and words on it if it is not
        stated by a known name, but only one is possible; else None."""
        said = self.word("wavelength units", "").lower()
        named = next((axis for axis, names in AXES.items() if said in names), None)
        if named or centre is None or said == "index":
            return named, []
        centre = centre[self.good(centre.size)]  # bad bands may have any value
        for axis, (low, high) in THERMAL.items():
            if low <= centre.min() and centre.max() <= high:
                why = f"{said[:60]!r} is not a known unit" if said else "their unit is missing"
                return axis, [f"wavelengths taken to be in {axis}, since {why}"]
        return None, []

    def good(self, bands):
        """(bands,) bool, those that bbl does not call bad; all, if it calls all of them bad."""
        bbl = self.numbers("bbl", bands)
        return np.ones(bands, bool) if bbl is None or not bbl.any() else bbl != 0

    def ignored(self):
        """The finite number that stands for no measurement; None if there is none, or if it is not
        a number anyway."""
        text = self.word("data ignore value", "").strip("{} ")
        if not text or "#" in text:  # how Windows writes NaN: -1.#IND
            return None
        try:
            value = float(text)
        except ValueError as e:
            raise self.error(f"data ignore value must be a number, not {text[:60]!r}") from e
        return value if math.isfinite(value) else None

    def whole(self, key, default=None, least=0):
        """A whole number."""
        if default is not None and key not in self.fields:
            return default
        text = self.word(key)
        if re.fullmatch("[0-9]{1,18}", text) is None or int(text) < least:
            raise self.error(f"{key} must be a whole number >= {least}, not {text[:60]!r}")
        return int(text)

    def numbers(self, key, count=None):
        """(count,) finite numbers of a list or of one number; None if the field is missing, or
        empty."""
        words = re.sub("[{},]", " ", self.fields.get(key, "")).split()
        if not words:
            return None
        try:
            numbers = np.array([float(word) for word in words])
        except ValueError:
            numbers = np.array([np.nan])
        if not np.isfinite(numbers).all():
            raise self.error(f"{key} must hold finite numbers")
        if count not in (None, numbers.size):
            raise self.error(f"{key} holds {numbers.size} numbers where {count} are needed")
        return numbers
