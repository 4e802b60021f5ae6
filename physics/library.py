"""MaterialLibrary: the curves e_m(wavelength) that a scene may be made of.

A library file is JSON:

    {"wavelength_um": [...],
     "materials": [{"name": "water", "emissivity": [...], "hue_deg": 210,
                    "albedo_rgb": [r, g, b], "description": "...", "level_sigma": 0}, ...]}

All but `name` and `emissivity` may be left out of any material; names that the starter
library holds have its hue then. The sky is the material named "sky"; its curve is 1 - transmittance
of the atmosphere towards the zenith.
"""

import json
import unicodedata
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from pathlib import Path

import numpy as np

from .cube.heat_cube import check_wavelength, numbers
from .errors import InputError
from .machinery.json_file import read_json
from .machinery.read_only import ReadOnly
from .machinery.whole_file import whole_file

SKY = "sky"
GREY = (0.4, 0.4, 0.4)  # albedo where none is given
MIRROR = 0.3  # mean emissivity, below which a material is one


@dataclass(frozen=True, eq=False, repr=False)
class MaterialLibrary(ReadOnly):
    """Semantic library of spectral emissivities, immutable.

    names          unique names, one per material; "sky" stands for the sky
    wavelength_um  (n,) in um, ascending
    emissivity     (materials, n) hemispherical emissivity, 0..1
    hue_deg        (materials,) TeX-vision hue, 0..360; if not given, the starter library's of that
                   name, else one between the others
    albedo_rgb     (materials, 3) reflectance in visible light, 0..1; 0.4 if not given
    descriptions   per material: sources and modelling choices; may be empty strings
    level_sigma    (materials,) one standard deviation by which all of a curve may be off together;
                   0 if not given

    Raises InputError where the data are not that.
    """

    names: tuple[str, ...]
    wavelength_um: np.ndarray
    emissivity: np.ndarray
    hue_deg: np.ndarray | None = None
    albedo_rgb: np.ndarray | None = None
    descriptions: tuple[str, ...] | None = None
    level_sigma: np.ndarray | None = None

    def __post_init__(self):
        names = tuple(str(n) for n in self.names)
        m = len(names)
        w = check_wavelength(self.wavelength_um, "library")
        e = np.array(numbers(self.emissivity, "library: emissivity"), dtype=np.float64)
        if m == 0:
            raise InputError("library: it holds no material.")
        if "" in names:
            raise InputError("library: a material has an empty name.")
        if odd := [n for n in names if _holds(n, "Cc", "Cs")]:
            raise InputError(f"library: the name {odd[0]!r} has invalid characters; rename it.")
        if len(set(names)) != m:
            twice = next(n for i, n in enumerate(names) if n in names[:i])
            raise InputError(f"library: there are two materials {twice!r}; rename one.")
        if e.shape != (m, w.size):
            raise InputError(
                f"library: emissivity must be (materials, wavelengths) = {(m, w.size)}, "
                f"got {e.shape}."
            )
        bad = np.argwhere(~((e >= 0) & (e <= 1)))
        if len(bad):
            i, band = bad[0]
            percent = "; divide by 100 if these are percent" if 2 < e[i, band] <= 100 else ""
            raise InputError(
                f"library: emissivity of {names[i]} is {e[i, band]:g} at {w[band]:g} um; it must "
                f"lie within 0..1{percent}."
            )
        hue = _fill_hues(names, [None] * m) if self.hue_deg is None else self.hue_deg
        hue = np.array(numbers(hue, "library: hue_deg"), float)
        rgb = [GREY] * m if self.albedo_rgb is None else self.albedo_rgb
        rgb = np.array(numbers(rgb, "library: albedo_rgb"), float)
        text = ("",) * m if self.descriptions is None else tuple(self.descriptions)
        if hue.shape != (m,) or not np.isfinite(hue).all():
            raise InputError("library: hue_deg must hold one finite hue per material.")
        if rgb.shape != (m, 3) or not ((rgb >= 0) & (rgb <= 1)).all():
            raise InputError("library: albedo_rgb must hold three values in 0..1 per material.")
        if len(text) != m or any(_holds(t, "Cs") for t in text):
            raise InputError("library: descriptions must hold one text per material.")
        level = np.zeros(m) if self.level_sigma is None else self.level_sigma
        level = np.array(numbers(level, "library: level_sigma"), float)
        if level.shape != (m,) or not ((level >= 0) & (level < 1)).all():
            raise InputError("library: level_sigma must hold one value >= 0 and < 1 per material.")
        self._set(
            names=names, wavelength_um=w, emissivity=e,
            hue_deg=hue, albedo_rgb=rgb, descriptions=text, level_sigma=level,
        )  # fmt: skip

    def __repr__(self):
        low, high = self.wavelength_um[[0, -1]]
        return f"<MaterialLibrary of {low:g}-{high:g} um: {', '.join(self.names)}>"

    def __len__(self):
        return len(self.names)

    @property
    def sky_index(self):
        """Index of the sky among the materials, or None."""
        return self.names.index(SKY) if SKY in self.names else None

    @property
    def is_sky(self):
        """(materials,) bool: the sky among the materials."""
        return np.array(self.names) == SKY

    def index(self, name):
        """Index of a material by name; InputError lists the names if it is not there."""
        if name not in self.names:
            raise InputError(f"library: no material {name!r}; it holds {', '.join(self.names)}.")
        return self.names.index(name)

    def subset(self, names):
        """The library of these materials, in this order; InputError as `index`."""
        if isinstance(names, str):
            raise InputError(f"library: names must be a list, as [{names!r}].")
        i = [self.index(n) for n in names]
        return MaterialLibrary(
            [self.names[j] for j in i], self.wavelength_um, self.emissivity[i],
            self.hue_deg[i], self.albedo_rgb[i], [self.descriptions[j] for j in i],
            self.level_sigma[i],
        )  # fmt: skip

    def is_mirror(self, wavelength_um):
        """(materials,) bool, which reflect most of the light at wavelengths (n,) in um: with so
        little glow of their own they may look like anything. Raises InputError as `at`."""
        return self.at(wavelength_um).mean(axis=1) < MIRROR

    def of_bands(self, nodes_um):
        """(materials, bands) means over bands of nodes (bands, n) in um, as `HeatCube.nodes_um` or
        `bands.quadrature` have them. Raises InputError as `at`."""
        return self.at(nodes_um).mean(axis=-1)

    def covers(self, wavelength_um):
        """(...) bool: whether the library's curves reach to wavelengths (...) in um."""
        w, (low, high) = np.asarray(wavelength_um), self.wavelength_um[[0, -1]]
        return (w >= low - 1e-9) & (w <= high + 1e-9)

    def at(self, wavelength_um):
        """(materials, ...) emissivity at wavelengths (...) in um, linear in between.

        Raises InputError where the library's curves do not reach.
        """
        w = np.asarray(wavelength_um, dtype=np.float64)
        inside = self.covers(w)
        if not inside.all():
            low, high = self.wavelength_um[[0, -1]]
            # bands that reach beyond have centres within
            of_bands = lambda a: a.reshape(len(w) if w.ndim else 1, -1)
            bands = of_bands(w)[of_bands(inside).all(axis=1)].mean(axis=1)
            of_cube = ""
            if len(bands):
                low_um, high_um = bands.min() - 0.001, bands.max() + 0.001
                of_cube = f" (`texnet import CUBE --range {low_um:.3f}:{high_um:.3f}` keeps those)"
            raise InputError(
                f"library: its curves cover {low:g}-{high:g} um but the bands need "
                f"{w.min():.4g}-{w.max():.4g} um; take another library, or bands within its curves"
                f"{of_cube}."
            )
        return np.stack([np.interp(w, self.wavelength_um, e) for e in self.emissivity])

    def save(self, path):
        """Write a library file (JSON, see the module), one material a line, whole or not at all."""
        rows = [
            {"name": n, "emissivity": list(e), "hue_deg": h, "albedo_rgb": list(rgb),
             "description": text} | ({"level_sigma": level} if level else {})
            for n, e, h, rgb, text, level in zip(
                self.names, self.emissivity, self.hue_deg, self.albedo_rgb, self.descriptions,
                self.level_sigma, strict=True,
            )
        ]  # fmt: skip
        write_library_file(path, list(self.wavelength_um), rows)

    @staticmethod
    def load(path):
        """Read a library file (JSON, see the module); InputError says what is wrong."""
        instead = ""
        if Path(path).suffix.lower() != ".json":
            instead = "; texnet library import turns a .csv, .txt, .mat or ENVI library into one"
        return MaterialLibrary._from_json(read_json(path, "library", instead), path)

    @staticmethod
    def _from_json(data, path):
        try:
            rows, bands = data["materials"], len(data["wavelength_um"])
            for r in rows:
                _check_row(r, bands)
            return MaterialLibrary(
                [r["name"] for r in rows], data["wavelength_um"], [r["emissivity"] for r in rows],
                _fill_hues([r["name"] for r in rows], [r.get("hue_deg") for r in rows]),
                [r.get("albedo_rgb", GREY) for r in rows],
                [r.get("description", "") for r in rows],
                [r.get("level_sigma", 0.0) for r in rows],
            )  # fmt: skip
        except InputError as e:
            raise InputError(f"library: {path}: {str(e).removeprefix('library: ')}") from e
        except (KeyError, TypeError, ValueError, OverflowError) as e:
            lacks = f" (there is no {e})" if isinstance(e, KeyError) else ""
            raise InputError(
                f"library: {path} must be an object with wavelength_um, a list of numbers, and "
                "materials, a list of objects, each with its name and emissivity, as many "
                f"numbers{lacks}."
            ) from e

    @staticmethod
    @cache
    def starter():
        """The library that ships with the package; `texnet library rebuild` makes it."""
        path = files("physics") / "data" / "starter_library.json"
        return MaterialLibrary._from_json(json.loads(path.read_text(encoding="utf-8")), path)


def _holds(text, *categories):
    """Whether a character of text is of one of these categories of Unicode: Cc of control, or Cs,
    half a character, which no file can hold."""
    return not set(categories).isdisjoint(map(unicodedata.category, text))


def _is_number(x):
    return type(x) in (int, float)


OPTIONAL = {  # of a material in a library file: whether it is that, and in words
    "hue_deg": (_is_number, "a number"),
    "albedo_rgb": (
        lambda x: isinstance(x, list) and len(x) == 3 and all(map(_is_number, x)), "three numbers",
    ),
    "description": (lambda x: isinstance(x, str), "text"),
    "level_sigma": (_is_number, "a number"),
}  # fmt: skip


def _check_row(row, bands):
    """InputError unless a material of a library file has a name, an emissivity for each band, and
    nothing else but what is OPTIONAL."""
    name, e = row["name"], row["emissivity"]
    if not isinstance(name, str):
        raise InputError(f"the name of a material must be text, got {json.dumps(name)}.")
    if not isinstance(e, list) or not all(map(_is_number, e)):
        raise InputError(f"emissivity of {name} must be a list of numbers.")
    if len(e) != bands:
        raise InputError(
            f"emissivity of {name} must be {bands} numbers, one for each wavelength, got {len(e)}."
        )
    if unknown := row.keys() - {"name", "emissivity", *OPTIONAL}:
        raise InputError(
            f"{min(unknown)!r} of {name} is not known; besides its emissivity it may have "
            f"{', '.join(OPTIONAL)}."
        )
    for key, (fits, words) in OPTIONAL.items():
        if key in row and not fits(row[key]):
            raise InputError(f"{key} of {name} must be {words}, got {json.dumps(row[key])}.")


def _fill_hues(names, hue_deg):
    """Hues (n,) of all names, where hue_deg holds None for some: the starter library's, of names
    that it holds, and for the others hues between."""
    hues = list(hue_deg)
    if None not in hues:
        return np.array(hues, float)
    starter = MaterialLibrary.starter()
    for i, name in enumerate(names):
        if hues[i] is None and name in starter.names:
            hues[i] = starter.hue_deg[starter.index(name)]
    missing = [i for i, hue in enumerate(hues) if hue is None]
    between = hues_between([hue for hue in hues if hue is not None], len(missing))
    for i, hue in zip(missing, between, strict=True):
        hues[i] = hue
    return np.array(hues, float)


def hues_between(taken, n):
    """n hues, degrees, in the gaps that those taken leave on the circle, as even as these allow."""
    if not len(taken):
        return list(np.arange(n) * 360.0 / n)
    taken = np.sort(np.array(taken, float) % 360)
    gaps = np.diff(taken, append=taken[0] + 360)
    inside = np.zeros(len(gaps), int)
    for _ in range(n):
        inside[np.argmax(gaps / (inside + 1))] += 1
    steps = zip(taken, gaps, inside, strict=True)
    return [(t + g * (j + 1) / (m + 1)) % 360 for t, g, m in steps for j in range(m)]


def write_library_file(path, wavelength_um, materials):
    """Write lists of um and of dicts as a library file, one material a line, or nothing."""
    lines = ",\n".join(json.dumps(row, ensure_ascii=False) for row in materials)
    text = f'{{"wavelength_um": {json.dumps(wavelength_um)},\n"materials": [\n{lines}\n]}}\n'
    with whole_file(path) as part:
        part.write_text(text, encoding="utf-8")
