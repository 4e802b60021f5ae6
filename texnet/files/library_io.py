"""Third-party material libraries, turned into a MaterialLibrary, with a note of what was converted.

HADAR `.mat` (up to v7): `matLib` is bands x materials, `emiLib` materials x bands; `matName`
holds the names. The bands are not in the file, so the caller states them: equidistant in
wavenumber, in the file's order.

ECOSTRESS / ASTER `.txt`, or a folder of them, one material per file: `key: value` lines in
ISO-8859-1, then rows of micrometres and reflectance R. Only for an opaque sample and hemispherical
reflectance does Kirchhoff's law give e = 1 - R. A folder's files are interpolated to the finest of
their grids, between 7 and 15 um.

ENVI spectral libraries, a `.hdr` beside a binary (`.sli`): see `envi`. Their y axis title says
whether they hold emissivity or hemispherical reflectance; spectra without complete data from
7 to 15 um are left out.

`.csv`: a `text_table` with one column per material, emissivity 0..1, used from 7 to 15 um.

`.json`: a library file, to name or add a sky.
"""

import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from physics.cube.heat_cube import check_wavelength
from physics.errors import InputError
from physics.library import SKY, MaterialLibrary

from .envi import read_spectra
from .mat_file import read_mat
from .text_table import MAX_GAP_UM, number, read_table
from .wavelengths import ascending

DELETED = 1e6  # numbers this large mark a deleted band, such as -1.23e34 in files of the USGS
DARK, BRIGHT = 0.5, 0.99  # mean emissivities that a few of a library's solids have, but not all
SAME = 1e-3  # largest difference of curves that are the same
CLIP = 0.02  # noise takes measured curves out of 0..1; by more, the unit is wrong
TEXT_RANGE_UM = (7.0, 15.0)  # 8-14 um with a margin; spectra may start at 0.35 um
PUBLISHED_CM1 = {49: "760:1240", 54: "720:1250"}  # of the HADAR libraries, by number of bands
LAYOUT = {"matLib": "bands x materials", "emiLib": "materials x bands"}
KEY = re.compile(r"\s*([A-Za-z][A-Za-z .]*):(.*)")
# for vegetation the shorter wavelengths are bidirectional, TEXT_RANGE_UM hemispherical
BIDIRECTIONAL = re.compile("bi-?directional(?! and (directional )?hemispherical)", re.I)


def import_library(path, wavenumbers_cm1=None, names=None, sky=None, add_sky=False):
    """Read the library at path (.mat, .csv, .hdr, .sli, .txt, a folder of .txt, or .json; see the
    module).

    wavenumbers_cm1  .mat only: of the first and of the last band, cm-1, equidistant
    names            .mat only: one per material, instead of the file's `matName`
    sky              the material that is the sky; it is renamed to "sky"
    add_sky          add the starter library's sky if there is none (`with_sky`)

    Returns (MaterialLibrary, note): wavelengths in um, ascending, and one sentence on what
    was converted from what. Raises InputError if the file is damaged or leaves the meaning of
    its numbers open.
    """
    path = Path(path)
    if not os.path.exists(path):  # unlike Path.exists, False where access is denied
        raise InputError(f"library: there is no file {path}.")
    kind = ".txt" if path.is_dir() else path.suffix.lower()
    if kind not in (".mat", ".json") and kind not in READERS:
        raise InputError(
            f"library: {path.name} is not a known kind of library file; use .mat, .csv, ENVI .hdr "
            "or .sli, .txt, or a folder of .txt, or .json to add or name a sky."
        )
    if kind != ".mat" and (wavenumbers_cm1 is not None or names is not None):
        raise InputError(
            f"library: {path.name} states its own bands and names; leave out --wavenumbers and "
            "--names, which are for .mat files."
        )
    if kind == ".json":
        library, words = MaterialLibrary.load(path), ["a library file of this kind"]
    else:
        library, words = _read(path, kind, wavenumbers_cm1, names)
    names, words_on_sky = _named_sky(library.names, sky)
    library = replace(library, names=names)
    if add_sky and SKY in names:
        raise InputError(f"library: it has a material {SKY!r} already; leave out --add-sky.")
    if add_sky and (alike := [n for n in names if n.lower() == SKY]):
        raise InputError(f"library: is {alike[0]!r} the sky? Then give --sky {alike[0]}.")
    if add_sky:
        library = with_sky(library)
        low, high = library.wavelength_um[[0, -1]]
        words_on_sky = [f"with the starter library's sky, {low:.4g}-{high:.4g} um in common"]
    elif SKY not in names:
        words_on_sky = ["no material is the sky: name it with --sky, or give --add-sky"]
    if kind != ".json":  # which has hues; others get them last, with room for the sky's
        library = replace(library, hue_deg=None)
    note = "; ".join([*words, *words_on_sky])
    return library, f"{path}: {note}.{_unusual(library)}"


def _read(path, kind, wavenumbers_cm1, names):
    """(MaterialLibrary, words) of a file that is not JSON."""
    try:
        if kind == ".mat":
            names, w, e, sources, words = _read_mat(path, wavenumbers_cm1, names)
        else:
            names, w, e, sources, words = READERS[kind](path)
    except OSError as error:
        where = error.filename or path
        raise InputError(f"library: cannot read {where}: {error.strerror or error}.") from error
    e, clipped = _within_0_and_1(e, names, w)
    return MaterialLibrary(names, w, e, descriptions=sources), [*words, *clipped]


def _unusual(library):
    """A warning if curves are not like solids', or two are the same; else ""."""
    mean = library.emissivity[~library.is_sky].mean(axis=1)
    if not mean.size:
        return ""
    if np.median(mean) < DARK:
        return f"\nWarning: half of the curves are below {DARK}; are these reflectances, 1 - e?"
    if mean.min() > BRIGHT:
        return f"\nWarning: all emissivities are above {BRIGHT} on average; are they in percent?"
    for i, e in enumerate(library.emissivity[:-1], 1):
        same = np.abs(library.emissivity[i:] - e).max(axis=1) < SAME
        if same.any():
            one, other = library.names[i - 1], library.names[i + int(same.argmax())]
            return (
                f"\nWarning: the curves of {one!r} and {other!r} are the same, so that either may "
                "be named; leave one of them out."
            )
    return ""


def with_sky(library):
    """The MaterialLibrary, with the starter library's sky added if it has none.

    The curves are then interpolated to both libraries' wavelengths, where both have data. Raises
    InputError if that is nowhere.
    """
    if library.sky_index is not None:
        return library
    sky = MaterialLibrary.starter().subset([SKY])
    w = np.union1d(library.wavelength_um, sky.wavelength_um)
    w = w[library.covers(w) & sky.covers(w)]
    if w.size == 0:
        raise InputError(
            f"library: it has no sky, and the starter library's covers 7.5-14.5 um, "
            f"not {library.wavelength_um[0]:g}-{library.wavelength_um[-1]:g} um."
        )
    return MaterialLibrary(
        library.names + sky.names, w, np.vstack([library.at(w), sky.at(w)]),
        np.append(library.hue_deg, sky.hue_deg), np.vstack([library.albedo_rgb, sky.albedo_rgb]),
        library.descriptions + sky.descriptions,
        np.append(library.level_sigma, sky.level_sigma),
    )  # fmt: skip


def read_names(path):
    """The names in a text file (UTF-8), one per line, ignoring blank lines."""
    try:
        lines = Path(path).read_text(encoding="utf-8-sig").splitlines()
    except OSError as e:
        raise InputError(f"library: cannot read {path}: {e.strerror}.") from e
    except UnicodeDecodeError as e:
        raise InputError(f"library: {path} must be UTF-8 text, one name a line.") from e
    return [line.strip() for line in lines if line.strip()]


def _thermal(w, name):
    """(n,) bool, which of w, um, are in TEXT_RANGE_UM; InputError unless two are."""
    low, high = TEXT_RANGE_UM
    inside = (w >= low) & (w <= high)
    if np.count_nonzero(inside) < 2:
        check_wavelength(w, "library")  # may know the intended unit
        raise InputError(
            f"library: {name} covers {w.min():.4g}-{w.max():.4g} um, with no two bands in "
            f"{low:g}-{high:g} um; use another file, or correct its unit of wavelengths."
        )
    return inside


# --- HADAR .mat --------------------------------------------------------------------------


def _read_mat(path, wavenumbers_cm1, names):
    key, table, inside = _mat_table(path)
    e = np.array(table.T if key == "matLib" else table, np.float64)
    materials, bands = e.shape
    if wavenumbers_cm1 is None:
        hint = PUBLISHED_CM1.get(bands)
        hint = f" (the published HADAR libraries of {bands} bands need {hint})" if hint else ""
        raise InputError(
            f"library: {path} does not say where its {bands} bands lie; give "
            f"--wavenumbers FIRST:LAST in cm-1{hint}."
        )
    if names is None:
        names = inside
    if names is None:
        raise InputError(
            f"library: {path} holds no readable matName for its {materials} materials; give "
            "--names FILE with one name a line."
        )
    if len(names) != materials:
        raise InputError(
            f"library: there are {len(names)} names for {materials} materials ({key} is "
            f"{LAYOUT[key]}, here {table.shape[0]} x {table.shape[1]}); give --names FILE with one "
            "name a line for each."
        )
    first, last = wavenumbers_cm1
    if bands < 2 or first == last:
        raise InputError(
            f"library: {bands} bands from {first:g} to {last:g} cm-1 are no grid; "
            "give two different ends and two or more bands."
        )
    order, w, moved = ascending(np.linspace(first, last, bands), "cm-1", "library")
    _thermal(w, path.name)
    words = [
        f"HADAR .mat, {key} ({LAYOUT[key]}), {materials} materials",
        f"{bands} bands equidistant from {first:g} to {last:g} cm-1 became "
        f"{w[0]:.4g}-{w[-1]:.4g} um{moved}",
    ]
    return names, w, e[:, order], [f"From {path.name}."] * materials, words


def _mat_table(path):
    """(key, 2-D array, names or None) of a .mat library."""
    try:
        held = read_mat(path)
    except InputError as e:
        raise InputError(f"library: {e}") from e
    keys = [key for key in LAYOUT if key in held]
    if len(keys) != 1:
        raise InputError(
            f"library: {path} must hold one of matLib (bands x materials) and emiLib "
            f"(materials x bands); it holds {', '.join(held) or 'nothing'}."
        )
    table, names = held[keys[0]], held.get("matName")
    if not isinstance(table, np.ndarray) or table.ndim != 2 or 0 in table.shape:
        raise InputError(f"library: {keys[0]} in {path} must be a full table of real numbers.")
    return keys[0], table, names if isinstance(names, list) else None


# --- CSV ---------------------------------------------------------------------------------


def _read_csv(path):
    names, w, e, words = read_table(path, "library", "material")
    inside = _thermal(w, path.name)
    if not inside.all():
        w, e = w[inside], e[:, inside]
        words.append(f"those of {w[0]:.4g}-{w[-1]:.4g} um kept")
    _check_gaps(w, path, f"give rows at most {MAX_GAP_UM:g} um apart")
    return names, w, e, [f"From {path.name}."] * len(names), words


# --- ENVI --------------------------------------------------------------------------------


def _read_envi(path):
    spectra = read_spectra(path)
    said = spectra.quantity.lower()
    if ("emiss" in said) == ("reflect" in said):
        raise InputError(
            f"library: {path.name} does not say whether it holds emissivity or reflectance; write "
            "y axis title = Emissivity, or Reflectance if it is hemispherical, into its header."
        )
    if BIDIRECTIONAL.search(said):
        raise InputError(
            f"library: {path.name} holds {spectra.quantity!r}, but emissivity follows only from "
            "hemispherical reflectance; take another file."
        )
    order, w, moved = ascending(spectra.centre, spectra.axis, "library")
    inside = _thermal(w, path.name)
    w, values = w[inside], spectra.values[:, order[inside]]
    _check_gaps(w, path.name, "take another")
    good = (np.abs(values) < DELETED).all(axis=1)  # False for NaN
    if not good.any():
        raise InputError(
            f"library: no spectrum of {path.name} is complete from {w[0]:.4g} to {w[-1]:.4g} um."
        )
    percent = re.search("percent|%", said) and not spectra.scaled
    values = values * (0.01 if percent else 1.0)
    e = values if "emiss" in said else 1 - values
    words = [
        f"ENVI spectral library of {spectra.quantity.lower()}"
        + ("" if "emiss" in said else ", emissivity as 1 - hemispherical reflectance"),
        f"{w.size} bands, {w[0]:.4g}-{w[-1]:.4g} um{moved}",
    ]
    if spectra.bad:
        words.append(f"{spectra.bad} bands left out that bbl calls bad")
    left = [name for name, there in zip(spectra.names, good, strict=True) if not there]
    if left:
        words.append(f"left out because of deleted bands: {', '.join(left)}")
    names = [name for name, there in zip(spectra.names, good, strict=True) if there]
    sources = [f"{name}, from {path.name}." for name in names]
    return _unique(names), w, e[good], sources, words


# --- ECOSTRESS / ASTER text --------------------------------------------------------------


class Other(InputError):
    """A file without what lacks says, as is common among others."""

    def __init__(self, message, lacks=f"spectrum of {TEXT_RANGE_UM[0]:g}-{TEXT_RANGE_UM[1]:g} um"):
        super().__init__(message)
        self.lacks = lacks


def _read_texts(path):
    if path.is_dir():
        text = [p for p in sorted(path.iterdir()) if p.suffix.lower() == ".txt" and p.is_file()]
        # ECOSTRESS puts further measurements beside a spectrum, under this name.
        files = [p for p in text if not p.name.lower().endswith(".ancillary.txt")]
        if not files:
            raise InputError(f"library: the folder {path} holds no spectrum .txt file.")
    else:
        files = [path]
    spectra, refused, others = [], {}, {}
    for file in files:
        try:
            spectra.append(_read_text(file))
        except Other as e:
            others[file.name] = e
        except InputError as e:
            refused[file.name] = str(e)
    if not spectra:
        refused |= {name: str(e) for name, e in others.items()}
    if refused:
        first, *more = refused
        rest = f"; also refused: {', '.join(more)}." if more else "."
        raise InputError(refused[first].removesuffix(".") + rest)
    files = [file for file in files if file.name not in others]
    low = max(w[0] for _, w, _, _ in spectra)
    high = min(w[-1] for _, w, _, _ in spectra)
    if low >= high:
        late = files[int(np.argmax([w[0] for _, w, _, _ in spectra]))]
        early = files[int(np.argmin([w[-1] for _, w, _, _ in spectra]))]
        raise InputError(
            f"library: {late.name} starts at {low:g} um, beyond the end of {early.name} "
            f"({high:g} um); import them separately."
        )
    inner = [w[(w > low) & (w < high)] for _, w, _, _ in spectra]
    grid = np.concatenate([[low], max(inner, key=len), [high]])
    e = np.stack([np.interp(grid, w, 1 - r) for _, w, r, _ in spectra])
    names = _unique([name for name, _, _, _ in spectra])
    sources = [
        f"{name}, from {file.name}: 1 - hemispherical reflectance."
        for file, (name, _, _, _) in zip(files, spectra, strict=True)
    ]
    words = [
        f"ECOSTRESS / ASTER text, {len(files)} file{'s' * (len(files) > 1)}, emissivity as "
        "1 - hemispherical reflectance of an opaque sample",
        f"interpolated onto {grid.size} wavelengths, {low:.4g}-{high:.4g} um, the finest of the "
        f"files' grids in their common range within {TEXT_RANGE_UM[0]:g}-{TEXT_RANGE_UM[1]:g} um",
    ]
    skipped = sum(n for _, _, _, n in spectra)
    for lacks in dict.fromkeys(e.lacks for e in others.values()):
        names_of = [name for name, e in others.items() if e.lacks == lacks]
        words.append(f"no {lacks} in {', '.join(names_of)}: left out")
    if skipped:
        words.append(f"{skipped} rows skipped that are not two positive numbers")
    return names, grid, e, sources, words


def _read_text(path):
    """(name, wavelength in um ascending, reflectance 0..1, bad rows) of a spectrum file."""
    raw = path.read_bytes()
    try:
        lines = raw.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError:
        lines = raw.decode("iso-8859-1").splitlines()
    matches = [(i, m) for i, line in enumerate(lines) if (m := KEY.match(line))]
    # After the last key, because descriptions span lines and the number of keys varies.
    first = matches[-1][0] + 1 if matches else 0
    rows = [line.split() for line in lines[first:] if line.strip()]
    numbers = [[number(cell) for cell in row] for row in rows]
    pairs = [row for row in numbers if len(row) == 2 and None not in row]
    header = {}
    for _, match in matches:
        header.setdefault(" ".join(match[1].lower().split()), match[2].strip())
    if not pairs:  # damaged, or about something else
        raise (InputError if "x units" in header else Other)(
            f"library: {path.name} holds no spectrum; leave this file out."
        )
    if not matches:
        raise InputError(
            f"library: {path.name} has no 'key: value' lines, so no units; give it as .csv (see "
            "docs/files.md)."
        )

    def say(key):
        if not header.get(key.lower()):
            raise InputError(f"library: {path.name} has no line '{key}:', which must be stated.")
        return header[key.lower()]

    name, x_units, y_units, measured = map(say, ("Name", "X Units", "Y Units", "Measurement"))
    if re.search(r"\bmicro|\b[uµμ]m\b", x_units, re.I) is None:
        raise InputError(
            f"library: {path.name} has X Units {x_units!r}; only micrometers are supported."
        )
    good = [row for row in pairs if row[0] > 0 and row[1] >= 0]  # negative: not measured
    # Instruments that meet at one wavelength both give it: take their mean.
    w, where = np.unique([row[0] for row in good], return_inverse=True)
    r = np.bincount(where, [row[1] for row in good]) / np.bincount(where)
    low, high = TEXT_RANGE_UM
    inside = (w >= low) & (w <= high)
    if np.count_nonzero(inside) < 2:
        covers = f"covers {w[0]:g}-{w[-1]:g} um" if w.size else "holds no spectrum"
        raise (Other if w.size else InputError)(
            f"library: {path.name} {covers}, with no two rows in {low:g}-{high:g} um; "
            "leave this file out."
        )
    if re.search("hemispherical.*reflectance", measured, re.I) is None or re.search(
        f"{BIDIRECTIONAL.pattern}|transmi", measured + y_units, re.I
    ):
        raise Other(
            f"library: {path.name} holds {measured!r} in {y_units!r}, but emissivity follows only "
            "from hemispherical reflectance; leave this file out.",
            "hemispherical reflectance",
        )
    if re.search("percent|%", y_units, re.I):
        scale = 0.01
    elif re.search("fraction", y_units, re.I):
        scale = 1.0
    else:
        raise InputError(
            f"library: {path.name} has Y Units {y_units!r}; write 'Reflectance (percent)' or "
            "'Reflectance (fraction)'."
        )
    w, r = w[inside], scale * r[inside]
    _check_gaps(w, path.name, "leave this file out")
    return name, w, r, len(rows) - len(good)


def _check_gaps(w, file, remedy):
    """Raise InputError if ascending wavelengths w, um, leave a gap in TEXT_RANGE_UM."""
    low, high = TEXT_RANGE_UM
    gaps = np.where((w[:-1] < high) & (w[1:] > low), np.diff(w), 0.0)
    for i in np.flatnonzero(gaps > MAX_GAP_UM + 1e-9)[:1]:
        raise InputError(
            f"library: {file} has no good row from {w[i]:g} to {w[i + 1]:g} um; {remedy}."
        )


def _unique(names):
    """Names in lower case with underscores; the second `water` is `water_2`."""
    unique = []
    for name in names:
        stem = re.sub(r"[\W_]+", "_", name.lower()).strip("_") or "unnamed"
        tries = (stem if n == 1 else f"{stem}_{n}" for n in range(1, len(names) + 1))
        unique.append(next(t for t in tries if t not in unique))
    return unique


# --- shared ------------------------------------------------------------------------------


def _named_sky(names, sky):
    """The names with the sky called "sky", and words on that."""
    if sky is None:
        return names, []
    if sky not in names:
        raise InputError(f"library: there is no material {sky!r} among {', '.join(names)}.")
    if sky != SKY and SKY in names:
        raise InputError(f"library: it has a material {SKY!r} already; leave out --sky.")
    return [SKY if n == sky else n for n in names], [f"{sky!r} is the sky"]


def _within_0_and_1(e, names, w):
    """e (materials, bands) at w, um, clipped to 0..1 if it is outside by no more than CLIP, and
    words on that."""
    excess = np.maximum(e - 1, -e)
    worst = np.nan_to_num(excess, nan=np.inf).max(axis=1)
    if worst.max() > CLIP + 1e-9:  # 1.02 - 1 is more than 0.02
        i = int(np.argmax(worst))
        percent = ""
        if 2 < e[i].max() <= 100 or -100 <= e[i].min() < -1:  # in percent, or 1 - percent
            percent = "; divide the file's numbers by 100 if they are in percent"
        at = w[np.argmax(np.nan_to_num(excess[i], nan=np.inf))]
        raise InputError(
            f"library: emissivity of {names[i]} spans {e[i].min():g} to {e[i].max():g}, worst at "
            f"{at:.4g} um; it must be finite and within 0..1, or off by {CLIP:g} at most{percent}."
        )
    n = np.count_nonzero(excess > 0)
    words = [f"{n} values up to {worst.max():.2g} outside 0..1 clipped"] if n else []
    return np.clip(e, 0, 1), words


READERS = {  # of files that state their own bands and names, unlike .mat
    ".csv": _read_csv, ".txt": _read_texts, ".hdr": _read_envi, ".sli": _read_envi,
}  # fmt: skip
